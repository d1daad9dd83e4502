"""`camcal optics`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.report.table import Column
from camcal.tasks.lenses.options import OpticsOptions

if TYPE_CHECKING:
    from camcal.tasks.lenses.optics import OpticsReport


def optics(options: OpticsOptions, call: Call) -> None:
    """Compute field of view, depth of field, blur, pixel footprint, and the expected accuracy with a board.

    Give what is known: a camera file, or a focal length and a sensor. All figures that follow are shown, and which
    input the others need. --formats lists sensors.
    """
    from camcal.tasks.lenses import optics_document as words
    from camcal.tasks.lenses.optics import optics as run

    if options.formats:
        call.give(words.formats_document, _show_formats)
        return
    report = run(options, call.progress)
    call.give(lambda: words.document(report), lambda: _show(report))


def _show_formats() -> None:
    from camcal.tasks.lenses import optics_document as words

    sides = [Column(name, "mm") for name in ("width", "height", "diagonal")]
    columns = [Column("name"), *sides, Column("the name says", "mm")]
    show.table("sensor formats", columns, words.format_rows())
    show.text(words.FORMAT_NOTE)


def _show(report: "OpticsReport") -> None:
    from camcal.tasks.lenses import optics_document as words

    show.table(
        "lens and sensor", ["figure", "value", "unit", Column("from", wraps=True)], list(words.lens_rows(report))
    )
    if report.at:
        show.table("at a distance", *words.distance_table(report))
    if report.board is not None:
        show.table(words.board_title(report.board), *words.board_table(report.board))
        for line in words.board_lines(report, report.board):
            show.text(line)
    for line in words.closing_lines(report):
        show.text(line)
    show.wrote(report.plot)
