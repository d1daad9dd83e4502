"""How long work reports on itself, and what one item of a fan-out leaves behind."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from camcal.errors import CamcalError

Item = TypeVar("Item")
Value = TypeVar("Value")


class Progress(Protocol):
    """What a task tells whoever watches; the command line shows a bar, a library user nothing."""

    def start(self, what: str, total: int | None) -> None: ...
    def advance(self, count: int = 1) -> None: ...
    def finish(self) -> None: ...
    def warn(self, message: str) -> None: ...


class Silent:
    """The default: nobody is told anything."""

    def start(self, what: str, total: int | None) -> None:
        pass

    def advance(self, count: int = 1) -> None:
        pass

    def finish(self) -> None:
        pass

    def warn(self, message: str) -> None:
        pass


SILENT = Silent()


@dataclass(frozen=True)
class Outcome(Generic[Item, Value]):
    """One item of a fan-out: its value, or the error that kept it from one."""

    item: Item
    value: Value | None = None
    error: CamcalError | None = None
