"""Progress reports, and the outcome of one item of a fan-out."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, Protocol, TypeVar

from camcal.dataclass import dataclass
from camcal.errors import CamcalError, ItemsFailed
from camcal.messages import Message

Item = TypeVar("Item")
Value = TypeVar("Value")
Other = TypeVar("Other")


class Progress(Protocol):
    """The progress of a task; the command line shows a bar, the library nothing."""

    def start(self, what: str, total: int | None) -> None: ...
    def advance(self, count: int = 1) -> None: ...
    def finish(self) -> None: ...
    def warn(self, message: Message) -> None: ...


class Silent:
    """The default: no output."""

    def start(self, what: str, total: int | None) -> None:
        pass

    def advance(self, count: int = 1) -> None:
        pass

    def finish(self) -> None:
        pass

    def warn(self, message: Message) -> None:
        pass


class Collected(Silent):
    """Keeps warnings, for work that has nobody to tell them to."""

    def __init__(self) -> None:
        self.warnings: list[Message] = []

    def warn(self, message: Message) -> None:
        self.warnings.append(message)


SILENT = Silent()


@dataclass
class Timing:
    """How long a stage of work took: wall-clock time and the processor time of this process, s."""

    wall_s: float = 0.0
    cpu_s: float = 0.0


class Timed:
    """Passes the progress on, and notes in `timings` how long each stage takes, under its name."""

    def __init__(self, progress: Progress, timings: dict[str, Timing]) -> None:
        self.progress, self.timings = progress, timings
        self.stage, self.began = "", (0.0, 0.0)

    def start(self, what: str, total: int | None) -> None:
        self.stage, self.began = what, (time.perf_counter(), time.process_time())
        self.progress.start(what, total)

    def advance(self, count: int = 1) -> None:
        self.progress.advance(count)

    def finish(self) -> None:
        timing = self.timings.setdefault(self.stage, Timing())
        timing.wall_s += time.perf_counter() - self.began[0]
        timing.cpu_s += time.process_time() - self.began[1]
        self.progress.finish()

    def warn(self, message: Message) -> None:
        self.progress.warn(message)


@contextmanager
def stage(progress: Progress, what: str) -> Iterator[None]:
    """Report a stage of work that has no items."""
    progress.start(what, None)
    try:
        yield
    finally:
        progress.finish()


def warn_of(messages: Iterable[Message], progress: Progress) -> None:
    """Give every one of some warnings."""
    for message in messages:
        progress.warn(message)


@dataclass(frozen=True)
class Outcome(Generic[Item, Value]):
    """One item of a fan-out: its value, or the error that kept it from one.

    reused: whether an earlier run made it, and this one left it as it is.
    """

    item: Item
    value: Value | None = None
    error: CamcalError | None = None
    reused: bool = False

    def of(self, item: Other) -> "Outcome[Other, Value]":
        """Return it as that of another item, such as the file that it is about."""
        return Outcome(item, self.value, self.error, self.reused)


def reused(outcomes: Iterable[Outcome[Item, Value]]) -> int:
    """Return how many items of a fan-out an earlier run made."""
    return sum(outcome.reused for outcome in outcomes)


def failed_items(outcomes: Iterable[Outcome[Any, Any]], *names: str) -> list[dict[str, Any]]:
    """Return the items of a fan-out that failed, or their parts, under some names, and why, as plain data."""
    return [
        dict(zip(names, outcome.item if isinstance(outcome.item, tuple) else [outcome.item], strict=False))
        | {"message": str(outcome.error)}
        for outcome in outcomes
        if outcome.error is not None
    ]


def values_of(outcomes: Iterable[Outcome[Item, Value]]) -> list[Value]:
    """Return the values of a fan-out that makes no sense without all of them; raises the first error."""
    outcomes = list(outcomes)
    for outcome in outcomes:
        if outcome.error is not None:
            raise outcome.error
    return [outcome.value for outcome in outcomes if outcome.value is not None]


def require_all(outcomes: Iterable[Outcome[Item, Value]], what: str) -> None:
    """Raise ItemsFailed with the first error if items of a fan-out failed; what: the items in words, such as images."""
    outcomes = list(outcomes)
    failed = [str(outcome.error) for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{ItemsFailed.of(len(failed), len(outcomes), what)}: {failed[0]}")
