"""What is said of raw frames beforehand: the names of colour filter patterns, the layout of header-less files."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from camcal.options import RAW_FRAMES, SIZE, Option, OptionsRecord

if TYPE_CHECKING:
    from camcal.raw.headerless import Layout

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
MONO = "MONO"
BARE_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm", ".npy"})
HEADERLESS_SUFFIXES = frozenset({".raw", ".bin"})
ENDIANS = ("little", "big")
ALIGNS = ("lsb", "msb")


@dataclass(frozen=True)
class GivenLayout(OptionsRecord):
    """What is said of header-less files; see `Layout`. format: a name that `pixel_format_named` knows.

    Raises InvalidInput for a format it does not know.
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
        Option("Where the bits of unpacked samples stand in 16.", metavar="lsb|msb", group=RAW_FRAMES, choices=ALIGNS),
    ] = "lsb"
    frame: Annotated[
        int | None,
        Option("Which frame of a header-less file with several, from 0.", metavar="N", group=RAW_FRAMES),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format is not None:
            from camcal.raw.pixel_formats import pixel_format_named

            pixel_format_named(self.format)

    def complete(self, path: Path, pattern: str | None) -> "Layout":
        """Return the layout of a file; raises InvalidInput, with what fits its length, if format or size is missing."""
        from camcal.raw.headerless import Layout, missing_layout
        from camcal.raw.pixel_formats import pixel_format_named

        pixel_format = None if self.format is None else pixel_format_named(self.format)
        if pixel_format is None or self.size is None:
            raise missing_layout(path, pixel_format, self.size, self.offset)
        return Layout(pixel_format, self.size, self.stride, self.offset, self.endian, self.align, pattern, self.frame)

    def settings(self) -> dict[str, Any]:
        """Return what was said as options of a command, without what is so by default."""
        size = None if self.size is None else "{}x{}".format(*self.size)
        said = {"format": self.format, "size": size, "stride": self.stride, "offset": self.offset or None}
        order = {"endian": self.endian, "align": self.align, "frame": self.frame}
        standard = {"endian": "little", "align": "lsb", "frame": None}
        return said | {name: value for name, value in order.items() if value != standard[name]}


NO_LAYOUT = GivenLayout()
