"""The options of `camcal pnp`, and those that it shares with `camcal track`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.options import (
    BOARD,
    CHECKS,
    DEGREES,
    INPUT,
    NUMBER,
    OUTPUT,
    Argument,
    Option,
    OptionsRecord,
    ValueType,
    separated,
)
from camcal.parsing import parse_number
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.tasks.options import (
    PICTURES,
    POSES,
    BoardText,
    CameraName,
    GivenCamera,
    Jobs,
    Overwrite,
    Recursive,
    output_option,
)

if TYPE_CHECKING:
    from camcal.formats.poses.record import PoseRecord

AUTO = "auto"
OUTLIERS = (AUTO, "none", "few", "many")
REPEATED_IDS = ("drop", "keep")

_REASON = 1e-12, 1e12  # m or rad, between which a standard deviation is one that can be computed with
_PAIR = separated("METRES,DEGREES such as 0.05,2", count=2)


def _read_sigma(text: str) -> tuple[float, float]:
    metres, degrees = _PAIR.read(text)
    return metres, math.radians(degrees)


def or_auto(needed: str) -> ValueType:
    """Return the type of a number, or of the word auto."""
    return ValueType(
        lambda text: text if text == AUTO else parse_number(text),
        lambda value: value if value == AUTO else NUMBER.write(value),
        f"{needed}, or auto",
    )


@dataclass(frozen=True)
class DetectionOptions(OptionsRecord):
    """What is searched for, and how: a board (file or short form) or tags (file or short form).

    board_shape: take the board as the camera file says it is, not as drawn. scale: fit the camera to resized images.
    repeated_ids: what becomes of single tags that an image shows more than once, "drop" or "keep".
    """

    board: BoardText = None
    tags: Annotated[
        str | None,
        Option(
            "A tag file, or a short form such as tag36h11:53mm or tag36h11:53mm:0,1,5.", metavar="TAGS", group=BOARD
        ),
    ] = None
    board_shape: Annotated[
        bool, Option("Use the board shape of the camera file instead of a planar board as designed.", group=BOARD)
    ] = True
    scale: Annotated[
        bool,
        Option(
            "Rescale the intrinsics to images that were resized (not cropped).", group=INPUT, names="--scale-intrinsics"
        ),
    ] = False
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    repeated_ids: Annotated[
        str,
        Option(
            "Tags whose id occurs more than once in an image: drop them, or keep them as tag_5, "
            "tag_5_2, … from top to bottom.",
            metavar="drop|keep",
            group=BOARD,
            choices=REPEATED_IDS,
        ),
    ] = "drop"


CONSISTENT = "consistent"
INCONSISTENT = ("other_camera", "residuals_exceed_noise")
_GATES = {
    **dict.fromkeys(INCONSISTENT, f"--require {CONSISTENT}"),
    "pose_rms": "--max-rms",
    "pose_ambiguity": "--max-ambiguity",
    "pose_inliers": "--min-inliers",
}


@dataclass(frozen=True)
class Gates(OptionsRecord):
    """What poses must hold: the largest RMS (px), the largest probability of being wrong, the fewest inliers; require:
    that the residuals are as large as the noise says.
    """

    max_rms: Annotated[
        float | None, Option("Exit with 7 if the RMS of the residuals of a pose is larger.", metavar="PX", group=CHECKS)
    ] = None
    max_ambiguity: Annotated[
        float | None,
        Option(
            "Exit with 7 if the probability of the alternative pose is larger; try 0.01.", metavar="P", group=CHECKS
        ),
    ] = None
    min_inliers: Annotated[
        int | None, Option("Exit with 7 if a pose has fewer inliers.", metavar="N", group=CHECKS, least=1)
    ] = None
    require: Annotated[
        str | None,
        Option(
            "Exit with 7 if the residuals exceed the noise that is given, or that detection and calibration expect: "
            "the camera file may be of another camera. The poses are written all the same.",
            metavar=CONSISTENT,
            group=CHECKS,
            choices=(CONSISTENT,),
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_rms is not None and not self.max_rms > 0:
            raise InvalidInput(f"--max-rms must be more than 0 px, found {self.max_rms:g}")
        if self.max_ambiguity is not None and not 0 <= self.max_ambiguity <= 1:
            raise InvalidInput(f"--max-ambiguity is a probability, 0 … 1, found {self.max_ambiguity:g}")

    def failures(self, record: "PoseRecord") -> Iterator[Message]:
        """Yield the gates that a pose does not pass."""
        if self.max_rms is not None and record.rms_px > self.max_rms:
            text = f"reprojection RMS {record.rms_px:.3g} px (limit {self.max_rms:g} px)"
            yield Message("pose_rms", text, {"rms_px": record.rms_px, "limit_px": self.max_rms})
        if self.max_ambiguity is not None and record.p_wrong > self.max_ambiguity:
            text = f"probability of a wrong pose {record.p_wrong:.2g} (limit {self.max_ambiguity:g})"
            yield Message("pose_ambiguity", text, {"p_wrong": record.p_wrong, "limit": self.max_ambiguity})
        if self.min_inliers is not None and record.n_inliers < self.min_inliers:
            text = f"{record.n_inliers} of {record.n_points} points are inliers (limit {self.min_inliers})"
            yield Message("pose_inliers", text, {"inliers": record.n_inliers, "limit": self.min_inliers})

    def named(self, failures: Sequence[Message]) -> str:
        """Return the options that these failures are of."""
        codes = {failure.code for failure in failures}
        return ", ".join(option for code, option in _GATES.items() if code in codes)


@dataclass(frozen=True)
class PriorOptions(OptionsRecord):
    """A pose that is known beforehand: a file, None for no such pose, and the standard deviations (m, rad).

    sigma: of place and direction, None for those that a pose file has.
    """

    path: Annotated[
        Path | None,
        Option(
            "Prior pose: a pose file with one pose, or a matrix as text.",
            metavar="FILE",
            group=INPUT,
            names="--prior",
        ),
    ] = None
    sigma: Annotated[
        tuple[float, float] | None,
        Option(
            "Standard deviation of --prior; by default from the pose file.",
            metavar="METRES,DEGREES",
            group=INPUT,
            names="--prior-sigma",
            type=ValueType(
                _read_sigma, lambda sigma: f"{NUMBER.write(sigma[0])},{DEGREES.write(sigma[1])}", _PAIR.needed
            ),
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sigma is None:
            return
        if self.path is None:
            raise InvalidInput("--prior-sigma needs --prior")
        if not min(self.sigma) > 0:
            raise InvalidInput(f"--prior-sigma must be positive, found {self.sigma[0]:g} m, {self.sigma[1]:g} rad")
        if not _REASON[0] <= min(self.sigma) <= max(self.sigma) <= _REASON[1]:
            raise InvalidInput(f"--prior-sigma {self.sigma[0]:g} m, {self.sigma[1]:g} rad is implausible")


@dataclass(frozen=True)
class PnpOptions(OptionsRecord):
    """A camera file (FILE or FILE#NAME), or a rig's, and what was seen: `points`, or `inputs` of a board or of tags.

    given: the camera itself; what stands for its file is an input then.

    points: a file of correspondences. inputs: images, videos, folders and globs, or one detections file; of a rig
    CAMERA=PATH. rig: the camera file of a rig; what stands for the camera is an input then. name: of the camera in its
    file. pose: camera_T_object, object_T_camera (of a rig: of its frame). outliers: auto is many for points, few for
    boards and tags. noise_px: standard deviation of every pixel coordinate, of weight 1 where pixels have weights;
    "auto": from the residuals. noise_scale: in its place, the factor on the standard deviations that the pixels come
    with; None: 1 for those of the points' file, otherwise as "auto", from the residuals. intrinsics: propagate the
    camera's covariance. draw: a folder for pictures.
    """

    camera: Annotated[
        str | None, Argument("Camera file, or FILE#NAME; left out with --camera-matrix and --rig.", metavar="CAMERA")
    ] = None
    given: GivenCamera = field(default_factory=GivenCamera)
    points: Annotated[
        Path | None,
        Option(
            "Correspondences as .csv, .yaml or .json: X,Y,Z (metres), u,v (pixels), optionally image, id, camera "
            "and sigma (px), suu,suv,svv (px²) or weight.",
            metavar="FILE",
            group=INPUT,
        ),
    ] = None
    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "Images of a board or of tags, videos, folders, globs; or one detections file. With --rig NAME=IMAGES "
            "for each camera, such as left=photos/left right=photos/right.",
            metavar="IMAGES…|DETECTIONS",
        ),
    ] = ()
    detection: DetectionOptions = field(default_factory=DetectionOptions)
    rig: Annotated[
        Path | None,
        Option(
            "Rig: a camera file with several cameras and transforms; one pose per instant from all cameras.",
            metavar="FILE",
            group=INPUT,
        ),
    ] = None
    output: Annotated[
        Path | None,
        output_option("Output file of the poses: .yaml, .json or .csv.", POSES),
    ] = None
    draw: Annotated[
        Path | None,
        Option(
            "Pictures of the axes, projected points and enlarged residuals: a folder, for one image a file.",
            metavar="PATH",
            group=OUTPUT,
            recorded=False,
            written=PICTURES,
        ),
    ] = None
    name: CameraName = None
    pose: Annotated[
        str | None,
        Option(
            "camera_T_object (default) or object_T_camera; for a rig the frame `rig` or its first "
            "camera replaces `camera`.",
            metavar="NAME",
            group=OUTPUT,
        ),
    ] = None
    outliers: Annotated[
        str,
        Option(
            "none; few (rejected after a fit to all points); many (RANSAC). By default many for "
            "--points and few for boards and tags.",
            metavar="auto|none|few|many",
            choices=OUTLIERS,
        ),
    ] = AUTO
    threshold_px: Annotated[
        float | None,
        Option(
            "Inlier threshold; by default where a point is equally likely an inlier or an outlier.",
            metavar="PX",
            names="--threshold",
        ),
    ] = None
    noise_px: Annotated[
        float | Literal["auto"] | None,
        Option(
            "Standard deviation of a pixel coordinate (of weight 1 if points have weights), instead "
            "of the values of detection, camera file or --points; auto: from the residuals of all "
            "images.",
            metavar="PX|auto",
            names="--noise",
            type=or_auto("a number of pixels"),
        ),
    ] = None
    noise_scale: Annotated[
        float | Literal["auto"] | None,
        Option(
            "Factor on the standard deviations of the pixels. By default 1 for sigma or suu,suv,svv "
            "of --points; for boards and tags auto: from the residuals of all images.",
            metavar="FACTOR|auto",
            type=or_auto("a factor"),
        ),
    ] = None
    prior: PriorOptions = field(default_factory=PriorOptions)
    seed: Annotated[int, Option("Random seed of RANSAC.", metavar="N", least=0)] = 0
    all_solutions: Annotated[bool, Option("List all solutions, not only the two most likely.", group=OUTPUT)] = False
    intrinsics: Annotated[
        bool, Option("Include the covariance of the calibration in that of the poses: lenses, and transforms of a rig.")
    ] = True
    gates: Gates = field(default_factory=Gates)
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        alone = self.given.without_file([self.camera] if self.camera else [])
        if self.rig is not None and alone:
            raise InvalidInput("--rig and --camera-matrix exclude each other")
        if self.camera is None and self.rig is None and not alone:
            raise InvalidInput("no camera: give a camera file, --camera-matrix FX,FY,CX,CY, or --rig")

    @property
    def camera_file(self) -> str | None:
        """The file of the camera (FILE or FILE#NAME) or of the rig, None for a camera that is given itself."""
        if self.rig is not None:
            return str(self.rig)
        return None if self.given.camera_matrix is not None else self.camera

    @property
    def address(self) -> tuple[Path | None, str | None]:
        """The file of the camera or rig, and the name of the camera in it that is meant, as far as there are any."""
        from camcal.formats import split_address

        path, name = (None, None) if self.camera_file is None else split_address(self.camera_file)
        return path, name or self.name

    @property
    def seen(self) -> tuple[str, ...]:
        """What was seen: without a camera file also what stands for it."""
        first = (self.camera,) if self.camera is not None and self.camera_file != self.camera else ()
        return (*first, *self.inputs)

    @property
    def paths(self) -> list[Path]:
        """What was seen, without the names of a rig's cameras before the paths."""
        return [Path(text.partition("=")[2] or text if self.rig else text) for text in self.seen]
