"""What operating systems do in their own ways with files: locks, opening without waiting, pipes, the case of names.

Nothing else asks for what only some of them have; for signals and processes that is `run.process`.
"""

import os
import select
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = fcntl is not None
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def lock(handle: int) -> None:
    """Lock an open file; raises BlockingIOError if another process has, OSError where the file system has no locks."""
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Keep the lock of a file during the block, where there are locks; raises BlockingIOError as `lock` does."""
    with ExitStack() as opened:
        for access in (os.O_RDONLY, os.O_RDWR):  # NFS locks nothing that is opened for reading only
            try:
                handle = os.open(path, access | _WITHOUT_WAITING)
                opened.callback(os.close, handle)
                lock(handle)
                break
            except BlockingIOError:
                raise
            except OSError:  # a file system without locks, or a file that may not be written
                continue
        yield


@contextmanager
def made_and_held(path: Path) -> Iterator[None]:
    """Keep a file that is made and locked for the block, and removed after it; raises BlockingIOError as `lock` does.

    There is none where there are no locks, or where it cannot be made.
    """
    with ExitStack() as opened:
        while HAS_LOCKS:
            try:
                handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | _WITHOUT_WAITING, 0o600)
            except OSError:
                break
            opened.callback(os.close, handle)
            try:
                lock(handle)
            except BlockingIOError:
                raise
            except OSError:  # a file system without locks
                pass
            if _is_at(handle, path):  # else the one that held it has removed it meanwhile
                opened.callback(_remove, handle, path)
                break
        yield


def _remove(handle: int, path: Path) -> None:
    """Remove an open file, unless another one stands in its place."""
    if _is_at(handle, path):
        path.unlink()


def _is_at(handle: int, path: Path) -> bool:
    """Return whether a path still leads to an open file."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), path.stat())
    return False


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes that ask for the same from a folder during the block, where the system has locks."""
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def open_to_read(path: Path, *, follow: bool = True) -> int:
    """Return the handle of an opened file; of a named pipe too, which would else wait for its writer, however long.

    follow: open what a symbolic link stands for; otherwise OSError is raised for a link.
    """
    return os.open(path, os.O_RDONLY | _WITHOUT_WAITING | (0 if follow else getattr(os, "O_NOFOLLOW", 0)))


def wait_for_data(pipe: BinaryIO, seconds: float | None) -> bool:
    """Return whether something is in a pipe, or its end, within a time; from then on reading waits for more."""
    if not hasattr(os, "O_NONBLOCK"):  # opening has waited, and `select` takes sockets only
        return True
    if not select.select([pipe], [], [], seconds)[0]:
        return False
    os.set_blocking(pipe.fileno(), True)
    return True


def place_of(path: Path) -> str:
    """Return what all spellings of the path of one file have in common, where its folder ignores the case of names."""
    place = str(path.resolve())
    return place.casefold() if ignores_case(path.absolute().parent) else place


def ignores_case(folder: Path) -> bool:
    """Return whether a folder takes names that differ only in case for one, as folders of Windows and macOS do.

    This is told by its own name, or by that of the nearest folder above it that exists and has letters in its name.
    """
    for known in (folder, *folder.parents):
        other = known.with_name(known.name.swapcase()) if known.name.swapcase() != known.name else known
        if other != known and known.exists():
            return other.exists() and other.samefile(known)
    return False
