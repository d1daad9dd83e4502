"""The letters that figures in text are made of: blocks where the encoding of a terminal has them, ASCII otherwise."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Letters:
    """Levels of gray, parts of a bar and of a column from empty to full, the frame, and other marks.

    frame: corners from the top left in reading order, a horizontal and a vertical line.
    """

    grays: str
    bar: str
    column: str
    frame: str
    expected: str
    outside: str = "/"


BLOCKS = Letters(" ░▒▓█", " ▏▎▍▌▋▊▉█", " ▁▂▃▄▅▆▇█", "┌┐└┘─│", "│")
ASCII = Letters(" .:o#", " #", " .:-=+*%#", "++++-|", "|")


def letters(encoding: str | None) -> Letters:
    """Return the letters for a stream of an encoding."""
    try:
        f"{BLOCKS.grays}{BLOCKS.bar}{BLOCKS.column}{BLOCKS.frame}".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return ASCII
    return BLOCKS
