"""The options that several tasks share, each declared once.

No module of options imports the core: a command knows its options before it runs, and its help is there at once.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from camcal.options import BOARD, GENERAL, INPUT, OUTPUT, RAW_FRAMES, TEXT, Argument, Option, OptionsRecord
from camcal.raw.options import MONO, NO_LAYOUT, PATTERNS, GivenLayout


def output_option(help: str, metavar: str = "PATH", *, required: bool = False) -> Option:  # noqa: A002 - as Option has it
    """Return the option -o of a command with a help of its own."""
    return Option(help, metavar=metavar, group=OUTPUT, names="--output -o", recorded=False, required=required)


OUTPUT_OPTION = output_option("Where to write the result.", required=True)
Output = Annotated[Path, OUTPUT_OPTION]
Jobs = Annotated[
    int | None,
    Option(
        "Cores to work on; by default all this process may use.",
        metavar="N",
        group=GENERAL,
        names="--jobs -j",
        least=1,
        recorded=False,
    ),
]
Recursive = Annotated[bool, Option("Read the folders below a folder too.", group=INPUT, names="--recursive -r")]
BOARD_OPTION = Option(
    "A board file, or a short form such as chessboard:9x6:25mm (inner corners), "
    "charuco:9x7:30mm:22mm:DICT_5X5_100 (squares), aprilgrid:6x6:88mm:0.3 (tags) or circles:10x8:25mm:15mm.",
    metavar="BOARD",
    group=BOARD,
    names="--board -b",
    type=TEXT,
)
BoardText = Annotated[str | None, BOARD_OPTION]
CameraName = Annotated[
    str | None,
    Option(
        "Which camera of a file with several; FILE#NAME does the same.",
        metavar="NAME",
        group=INPUT,
        names="--camera",
    ),
]
Pattern = Annotated[
    str | None,
    Option(
        "Colours of the first 2x2 pixels of bare mosaics: RGGB, GRBG, GBRG, BGGR; or MONO.",
        metavar="LETTERS",
        group=RAW_FRAMES,
        choices=(*PATTERNS, MONO),
    ),
]


@dataclass(frozen=True)
class InspectOptions(OptionsRecord):
    """A camera file, or FILE#NAME for one of its cameras; or a raw frame, its pattern and layout as far as needed.

    get: the path of one value in a camera file.
    """

    file: Annotated[
        str,
        Argument(
            "A camera file, or FILE#NAME for one of several cameras; or a raw frame: of a camera (.dng, .cr2, …), "
            "a bare mosaic (PNG, TIFF, PGM, NPY), a dump of a sensor (.raw, .bin).",
            metavar="FILE",
        ),
    ]
    get: Annotated[
        str | None,
        Option("Print one value only, such as cameras.left.intrinsics.fx; lists as JSON.", metavar="KEY", group=OUTPUT),
    ] = None
    camera: CameraName = None
    pattern: Pattern = None
    layout: GivenLayout = NO_LAYOUT

    @property
    def address(self) -> tuple[Path, str | None]:
        """The file, and the camera in it that is meant; None for all of them."""
        from camcal.run.paths import split_address

        path, name = split_address(self.file)
        return path, self.camera or name


def lens_models() -> str:
    """Return the names of the lens models, for a help: only that imports them."""
    from camcal.cameras.catalogue import help_line

    return help_line()
