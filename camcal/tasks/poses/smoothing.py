"""What comes of `camcal smooth`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.kalman import Consistency
from camcal.estimate.trajectory_error import TrajectoryError
from camcal.tasks.poses.smooth_options import SmoothOptions

_MOST_STAMPS = 1_000_000


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
    before, after: errors of measured and smoothed poses against a reference. written: the files.
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
