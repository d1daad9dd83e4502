"""The options of what is drawn: undistorted images, by `camcal undistort`, and boards, by `camcal board`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.images.options import JPEG_QUALITY, MAP_SUFFIXES, MESH_STEP, ViewOptions
from camcal.options import BOARD, INPUT, NUMBERS, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.tasks.options import (
    CameraName,
    GivenCamera,
    Jobs,
    JpegQuality,
    Overwrite,
    PictureFormat,
    Recursive,
    image_suffixes,
    output_option,
)

SHEET = "Sheet"


@dataclass(frozen=True)
class UndistortOptions(OptionsRecord):
    """What to undistort and how; see `camcal undistort --help`.

    camera: a camera file or FILE#NAME; an input where `given` is the camera itself.
    output: a folder; of points a CSV file, or a folder for one of the same name.
    border: one number, or one for each channel. format: None keeps the type of the source. mask: write
    which pixels have a source, too. scale_intrinsics: fit the camera to resized images. align_channels: draw the
    colours of colour images through their own lenses, where the camera file has them. points: a CSV file with columns
    u, v and any others, in place of images. maps: write where the pixels of the view come from, in place of images;
    mesh_step: pixels between those of an LDC mesh. distort: from pixels of the view to pixels of the image the camera
    took.
    """

    camera: Annotated[
        str | None,
        Argument("A camera file, or FILE#NAME for one of several; left out with --camera-matrix.", metavar="CAMERA"),
    ] = None
    output: Annotated[
        Path,
        output_option(
            "Output folder; for one image also the file, for --points a CSV, for --maps a map.",
            Written(lambda: (*image_suffixes(), ".csv", *MAP_SUFFIXES), folder=True, stdout=True),
            required=True,
        ),
    ] = Path("undistorted")
    inputs: Annotated[tuple[str, ...], Argument("Images, videos, folders, globs.", metavar="IMAGES…")] = ()
    given: Annotated[GivenCamera, Without(("size",))] = field(default_factory=GivenCamera)
    camera_name: CameraName = None
    points: Annotated[
        Path | None,
        Option(
            "Undistort pixel coordinates instead of images: a CSV with columns u, v; other columns are kept.",
            metavar="CSV",
            group=INPUT,
        ),
    ] = None
    maps: Annotated[
        bool,
        Option(
            "Write the map of the view instead of images: .npz for cv2.remap, .exr or .png (16 bits) as an ST map, "
            ".txt as offsets for Texas Instruments' LDC.",
            group=OUTPUT,
        ),
    ] = False
    mesh_step: Annotated[
        int,
        Option("Of the offsets of --maps: pixels between two nodes.", metavar="PX", group=OUTPUT, least=1, most=128),
    ] = MESH_STEP
    distort: Annotated[
        bool,
        Option("With --points and --maps: the way back, from undistorted pixels to the original image."),
    ] = False
    view: ViewOptions = field(default_factory=ViewOptions)
    interpolation: Annotated[
        str,
        Option(
            "nearest-truncate (floor), nearest (rounded), linear, cubic, lanczos. Linear is "
            "geometrically the most accurate: OpenCV's cubic and lanczos shift by up to 0.06 and 0.03"
            " px.",
            metavar="NAME",
        ),
    ] = "linear"
    border: Annotated[
        tuple[float, ...],
        Option("Value of pixels without a source: a number, or one per channel: B,G,R.", metavar="VALUE", type=NUMBERS),
    ] = (0.0,)
    scale_intrinsics: Annotated[bool, Option("Rescale the intrinsics to images that were resized (not cropped).")] = (
        False
    )
    align_channels: Annotated[
        bool,
        Option("Correct lateral chromatic aberration if the camera file has channels ('camcal calibrate --channels')."),
    ] = True
    mask: Annotated[
        bool, Option("Also write valid_mask.png: 255 where a pixel has a source.", group=OUTPUT, recorded=False)
    ] = False
    format: PictureFormat = None
    quality: JpegQuality = JPEG_QUALITY
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        alone = self.given.without_file([self.camera] if self.camera else [])
        if self.camera is None and not alone:
            raise InvalidInput("no camera: give a camera file, or --camera-matrix FX,FY,CX,CY")
        if self.points is not None and self.maps:
            raise InvalidInput("--points and --maps: give one of them")
        other = "--points" if self.points is not None else "--maps" if self.maps else None
        if other is not None and self.images:
            raise InvalidInput(f"{other} takes no images, found {self.images[0]}")
        if self.maps and self.output.suffix.lower() not in MAP_SUFFIXES:
            raise InvalidInput(f"--maps is written as {', '.join(MAP_SUFFIXES)}", where=str(self.output))
        if self.points is None and str(self.output) == STANDARD:
            raise InvalidInput("--output writes only --points to standard output; name a folder for images")
        if other is None and self.distort:
            raise InvalidInput("--distort is for --points and --maps")

    @property
    def camera_file(self) -> str | None:
        """The camera file or FILE#NAME, None for a camera that is given itself."""
        return None if self.given.camera_matrix is not None else self.camera

    @property
    def images(self) -> tuple[str, ...]:
        """The images: without a camera file also what stands for it."""
        first = (self.camera,) if self.camera is not None and self.camera_file is None else ()
        return (*first, *self.inputs)


@dataclass(frozen=True)
class SheetOptions(OptionsRecord):
    """A board (its file or its short form), the file to draw it into, and the paper.

    paper: a name or a size such as 300x400mm, None for the smallest of A4 … A0 that does. landscape: None for what
    fits. margin_mm: what the printer cannot reach. dpi: of PNG. kalibr: where a target file for Kalibr goes.
    """

    board: Annotated[
        str, Argument("A board file, or a short form such as chessboard:9x6:25mm.", metavar="BOARD", group=BOARD)
    ]
    output: Annotated[
        Path,
        output_option(
            "Output: .pdf, .svg or .png; the board file is written beside it as .yaml.",
            Written((".pdf", ".svg", ".png")),
            metavar="FILE",
        ),
    ]
    paper: Annotated[
        str | None,
        Option(
            "A4, A3, A2, A1, A0, Letter, Legal, Tabloid or a size such as 300x400mm; by default the smallest of A4 to "
            "A0 that the board fits on.",
            metavar="NAME|WxHmm",
            group=SHEET,
        ),
    ] = None
    landscape: Annotated[
        bool | None,
        Option("Paper orientation; by default as the board fits.", group=SHEET, names="--landscape/--portrait"),
    ] = None
    margin_mm: Annotated[
        float,
        Option(
            "Unprintable margin of the paper.",
            metavar="MM",
            group=SHEET,
            names="--margin",
        ),
    ] = 5.0
    ruler: Annotated[bool, Option("Draw a 100 mm ruler below the board to check the print.", group=SHEET)] = True
    dpi: Annotated[
        float | None,
        Option(
            "Resolution of a PNG; by default 254, ten pixels a millimetre.",
            metavar="N",
            group=OUTPUT,
            least=1,
            most=100_000,
        ),
    ] = None
    kalibr: Annotated[
        Path | None,
        Option(
            "Also write Kalibr's target YAML.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=Written((".yaml", ".yml")),
        ),
    ] = None
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        suffix = self.output.suffix.lower()
        if self.dpi is not None and suffix != ".png":
            raise InvalidInput(f"--dpi is for .png; {suffix} has no pixels")

    @property
    def board_file(self) -> Path:
        """Where the board file goes."""
        return self.output.with_suffix(".yaml")
