"""Options of raw frames: patterns, layouts, white balance, development."""

import re
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import LENS, RAW_FRAMES, SIZE, Option, OptionsRecord, Without
from camcal.parsing import parse_integer, parse_numbers
from camcal.raw import ALIGNS, AUTO, ENDIANS, GRAY, GREEN, MONO, PATTERNS

if TYPE_CHECKING:
    from camcal.raw.headerless import Layout

BARE_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm", ".npy"})
HEADERLESS_SUFFIXES = frozenset({".raw", ".bin"})
NO_BALANCE, CAMERA, GRAY_WORLD, PATCH = "none", "camera", "gray-world", "patch:"
NORMALISATIONS = ("min", "green")
NO_MATRIX = "none"
SRGB = "srgb"
LINEAR = "linear"
TONES = (LINEAR, SRGB, "bt709")
DEPTHS = ("8", "16", "float")
ENCODINGS = (LINEAR, "gamma")
DEVELOPMENT = "Development"  # title of the options of what is done to a frame

ALGORITHMS = (GREEN, GRAY)  # by which raw frames become what detectors look at

_POWER = re.compile(r"power:([0-9]+(?:\.[0-9]*)?|\.[0-9]+)$")

Gains = tuple[float, float, float]


@dataclass(frozen=True)
class GivenLayout(OptionsRecord):
    """What is said of header-less files; see `Layout`. format: a name that `pixel_format_named` knows.

    Raises InvalidInput for a format it does not know, naming the other option if it is a sensor's optical format.
    """

    format: Annotated[
        str | None,
        Option("Pixel format of header-less files, such as BayerRG12p or pRAA.", metavar="NAME", group=RAW_FRAMES),
    ] = None
    size: Annotated[
        tuple[int, int] | None, Option("Size of header-less frames.", metavar="WxH", group=RAW_FRAMES, type=SIZE)
    ] = None
    stride: Annotated[
        int | None, Option("Bytes from row to row; by default no padding.", metavar="BYTES", group=RAW_FRAMES)
    ] = None
    offset: Annotated[int, Option("Bytes before the frame.", metavar="BYTES", group=RAW_FRAMES)] = 0
    endian: Annotated[
        str,
        Option("Order of the two bytes of unpacked samples.", metavar="little|big", group=RAW_FRAMES, choices=ENDIANS),
    ] = "little"
    align: Annotated[
        str,
        Option(
            "Alignment of the bits of unpacked samples in 16 bits.", metavar="lsb|msb", group=RAW_FRAMES, choices=ALIGNS
        ),
    ] = "lsb"
    frame: Annotated[
        int | None,
        Option("Index of the frame in a header-less file with several, from 0.", metavar="N", group=RAW_FRAMES),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format is None:
            return
        from camcal.raw.pixel_formats import pixel_format_named

        try:
            pixel_format_named(self.format)
        except InvalidInput:
            if not _is_optical(self.format):
                raise
            words = "--format is the pixel format of header-less files; the optical one is --sensor-format"
            raise InvalidInput(f"{words} {self.format}, of camcal sensor") from None

    def complete(self, path: Path, pattern: str | None) -> "Layout":
        """Return the layout of a file; raises InvalidInput, with what fits its length, if format or size is missing."""
        from camcal.raw.headerless import Layout, missing_layout
        from camcal.raw.pixel_formats import pixel_format_named

        pixel_format = None if self.format is None else pixel_format_named(self.format)
        if pixel_format is None or self.size is None:
            raise missing_layout(path, pixel_format, self.size, self.offset)
        return Layout(
            pixel_format=pixel_format,
            size=self.size,
            stride=self.stride,
            offset=self.offset,
            endian=self.endian,
            align=self.align,
            pattern=pattern,
            frame=self.frame,
        )


NO_LAYOUT = GivenLayout()


@dataclass(frozen=True)
class ImageReadOptions(OptionsRecord):
    """How photographs of a board are read.

    pattern: that of gray images which are raw frames, None where images are images; camera raw files bring their own.
    algorithm: what is made of a raw frame, one of ALGORITHMS. colours: measure corners in red and in blue as well.
    layout: of header-less files.
    """

    pattern: Annotated[
        str | None,
        Option(
            "Treat gray images as raw mosaics with this Bayer pattern of the first 2x2 pixels: RGGB, GRBG, GBRG, BGGR.",
            metavar="LETTERS",
            group=RAW_FRAMES,
            choices=(*PATTERNS, MONO),
        ),
    ] = None
    algorithm: Annotated[
        str,
        Option(
            "For raw frames: green (unaffected by lateral chromatic aberration) or gray (all samples,"
            " white-balanced; equivalent to a monochrome sensor if the lens has no lateral chromatic "
            "aberration).",
            metavar="NAME",
            group=RAW_FRAMES,
            choices=ALGORITHMS,
        ),
    ] = GREEN
    colours: Annotated[
        bool,
        Option(
            "Also calibrate red and blue, which gives the lateral chromatic aberration; best from raw"
            " frames, since demosaicing mixes the colours.",
            group=LENS,
            names="--channels",
        ),
    ] = False
    layout: Annotated[GivenLayout, Without(("frame",))] = NO_LAYOUT

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.colours and self.algorithm != GREEN:
            raise InvalidInput("channels are measured against green: leave --algorithm out")

    @property
    def suffixes(self) -> frozenset[str]:
        """Suffixes that are read in folders beside those of images: of header-less files, if their layout is given."""
        return frozenset() if self.layout == NO_LAYOUT else HEADERLESS_SUFFIXES


AS_IMAGES = ImageReadOptions()


def _is_optical(name: str) -> bool:
    """Return whether this is the optical format of a sensor, such as 1/2.8."""
    from camcal.optics import sensor_format

    try:
        sensor_format(name)
    except InvalidInput:
        return False
    return True


@dataclass(frozen=True)
class Balance(OptionsRecord):
    """How the gains are found: none, camera, gray-world, patch:X,Y,W,H (a gray area), or three gains R,G,B.

    normalise: gains that are found are scaled so that the smallest is 1 ("min": what is saturated turns white) or
    that of green ("green": green keeps its level). Three gains are taken as they are.
    """

    text: Annotated[
        str,
        Option(
            "White balance: none, camera, gray-world, patch:X,Y,W,H, or gains R,G,B.",
            metavar="BALANCE",
            group=DEVELOPMENT,
            names="--wb",
        ),
    ] = NO_BALANCE
    normalise: Annotated[
        str,
        Option(
            "Which estimated gain is normalised to 1: the smallest, or that of green.",
            metavar="min|green",
            group=DEVELOPMENT,
            names="--wb-normalize",
            choices=NORMALISATIONS,
        ),
    ] = NORMALISATIONS[0]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.text.startswith(PATCH):
            self.patch()
        elif self.text not in (NO_BALANCE, CAMERA, GRAY_WORLD):
            self.gains()

    def patch(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height of the gray area; raises InvalidInput unless it is four such numbers."""
        parts = self.text.removeprefix(PATCH).split(",")
        if len(parts) != 4 or not all(part.strip().isdecimal() for part in parts):
            raise InvalidInput(f"white balance {self.text!r}: a gray area is patch:X,Y,WIDTH,HEIGHT in pixels")
        x, y, width, height = (parse_integer(part) for part in parts)
        return x, y, width, height

    def gains(self) -> Gains:
        """Return the three gains that were given; raises InvalidInput unless they are positive numbers."""
        try:
            red, green, blue = parse_numbers(self.text.split(","))
        except ValueError:
            choices = f"{NO_BALANCE}, {CAMERA}, {GRAY_WORLD}, {PATCH}X,Y,W,H or three gains R,G,B"
            raise InvalidInput(f"white balance {self.text!r} is unknown; use {choices}") from None
        if not all(isfinite(gain) and gain > 0 for gain in (red, green, blue)):
            raise InvalidInput(f"white balance {self.text!r}: gains must be positive numbers")
        return red, green, blue


NOT_BALANCED = Balance()


@dataclass(frozen=True)
class Development(OptionsRecord):
    """What is done to a raw frame.

    balance: see `Balance`. exposure: stops by which the light is multiplied. colour: see `colour_matrix`. tone: linear,
    power:2.2 (v becomes v^(1/2.2)), srgb or bt709. depth: 8, 16 or float; None keeps that of the raw frame. encoding:
    what the counts are, linear in light or gamma-encoded; None takes 8 bits that nothing is done to for gamma-encoded.
    """

    algorithm: Annotated[
        str,
        Option(
            "auto (ri), ri, malvar, bilinear, ea, vng, half, green, gray, none, or LibRaw's, such as libraw:AHD.",
            metavar="NAME",
            group=DEVELOPMENT,
        ),
    ] = AUTO
    balance: Balance = NOT_BALANCED
    exposure: Annotated[
        float,
        Option(
            "Exposure: linear light is multiplied by 2^STOPS.",
            metavar="STOPS",
            group=DEVELOPMENT,
            names="--ev",
            least=-20,
            most=20,
        ),
    ] = 0.0
    colour: Annotated[
        str,
        Option(
            "Colour matrix: none, srgb (from the metadata of the raw file), or a file of nine numbers.",
            metavar="MATRIX",
            group=DEVELOPMENT,
        ),
    ] = NO_MATRIX
    tone: Annotated[
        str,
        Option(
            "Tone curve: linear, power:2.2 (v becomes v^(1/2.2)), srgb or bt709.", metavar="CURVE", group=DEVELOPMENT
        ),
    ] = LINEAR
    depth: Annotated[
        str | None,
        Option(
            "Depth of the images; by default that of the input.",
            metavar="8|16|float",
            group=DEVELOPMENT,
            choices=DEPTHS,
        ),
    ] = None
    encoding: Annotated[
        str | None,
        Option(
            "Encoding of the input values; unprocessed 8-bit images are assumed gamma-encoded.",
            metavar="linear|gamma",
            group=DEVELOPMENT,
            choices=ENCODINGS,
        ),
    ] = None

    def __post_init__(self) -> None:
        from camcal.raw.demosaic import require_algorithm

        super().__post_init__()
        require_algorithm(self.algorithm)
        if self.tone not in TONES:
            gamma_of(self.tone)
        if self.colour not in (NO_MATRIX, SRGB) and Path(self.colour).name == self.colour and "." not in self.colour:
            self._require_matrix()

    def _require_matrix(self) -> None:
        """Raise InvalidInput for a word that is neither a choice of --colour nor a file."""
        if not Path(self.colour).exists():
            raise InvalidInput(
                f"--colour {self.colour!r}: it is none, {SRGB}, or a file of nine numbers; images are in colour "
                f"without it, and --colour {SRGB} takes the camera's colours to sRGB"
            )

    @property
    def is_neutral(self) -> bool:
        """Whether light stays as it is until it is demosaiced."""
        return self.balance.text == NO_BALANCE and self.exposure == 0 and self.colour == NO_MATRIX


def gamma_of(tone: str) -> float:
    """Return the γ of power:γ; raises InvalidInput unless it is a positive number."""
    match = _POWER.match(tone)
    if match is None or not float(match[1]) > 0:
        raise InvalidInput(f"tone {tone!r} is unknown; use {', '.join(TONES)} or power:GAMMA")
    return float(match[1])
