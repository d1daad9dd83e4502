"""The result of `camcal smooth`, as a record and as text."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.batch import OUTLIER_CONFIDENCE
from camcal.estimate.smoothing.kalman import Consistency
from camcal.estimate.trajectory_error import ErrorFigures, ErrorOptions, TrajectoryError
from camcal.report.track_words import consistency_details, consistency_line
from camcal.tasks.poses.smooth_options import SmoothOptions

_MOST_STAMPS = 1_000_000
_LISTED = 10
_UNITS = {"rw": ("m²/s", "rad²/s"), "cv": ("m²/s³", "rad²/s³"), "ca": ("m²/s⁵", "rad²/s⁵")}
Rows = list[list[object]]


def wanted_stamps(options: SmoothOptions, stamps: Array) -> Array | None:
    """Return the times (M,) in s that are wanted in place of those measured, from the first on; None: those."""
    if options.resample is None:
        return None
    steps = (stamps[-1] - stamps[0]) / options.resample
    if steps >= _MOST_STAMPS:
        raise InvalidInput(f"--resample {options.resample:g} s makes {steps:.3g} stamps of this; ask for fewer")
    return np.asarray(stamps[0] + options.resample * np.arange(int(steps + 1e-9) + 1))


@dataclass(frozen=True)
class Outlier:
    """A measurement that disagrees with all others: its number from 0, its time, and the column it stands in."""

    index: int
    t: float
    column: str | None


@dataclass(frozen=True, eq=False)
class Smoothing:
    """What came of smoothing. q, sigma: by name, sigma empty where every measurement has its own.

    nis: (N,) by column, or 'pose', of the measurements in the order of the file, NaN where none was predicted.
    residual: root mean square of measured minus smoothed, in the unit of the columns, or m and rad of poses.
    before, after: errors of measured and smoothed poses against a reference. written: the files; figures: those
    of figures.
    """

    options: SmoothOptions
    kind: str
    measured: int
    missing: int
    stamps: Array
    q: dict[str, float]
    sigma: dict[str, float]
    residual: dict[str, float]
    log_likelihood: float
    consistency: Consistency
    nis: dict[str, Array]
    outliers: tuple[Outlier, ...]
    before: TrajectoryError | None = None
    after: TrajectoryError | None = None
    written: tuple[Path, ...] = ()
    figures: tuple[Path, ...] = ()


def lines(found: Smoothing) -> Iterator[str]:
    """Yield what was smoothed, and with which noise."""
    span = found.stamps[-1] - found.stamps[0]
    missing = f", {found.missing} missing" if found.missing else ""
    yield f"{found.options.source}: {found.measured} measurements{missing} over {span:.6g} s"
    yield f"smoothed by {_model(found)}"
    yield f"process noise q {_noise(found.q, found, squared=True)}{_estimated(found.options.q is None)}"
    if found.sigma:
        yield f"measurement noise sigma {_noise(found.sigma, found)}{_estimated(found.options.sigma is None)}"
    yield f"residual RMS: {_noise(found.residual, found)}"


def consistency_lines(found: Smoothing) -> Iterator[str]:
    """Yield whether the covariances are reliable, and then what speaks for it."""
    yield consistency_line(found.consistency)
    if not found.consistency.innovations:
        return
    yield consistency_details(found.consistency)
    if found.options.q is None:
        yield "(q was estimated from the same data; validate with a second recording)"


def outlier_line(found: Smoothing, everything: bool) -> str:
    """Return which measurements disagree with all others; the first few, or every one."""
    named = [f"{outlier.t:.3f} s{f' ({outlier.column})' if outlier.column else ''}" for outlier in found.outliers]
    shown = named if everything else named[:_LISTED]
    rest = f" and {len(named) - len(shown)} more" if len(shown) < len(named) else ""
    what = "weights reduced" if found.options.robust != "none" else "--robust huber reduces their weights"
    chance = (1 - OUTLIER_CONFIDENCE) * found.measured
    return f"{len(named)} outliers ({chance:.2g} expected by chance; {what}): {', '.join(shown)}{rest}"


def evaluation_rows(
    options: ErrorOptions, before: TrajectoryError, after: TrajectoryError
) -> tuple[str, Sequence[str], Rows]:
    """Return title, columns and rows of the table of errors against a reference, mm and degrees."""
    motions = f"motions over {options.delta:g} {options.unit}"
    title = f"{after.poses} poses compared with the reference, alignment {options.alignment}; {motions}"
    rows: Rows = []
    for name, pick, scale in (
        ("absolute, mm", "translation", 1e3),
        ("absolute, deg", "rotation", degrees(1)),
        ("relative, mm", "relative_translation", 1e3),
        ("relative, deg", "relative_rotation", degrees(1)),
    ):
        for state, error in (("measured", before), ("smoothed", after)):
            figures: ErrorFigures | None = getattr(error, pick)
            if figures is not None:
                rows.append([name, state, *(scale * value for value in (figures.rmse, figures.median, figures.max))])
    return title, ("error", "", "RMS", "median", "largest"), rows


def _model(found: Smoothing) -> str:
    names = {"rw": "random walk", "cv": "constant velocity", "ca": "constant acceleration"}
    robust = ", Huber's loss" if found.options.robust != "none" else ""
    return f"{names[found.options.model]} ({found.options.form} noise{robust}), {found.options.method}"


def _noise(values: dict[str, float], found: Smoothing, squared: bool = False) -> str:
    """Return numbers with their names and, where poses give them, units."""
    if found.kind != "poses":
        return ", ".join(f"{value:.4g}" if name == "all" else f"{name} {value:.4g}" for name, value in values.items())
    units = ("m", "rad")
    if squared:
        units = _UNITS[found.options.model] if found.options.form == "continuous" else ("per step", "per step")
    return ", ".join(f"{name} {value:.4g} {unit}" for (name, value), unit in zip(values.items(), units, strict=True))


def _estimated(estimated: bool) -> str:
    return " (the most likely)" if estimated else ""
