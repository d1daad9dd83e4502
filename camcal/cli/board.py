"""`camcal board`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.calibration.board_sheet import BoardSheet

Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="What to draw: .pdf, .svg or .png. FILE.yaml beside it is the board file.",
    ),
]


def board(
    board: Annotated[
        str, typer.Argument(metavar="BOARD", help="A board file, or a short form such as chessboard:9x6:25mm.")
    ],
    output: Output,
    paper: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|WxHmm",
            help="A4, A3, A2, A1, A0, Letter, Legal, Tabloid or a size such as 300x400mm; by default the smallest "
            "of A4 to A0 that the board fits on.",
        ),
    ] = None,
    landscape: Annotated[
        bool | None, typer.Option("--landscape/--portrait", help="How the paper lies; by default as the board fits.")
    ] = None,
    margin: Annotated[
        float, typer.Option(metavar="MM", help="Edge of the paper that the printer does not reach; it stays empty.")
    ] = 5.0,
    ruler: Annotated[
        bool, typer.Option("--ruler/--no-ruler", help="A ruler of 100 mm below the board to check the print with.")
    ] = True,
    dpi: Annotated[
        float | None,
        typer.Option(metavar="N", help="Resolution of a PNG; by default 254, ten pixels a millimetre."),
    ] = None,
    kalibr: Annotated[
        Path | None,
        typer.Option("--kalibr", metavar="FILE", help="Write the board for Kalibr too, as its target YAML."),
    ] = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Draw a board to print at true scale, and write its board file beside it.

    Print it at 100 % (actual size, no scaling), let nothing but black ink be used, and measure the ruler and some
    squares on the sheet: what calibration takes for the size of the board is what you measure.
    """
    from camcal.tasks.calibration.board_sheet import SheetOptions, board_sheet, document

    options = SheetOptions(board, output, paper, landscape, margin, ruler, dpi, kalibr)
    sheet = board_sheet(options, show.progress(quiet))
    if json:
        show.document("board", document(sheet))
    elif not quiet:
        _show(sheet)


def _show(sheet: "BoardSheet") -> None:
    options, (width, height) = sheet.options, sheet.ink.size
    show.text(f"{options.output}: {sheet.board.words}, {width:g} x {height:g} mm, on {sheet.paper.described()}")
    if sheet.pixels is not None:
        show.text("  {} x {} pixels, gray where an edge runs through one".format(*sheet.pixels))
    show.text(f"{options.board_file}: the board file, for --board")
    if options.kalibr is not None:
        show.text(f"{options.kalibr}: the same for Kalibr")
    show.text("print at 100 % (actual size)" + (", then measure the ruler" if options.ruler else ""))
