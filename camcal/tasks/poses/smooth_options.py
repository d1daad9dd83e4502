"""The options of `camcal smooth` and `camcal track`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass, field
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
    Without,
    separated,
)
from camcal.parsing import parse_number
from camcal.tasks.options import (
    FIGURES,
    NO_FIGURES,
    TRAJECTORY,
    CameraName,
    FigureOptions,
    GivenCamera,
    Overwrite,
    output_option,
)
from camcal.tasks.poses.options import AUTO, DetectionOptions
from camcal.tasks.timing import Timing

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


POSE_SUFFIXES = (".yaml", ".yml", ".json")
_STRENGTHS = separated("auto, or two numbers such as 0.02,0.5", count=2)


@dataclass(frozen=True)
class TrackingOptions(OptionsRecord):
    """A camera file (FILE or FILE#NAME) and the video or images it took; or a pose file alone.

    given: the camera itself; all inputs are images or a video then.

    name: of the camera in its file. noise_px: standard deviation of every pixel coordinate, None to find it out.
    timing: when frames were taken. object: the one to follow, None for all; tag_id: the same by the id of a tag.
    process_noise: strength of the accelerations (m²/s³, rad²/s³), None for what the frames make likeliest. pose: what
    is written, such as object_T_camera; None as the form wants it. kind: of the output, one of the forms of
    trajectories or None.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "Camera file (or FILE#NAME; left out with --camera-matrix) and a video, a folder or images; or a pose "
            "file of 'camcal pnp' alone.",
            metavar="CAMERA VIDEO|IMAGES… | POSES",
        ),
    ]
    given: GivenCamera = field(default_factory=GivenCamera)
    detection: Annotated[DetectionOptions, Without(("board_shape", "scale", "repeated_ids", "batch.resume"))] = field(
        default_factory=DetectionOptions
    )
    object: Annotated[str | None, Option("Object to track; by default all.", metavar="NAME", group=INPUT)] = None
    tag_id: Annotated[
        int | None, Option("Object to track, by tag id.", metavar="N", group=INPUT, names="--id", least=0)
    ] = None
    output: Annotated[
        Path | None,
        output_option(
            "Output file: .csv, .yaml or .json with all frames and their state; .tum with poses only.", TRAJECTORY
        ),
    ] = None
    kind: Annotated[
        str | None,
        Option(
            "Output format with poses only: tum, kitti or tf (ROS transforms as .yaml).",
            metavar="NAME",
            group=OUTPUT,
            names="--format",
        ),
    ] = None
    plot: Annotated[
        Path | None,
        Option(
            "Plot of positions, angles and NIS over time: .png, .svg or .pdf.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=FIGURES,
        ),
    ] = None
    pose: Annotated[
        str | None,
        Option(
            "camera_T_object, or object_T_camera, which is the default for .tum: a camera's path.",
            metavar="NAME",
            group=OUTPUT,
        ),
    ] = None
    timing: Timing = field(default_factory=Timing)
    process_noise: Annotated[
        tuple[float, float] | None,
        Option(
            "Process noise (power spectral density of the acceleration), m²/s³ and rad²/s³; auto "
            "(default): maximum likelihood.",
            metavar="auto|QV,QW",
            type=ValueType(
                lambda text: None if text == AUTO else _STRENGTHS.read(text), _STRENGTHS.write, _STRENGTHS.needed
            ),
        ),
    ] = None
    gate: Annotated[
        float, Option("Gate for a pose file: detections less likely than 1 - P are rejected.", metavar="P")
    ] = 0.999
    max_gap: Annotated[float, Option("Longest time without a detection within a track segment.", metavar="SECONDS")] = (
        1.0
    )
    fill: Annotated[bool, Option("Also poses of frames without an accepted detection, within a track segment.")] = False
    causal: Annotated[bool, Option("Filter only: every pose from the frames up to it.")] = False
    lag: Annotated[
        int | None, Option("Fixed-lag smoothing: every pose from the frames up to N later.", metavar="N", least=0)
    ] = None
    noise_px: Annotated[
        float | None,
        Option(
            "Standard deviation of a pixel coordinate; by default from corner detection and the residuals.",
            metavar="PX",
            names="--noise",
        ),
    ] = None
    name: CameraName = None
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.causal and self.lag:
            raise InvalidInput("--causal and --lag exclude each other")
        if self.object is not None and self.tag_id is not None:
            raise InvalidInput("--object and --id exclude each other")
        self.given.without_file(self.inputs)

    @property
    def camera(self) -> str | None:
        """The camera file, None for a camera that is given itself and for a pose file."""
        return self.inputs[0] if self.given.camera_matrix is None and names_camera(self.inputs) else None

    @property
    def of_poses(self) -> bool:
        """Whether a pose file is followed."""
        return self.given.camera_matrix is None and self.camera is None

    @property
    def frames(self) -> tuple[str, ...]:
        """The video or images, or the pose file."""
        if self.given.camera_matrix is not None:
            return self.inputs
        return self.inputs[1:] if self.camera else self.inputs[-1:]


def names_camera(arguments: Sequence[str]) -> bool:
    """Return whether the first of the arguments is the camera of what follows; a pose file needs none."""
    return len(arguments) > 2 or (len(arguments) == 2 and Path(arguments[1]).suffix.lower() not in POSE_SUFFIXES)
