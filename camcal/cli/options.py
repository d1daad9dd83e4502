"""The options that commands share, each declared once."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption

if TYPE_CHECKING:
    from camcal.raw.options import GivenLayout

_MOST_PIXELS = 1e6  # millions; sides are 32-bit numbers


def _apply_settings(context: typer.Context, path: Path | None) -> Path | None:
    """Let a settings file give the defaults of the options that are not on the command line."""
    from camcal.cli.command import apply_settings

    return apply_settings(context, path)


LENS_MODELS = "{lens models}"  # stands for their names in the help of an option


class LensModelCommand(TyperCommand):
    """A command with an option for the lens model. Its help names the models, and imports them only then."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the help of the options."""
        for option in self.params:
            if isinstance(option, TyperOption) and option.help:
                option.help = with_lens_models(option.help)
        super().format_options(ctx, formatter)


def with_lens_models(text: str) -> str:
    """Return the text with the names of the lens models where it has LENS_MODELS."""
    from camcal.tasks.options import lens_models

    return text.replace(LENS_MODELS, lens_models()) if LENS_MODELS in text else text


def _not_the_settings(context: typer.Context, path: Path | None) -> Path | None:
    """Refuse to write the result over the settings file that was just read."""
    settings = context.params.get("config")
    if path is not None and settings is not None:
        from camcal.run.outputs import refuse_overwriting

        refuse_overwriting([path], [settings])
    return path


def _limit_pixels(millions: float | None) -> float | None:
    """Set how many pixels an image may have; every reader asks for it, and worker processes inherit it."""
    if millions is not None:
        from camcal.errors import InvalidInput
        from camcal.images import limits

        if not 0 < millions <= _MOST_PIXELS:
            raise InvalidInput(f"--max-pixels {millions:g}: more than 0 and at most {_MOST_PIXELS:g} million")
        limits.set_max_pixels(round(millions * 1e6))
    return millions


Output = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="PATH", callback=_not_the_settings, help="Where to write the result."),
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", metavar="N", min=1, help="Cores to work on; by default all this process may use."),
]
MaxPixels = Annotated[
    float | None,
    typer.Option(
        "--max-pixels",
        metavar="MILLIONS",
        callback=_limit_pixels,
        help="Images with more million pixels are refused before they are decoded; by default 300.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Only warnings and errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="List everything.")]
Recursive = Annotated[bool, typer.Option("--recursive", "-r", help="Read the folders below a folder too.")]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        is_eager=True,
        callback=_apply_settings,
        help="Options from a YAML file (option: value); those on the command line come first.",
    ),
]
BoardOption = Annotated[
    str | None,
    typer.Option(
        "--board",
        "-b",
        metavar="BOARD",
        help="A board file, or a short form such as chessboard:9x6:25mm (inner corners), "
        "charuco:9x7:30mm:22mm:DICT_5X5_100 (squares), aprilgrid:6x6:88mm:0.3 (tags) or circles:10x8:25mm:15mm.",
    ),
]
CameraName = Annotated[
    str | None,
    typer.Option("--camera", metavar="NAME", help="Which camera of a file with several; FILE#NAME does the same."),
]


Pattern = Annotated[
    str | None,
    typer.Option(
        metavar="LETTERS", help="Colours of the first 2x2 pixels of bare mosaics: RGGB, GRBG, GBRG, BGGR; or MONO."
    ),
]
PixelFormat = Annotated[
    str | None,
    typer.Option("--format", metavar="NAME", help="Pixel format of header-less files, such as BayerRG12p or pRAA."),
]
FrameSize = Annotated[str | None, typer.Option("--size", metavar="WxH", help="Size of header-less frames.")]
Stride = Annotated[int | None, typer.Option(metavar="BYTES", help="Bytes from row to row; by default no padding.")]
Offset = Annotated[int, typer.Option(metavar="BYTES", help="Bytes before the frame.")]
Endian = Annotated[str, typer.Option(metavar="little|big", help="Order of the two bytes of unpacked samples.")]
Frame = Annotated[int | None, typer.Option(metavar="N", help="Which frame of a header-less file with several, from 0.")]
Align = Annotated[str, typer.Option(metavar="lsb|msb", help="Where the bits of unpacked samples stand in 16.")]


PairCamera = Annotated[
    str | None,
    typer.Argument(metavar="CAMERA", help="Camera file of the rectified pair, or FILE#NAME; or a calib.txt."),
]
Fx = Annotated[float | None, typer.Option(metavar="PIXELS", help="Focal length.")]
Fy = Annotated[float | None, typer.Option(metavar="PIXELS", help="Focal length along y; by default fx.")]
Cx = Annotated[float | None, typer.Option(metavar="PIXELS", help="Principal point of the left image, x.")]
Cy = Annotated[float | None, typer.Option(metavar="PIXELS", help="Principal point, y.")]
Baseline = Annotated[float | None, typer.Option(metavar="METRES", help="Distance of the cameras.")]
Doffs = Annotated[
    float | None, typer.Option(metavar="PIXELS", help="cx of the right image minus cx of the left; by default 0.")
]


def one_of(option: str, text: str, known: tuple[str, ...]) -> str:
    """Return the text; raises InvalidInput, naming the option, if it is none of those known."""
    from camcal.errors import InvalidInput

    if text not in known:
        raise InvalidInput(f"{option} {text!r}: use one of {', '.join(known)}")
    return text


def parse_size(text: str) -> tuple[int, int]:
    """Return (width, height) from a size written as 1920x1080; raises InvalidInput for anything else."""
    from camcal.errors import InvalidInput

    width, _, height = text.lower().partition("x")
    if not (re.fullmatch("[0-9]{1,30}x[0-9]{1,30}", text.lower()) and int(width) and int(height)):
        raise InvalidInput(f"{text!r} is not a size; write WIDTHxHEIGHT, such as 1920x1080")
    return int(width), int(height)


def given_layout(
    pixel_format: str | None,
    size: str | None,
    stride: int | None,
    offset: int,
    endian: str,
    align: str,
    frame: int | None = None,
) -> "GivenLayout":
    """Return what the options say of header-less files; raises InvalidInput for a size or a format that is none."""
    from camcal.raw.options import GivenLayout

    shape = None if size is None else parse_size(size)
    return GivenLayout(pixel_format, shape, stride, offset, endian, align, frame)


def parse_numbers(option: str, text: str) -> tuple[float, ...]:
    """Return the finite numbers of a text such as 64,64,65,64; raises InvalidInput, naming the option, for others."""
    from math import isfinite

    from camcal.errors import InvalidInput
    from camcal.parsing import parse_numbers

    try:
        numbers = tuple(parse_numbers(text.split(",")))
    except ValueError:
        numbers = ()
    if not numbers or not all(map(isfinite, numbers)):
        raise InvalidInput(f"{option} {text!r}: numbers are needed, separated by commas")
    return numbers
