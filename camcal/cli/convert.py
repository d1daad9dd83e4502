"""`camcal convert`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.options import ConvertFileOptions

if TYPE_CHECKING:
    from camcal.tasks.convert import ConvertedFile


def convert(options: ConvertFileOptions, call: Call) -> None:
    """Convert a camera file: camcal's own, OpenCV's FileStorage (YAML, XML, JSON), ROS camera_info, Kalibr's camchain.

    The format of IN is told by its content, that of OUT by its suffix or --to. Lenses are written exactly or refused,
    unless --max-error accepts the nearest one. What else is known and the other format does not hold is named.
    """
    from camcal.tasks.convert import convert as run
    from camcal.tasks.convert import document

    converted = run(options, call.progress)
    call.give(lambda: document(converted), lambda: _show(converted))


def _show(converted: "ConvertedFile") -> None:
    from camcal.tasks.convert import words

    show.text(words(converted))
    show.wrote(*converted.outputs)
