"""`camcal board`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.calibration.options import SheetOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.board_sheet import BoardSheet


def board(options: SheetOptions, call: Call) -> None:
    """Draw a board to print at true scale, and write its board file beside it.

    Print it at 100 % (actual size, no scaling), let nothing but black ink be used, and measure the ruler and some
    squares on the sheet: what calibration takes for the size of the board is what you measure.
    """
    from camcal.tasks.calibration.board_sheet import board_sheet, document

    sheet = board_sheet(options, call.progress)
    call.give(lambda: document(sheet), lambda: _show(sheet))


def _show(sheet: "BoardSheet") -> None:
    options, (width, height) = sheet.options, sheet.ink.size
    show.text(f"{options.output}: {sheet.board.words}, {width:g} x {height:g} mm, on {sheet.paper.described()}")
    if sheet.pixels is not None:
        show.text("  {} x {} pixels, gray where an edge runs through one".format(*sheet.pixels))
    show.text(f"{options.board_file}: the board file, for --board")
    if options.kalibr is not None:
        show.text(f"{options.kalibr}: the same for Kalibr")
    show.text("print at 100 % (actual size)" + (", then measure the ruler" if options.ruler else ""))
