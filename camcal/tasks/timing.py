"""When frames were taken: options that commands share."""

import math
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import INPUT, Option, OptionsRecord

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAME = "name"


@dataclass(frozen=True)
class Timing(OptionsRecord):
    """Where the times of frames come from; without anything, from the video.

    fps: frames follow one another at this rate. source: a file of times, "exif", "name" for the last number of the
    names, or "name:REGEX" for the first group of a pattern; with fps too, that number counts frames. unit: of the
    numbers of files and names, one of UNITS.
    """

    fps: Annotated[
        float | None, Option("Frames per second; by default from the video.", metavar="RATE", group=INPUT)
    ] = None
    source: Annotated[
        str | None,
        Option(
            "Times of the frames: a file (a line each, or CSV with image,t), the last number of their names or "
            "name:REGEX (with --fps it counts frames), or EXIF.",
            metavar="FILE|name|exif",
            group=INPUT,
            names="--timestamps",
        ),
    ] = None
    unit: Annotated[
        str,
        Option(
            "Unit of times in files and names.",
            metavar="s|ms|us|ns",
            group=INPUT,
            names="--time-unit",
            choices=tuple(UNITS),
        ),
    ] = "s"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fps is not None and not (math.isfinite(self.fps) and self.fps > 0):
            raise InvalidInput(f"--fps must be more than 0, found {self.fps:g}")
        if self.fps is not None and self.source is not None and not self.by_name:
            raise InvalidInput("--fps and --timestamps are redundant, except with frame numbers in names")

    @property
    def by_name(self) -> bool:
        """Whether names tell the times."""
        return self.source is not None and self.source.partition(":")[0] == _NAME
