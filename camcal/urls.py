"""What stands for files of URLs: `run.remote` gives each a path when a URL is given, and reads and writes by it.

Without a URL there is nothing here but paths, and nothing touches a network.
"""

from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from typing import Protocol


class Remote(Protocol):
    """What reads and writes the files of URLs, each by a path that stands for it; see `run.remote`."""

    def holds(self, path: Path) -> bool:
        """Return whether a path stands for a URL."""

    def named(self, text: str) -> str:
        """Return a text with URLs in place of the paths that stand for them."""

    def standing(self, text: str) -> str:
        """Return a text with the paths that stand for URLs in place of these: what was made by `named`."""

    def local(self, path: Path) -> Path:
        """Return where the content of a path can be read."""

    def item(self) -> AbstractContextManager[None]:
        """Remove copies that were made during a block at its end."""

    def new_file(self, path: Path) -> Path:
        """Return a new temporary file for the content of a path."""

    def send(self, temporary: Path, path: Path) -> None:
        """Let the content of a temporary file take the place of the file of a URL."""

    def append(self, path: Path, content: bytes) -> None:
        """Add to the file of a URL, which gets it later."""

    def flush(self, path: Path) -> None:
        """Let the file of a URL have all that was added to it."""

    def remove(self, path: Path) -> None:
        """Remove the file of a URL, if it is there."""


REMOTE: ContextVar[Remote | None] = ContextVar("remote", default=None)


def local(path: Path) -> Path:
    """Return where the content of a file is on this machine; a file of a URL is copied for that."""
    remote = REMOTE.get()
    return path if remote is None else remote.local(path)


def named(text: str) -> str:
    """Return a text as users know it, with URLs in place of the paths that stand for them."""
    remote = REMOTE.get()
    return text if remote is None else remote.named(text)


def standing(text: str) -> str:
    """Return a text that was kept as `named` returned it, perhaps by another process, with paths in place of URLs."""
    remote = REMOTE.get()
    return text if remote is None else remote.standing(text)


def item() -> AbstractContextManager[None]:
    """Remove at the end of a block, the work on one item, the copies that it needed."""
    remote = REMOTE.get()
    return nullcontext() if remote is None else remote.item()


def holder(path: Path) -> Remote | None:
    """Return what reads and writes a path that stands for a URL, None for any other path."""
    remote = REMOTE.get()
    return remote if remote is not None and remote.holds(path) else None


def append(path: Path, content: bytes) -> None:
    """Add to a file."""
    if (remote := holder(path)) is not None:
        remote.append(path, content)
        return
    with path.open("ab") as stream:
        stream.write(content)


def flush(path: Path) -> None:
    """Let a file have all that was added to it."""
    if (remote := holder(path)) is not None:
        remote.flush(path)


def remove(path: Path) -> None:
    """Remove a file, if it is there."""
    if (remote := holder(path)) is not None:
        remote.remove(path)
    else:
        path.unlink(missing_ok=True)
