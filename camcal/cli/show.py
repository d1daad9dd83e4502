"""What commands print: text, tables and JSON documents to stdout; progress, warnings and errors to stderr."""

import json
import math
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from camcal.errors import FileError, in_one_line, reason
from camcal.progress import Outcome, Progress, Silent

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

LISTED = 10  # rows and lines of a list, unless all are asked for

_REDRAW_S = 0.1
_LONGEST = 400  # characters of a line on stderr
_END = 100  # of them that stay of its end
_STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
_SIGNIFICANT_DIGITS = 12

_documents: ContextVar[list[str] | None] = ContextVar("documents", default=None)


def text(line: str) -> None:
    """Print a line to stdout, what steers a terminal written as escapes; a closed pipe swallows it."""
    try:
        print(printable(line))  # noqa: T201
    except OSError as error:
        give_up_stdout(error)


def printable(words: str) -> str:
    """Return words with escapes in the place of control characters, and of those that turn the direction of writing."""
    return _STEERING.sub(lambda found: repr(found[0])[1:-1], words)


def flush() -> None:
    """Send out what was printed; raises FileError if it cannot be written (a full disk, not a closed pipe)."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        give_up_stdout(error)


def give_up_stdout(error: OSError) -> None:
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


def failed(outcomes: Iterable[Outcome[Any, Any]]) -> None:
    """Print why items of a fan-out failed, a line each."""
    for outcome in outcomes:
        if outcome.error is not None:
            text(f"failed: {outcome.error}")


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], verbose: bool = True) -> None:
    """Print a title and aligned columns; numbers to the right with 6 significant digits, None as a dash.

    verbose: all rows, otherwise the first ones and how many more there are.
    """
    shown = rows if verbose else rows[:LISTED]
    cells = [list(columns), *([_cell(value) for value in row] for row in shown)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    numeric = [all(value is None or _is_number(value) for value in column) for column in zip(*shown, strict=True)]
    aligned = [
        [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric or [False] * len(widths), strict=True)
        ]
        for row in cells
    ]
    text(title)
    for row in aligned:
        text(f"  {'  '.join(row)}".rstrip())
    if len(shown) < len(rows):
        text(f"… and {len(rows) - len(shown)} more (--verbose lists all)")


def document(command: str, payload: Mapping[str, Any]) -> None:
    """Print the one JSON document of a command, such as 'stereo cloud': its schema first, then the payload.

    Numbers have 12 significant digits; NaN and infinities become null, arrays lists, paths text.
    """
    schema = f"camcal/{command.replace(' ', '-')}/1"
    text(json.dumps({"schema": schema, **_plain(payload)}, indent=2, allow_nan=False))
    shown = _documents.get()
    if shown is not None:
        shown.append(schema)


@contextmanager
def documents() -> Iterator[list[str]]:
    """Yield a list that receives the schema of every document printed inside the block."""
    shown: list[str] = []
    token = _documents.set(shown)
    try:
        yield shown
    finally:
        _documents.reset(token)


def warning(message: str) -> None:
    """Print a warning to stderr, one line for each of its lines."""
    _complain("warning", message)


def error(message: str) -> None:
    """Print an error to stderr, one line for each of its lines."""
    _complain("error", message)


def progress(quiet: bool) -> Progress:
    """Return what a task reports to: a bar on a terminal unless `quiet`, and warnings as lines in any case."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        return _Warnings()
    return _Terminal()


class _Warnings(Silent):
    def warn(self, message: str) -> None:
        warning(message)


class _Terminal:
    """A progress bar on stderr, drawn when items are done and not by a thread of its own."""

    def __init__(self) -> None:
        self.bar: Bar | None = None
        self.drawn = 0.0

    def start(self, what: str, total: int | None) -> None:
        from rich import progress as rich
        from rich.console import Console

        columns = (rich.TextColumn("{task.description}", markup=False), rich.BarColumn(), rich.MofNCompleteColumn())
        self.bar = rich.Progress(
            *columns,
            rich.TimeRemainingColumn(),
            console=Console(stderr=True),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self.bar.add_task(what, total=total)
        self.bar.start()

    def advance(self, count: int = 1) -> None:
        if self.bar is None:
            return
        self.bar.advance(self.bar.task_ids[0], count)
        if time.monotonic() - self.drawn > _REDRAW_S:
            self.bar.refresh()
            self.drawn = time.monotonic()

    def finish(self) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None

    def warn(self, message: str) -> None:
        if self.bar is None:
            warning(message)
            return
        for line in _lines(message):
            self.bar.console.print(f"camcal: warning: {line}", markup=False, highlight=False, soft_wrap=True)


def _complain(kind: str, message: str) -> None:
    if sys.stderr is None:
        return
    with suppress(OSError):  # nobody is left to hear of it
        for line in _lines(message):
            print(f"camcal: {kind}: {line}", file=sys.stderr)  # noqa: T201


def _lines(message: str) -> Iterator[str]:
    """Yield the lines of a message as they are shown: without what steers a terminal, and none without end."""
    for line in map(printable, message.split("\n")):
        yield line if len(line) <= _LONGEST else f"{line[: _LONGEST - _END]} … {line[-_END:]}"


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if _is_number(value) and not isinstance(value, int) else in_one_line(str(value))


def _is_number(value: object) -> bool:
    return hasattr(value, "__float__") and not isinstance(value, bool)


def _plain(value: Any) -> Any:
    """Return the value as JSON takes it."""
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if math.isfinite(value) else None
    return str(value) if isinstance(value, PurePath) else value
