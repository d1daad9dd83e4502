"""`camcal smooth`: smoothing of trajectories or series, with covariances and noise estimates."""

from collections.abc import Iterator, Sequence
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files, records
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.batch import OUTLIER_CONFIDENCE
from camcal.estimate.smoothing.kalman import NOT_JUDGED, Consistency
from camcal.estimate.smoothing.poses import PosesOptions, SmoothedPoses, poses_at, smooth_poses
from camcal.estimate.smoothing.series import Series, SeriesOptions, SmoothedSeries, series_at, smooth_series
from camcal.estimate.trajectory_error import ErrorFigures, ErrorOptions, TrajectoryError, trajectory_error
from camcal.formats import series as tables
from camcal.formats import trajectories
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.figures.figure import encoded
from camcal.report.figures.over_time import Panel, broken_at_half_turns, over_time
from camcal.report.figures.trajectories import path_of, trajectory_plots
from camcal.report.track_words import consistency_details, consistency_line
from camcal.run.outputs import writes
from camcal.tasks.figure_files import figure_data, write_figures
from camcal.tasks.poses.smooth_options import SmoothOptions

_MOST_STAMPS = 1_000_000
_LISTED = 10
_UNITS = {"rw": ("m²/s", "rad²/s"), "cv": ("m²/s³", "rad²/s³"), "ca": ("m²/s⁵", "rad²/s⁵")}
_MODELS = {"rw": "random walk", "cv": "constant velocity", "ca": "constant acceleration"}
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
    options, robust = found.options, ", Huber's loss" if found.options.robust != "none" else ""
    yield f"smoothed by {_MODELS[options.model]} ({options.form} noise{robust}), {options.method}"
    likeliest = {True: " (the most likely)", False: ""}
    yield f"process noise q {_noise(found.q, found, squared=True)}{likeliest[options.q is None]}"
    if found.sigma:
        yield f"measurement noise sigma {_noise(found.sigma, found)}{likeliest[options.sigma is None]}"
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


def _noise(values: dict[str, float], found: Smoothing, squared: bool = False) -> str:
    """Return numbers with their names and, where poses give them, units."""
    if found.kind != "poses":
        return ", ".join(f"{value:.4g}" if name == "all" else f"{name} {value:.4g}" for name, value in values.items())
    units = ("m", "rad")
    if squared:
        units = _UNITS[found.options.model] if found.options.form == "continuous" else ("per step", "per step")
    return ", ".join(f"{name} {value:.4g} {unit}" for (name, value), unit in zip(values.items(), units, strict=True))


_PARTS = ("translation", "rotation")
_SMOOTHED_ALREADY = "poses are smoothed already ({}), their errors are correlated: smooth the measured poses instead"
_NOISELESS = 1e-6  # residual over the path's length
_AXES = ("tx, m", "ty, m", "tz, m", "rx, rad", "ry, rad", "rz, rad")


@writes
def smooth(options: SmoothOptions, progress: Progress = SILENT) -> Smoothing:
    """Return what came of smoothing, everything asked for written.

    Raises InvalidInput and FileError for what cannot be read, InsufficientData naming what is not observed.
    """
    found = smooth_table(options) if _is_table(options) else smooth_trajectory(options, progress)
    if found.consistency.warning is not None:
        progress.warn(found.consistency.warning)
    return found


def document(found: Smoothing) -> dict[str, Any]:
    """Return what came of smoothing as plain data for --json."""
    options = found.options
    return {
        "source": options.source,
        "kind": found.kind,
        "measurements": found.measured,
        "missing": found.missing,
        "stamps": len(found.stamps),
        "span_s": float(found.stamps[-1] - found.stamps[0]),
        "model": options.model,
        "process_noise_form": options.form,
        "method": options.method,
        "robust": options.robust,
        "q": found.q,
        "q_estimated": options.q is None,
        "sigma": found.sigma,
        "sigma_estimated": options.sigma is None and bool(found.sigma),
        "residual_rms": found.residual,
        "log_likelihood": found.log_likelihood,
        "consistency": found.consistency.data(),
        "nis": found.nis,
        "outliers": found.outliers,
        "evaluation": evaluation(found),
        "written": found.written,
        **figure_data(found.figures),
    }


def _is_table(options: SmoothOptions) -> bool:
    is_csv, of_table = files.suffix_of(options.source) == ".csv", bool(options.columns) or options.controls is not None
    if of_table and not is_csv:
        raise InvalidInput("--columns and --input go with a CSV of numbers over time", where=str(options.source))
    return of_table or (is_csv and not trajectories.is_trajectory_csv(options.source))


def smooth_table(options: SmoothOptions) -> Smoothing:
    """Return what came of smoothing the columns of a table, everything asked for written."""
    if options.reference is not None or options.kind is not None or options.frames is not None:
        raise InvalidInput("--evaluate, --format and --frames go with poses, not with a table of other numbers")
    if options.output is not None and not files.is_stream(options.output):
        tables.require_suffix(options.output)
    series = _read_series(options)
    grid = wanted_stamps(options, series.stamps)
    if options.q is not None and len(options.q) != 1:
        raise InvalidInput(f"--q has {len(options.q)} numbers; a table has one")
    q = None if options.q is None else options.q[0]
    smoothed = smooth_series(series, SeriesOptions(options.motion, q, options.method, options.robust != "none"))
    shown = smoothed if grid is None else series_at(smoothed, grid)
    if options.output is not None:
        tables.write(options.output, shown)
    if options.plot is not None:
        files.write_bytes(options.plot, encoded(over_time(_table_panels(smoothed, shown)), options.plot.suffix))
    figures = write_figures(options.figures, (over_time(_table_panels(smoothed, shown)),))
    return replace(_of_table(options, smoothed, shown), figures=figures)


def _read_series(options: SmoothOptions) -> Series:
    series = tables.read(options.source, options.columns)
    if options.sigma is not None:
        sigma = np.array(options.sigma)
        if len(sigma) not in (1, len(series.names)):
            raise InvalidInput(f"--sigma has {len(sigma)} numbers; one, or one for each of {', '.join(series.names)}")
        series = replace(series, sigma=np.broadcast_to(sigma, series.values.shape))
    if options.controls is not None:
        series = replace(series, controls=tables.read_controls(options.controls, series))
    return series


def _of_table(options: SmoothOptions, smoothed: SmoothedSeries, shown: SmoothedSeries) -> Smoothing:
    series = smoothed.series
    off = series.values - smoothed.states[:, :, 0]
    outliers = [
        Outlier(int(row), float(series.stamps[row]), series.names[axis]) for row, axis in np.argwhere(smoothed.outliers)
    ]
    return Smoothing(
        options,
        "series",
        measured=int(np.isfinite(series.values).sum()),
        missing=int(np.isnan(series.values).sum()),
        stamps=shown.series.stamps,
        q={"all": smoothed.q},
        sigma=_sigma(options, smoothed),
        residual={name: _rms(off[:, axis]) for axis, name in enumerate(series.names)},
        log_likelihood=smoothed.log_likelihood,
        consistency=smoothed.consistency,
        nis=dict(zip(series.names, smoothed.nis.T, strict=True)),
        outliers=tuple(outliers),
        written=options.outputs(),
    )


def _sigma(options: SmoothOptions, smoothed: SmoothedSeries) -> dict[str, float]:
    """Return the standard deviation of measurements by column, empty if the table has one for each."""
    if smoothed.sigma is not None:
        return {"all": smoothed.sigma}
    if options.sigma is None:
        return {}
    return dict(zip(smoothed.series.names, np.resize(options.sigma, len(smoothed.series.names)).tolist(), strict=True))


def _table_panels(measured: SmoothedSeries, shown: SmoothedSeries) -> list[Panel]:
    return [
        Panel(
            name,
            (shown.series.stamps, shown.states[:, axis, 0], np.sqrt(shown.covariances[:, axis, 0, 0])),
            (measured.series.stamps, measured.series.values[:, axis]),
            measured.outliers[:, axis],
        )
        for axis, name in enumerate(measured.series.names)
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def smooth_trajectory(options: SmoothOptions, progress: Progress) -> Smoothing:
    """Return what came of smoothing poses, everything asked for written."""
    if options.output is not None:
        trajectories.kind_of(options.output, options.kind)
    measured = trajectories.read(options.source, options.frames)
    grid = wanted_stamps(options, measured.stamps)
    reference = None
    if options.reference is not None:
        reference, repeated = trajectories.read_reference(options.reference)
        if repeated:
            text = f"{repeated} poses with repeated time stamps skipped"
            progress.warn(Message("repeated_stamps", text, {"poses": repeated}, str(options.reference)))
    how = PosesOptions(
        options.motion,
        _pair("--q", options.q),
        _pair("--sigma", options.sigma),
        options.method,
        options.robust != "none",
    )
    smoothed = smooth_poses(measured, how)
    shown = smoothed.trajectory if grid is None else poses_at(measured, smoothed, how, grid)
    errors = [
        None if reference is None else trajectory_error(each, reference, options.comparison)
        for each in (measured, shown)
    ]
    if options.output is not None:
        trajectories.write(options.output, shown, options.kind)
    if options.plot is not None:
        files.write_bytes(
            options.plot, encoded(over_time(_pose_panels(measured, smoothed, shown)), options.plot.suffix)
        )
    found = _of_poses(options, measured, smoothed, shown, (errors[0], errors[1]))
    path = np.linalg.norm(np.diff(measured.translations, axis=0))
    noiseless = found.residual["translation"] < _NOISELESS * path and found.consistency.warning is not None
    if measured.velocities is not None or noiseless:  # which only a filter knows, or leaves
        said = "no noise, but correlated innovations" if measured.velocities is None else "they have velocities"
        warning = Message("smoothed_already", _SMOOTHED_ALREADY.format(said))
        found = replace(found, consistency=replace(found.consistency, verdict=NOT_JUDGED, warning=warning))
    if options.figures.folder is None:
        return found
    drawn = trajectory_plots(path_of(shown, reference, options.comparison))
    panels = over_time(_pose_panels(measured, smoothed, shown))
    return replace(found, figures=write_figures(options.figures, (*drawn, panels)))


def evaluation(found: Smoothing) -> dict[str, Any] | None:
    """Return errors against a reference before and after smoothing as plain data, None without one."""
    if found.before is None or found.after is None:
        return None
    comparison = found.options.comparison
    return {
        "alignment": comparison.alignment,
        "delta": comparison.delta,
        "delta_unit": comparison.unit,
        **{
            state: {
                "poses": error.poses,
                "scale": error.alignment.scale,
                "pairs": error.pairs,
                **records.figures(error),
            }
            for state, error in (("measured", found.before), ("smoothed", found.after))
        },
    }


def _of_poses(
    options: SmoothOptions,
    measured: Trajectory,
    smoothed: SmoothedPoses,
    shown: Trajectory,
    errors: tuple[TrajectoryError | None, TrajectoryError | None],
) -> Smoothing:
    found = smoothed.trajectory
    shift = np.linalg.norm(measured.translations - found.translations, axis=1)
    turn = so3.angle_between(found.rotations, measured.rotations)
    outliers = [Outlier(int(row), float(measured.stamps[row]), None) for row in np.flatnonzero(smoothed.outliers)]
    return Smoothing(
        options,
        "poses",
        measured=len(measured),
        missing=0,
        stamps=shown.stamps,
        q=dict(zip(_PARTS, smoothed.q, strict=True)),
        sigma={} if smoothed.sigma is None else dict(zip(_PARTS, smoothed.sigma, strict=True)),
        residual=dict(zip(_PARTS, (_rms(shift), _rms(turn)), strict=True)),
        log_likelihood=smoothed.log_likelihood,
        consistency=smoothed.consistency,
        nis={"pose": smoothed.nis},
        outliers=tuple(outliers),
        before=errors[0],
        after=errors[1],
        written=options.outputs(),
    )


def _pose_panels(measured: Trajectory, smoothed: SmoothedPoses, shown: Trajectory) -> list[Panel]:
    """Return translations, and rotations as vectors from the first one; without what covariances cannot say."""
    first = smoothed.trajectory.rotations[0].T
    lines, points = (np.hstack([poses.translations, so3.log(poses.rotations @ first)]) for poses in (shown, measured))
    lines[:, 3:] = broken_at_half_turns(lines[:, 3:])
    covariances = shown.covariances if shown.covariances is not None else np.zeros((len(shown), 6, 6))
    std = np.sqrt(np.einsum("kii->ki", covariances))
    return [
        Panel(name, (shown.stamps, lines[:, k], std[:, k]), (measured.stamps, points[:, k]), smoothed.outliers)
        for k, name in enumerate(_AXES)
    ]


def _pair(option: str, numbers: tuple[float, ...] | None) -> tuple[float, float] | None:
    if numbers is None:
        return None
    if len(numbers) != 2:
        raise InvalidInput(f"{option} has {len(numbers)} numbers; poses have two: of translation and of rotation")
    return numbers[0], numbers[1]
