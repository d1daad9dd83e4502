"""The options of the commands for calibration and board detection."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.options import (
    BOARD,
    CHECKS,
    INPUT,
    LENS,
    METHOD,
    NAMES,
    OUTPUT,
    PERCENT,
    SIZE,
    Argument,
    Option,
    OptionsRecord,
    Without,
    Written,
    given_words,
)
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.tasks.gates import LENGTHS, ROBOT_NOISE, trust_option
from camcal.tasks.options import (
    BOARD_OPTION,
    CAMERA_FILE,
    DETECTIONS,
    FIGURES,
    FOLDER,
    NO_FIGURES,
    PICTURES,
    WHOLE,
    BoardText,
    DetectionsModel,
    DetectionsSize,
    FigureOptions,
    ImagePart,
    Jobs,
    Overwrite,
    Recursive,
    ReportFile,
    lens_model_names,
    lens_models,
    output_option,
    result_option,
)
from camcal.tasks.timing import Timing

if TYPE_CHECKING:
    from camcal.targets.board import Board

MOST_FRAMES = 40


Parts = Annotated[
    bool,
    Option(
        "Also use partly visible chessboards where the visible part is unambiguous.", group=BOARD, names="--partial"
    ),
]
MixedSizes = Annotated[
    bool | None,
    Option(
        "Also use images of other sizes: half or twice the size, rotated by 90 degrees, or "
        "different by a pixel or two.",
        group=INPUT,
        names="--mixed-sizes",
    ),
]
ImageSize = Annotated[
    tuple[int, int] | None,
    Option("Image size for .vnl files, which do not contain it.", metavar="WxH", group=INPUT, type=SIZE),
]


@dataclass(frozen=True)
class FrameOptions(OptionsRecord):
    """Which frames of videos are taken: at most `most`, chosen among every `every`-th one; whole: all of these."""

    most: Annotated[
        int,
        Option(
            "Maximum number of video frames; sharp frames with the most information about the lens are selected.",
            metavar="N",
            group=INPUT,
            names="--max-frames",
            least=1,
        ),
    ] = MOST_FRAMES
    every: Annotated[int, Option("Use every K-th frame of a video only.", metavar="K", group=INPUT, least=1)] = 1
    whole: Annotated[
        bool, Option("Use all frames of videos instead of a selection.", group=INPUT, names="--all-frames")
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.whole and self.most != MOST_FRAMES:
            raise InvalidInput("--all-frames takes all there are; leave --max-frames out")


BEST_FRAMES = FrameOptions()


@dataclass(frozen=True)
class DetectOptions(OptionsRecord):
    """Images and videos (files, folders, globs), the board that is looked for, and the detections file, None for none.

    board: a board, its file or its short form. reading: what is made of camera raw files and bare mosaics. frames:
    which ones of videos are taken. draw: a folder for pictures of what was found. parts: whether parts of a chessboard
    will do that show which part they are. mixed_sizes: whether images of another size than most are used where it is
    known how the sizes are related; None is no, by a command without that option.
    """

    inputs: Annotated[
        tuple[str, ...], Argument("Images, videos, folders or quoted globs.", metavar="IMAGES…", required=True)
    ] = ()
    board: Annotated["Board | str | None", BOARD_OPTION] = None
    output: Annotated[Path | None, result_option(DETECTIONS)] = None
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    reading: Annotated[ImageReadOptions, Without(("colours",))] = AS_IMAGES
    frames: FrameOptions = BEST_FRAMES
    draw: Annotated[
        Path | None,
        Option(
            "Pictures of all images with corners, or the reason why there are none: a folder, for one image a file.",
            metavar="PATH",
            group=OUTPUT,
            recorded=False,
            written=PICTURES,
        ),
    ] = None
    parts: Parts = False
    mixed_sizes: MixedSizes = False
    overwrite: Overwrite = False


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(OptionsRecord):
    """The options that `calibrate` and `rig` share.

    max_rejected: share of the corners, 0 to 1. report: an HTML file, None for none; it is written of a refused
    calibration too. image_size: (width, height) of the images of a .vnl file. reading: what is made of raw frames.
    frames: which ones of videos are taken; timing: their times. parts: whether parts of a chessboard will do that show
    which part they are. refine: measure the corners once more along the edges that the calibrated lens expects, and
    calibrate with these; None: where there are images. mixed_sizes: whether images turned by 90°, of half the size or
    off by a pixel or two are used. part: of the images of the guess, that these are. require, max_uncertainty (px):
    what the result has to be, see `require_good`.
    """

    part: ImagePart = WHOLE
    flat_board: Annotated[
        bool, Option("Assume a planar board as designed; by default its shape is estimated.", group=BOARD)
    ] = False
    free_corners: Annotated[bool, Option("Estimate an offset for every corner of the board.", group=BOARD)] = True
    max_rejected: Annotated[
        float,
        Option(
            "Fail if a larger share of corners has residuals above 4 % of a square.",
            metavar="PERCENT",
            group=CHECKS,
            type=PERCENT,
            least=0,
            most=1,
        ),
    ] = 0.1
    save_detections: Annotated[
        Path | None,
        Option(
            "Also write the detections, so that another calibration needs no images.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=DETECTIONS,
        ),
    ] = None
    report: ReportFile = None
    image_size: ImageSize = None
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    reading: ImageReadOptions = AS_IMAGES
    frames: FrameOptions = BEST_FRAMES
    timing: Timing = field(default_factory=Timing)
    parts: Parts = False
    refine: Annotated[
        bool | None,
        Option(
            "Refine the corners with the calibrated lens, add missed ones, and calibrate again; by default if there "
            "are images."
        ),
    ] = None
    rolling_shutter: Annotated[
        bool,
        Option(
            "Estimate the readout time of a rolling shutter from the motion of the board: images need times; all "
            "frames of videos are used."
        ),
    ] = False
    mixed_sizes: MixedSizes = False
    require: Annotated[
        str | None,
        trust_option(
            "Exit with 7 if the calibration is not trustworthy: a lens model does not fit or is not invertible where "
            "corners are, projections are uncertain, the focal length changes between views, or the views are of "
            "several cameras. The camera file is written all the same."
        ),
    ] = None
    max_uncertainty: Annotated[
        float | None,
        Option(
            "Exit with 7 if the projection uncertainty (1 sigma, RMS over the area with corners) of a camera is "
            "larger; the camera file is written all the same.",
            metavar="PX",
            group=CHECKS,
            recorded=False,
        ),
    ] = None
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_uncertainty is not None and not self.max_uncertainty > 0:
            raise InvalidInput(f"--max-uncertainty {self.max_uncertainty:g} is not above 0")


@dataclass(frozen=True)
class CalibrateOptions(CalibrationOptions):
    """What to calibrate from and how; see `camcal calibrate --help`.

    inputs: images, folders and globs, or one detections file. output: None for no file. board: a board file or short
    form, None when the detections file names it. model: None for the usual one, or where another one predicts views
    clearly better, that one. reading: also whether red and blue get lenses of their own.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument("Images, videos, folders, globs; or a detections file.", metavar="IMAGES…|DETECTIONS", required=True),
    ] = ()
    output: Annotated[Path | None, result_option(CAMERA_FILE)] = None
    board: BoardText = None
    model: Annotated[
        str | None,
        Option(
            lambda: (
                f"Lens model: {lens_models()}. Default: opencv5, unless another one predicts views "
                "clearly better; telecentric is used where it is asked for."
            ),
            metavar="MODEL",
            group=LENS,
            suggested=lens_model_names,
        ),
    ] = None
    fix: Annotated[
        tuple[str, ...],
        Option(
            "Lens parameters to fix, such as k3 or p1,p2, at 0 or at the value of the guess.",
            metavar="NAMES",
            group=LENS,
            type=NAMES,
        ),
    ] = ()
    guess: Annotated[
        str | None,
        Option("Camera file with the initial guess; FILE#NAME for one of several.", metavar="CAMERA", group=LENS),
    ] = None
    name: Annotated[str, Option("Name of the camera in the file.", metavar="NAME", group=OUTPUT)] = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.timing != Timing() and not self.rolling_shutter:
            raise InvalidInput(f"{given_words(self.timing)[0]} goes with --rolling-shutter")


@dataclass(frozen=True)
class DemoOptions(OptionsRecord):
    """Where to leave the demonstration, how many photographs, which ones, and how many cores to work on."""

    output: Annotated[
        Path,
        output_option("Output folder for images, results and a README.", FOLDER, metavar="DIR"),
    ] = Path("camcal-demo")
    views: Annotated[int, Option("Number of images.", metavar="N", group=INPUT)] = 20
    seed: Annotated[int, Option("Random seed of poses and noise.", metavar="N", group=INPUT, least=0)] = 0
    jobs: Jobs = None
    overwrite: Overwrite = False


@dataclass(frozen=True)
class DiffOptions(OptionsRecord):
    """Camera files that are compared with the first of them, each FILE or FILE#NAME.

    distances: m, of points that the difference is for, none for infinity. part: of the images of the first camera, that
    those of the others are. most_px, most_sigma: what it may be at most.
    """

    files: Annotated[
        tuple[str, ...],
        Argument(
            "Camera files of any format, or FILE#NAME; each is compared with the first one.",
            metavar="CAMERA…",
            required=True,
        ),
    ] = ()
    distances: Annotated[
        tuple[float, ...],
        Option(
            "Distances of points, after the rigid motion that suits best; by default infinity, after a rotation.",
            metavar="LENGTH,…",
            names="--at",
            type=LENGTHS,
        ),
    ] = ()
    part: ImagePart = WHOLE
    most_px: Annotated[
        float | None,
        Option(
            "Exit with 7 if projections differ by more anywhere that both cameras are known.",
            metavar="PX",
            group=CHECKS,
            names="--max",
            least=0,
            recorded=False,
        ),
    ] = None
    most_sigma: Annotated[
        float | None,
        Option(
            "Exit with 7 if the difference (RMS) is more standard deviations, or their number is not known.",
            metavar="K",
            group=CHECKS,
            names="--max-sigma",
            least=0,
            recorded=False,
        ),
    ] = None
    plot: Annotated[
        Path | None,
        Option("Draw the map of the difference.", metavar="FILE", group=OUTPUT, recorded=False, written=FIGURES),
    ] = None
    csv: Annotated[
        Path | None,
        Option(
            "Write the difference at the pixels of a grid as a table.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=Written((".csv",)),
        ),
    ] = None
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.files) == 1:
            raise InvalidInput(f"one camera file ({self.files[0]}): give two or more to compare")


@dataclass(frozen=True)
class AdviseOptions(OptionsRecord):
    """A camera file or a detections file, how many views to suggest, and where their picture goes.

    board: of detections that name none, or another one than that of the calibration. model, image_size: of detections,
    as for `calibrate`. robot: standard deviations of its position (m) and rotation (rad), for poses of its hand.
    """

    file: Annotated[
        str, Argument("Camera file of camcal, or FILE#NAME, or detections file.", metavar="CAMERA|DETECTIONS")
    ]
    board: BoardText = None
    model: DetectionsModel = None
    image_size: DetectionsSize = None
    robot: Annotated[
        tuple[float, float] | None,
        Option(
            "Suggest poses of the hand for a file of 'camcal handeye': the robot's noise of position and rotation, as "
            "that said it, such as 0.5mm,0.06deg.",
            metavar="STD",
            group=METHOD,
            type=ROBOT_NOISE,
        ),
    ] = None
    count: Annotated[
        int, Option("Number of views to suggest.", metavar="N", names="--views", group=METHOD, least=1, most=20)
    ] = 3
    output: Annotated[Path | None, output_option("Picture of the suggested views.", FIGURES, "FILE")] = None
    overwrite: Overwrite = False
