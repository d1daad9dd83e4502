"""The options of `camcal check` and `camcal handeye`, which take new images of calibrated cameras."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass
from camcal.options import (
    BOARD,
    CHECKS,
    DEGREES,
    INPUT,
    METHOD,
    MILLIMETRES,
    OUTPUT,
    Argument,
    Option,
    OptionsRecord,
    Without,
    Written,
)
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.tasks.calibration.options import BEST_FRAMES, FrameOptions, ImageSize
from camcal.tasks.options import (
    BOARD_OPTION,
    CAMERA_FILE,
    FIGURES,
    PAGE,
    WHOLE,
    ImagePart,
    Jobs,
    Overwrite,
    Recursive,
    result_option,
)
from camcal.tasks.rigs.options import AUTO, MATCHES

if TYPE_CHECKING:
    from camcal.targets.board import Board

BASE_T_HAND, HAND_T_BASE = "base_T_hand", "hand_T_base"
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


@dataclass(frozen=True)
class CheckOptions(OptionsRecord):
    """A camera or rig file, FILE or FILE#NAME, and new images of a board that it is checked by.

    board: None for the one of the calibration. most_px: the drift that counts, None for the larger of 0.5 px and three
    standard deviations of the calibration. reference: a pose file, with what the camera may have moved against it at
    most (m, rad).
    """

    camera: Annotated[str, Argument("Camera or rig file, or FILE#NAME.", metavar="CAMERA", required=True)] = ""
    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "New images, videos, folders, globs; or a detections file. For a rig NAME=IMAGES for each camera, such as "
            "left=photos/left right=photos/right, or one folder with those of all cameras.",
            metavar="IMAGES…|DETECTIONS",
            required=True,
        ),
    ] = ()
    board: Annotated["Board | str | None", BOARD_OPTION] = None
    most_px: Annotated[
        float | None,
        Option(
            "Largest drift of the projection that is accepted, RMS. Default: 0.5, or three standard deviations of the "
            "calibration where that is more.",
            metavar="PX",
            group=CHECKS,
            names="--max-drift",
            least=0,
        ),
    ] = None
    reference: Annotated[
        Path | None,
        Option(
            "Pose file of 'camcal pnp' with the board where it stays: by how much the camera has moved against it.",
            metavar="POSES",
            group=CHECKS,
        ),
    ] = None
    tags: Annotated[
        str | None,
        Option("Tags with a pose in --reference: as of 'camcal pnp'.", metavar="TAGS", group=BOARD),
    ] = None
    most_shift: Annotated[
        float,
        Option(
            "Largest shift against --reference that is accepted.",
            metavar="MM",
            group=CHECKS,
            names="--max-shift",
            type=MILLIMETRES,
            least=0,
        ),
    ] = 2e-3
    most_turn: Annotated[
        float,
        Option(
            "Largest rotation against --reference that is accepted.",
            metavar="DEG",
            group=CHECKS,
            names="--max-turn",
            type=DEGREES,
            least=0,
        ),
    ] = 0.0034906585039886592
    match: Annotated[
        str,
        Option(
            "What images of one capture of a rig have in common, as of 'camcal rig'.",
            metavar="|".join(MATCHES),
            group=INPUT,
            choices=MATCHES,
        ),
    ] = AUTO
    image_size: ImageSize = None
    part: ImagePart = WHOLE
    recursive: Recursive = False
    jobs: Jobs = None
    reading: Annotated[ImageReadOptions, Without(("colours",))] = AS_IMAGES
    frames: FrameOptions = BEST_FRAMES
    junit: Annotated[
        Path | None,
        Option(
            "Also write the result as JUnit XML, which build servers show.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=Written((".xml",)),
        ),
    ] = None
    plot: Annotated[
        Path | None,
        Option("Draw the map of the drift.", metavar="FILE", group=OUTPUT, recorded=False, written=FIGURES),
    ] = None
    report: Annotated[
        Path | None,
        Option(
            "Also write a page with the verdict, and maps of what the calibration leaves open and of the drift.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=PAGE,
        ),
    ] = None
    overwrite: Overwrite = False


@dataclass(frozen=True)
class HandEyeOptions(OptionsRecord):
    """A camera file, FILE or FILE#NAME, images of a board, and the poses of the robot that they were taken at.

    camera_poses: of the board, in the place of images. robot_form, robot_frames, robot_unit: how the poses are written,
    None for what the images tell. eye_to_hand: whether the board is in the hand, and the camera stands still.
    free_lens, robot_scale: whether the lens, or the scale of the robot's lengths, is estimated too.
    """

    camera: Annotated[
        str,
        Argument(
            "Camera file, or FILE#NAME; of a rig all cameras, which stay as they are to each other.", metavar="CAMERA"
        ),
    ] = ""
    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "Images, videos, folders, globs; or a detections file. For a rig NAME=IMAGES for each camera.",
            metavar="IMAGES…|DETECTIONS",
        ),
    ] = ()
    robot: Annotated[
        Path | None,
        Option(
            "Poses of the robot's hand, one for each image: by the names of images, their times, or in their order.",
            metavar="POSES",
            group=INPUT,
            required=True,
        ),
    ] = None
    camera_poses: Annotated[
        Path | None,
        Option(
            "Poses of the board as a camera saw it, camera_T_board, in the place of images: of 'camcal pnp', with "
            "their covariances, or as --robot.",
            metavar="POSES",
            group=INPUT,
        ),
    ] = None
    output: Annotated[Path | None, result_option(CAMERA_FILE)] = None
    board: Annotated["Board | str | None", BOARD_OPTION] = None
    eye_to_hand: Annotated[
        bool, Option("The camera stands still, and the hand holds the board; by default it holds the camera.")
    ] = False
    robot_form: Annotated[
        str | None,
        Option(
            "How a pose is written: matrix, quat:wxyz, ros, rvec, euler:ZYX:deg, …; by default what fits the images.",
            metavar="FORM",
            group=INPUT,
        ),
    ] = None
    robot_frames: Annotated[
        str | None,
        Option(
            "Which way the poses are; by default what fits the images.",
            metavar=f"{BASE_T_HAND}|{HAND_T_BASE}",
            group=INPUT,
            choices=(BASE_T_HAND, HAND_T_BASE),
        ),
    ] = None
    robot_unit: Annotated[
        str | None,
        Option(
            "Unit of the poses' lengths; by default what fits the images.",
            metavar="|".join(UNITS),
            group=INPUT,
            choices=tuple(UNITS),
        ),
    ] = None
    free_lens: Annotated[
        bool,
        Option(
            "Estimate the lens too, from these images alone; by default it is known as well as its file says.",
            group=METHOD,
        ),
    ] = False
    robot_scale: Annotated[
        bool, Option("Estimate too by how much of itself all lengths of the robot are wrong.", group=METHOD)
    ] = False
    image_size: ImageSize = None
    part: ImagePart = WHOLE
    recursive: Recursive = False
    jobs: Jobs = None
    reading: Annotated[ImageReadOptions, Without(("colours",))] = AS_IMAGES
    frames: FrameOptions = BEST_FRAMES
    report: Annotated[
        Path | None,
        Option(
            "Also write a page with the transforms, the noise of the robot and the errors of its poses.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=PAGE,
        ),
    ] = None
    overwrite: Overwrite = False
