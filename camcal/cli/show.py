"""What commands print: text, tables and JSON documents to stdout; progress, warnings and errors to stderr."""

import json
import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import StringIO
from pathlib import Path, PurePath
from typing import Any, TextIO

from camcal import records
from camcal.cli.progress_bar import ProgressBar
from camcal.dataclass import dataclass, field
from camcal.errors import FileError, reason
from camcal.files import STANDARD
from camcal.messages import Message, counted
from camcal.parsing import in_one_line
from camcal.progress import Item, Outcome, Progress, Silent
from camcal.report.table import Column, table_lines, wrapped
from camcal.urls import named

DO_NOT_TRUST = "DO NOT TRUST: "
TRUSTWORTHY = "Calibration is trustworthy"
LISTED = 10  # rows and lines of a list, unless all are asked for

_BOLD_GREEN, _BOLD_RED, _PLAIN = "\x1b[1;32m", "\x1b[1;31m", "\x1b[0m"
_NARROWEST = 40  # cells: no line is made shorter
_SIGNIFICANT_DIGITS = 12
_LONGEST = 4000  # characters of a line on stderr
_QUOTED = 100  # characters of a quotation that is shortened
_QUOTATION = re.compile(r"""(['"])((?:(?!\1).){200,})\1""")
_STEERING = re.compile(  # of a terminal, of the direction of writing, or without a width
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff]"
)


@dataclass
class Session:
    """The JSON output of one command: the document of its result, if it has one, and all warnings."""

    command: str | None = None
    result: Mapping[str, Any] = field(default_factory=dict)
    warnings: list[Message] = field(default_factory=list)

    def document(self, command: str, error: Mapping[str, Any], failures: Sequence[Message] = ()) -> None:
        """Print the one document: result, warnings, and what failed; `command` counts where there is no result."""
        found = plain([*self.result.get("failures", ()), *failures])
        failed = {"failures": [each for place, each in enumerate(found) if each not in found[:place]]} if found else {}
        document(self.command or command, {**self.result, "warnings": self.warnings, **failed, **error})


@dataclass
class Kept:
    """What was not printed: to stdout, and to stderr as kinds and messages."""

    text: StringIO = field(default_factory=StringIO)
    messages: list[tuple[str, str]] = field(default_factory=list)


KEPT: ContextVar[Kept | None] = ContextVar("kept", default=None)
_session: ContextVar[Session | None] = ContextVar("session", default=None)
_aside: ContextVar[bool] = ContextVar("aside", default=False)


def text(line: str) -> None:
    """Print a line to stdout, what steers a terminal written as escapes; on a terminal it ends at words."""
    _print(_lines_of(line))


def value(line: str) -> None:
    """Print a line for a program to stdout: it is never cut."""
    _print([printable(line)])


def verdict(line: str, *, good: bool | None) -> None:
    """Print what a user should see first: what was judged, its state, and the figures that decide, in a line.

    It begins with a capital letter, and is green or red and bold on a terminal; good is None if nothing was judged.
    """
    indent = len(line) - len(line.lstrip(" "))
    lines = _lines_of(line[: indent + 1].upper() + line[indent + 1 :])
    has_colours = _on_terminal() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    if good is not None and has_colours:
        lines = [f"{_BOLD_GREEN if good else _BOLD_RED}{part}{_PLAIN}" for part in lines]
    _print(lines)


def trust(failures: Sequence[Message | str], where: str = "") -> None:
    """Print the verdict on a calibration: that it is to be trusted, and where, or why not, a line each."""
    for failure in failures:
        verdict(f"{DO_NOT_TRUST}{failure}", good=False)
    if not failures:
        verdict(f"{TRUSTWORTHY}{where}", good=True)


def figure(draw: Callable[[int, str | None], Sequence[str]]) -> None:
    """Print a figure made of letters on a terminal: draw(width, encoding) gives its lines. A pipe gets none."""
    stream = _stream()
    if stream is not None and _on_terminal():
        _print(draw(width(), stream.encoding))


def wrote(*files: Path | str | None) -> None:
    """Print the one line about what was written: paths, or what `several` says of them.

    None was not asked for, and what went to standard output is there to be seen.
    """
    listed = [str(file) for file in files if file is not None and str(file) != STANDARD]
    if listed:
        text(f"wrote {' and '.join(filter(None, (', '.join(listed[:-1]), listed[-1])))}")


def several(paths: Sequence[Path], noun: str) -> str | None:
    """Return files in words for `wrote`: '20 images to left/, right/', a few by their paths, None for no file."""
    folders = list(dict.fromkeys(path.parent for path in paths))
    if len(paths) <= len(folders):
        return ", ".join(map(str, paths)) or None
    return f"{len(paths)} {noun}s to {', '.join(f'{folder}{os.sep}' for folder in folders)}"


def reused(outcomes: Sequence[Outcome[Any, Any]], noun: str) -> None:
    """Print how many items were left as an earlier run made them, if some were."""
    count = sum(outcome.reused for outcome in outcomes)
    if count and count == len(outcomes):
        text(f"nothing to do: {counted(count, noun)} complete and unchanged")
    elif count:
        text(f"{count} of {counted(len(outcomes), noun)} complete and unchanged: left as they are")


def made(outcomes: Iterable[Outcome[Any, Item]]) -> list[Item]:
    """Return what this run made of its items, without what it reused."""
    return [outcome.value for outcome in outcomes if outcome.value is not None and not outcome.reused]


def _lines_of(line: str) -> list[str]:
    """Return the lines that a line of text takes: whole in a pipe, where whoever reads it may search for words."""
    lines = printable(line).split("\n")
    return [part for each in lines for part in wrapped(each, width())] if _on_terminal() else lines


def _print(lines: Iterable[str]) -> None:
    """Print lines to stdout, or beside it; a closed pipe swallows them."""
    stream = _stream()
    try:
        for line in lines if stream is not None else ():
            print(line, file=stream)
    except OSError as error:
        if not _aside.get():
            discard_stdout(error)


@contextmanager
def aside() -> Iterator[None]:
    """Print to stderr what the block would print to stdout, because a result goes there."""
    token = _aside.set(True)
    try:
        yield
    finally:
        _aside.reset(token)


@contextmanager
def kept() -> Iterator[Kept]:
    """Yield what takes all that the block would print, for whoever called a command as a part of something else."""
    printed = Kept()
    token = KEPT.set(printed)
    try:
        yield printed
    finally:
        KEPT.reset(token)


def _stream() -> TextIO | None:
    if (found := KEPT.get()) is not None:
        return found.text
    return sys.stderr if _aside.get() else sys.stdout


def width() -> int:
    """Return how many cells a line may have: COLUMNS of the environment, else those of the terminal, 80 in a pipe."""
    return max(_NARROWEST, shutil.get_terminal_size().columns)


def _on_terminal() -> bool:
    stream = _stream()
    return stream is not None and stream.isatty()


def printable(words: str) -> str:
    """Return words with escapes for control characters, for what turns the direction of writing, and for no UTF-8."""
    return _STEERING.sub(lambda found: repr(found[0])[1:-1], named(words))


def flush() -> None:
    """Send out what was printed; raises FileError if it cannot be written (a full disk, not a closed pipe)."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        discard_stdout(error)


def discard_stdout(error: OSError) -> None:
    """Let further output, and the flush at exit, go nowhere. A closed pipe is no error: whoever read has enough."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
    if not isinstance(error, BrokenPipeError):
        raise FileError(f"cannot be written: {reason(error)}", where="standard output") from error


def lines(items: Sequence[str], verbose: bool) -> None:
    """Print the lines of a list: all of them, or the first ones and how many more there are."""
    for line in items if verbose else items[:LISTED]:
        text(line)
    if not verbose and len(items) > LISTED:
        text(f"… and {len(items) - LISTED} more (--verbose lists all)")


def titled(title: str, lines_below: Sequence[str], verbose: bool) -> None:
    """Print a title and lines below it as `lines` does, nothing without lines."""
    if lines_below:
        text(title)
        lines([f"  {line}" for line in lines_below], verbose)


def failed(items: Iterable[Outcome[Any, Any] | str]) -> None:
    """Print to stderr why items failed, a line each: outcomes of a fan-out, those with an error, or the reasons."""
    for item in items:
        why = item if isinstance(item, str) else item.error
        if why is not None:
            _complain("failed", str(why))


def distrust(failures: Iterable[Message]) -> None:
    """Print to stderr why a result is not to be trusted, where no verdict is printed to stdout."""
    for failure in failures:
        _complain("warning", f"{DO_NOT_TRUST}{failure}")


def table(
    title: str,
    columns: Sequence[Column | str],
    rows: Sequence[Sequence[object]],
    *,
    verbose: bool = False,
    most: int | None = None,
) -> None:
    """Print a title and aligned columns that fit the width.

    most: so many rows, and how many more there are. verbose: all rows, all columns and whole paths.
    """
    shown = [list(map(_printable_cell, row)) for row in (rows if verbose else rows[:most])]
    heads = [Column(column) if isinstance(column, str) else column for column in columns]
    text(title)
    _print(table_lines(heads, shown, width(), in_full=verbose))
    if len(shown) < len(rows):
        text(f"… and {len(rows) - len(shown)} more (--verbose lists all)")


def document(command: str, payload: Mapping[str, Any]) -> None:
    """Print the one JSON document of a command, such as 'stereo cloud': its schema first, then the payload.

    Numbers have 12 significant digits; NaN and infinities become null, records mappings, arrays lists, paths text.
    """
    schema = f"camcal/{command.replace(' ', '-')}/1"
    value(json.dumps({"schema": schema, **plain(payload)}, indent=2, allow_nan=False))


def plain(value: Any) -> Any:
    """Return a value as JSON takes it: 12 significant digits, null for NaN, lists for arrays, texts for paths."""
    if records.is_record(value):
        value = records.document(value)
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if math.isfinite(value) else None
    return value.as_posix() if isinstance(value, PurePath) else value


def result(command: str, payload: Mapping[str, Any]) -> None:
    """Keep the document of a command's result until its end, when it is known what failed."""
    session = _session.get()
    if session is None:
        document(command, payload)
    else:
        session.command, session.result = command, payload


@contextmanager
def session() -> Iterator[Session]:
    """Yield what collects the result and the warnings of the command inside the block."""
    found = Session()
    token = _session.set(found)
    try:
        yield found
    finally:
        _session.reset(token)


def warning(message: Message) -> None:
    """Print a warning to stderr, once in a command."""
    if _is_new(message):
        _complain("warning", str(message))


def _is_new(message: Message) -> bool:
    """Return whether a command warns of something for the first time, and keep it for its document."""
    session = _session.get()
    if session is None:
        return True
    new = message not in session.warnings
    if new:
        session.warnings.append(message)
    return new


def note(about: str, line: str) -> None:
    """Print to stderr what came of a part of the work while the rest goes on."""
    _complain(about, line)


def error(message: str) -> None:
    """Print an error to stderr, one line for each of its lines."""
    _complain("error", message)


def examples(calls: Sequence[str]) -> None:
    """Print the most common calls of a command to stderr, for whoever called it without anything."""
    if sys.stderr is None or not calls:
        return
    with suppress(OSError):
        print("\n".join(["most common calls:", *(f"  {call}" for call in calls)]), file=sys.stderr)  # noqa: T201


def progress(quiet: bool) -> Progress:
    """Return what a task reports to: a bar on a terminal unless `quiet`, and warnings as lines in any case."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        return _Warnings()
    return _Terminal()


class _Warnings(Silent):
    def warn(self, message: Message) -> None:
        warning(message)


class _Terminal(ProgressBar):
    """A progress bar, and warnings above it."""

    def warn(self, message: Message) -> None:
        if self.bar is None:
            warning(message)
            return
        for line in _lines("warning", str(message)) if _is_new(message) else ():
            self.print_above(line)


def _complain(kind: str, message: str) -> None:
    if (found := KEPT.get()) is not None:
        found.messages.append((kind, message))
        return
    if sys.stderr is None:
        return
    with suppress(OSError):  # nobody is left to hear of it
        for line in _lines(kind, message):
            print(line, file=sys.stderr)  # noqa: T201


def _lines(kind: str, message: str) -> Iterator[str]:
    """Yield the lines of a message as they are shown: without what steers a terminal, and none without end.

    On a terminal they end at words.
    """
    for line in map(printable, message.split("\n")):
        said = f"camcal: {kind}: {_shorten(line)}"
        yield from wrapped(said, width()) if sys.stderr.isatty() else [said]


def _shorten(line: str) -> str:
    """Return a line with long quotations of files shortened, ending at a word where it would be too long."""
    line = _QUOTATION.sub(lambda found: f"{found[1]}{found[2][:_QUOTED]} …{found[1]}", line)
    if len(line) <= _LONGEST:
        return line
    kept = line[:_LONGEST]
    return f"{kept.rpartition(' ')[0] or kept} …"


def _printable_cell(cell: object) -> object:
    return printable(in_one_line(cell)) if isinstance(cell, str) else cell
