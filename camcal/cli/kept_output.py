"""What a command would print, kept for whoever called it as a part of something else."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from io import StringIO


@dataclass
class Kept:
    """What was not printed: to stdout, and to stderr as kinds and messages."""

    text: StringIO = field(default_factory=StringIO)
    messages: list[tuple[str, str]] = field(default_factory=list)


KEPT: ContextVar[Kept | None] = ContextVar("kept", default=None)


@contextmanager
def kept() -> Iterator[Kept]:
    """Yield what takes all that the block would print."""
    found = Kept()
    token = KEPT.set(found)
    try:
        yield found
    finally:
        KEPT.reset(token)
