"""What `camcal smooth` is asked for, and what comes of it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.consistency import Consistency
from camcal.estimate.smoothing.motion_models import MODELS, NOISE_FORMS, MotionModel
from camcal.estimate.smoothing.smooth import LARGEST, METHODS
from camcal.estimate.trajectory_error import ErrorOptions, TrajectoryError

ROBUST = ("none", "huber")

_MOST_STAMPS = 1_000_000


@dataclass(frozen=True)
class SmoothOptions:
    """What to smooth, by which motion and noise, and where everything goes.

    source: a trajectory, or a CSV of numbers over time (`columns`: of the time, then of what was measured). q, sigma:
    None for the most likely; one number, of poses two (translation, rotation). controls: a CSV of displacements.
    resample: s between the poses written, None for those measured. reference: a trajectory to compare poses with.
    frames, kind: what poses are and how they are written, None as their files say.
    """

    source: Path
    output: Path | None = None
    columns: tuple[str, ...] = ()
    model: str = "cv"
    form: str = "continuous"
    q: tuple[float, ...] | None = None
    sigma: tuple[float, ...] | None = None
    method: str = "rts"
    robust: str = "none"
    controls: Path | None = None
    resample: float | None = None
    reference: Path | None = None
    comparison: ErrorOptions = field(default_factory=ErrorOptions)
    plot: Path | None = None
    frames: str | None = None
    kind: str | None = None

    def __post_init__(self) -> None:
        for option, value, known in (
            ("--model", self.model, tuple(MODELS)),
            ("--process-noise-form", self.form, NOISE_FORMS),
            ("--method", self.method, METHODS),
            ("--robust", self.robust, ROBUST),
        ):
            if value not in known:
                raise InvalidInput(f"{option} {value!r}: use one of {', '.join(known)}")
        for option, numbers in (("--q", self.q), ("--sigma", self.sigma)):
            if numbers is not None and not all(1 / LARGEST < number < LARGEST for number in numbers):
                raise InvalidInput(
                    f"{option} must be more than 0, and a number to compute with; leave it out to have it estimated"
                )
        if self.resample is not None and not 0 < self.resample < np.inf:
            raise InvalidInput(f"--resample must be more than 0 s, found {self.resample:g}")
        if self.resample is not None and self.form == "discrete":
            raise InvalidInput("--resample needs continuous process noise: discrete noise has no state between samples")
        if self.method == "batch" and self.form == "discrete" and self.model != "rw":
            raise InvalidInput("--method batch needs continuous process noise: the discrete form has rank 1; use rts")

    @property
    def motion(self) -> MotionModel:
        """How things move."""
        return MotionModel(self.model, self.form)

    def grid(self, stamps: Array) -> Array | None:
        """Return the times (M,) in s that are wanted in place of those measured, from the first on; None: those."""
        if self.resample is None:
            return None
        steps = (stamps[-1] - stamps[0]) / self.resample
        if steps >= _MOST_STAMPS:
            raise InvalidInput(f"--resample {self.resample:g} s makes {steps:.3g} stamps of this; ask for fewer")
        return np.asarray(stamps[0] + self.resample * np.arange(int(steps + 1e-9) + 1))


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
