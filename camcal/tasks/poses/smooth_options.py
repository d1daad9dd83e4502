"""The options of `camcal smooth`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.errors import InvalidInput
from camcal.options import (
    INPUT,
    NAMES,
    NUMBER,
    NUMBERS,
    OUTPUT,
    Argument,
    Option,
    OptionsRecord,
    ValueType,
)
from camcal.parsing import parse_number
from camcal.tasks.options import (
    FIGURES,
    NO_FIGURES,
    TRAJECTORY,
    FigureOptions,
    Overwrite,
    output_option,
)
from camcal.tasks.poses.options import AUTO

if TYPE_CHECKING:
    from camcal.estimate.smoothing.linear_system import MotionModel
    from camcal.estimate.trajectory_error import ErrorOptions

MODELS = ("rw", "cv", "ca")
NOISE_FORMS = ("continuous", "discrete")
METHODS = ("rts", "batch")
ROBUST = ("none", "huber")
_LARGEST = 1e50  # of noise: its square, and products of these, are numbers


def _read_delta(text: str) -> tuple[float, str]:
    """Return a number and its unit: frames, m or s."""
    unit = text[-1:] if text[-1:] in {"m", "s"} else "frames"
    number = parse_number(text.removesuffix(unit))
    if not math.isfinite(number):
        raise ValueError(text)
    return number, unit


def _write_delta(delta: tuple[float, str]) -> str:
    return NUMBER.write(delta[0]) + ("" if delta[1] == "frames" else delta[1])


@dataclass(frozen=True)
class SmoothOptions(OptionsRecord):
    """What to smooth, by which motion and noise, and where everything goes.

    source: a trajectory, or a CSV of numbers over time (`columns`: of the time, then of what was measured). q, sigma:
    None for the most likely; one number, of poses two (translation, rotation). controls: a CSV of displacements.
    resample: s between the poses written, None for those measured. reference: a trajectory to compare poses with, by
    alignment, over motions of delta. frames, kind: what poses are and how they are written, None as their files say.
    """

    source: Annotated[
        Path,
        Argument(
            "Poses over time (.tum, .csv, .yaml, .json, KITTI, EuRoC), or a CSV of other numbers over time.",
            metavar="FILE",
        ),
    ]
    output: Annotated[
        Path | None,
        output_option("Smoothed poses (.tum .csv .yaml .json), or numbers (.csv .json).", TRAJECTORY),
    ] = None
    columns: Annotated[
        tuple[str, ...],
        Option(
            "Columns of a CSV: time, then the columns to smooth; by default all.",
            metavar="T,X[,Y…]",
            group=INPUT,
            type=NAMES,
        ),
    ] = ()
    model: Annotated[
        str,
        Option(
            "Motion model: random walk, constant velocity or constant acceleration.", metavar="rw|cv|ca", choices=MODELS
        ),
    ] = "cv"
    form: Annotated[
        str,
        Option(
            "Process noise: continuous white noise, or discrete (one value per step).",
            metavar="continuous|discrete",
            names="--process-noise-form",
            choices=NOISE_FORMS,
        ),
    ] = "continuous"
    q: Annotated[
        tuple[float, ...] | None,
        Option(
            "Process noise; two values for poses: 0.02,0.5; auto (default): maximum likelihood.",
            metavar="NUMBER|auto",
            type=ValueType(lambda text: None if text == AUTO else NUMBERS.read(text), NUMBERS.write, NUMBERS.needed),
        ),
    ] = None
    sigma: Annotated[
        tuple[float, ...] | None,
        Option(
            "Measurement noise (standard deviation); two values for poses (m,rad); by default from "
            "the file, else estimated.",
            metavar="NUMBER[,…]",
            type=NUMBERS,
        ),
    ] = None
    method: Annotated[
        str,
        Option(
            "Kalman filter and RTS smoother, or batch; the result is the same.", metavar="rts|batch", choices=METHODS
        ),
    ] = "rts"
    robust: Annotated[
        str, Option("Robust smoothing: reduce the weight of outliers.", metavar="none|huber", choices=ROBUST)
    ] = "none"
    controls: Annotated[
        Path | None,
        Option(
            "Control input: a CSV of known displacements, time and one column per series.",
            metavar="FILE",
            group=INPUT,
            names="--input",
        ),
    ] = None
    resample: Annotated[
        float | None,
        Option("Output interval; states are interpolated between measurements.", metavar="SECONDS", group=OUTPUT),
    ] = None
    reference: Annotated[
        Path | None,
        Option(
            "Reference trajectory for absolute and relative errors.",
            metavar="FILE",
            group=INPUT,
            names="--evaluate",
        ),
    ] = None
    alignment: Annotated[
        str,
        Option("Alignment to the reference before comparing.", metavar="none|se3|sim3|yaw", names="--align"),
    ] = "se3"
    delta: Annotated[
        tuple[float, str],
        Option(
            "Interval of relative errors: frames, metres or seconds.",
            metavar="NUMBER[m|s]",
            type=ValueType(_read_delta, _write_delta, "a number of frames, or one with m or s behind it"),
        ),
    ] = (1.0, "frames")
    plot: Annotated[
        Path | None,
        Option("Plot over time: .png, .svg or .pdf.", metavar="FILE", group=OUTPUT, recorded=False, written=FIGURES),
    ] = None
    frames: Annotated[
        str | None, Option("Direction of the poses, if the file does not state it.", metavar="A_T_B", group=INPUT)
    ] = None
    kind: Annotated[
        str | None,
        Option(
            "Output format: tum, csv, yaml, json, kitti or tf; by default by the suffix.",
            metavar="NAME",
            group=OUTPUT,
            names="--format",
        ),
    ] = None
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for option, numbers in (("--q", self.q), ("--sigma", self.sigma)):
            if numbers is not None and not all(1 / _LARGEST < number < _LARGEST for number in numbers):
                raise InvalidInput(
                    f"{option} must be more than 0, and a number to compute with; leave it out to have it estimated"
                )
        if self.resample is not None and not 0 < self.resample < math.inf:
            raise InvalidInput(f"--resample must be more than 0 s, found {self.resample:g}")
        if self.resample is not None and self.form == "discrete":
            raise InvalidInput("--resample needs continuous process noise: discrete noise has no state between samples")
        if self.method == "batch" and self.form == "discrete" and self.model != "rw":
            raise InvalidInput("--method batch needs continuous process noise: the discrete form has rank 1; use rts")
        _ = self.comparison  # which refuses what is none

    def outputs(self) -> tuple[Path, ...]:
        """Return the files to be written."""
        return tuple(path for path in (self.output, self.plot) if path is not None)

    @property
    def motion(self) -> "MotionModel":
        """How things move."""
        from camcal.estimate.smoothing.linear_system import MotionModel

        return MotionModel(self.model, self.form)

    @property
    def comparison(self) -> "ErrorOptions":
        """How poses are compared with the reference."""
        from camcal.estimate.trajectory_error import ErrorOptions

        return ErrorOptions(self.alignment, *self.delta)
