"""`camcal convert`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.tasks.options import ConvertFileOptions

if TYPE_CHECKING:
    from camcal.tasks.convert import ConvertReport


def convert(options: ConvertFileOptions, call: Call) -> None:
    """Convert a camera file: camcal's own, OpenCV's FileStorage (YAML, XML, JSON), ROS camera_info, Kalibr's camchain.

    The format of IN follows from its content, that of each OUT from its suffix or --to. Lenses are written exactly or
    refused, unless --max-error accepts the nearest one. What else is known and a format does not store is named.
    """
    from camcal.tasks.convert import convert as run
    from camcal.tasks.convert import document

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report))


def _show(report: "ConvertReport") -> None:
    from camcal.tasks.convert import words

    for converted in report.files:
        show.text(words(converted))
    show.wrote(*report.outputs)
