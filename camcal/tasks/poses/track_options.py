"""The options of `camcal track`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, ValueType, Without, separated
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

POSE_SUFFIXES = (".yaml", ".yml", ".json")
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAME = "name"
_STRENGTHS = separated("auto, or two numbers such as 0.02,0.5", count=2)


@dataclass(frozen=True)
class Timing(OptionsRecord):
    """Where the times of frames come from; without anything, from the video.

    fps: frames follow one another at this rate. source: a file of times, "exif", "name" for the last number of the
    names, or "name:REGEX" for the first group of a pattern; with fps too, that number counts frames. unit: of the
    numbers of files and names, one of UNITS.
    """

    fps: Annotated[
        float | None, Option("Frames per second; by default from the video.", metavar="RATE", group=INPUT)
    ] = None
    source: Annotated[
        str | None,
        Option(
            "Times of the frames: a file (a line each, or CSV with image,t), the last number of their names or "
            "name:REGEX (with --fps it counts frames), or EXIF.",
            metavar="FILE|name|exif",
            group=INPUT,
            names="--timestamps",
        ),
    ] = None
    unit: Annotated[
        str,
        Option(
            "Unit of times in files and names.",
            metavar="s|ms|us|ns",
            group=INPUT,
            names="--time-unit",
            choices=tuple(UNITS),
        ),
    ] = "s"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fps is not None and not (math.isfinite(self.fps) and self.fps > 0):
            raise InvalidInput(f"--fps must be more than 0, found {self.fps:g}")
        if self.fps is not None and self.source is not None and not self.by_name:
            raise InvalidInput("--fps and --timestamps are redundant, except with frame numbers in names")

    @property
    def by_name(self) -> bool:
        """Whether names tell the times."""
        return self.source is not None and self.source.partition(":")[0] == _NAME


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
    fill: Annotated[bool, Option("Interpolate poses of frames without a detection, within a track segment only.")] = (
        False
    )
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
