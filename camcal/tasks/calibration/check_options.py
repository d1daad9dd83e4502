"""The options of `camcal check`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass
from camcal.options import (
    BOARD,
    CHECKS,
    DEGREES,
    INPUT,
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
from camcal.tasks.options import BOARD_OPTION, FIGURES, PAGE, WHOLE, ImagePart, Jobs, Overwrite, Recursive
from camcal.tasks.rigs.options import AUTO, MATCHES

if TYPE_CHECKING:
    from camcal.targets.board import Board


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
