"""The options of `camcal board`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import BOARD, OUTPUT, Argument, Option, OptionsRecord, Written
from camcal.tasks.options import Overwrite, output_option

SHEET = "Sheet"


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
