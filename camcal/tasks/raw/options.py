"""The options of the commands that work on raw frames."""

from math import isfinite
from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.options import (
    CHECKS,
    INPUT,
    MICROMETRES,
    NUMBERS,
    OUTPUT,
    RAW_FRAMES,
    Argument,
    Option,
    OptionsRecord,
    Written,
    separated,
)
from camcal.raw.options import NO_LAYOUT, Development, GivenLayout
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.tasks.options import (
    CAMERA_FILE,
    FIGURES,
    NO_FIGURES,
    FigureOptions,
    Jobs,
    Overwrite,
    Pattern,
    Recursive,
    image_suffixes,
    result_option,
)

CORRECTIONS, SENSOR = "Corrections", "Sensor"
DEFAULT_TYPE = "tiff"  # 16-bit PNG takes seventeen times as long to write
TYPES = ("tiff", "png", "ppm", "npy", "dng")
SECONDS = separated("seconds, written as 0.01,0.02")

White = Annotated[
    float | None,
    Option(
        "White level (saturation); by default from the raw file, or full scale.", metavar="COUNTS", group=RAW_FRAMES
    ),
]


@dataclass(frozen=True)
class RawInput(OptionsRecord):
    """How raw frames are read and what their counts mean, where their files do not say it.

    pattern, layout: see `read_mosaic`. black: counts without light, one for all samples or four for red, green in red's
    rows, green in blue's rows, blue. white: counts at saturation.
    """

    pattern: Pattern = None
    layout: GivenLayout = NO_LAYOUT
    black: Annotated[
        tuple[float, ...] | None,
        Option(
            "Black level, or four: R,Gr,Gb,B; by default from the raw file, or 0.",
            metavar="COUNTS",
            group=RAW_FRAMES,
            type=NUMBERS,
        ),
    ] = None
    white: White = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.black is not None and len(self.black) not in (1, 4):
            raise InvalidInput(f"a black level is one number or four (R,Gr,Gb,B), found {len(self.black)}")


AS_DECLARED = RawInput()


@dataclass(frozen=True)
class CorrectionFiles(OptionsRecord):
    """Dark frames and flat fields (files, folders, globs), and a map of bad pixels."""

    dark: Annotated[
        tuple[str, ...],
        Option("Dark frames; their mean replaces the black level.", metavar="FRAMES", group=CORRECTIONS),
    ] = ()
    bad: Annotated[
        Path | None,
        Option(
            "Bad-pixel map: text (x y per line), a PNG mask, or NPY.",
            metavar="MAP",
            group=CORRECTIONS,
            names="--bad-pixels",
        ),
    ] = None
    flat: Annotated[
        tuple[str, ...],
        Option("Flat-field frames, to correct vignetting and dust.", metavar="FRAMES", group=CORRECTIONS),
    ] = ()


NO_FILES = CorrectionFiles()


@dataclass(frozen=True)
class DemosaicOptions(OptionsRecord):
    """Raw frames (files, folders, globs), where the images go, and what is done to them.

    output: a file for a single frame, otherwise a folder of files of a type. trust_pattern: do not ask the frames
    whether green stands where the pattern says. make_bad_pixel_map, preview_patterns: what the command makes in place
    of images, see the tasks of these names.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "Camera raw files, bare mosaics (PNG, TIFF, PGM, NPY), header-less .raw or .bin; folders, globs.",
            metavar="IN…",
        ),
    ]
    output: Annotated[
        Path,
        result_option(Written(lambda: (*image_suffixes(), ".dng", ".txt", ".badpixels"), folder=True)),
    ]
    reading: RawInput = AS_DECLARED
    corrections: CorrectionFiles = NO_FILES
    development: Development = field(default_factory=Development)
    type: Annotated[
        str,
        Option("Type of the files in a folder.", metavar="tiff|png|ppm|npy|dng", group=OUTPUT, choices=TYPES),
    ] = DEFAULT_TYPE
    make_bad_pixel_map: Annotated[
        bool, Option("Treat the inputs as dark frames and write a bad-pixel map.", group=OUTPUT)
    ] = False
    preview_patterns: Annotated[
        bool, Option("Write a thumbnail for each of the four patterns, nothing else.", group=OUTPUT)
    ] = False
    trust_pattern: Annotated[bool, Option("Skip the check of the pattern against the frame.", group=CHECKS)] = False
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.make_bad_pixel_map and self.preview_patterns:
            raise InvalidInput("--make-bad-pixel-map and --preview-patterns exclude each other")


@dataclass(frozen=True)
class SensorOptions(OptionsRecord):
    """Flat and dark frames (files, folders, globs), and what is known of them.

    pattern, layout: see `read_mosaic`. exposures: seconds, one for all flats or one for each input; dark_exposures:
    likewise. iso: which frames to use, or what all were taken at where files do not say. white: counts at saturation.
    pitch: of the pixels, metres; sensor_format: a name such as 1/2.8, which gives the pitch. plot: a file for the
    figure.
    """

    flats: Annotated[
        tuple[str, ...],
        Argument(
            "Flat frames (an evenly lit, defocused white surface), two or more per exposure level; "
            "also header-less .raw and .bin.",
            metavar="FLATS…",
        ),
    ]
    darks: Annotated[
        tuple[str, ...],
        Option(
            "Dark frames, taken with the lens covered; repeatable.",
            metavar="DARKS",
            group=INPUT,
            names="--dark",
        ),
    ]
    output: Annotated[Path, result_option(CAMERA_FILE)]
    pattern: Pattern = None
    layout: GivenLayout = NO_LAYOUT
    exposures: Annotated[
        tuple[float, ...],
        Option(
            "Exposure time of the flat frames in seconds, one or one per FLATS; by default from "
            "metadata, or from folder names such as 10ms.",
            metavar="S,…",
            group=SENSOR,
            names="--exposure",
            type=SECONDS,
        ),
    ] = ()
    dark_exposures: Annotated[
        tuple[float, ...],
        Option(
            "Exposure time of the dark frames, likewise.",
            metavar="S,…",
            group=SENSOR,
            names="--dark-exposure",
            type=SECONDS,
        ),
    ] = ()
    iso: Annotated[float | None, Option("ISO speed to use if the files have several.", metavar="N", group=SENSOR)] = (
        None
    )
    white: White = None
    pitch: Annotated[
        float | None,
        Option("Pixel pitch, micrometres.", metavar="UM", group=SENSOR, names="--pitch-um", type=MICROMETRES),
    ] = None
    sensor_format: Annotated[
        str | None,
        Option(
            "Optical format of the sensor, such as 1/2.8, 2/3, APS-C; gives the pixel pitch.",
            metavar="NAME",
            group=SENSOR,
        ),
    ] = None
    plot: Annotated[
        Path | None,
        Option(
            "Draw the photon transfer curve (.png, .svg, .pdf).",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=FIGURES,
        ),
    ] = None
    jobs: Jobs = None
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for value in (*self.exposures, *self.dark_exposures):
            if not (isfinite(value) and value > 0):
                raise InvalidInput(f"an exposure of {value:g} s: use seconds above 0")
        for number, name in ((self.pitch, "pixel pitch"), (self.white, "white level"), (self.iso, "ISO speed")):
            if number is not None and not (isfinite(number) and number > 0):
                raise InvalidInput(f"a {name} of {number:g}: use a number above 0")
        if self.pitch is not None and self.sensor_format is not None:
            raise InvalidInput("--sensor-format gives the pixel pitch: leave out --pitch-um, or the format")

    @property
    def reading(self) -> RawInput:
        """How the frames are read."""
        return RawInput(self.pattern, self.layout)
