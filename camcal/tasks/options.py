"""The options that several tasks share, each declared once.

No module of options imports the core: a command knows its options before it runs, and its help is there at once. The
names for helps and for the completions of a shell are asked for where only these import what they are names of.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import (
    BOARD,
    CROP,
    GENERAL,
    INPUT,
    LENS,
    NUMBERS,
    OUTPUT,
    RAW_FRAMES,
    SIZE,
    Option,
    OptionsRecord,
    ValueType,
    Written,
    separated,
)
from camcal.raw import MONO, PATTERNS


def board_kinds() -> list[str]:
    """Return the beginnings of the short forms of boards."""
    from camcal.targets.board_types import FORMS

    return [f"{kind}:" for kind in FORMS]


def camera_formats() -> str:
    """Return the help of --to, which names the camera formats."""
    return f"Format of OUT where its name does not say it: {', '.join(format_names())}."


def format_names() -> list[str]:
    """Return the names of the camera formats that are written."""
    from camcal.formats.cameras import FORMATS

    return [form.name for form in FORMATS.values() if form.suffixes]


def lens_models() -> str:
    """Return the names of the lens models."""
    from camcal.cameras.catalogue import help_line

    return help_line()


def lens_model_names() -> list[str]:
    """Return the names of the lens models that cameras are calibrated with."""
    from camcal.cameras.catalogue import MODELS

    return [name for name, model in MODELS.items() if not model.is_view]


CAMERA_SUFFIXES = (
    ".yaml",
    ".yml",
    ".xml",
    ".json",
    ".toml",
    ".cameramodel",
    ".txt",
    ".bin",
    ".ini",
    ".mat",
    ".m",
    ".urdf",
    ".launch",
    ".usda",
)

FIGURES = Written((".png", ".svg", ".pdf"))
CAMERA_FILE = Written((".yaml", ".yml", ""), stdout=True)
DETECTIONS = Written((".csv", ".vnl"), stdout=True)
FOLDER = Written(folder=True)
PAGE = Written((".html",))


def image_suffixes() -> tuple[str, ...]:
    """Return the suffixes of images that are written: only the core knows them."""
    from camcal.images.files import KINDS

    return tuple(KINDS)


def trajectory_suffixes() -> tuple[str, ...]:
    """Return the suffixes of trajectories that are written."""
    from camcal.formats import trajectories

    return trajectories.SUFFIXES


THEMES = ("light", "dark")  # of figures
FIGURE_TYPES = tuple(suffix[1:] for suffix in FIGURES.known)
PICTURES = Written(image_suffixes, folder=True)
POSES = Written((".yaml", ".yml", ".json", ".csv"), stdout=True)
TRAJECTORY = Written(trajectory_suffixes, stdout=True)


def output_option(
    help: str,  # noqa: A002 - as Option has it
    written: Written,
    metavar: str = "PATH",
    *,
    required: bool = False,
) -> Option:
    """Return the option -o of a command with a help of its own."""
    return Option(
        help, metavar=metavar, group=OUTPUT, names="--output -o", recorded=False, required=required, written=written
    )


def result_option(written: Written) -> Option:
    """Return the option -o of a command that needs it."""
    return output_option("Output file.", written, required=True)


Overwrite = Annotated[
    bool, Option("Also replace files that camcal did not write; never inputs.", group=OUTPUT, recorded=False)
]
Jobs = Annotated[
    int | None,
    Option(
        "Number of parallel jobs; by default all available cores.",
        metavar="N",
        group=GENERAL,
        names="--jobs -j",
        least=1,
        recorded=False,
    ),
]
Recursive = Annotated[bool, Option("Read folders recursively.", group=INPUT, names="--recursive -r")]
PICTURE_FORMATS = ("jpg", "png", "tiff", "npy")
PictureFormat = Annotated[
    str | None,
    Option(
        "Format: jpg, png, tiff or npy; by default as the input (video: jpg).",
        metavar="NAME",
        group=OUTPUT,
        choices=PICTURE_FORMATS,
    ),
]
JpegQuality = Annotated[int, Option("JPEG quality.", metavar="1…100", group=OUTPUT, least=1, most=100)]


def board_text(text: str) -> str:
    """Return the text that means a board; raises InvalidInput for a short form that is wrong."""
    from camcal.formats import boards
    from camcal.targets.board import parse_board

    if ":" in text and not boards.names_file(text):
        parse_board(text)
    return text


BOARD_OPTION = Option(
    "A board file, or a short form such as chessboard:9x6:25mm (inner corners), "
    "charuco:9x7:30mm:22mm:DICT_5X5_100 (squares), aprilgrid:6x6:88mm:0.3 (tags) or circles:10x8:25mm:15mm.",
    metavar="BOARD",
    group=BOARD,
    names="--board -b",
    type=ValueType(board_text, str, "a board"),
    suggested=board_kinds,
)
BoardText = Annotated[str | None, BOARD_OPTION]
DetectionsModel = Annotated[
    str | None,
    Option(
        lambda: f"Lens model for detections: {lens_models()}. By default as 'camcal calibrate'.",
        metavar="MODEL",
        group=LENS,
        suggested=lens_model_names,
    ),
]
DetectionsSize = Annotated[
    tuple[int, int] | None,
    Option("Image size for a .vnl file, which does not contain it.", metavar="WxH", group=INPUT, type=SIZE),
]
ReportFile = Annotated[
    Path | None,
    Option(
        "Also write a report: one HTML file with the verdict, figures and data to repeat it.",
        metavar="FILE",
        group=OUTPUT,
        recorded=False,
        written=PAGE,
    ),
]
CameraName = Annotated[
    str | None,
    Option(
        "Camera of a file with several; the same as FILE#NAME.",
        metavar="NAME",
        group=INPUT,
        names="--camera",
    ),
]
_INTRINSICS = separated("FX,FY,CX,CY in pixels, such as 1400,1400,959.5,539.5", count=4)


@dataclass(frozen=True)
class ImagePart(OptionsRecord):
    """Which part of a camera's images others are: crop (width, height, x, y), binning, scale_to, in this order."""

    crop: Annotated[
        tuple[int, int, int, int] | None,
        Option(
            "The images are this part of those that the camera is for: its size and its top-left pixel.",
            metavar="WxH+X+Y",
            group=INPUT,
            type=CROP,
        ),
    ] = None
    binning: Annotated[
        int | None,
        Option(
            "So many pixels a side of the camera's images, after --crop, are one of these.",
            metavar="N",
            group=INPUT,
            least=1,
        ),
    ] = None
    scale_to: Annotated[
        tuple[int, int] | None,
        Option(
            "Size that the camera's images, after --crop and --binning, were resized to.",
            metavar="WxH",
            group=INPUT,
            type=SIZE,
        ),
    ] = None


WHOLE = ImagePart()


@dataclass(frozen=True)
class GivenCamera(OptionsRecord):
    """A camera in place of a file, and what a file may not say of one.

    camera_matrix: fx, fy, cx, cy, pixels; None for a file. distortion: OpenCV's coefficients. size: (width, height) of
    the images, None for that of the first one. model: the lens model of four coefficients, which may be a fisheye's.
    part: which part of its images others are.
    """

    camera_matrix: Annotated[
        tuple[float, ...] | None,
        Option("Intrinsics instead of a camera file, pixels.", metavar="FX,FY,CX,CY", group=INPUT, type=_INTRINSICS),
    ] = None
    distortion: Annotated[
        tuple[float, ...] | None,
        Option(
            "Coefficients of --camera-matrix in OpenCV's order, 4, 5, 8, 12 or 14; of a fisheye k1,k2,k3,k4. "
            "By default none.",
            metavar="K1,K2,P1,P2[,K3…]",
            group=INPUT,
            type=NUMBERS,
        ),
    ] = None
    size: Annotated[
        tuple[int, int] | None,
        Option(
            "Size of the camera's images, where its file does not say it; by default that of the first image.",
            metavar="WxH",
            group=INPUT,
            type=SIZE,
        ),
    ] = None
    model: Annotated[
        str | None,
        Option(
            "Lens model of four coefficients, if the file does not state it: fisheye, or opencv4 for k1,k2,p1,p2.",
            metavar="NAME",
            group=INPUT,
        ),
    ] = None
    part: ImagePart = WHOLE

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.distortion is not None and self.camera_matrix is None:
            raise InvalidInput("--distortion goes with --camera-matrix FX,FY,CX,CY; give both")

    def without_file(self, positional: Sequence[str]) -> bool:
        """Return whether this is the camera; raises InvalidInput if the first argument is a camera file, too."""
        if self.camera_matrix is None:
            return False
        if positional and Path(positional[0].rpartition("#")[0] or positional[0]).suffix.lower() in CAMERA_SUFFIXES:
            raise InvalidInput(f"{positional[0]} and --camera-matrix are two cameras; leave one of them out")
        return True


FigureType = Annotated[
    str,
    Option(
        "Type of the figures.",
        metavar="|".join(FIGURE_TYPES),
        group=OUTPUT,
        names="--figure-format",
        choices=FIGURE_TYPES,
        recorded=False,
    ),
]


@dataclass(frozen=True)
class FigureOptions(OptionsRecord):
    """A folder for figures of the result, None for no figures, and the type of their files."""

    folder: Annotated[
        Path | None,
        Option(
            "Folder for figures of the result, with their captions in figures.md.",
            metavar="DIR",
            group=OUTPUT,
            names="--figures",
            recorded=False,
            written=FOLDER,
        ),
    ] = None
    kind: FigureType = FIGURE_TYPES[0]


NO_FIGURES = FigureOptions()

Pattern = Annotated[
    str | None,
    Option(
        "Colours of the first 2x2 pixels of bare mosaics: RGGB, GRBG, GBRG, BGGR; or MONO.",
        metavar="LETTERS",
        group=RAW_FRAMES,
        choices=(*PATTERNS, MONO),
    ),
]
