"""What operating systems do in their own ways with files, and the folders that a run writes into.

Locks, opening without waiting, pipes, the case of names: nothing else asks for what only some systems have; for signals
and processes that is `run.process`.

Each folder stays the folder that it was, and output folders are the run's alone. A folder is noted by device and number
when something is first written into it. What takes its place later, a link or another folder, gets nothing: it is
compared before a temporary file is made and again before that gets its name, and a rename finds no temporary file in a
folder that was exchanged in between.
"""

import os
import select
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from camcal import urls
from camcal.errors import FileError, reason

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = fcntl is not None
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)

_NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
TEMPORARY = ".camcal.part-"  # how names of unfinished files begin
HELD = f"{TEMPORARY}run"  # the file that keeps other runs from an output folder

FolderId = tuple[int, int]
Known = dict[Path, FolderId] | None  # None outside of a run

KNOWN: ContextVar[Known] = ContextVar("folders", default=None)  # of the run at work
_LOCKED: set[int] = set()  # handles of this process by which it keeps locks


def release_locks() -> None:
    """Close the handles that a process was forked with: locks are those of its parent, and end with that."""
    while _LOCKED:
        os.close(_LOCKED.pop())


def _close(handle: int) -> None:
    _LOCKED.discard(handle)
    os.close(handle)


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
                _LOCKED.add(handle)
                opened.callback(_close, handle)
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
            _LOCKED.add(handle)
            opened.callback(_close, handle)
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
    _LOCKED.add(handle)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        _close(handle)


def open_new(folder: Path, suffix: str, made: list[Path]) -> int:
    """Return the handle of a new temporary file, to read and write; made: gets its path, before there is such a file.

    Raises FileExistsError if there is one by chance, OSError if none can be made.
    """
    made.append(folder.absolute() / f"{TEMPORARY}{os.urandom(8).hex()}{suffix}")
    return os.open(made[-1], _NEW, 0o600)


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


def prepare(folder: Path) -> None:
    """Make a folder for what is to be written into it, and note which one it is.

    Raises OSError if it cannot be made, FileError as `require_same`.
    """
    require_same(folder)
    folder.mkdir(parents=True, exist_ok=True)
    known = KNOWN.get()
    if known is not None and urls.holder(folder / "file") is None and (found := _id(folder)) is not None:
        known.setdefault(folder.absolute(), found)


def require_writable(path: Path) -> None:
    """Raise FileError if a file cannot be made in its folder, or the folder cannot."""
    folder = path.parent
    while not os.path.lexists(folder) and folder.parent != folder:
        folder = folder.parent
    if not folder.is_dir():
        raise FileError(f"cannot be written: {folder} is not a folder", where=str(path))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"cannot be written: no permission to write into {folder.absolute()}", where=str(path))


def require_same(folder: Path) -> None:
    """Raise FileError if a folder, or one above it, is no longer the one that the run has written into."""
    place = folder.absolute()
    _require_same((place, *place.parents))


def require_all_same() -> None:
    """Raise FileError if one of the folders that the run has written into is no longer the same."""
    _require_same(tuple(KNOWN.get() or ()))


def _require_same(folders: tuple[Path, ...]) -> None:
    known = KNOWN.get() or {}
    for folder in folders:
        if folder in known and known[folder] != _id(folder):
            text = "was moved, removed or replaced while the run wrote into it; run the command again"
            raise FileError(text, where=str(folder))


def _id(folder: Path) -> FolderId | None:
    with suppress(OSError):
        found = folder.stat()
        return found.st_dev, found.st_ino
    return None


class OutputFolders:
    """The folders of the outputs of a run. options: what names output folders, each with them.

    shared: with the run that this one is a part of, which holds them.
    """

    def __init__(self) -> None:
        self.options: dict[Path, str] = {}
        self.shared = False
        self._held: set[Path] = set()
        self._new: list[Path] = []
        self._stack = ExitStack()

    def hold_above(self, paths: Iterable[Path]) -> bool:
        """Hold the output folders that files go to, unless they are held; return whether one was not.

        Raises FileError as `hold`.
        """
        left = {} if self.shared else {each: self.options[each] for each in self.options.keys() - self._held}
        above = {folder for path in paths for folder in path.absolute().parents} if left else set()
        due = {folder: option for folder, option in left.items() if folder.absolute() in above}
        for folder, option in due.items():
            self.hold(folder, option)
        return bool(due)

    def hold(self, folder: Path, option: str) -> None:
        """Keep other runs from an output folder, which is made for that, until this one ends; option: what names it.

        A locked file in it does that; there is none where there are no locks or nothing can be written, nor at a URL.
        Raises FileError if another run works in it, or it cannot be made.
        """
        if folder in self._held or urls.holder(folder / HELD) is not None:
            return
        self.note_new(folder)
        try:
            prepare(folder)
            self._stack.enter_context(made_and_held((folder / HELD).absolute()))
        except BlockingIOError:
            text = f"another run writes into this folder; wait until it has ended, or give another {option}"
            raise FileError(text, where=str(folder)) from None
        except OSError as error:
            raise FileError(f"cannot be written: {reason(error)}", where=str(folder)) from error
        self._held.add(folder)

    def note_new(self, folder: Path) -> None:
        """Note folders that are about to be made."""
        place = folder.absolute()  # the working directory may be another one at the end
        self._new += [each for each in (place, *place.parents) if not each.exists()]

    def close(self) -> None:
        """Let other runs use the output folders, and remove folders that were made for nothing."""
        self._stack.close()
        for folder in sorted(self._new, key=lambda each: len(each.parts), reverse=True):
            with suppress(OSError, FileError):  # something is in it, or it is another one now
                require_same(folder)
                folder.rmdir()
