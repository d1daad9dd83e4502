"""Safe reading of regular files, atomic writing, and natural order of file names."""

import codecs
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from threading import Lock
from typing import BinaryIO, Protocol, TextIO
from weakref import WeakKeyDictionary

from camcal import system, urls
from camcal.errors import FileError, reason
from camcal.system import TEMPORARY

STANDARD = "-"  # as a path: standard input or output
LARGEST = 4 << 30  # bytes of a file that is read as a whole

_LARGEST_PIPE = 256 << 20
_PIPE_TIMEOUT_S = 10.0  # until something comes out of a named pipe
_CHUNK = 1 << 20
_HEAD = 4096  # bytes by which the kind of a text is known
_KINDS = {".json": "JSON", ".yaml": "YAML", ".xml": "XML", ".csv": "CSV"}
_STARTS = (
    (".json", re.compile(rb'\s*(?:\{\s*["}]|\[\s*["\[\]{\d-])')),
    (".yaml", re.compile(rb"\s*(?:%YAML|---\s)")),
    (".xml", re.compile(rb"\s*<[?\w]")),
)
_UNMISTAKABLE = (".json", ".xml")  # kinds that always begin so
_LONGEST_SUFFIX = 16
_FULL = 1 << 16  # bytes free on a disk that counts as full
_UMASK = Lock()


class Ledger(Protocol):
    """What keeps account of the files that a run reads and writes, and refuses to lose one; see `run.outputs`."""

    def reads(self, path: Path, file: os.stat_result) -> None:
        """Note a file that is read; raises InvalidInput if it is to be written."""

    def writes(self, path: Path) -> None:
        """Raise InvalidInput for a file that must not be replaced, FileError for one that cannot be written."""

    def completes(self, path: Path, temporary: Path) -> bool:
        """Note what is to take the place of a file; return False to leave the file as it is, for it is the same."""

    def wrote(self, file: os.stat_result) -> None:
        """Note a file that was written."""


LEDGER: ContextVar[Ledger | None] = ContextVar("ledger", default=None)


@contextmanager
def unwatched() -> Iterator[None]:
    """Leave out of the ledger what the block reads and writes, as of outputs that are only examined."""
    token = LEDGER.set(None)
    try:
        yield
    finally:
        LEDGER.reset(token)


def note_read(path: Path) -> None:
    """Enter into the ledger, if a run has one, a file that is read in another way than by `opened`."""
    if (ledger := LEDGER.get()) is not None:
        with suppress(OSError):
            ledger.reads(path, path.stat())


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` (same suffix) that takes its place when the block succeeds.

    What is no file but a device, a named pipe or standard output ("-") is written to when the block has succeeded.
    The file is flushed to disk before the rename, so a killed run leaves the old file or the new one, never half. What
    a killed run left of a temporary file is removed by the next one that writes into the folder.
    Raises FileError if the folder cannot be written or is another one than before (see `system`), and what the ledger
    of a run raises.
    """
    ledger = LEDGER.get()
    if ledger is not None:
        ledger.writes(path)
    if is_stream(path):
        with _sent(path) as temporary:
            yield temporary
        return
    remote, made, handle = urls.holder(path), list[Path](), None
    try:  # from before there is a file: a signal may end the run at any moment
        handle = _make_beside(path, made)
        temporary = made[-1]
        yield temporary
        if ledger is None or ledger.completes(path, temporary):
            if remote is None:
                _put(temporary, path)
            else:
                remote.send(temporary, path)
        if ledger is not None:
            ledger.wrote(path.stat())
    except (OSError, FileError) as error:
        system.require_same(path.parent)  # else that is the reason
        if isinstance(error, OSError):
            raise _unwritable(path, error) from error
        raise
    finally:
        with suppress(OSError):  # its folder is another one now
            for each in made:
                each.unlink(missing_ok=True)
        if handle is not None:
            os.close(handle)


def _make_beside(path: Path, made: list[Path]) -> int | None:
    """Make a temporary file beside `path`, in a folder that is made for it; see `_make_locked`."""
    if (remote := urls.holder(path)) is not None:
        made.append(remote.new_file(path))
        return None
    try:
        system.prepare(path.parent)
        _sweep(path.parent.absolute())
        return _make_locked(path, made)
    except OSError as error:
        raise _unwritable(path, error) from error


def _put(temporary: Path, path: Path) -> None:
    """Flush a finished file to disk and give it its name."""
    with temporary.open("r+b") as stream:  # Windows flushes only what may be written
        os.fsync(stream.fileno())
    with _UMASK:  # asking for it sets it: two threads at once would leave it at nothing
        umask = os.umask(0)
        os.umask(umask)
    temporary.chmod(0o666 & ~umask)
    system.require_same(path.parent)
    temporary.replace(path)


def is_stream(path: Path) -> bool:
    """Return whether what is written there goes on its way: standard output, a device or a named pipe."""
    if str(path) == STANDARD:
        return True
    with suppress(OSError):
        mode = path.stat().st_mode
        return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)
    return False


@contextmanager
def _sent(path: Path) -> Iterator[Path]:
    """Yield a temporary path, whose content goes to a stream when the block succeeds; a closed pipe ends the run."""
    with tempfile.TemporaryDirectory(prefix=TEMPORARY) as folder:
        temporary = Path(folder) / f"output{path.suffix}"
        yield temporary
        try:
            with temporary.open("rb") as content:
                if str(path) != STANDARD:
                    with path.open("wb") as stream:
                        shutil.copyfileobj(content, stream)
                    return
                sys.stdout.flush()
                shutil.copyfileobj(content, sys.stdout.buffer)
                sys.stdout.buffer.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _unwritable(path, error) from error


def _make_locked(path: Path, made: list[Path]) -> int | None:
    """Make a temporary file beside `path`, open and locked for as long as it is being written, and return its handle.

    made: gets its name, before there is such a file. It is not held open where there are no locks, since open files are
    not renamed there.
    """
    suffix = path.suffix if len(path.suffix) <= _LONGEST_SUFFIX else ""
    while True:
        handle = system.open_new(path.parent, suffix, made)
        if not system.HAS_LOCKS:
            os.close(handle)
            return None
        try:
            system.lock(handle)
        except BlockingIOError:  # a sweep was faster, and removes it
            os.close(handle)
            continue
        except OSError:  # a file system without locks, where nothing is swept either
            return handle
        if made[-1].exists():
            return handle
        os.close(handle)


@cache
def _sweep(folder: Path) -> None:
    """Remove what runs that were killed left in a folder, once in a process: temporary files that are not locked."""
    for path in folder.glob(f"{TEMPORARY}*") if system.HAS_LOCKS else ():
        with suppress(OSError):  # another run writes it, or the file system has no locks, or it is gone
            handle = system.open_to_read(path, follow=False)
            try:
                system.lock(handle)
                path.unlink()
            finally:
                os.close(handle)


def _unwritable(path: Path, error: OSError) -> FileError:
    """Return the error of a file that cannot be written; libraries that count bytes do not say that a disk is full."""
    words = reason(error)
    if error.errno is None:
        with suppress(OSError):
            words = "the disk is full" if shutil.disk_usage(path.parent).free < _FULL else words
    return FileError(f"cannot be written: {words}", where=str(path))


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path` in one step; see `replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write `content` as UTF-8 with Unix line ends to `path` in one step; see `replacing` and `utf8`."""
    write_bytes(path, utf8(content))


def utf8(text: str) -> bytes:
    """Return a text as UTF-8: URLs by their own names, escapes in the place of bytes of file names that are none."""
    return urls.named(text).encode("utf-8", "backslashreplace")


def read_text(path: Path, limit: int = 64 << 20) -> str:
    """Return the text of a UTF-8 file (a byte-order mark is dropped).

    Raises FileError if it is missing, a folder or a device, empty, larger than `limit` bytes or not UTF-8.
    """
    content = read_bytes(path, limit)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"not a text file (byte {error.start} is not UTF-8)", where=str(path)) from error


def read_bytes(path: Path, limit: int = LARGEST) -> bytes:
    """Return the bytes of a file, or of a pipe up to its end.

    Raises FileError if it is missing, a folder or a device, empty or larger than `limit`, and for a named pipe that
    no process writes to.
    """
    with opened(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise FileError(f"{size} bytes is more than the limit of {limit}", where=str(path))
        if _is_pipe(stream):
            limit = min(limit, _LARGEST_PIPE)
        content = stream.read() if size else _read_up_to(stream, limit + 1)  # a pipe, or what the system makes up
    if not content:
        raise FileError("is empty", where=str(path))
    if len(content) > limit:
        raise FileError(f"more than the limit of {limit} bytes", where=str(path))
    return content


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading: a regular one, or a pipe once something is in it; errors within become FileError.

    Standard input ("-") is read once and can be opened again. Raises FileError if it is missing, a folder or a device,
    or a named pipe into which nothing comes.
    """
    if str(path) == STANDARD:
        with _standard_input() as stream:
            yield stream
        return
    try:
        content = urls.local(path)
        handle = system.open_to_read(content)
        with os.fdopen(handle, "rb") as stream:
            _require_readable(stream, path)
            if (ledger := LEDGER.get()) is not None:
                ledger.reads(path, os.fstat(handle) if content is path else path.stat())
            yield stream
    except FileNotFoundError as error:
        missing = f"a broken link to {path.readlink()}" if path.is_symlink() else "no such file"
        raise FileError(missing, where=str(path)) from error
    except IsADirectoryError as error:
        raise FileError("is a folder, not a file", where=str(path)) from error
    except OSError as error:
        raise FileError(f"cannot be read: {reason(error)}", where=str(path)) from error


_RECEIVED: WeakKeyDictionary[TextIO, bytes] = WeakKeyDictionary()


@contextmanager
def _standard_input() -> Iterator[BinaryIO]:
    """Yield a file with what comes from standard input up to its end, which is read once."""
    source = sys.stdin
    if source is None:
        raise FileError("there is none", where="standard input")
    if source not in _RECEIVED:
        _RECEIVED[source] = _read_up_to(source.buffer, _LARGEST_PIPE + 1)
    content = _RECEIVED[source]
    if len(content) > _LARGEST_PIPE:
        raise FileError(f"more than the limit of {_LARGEST_PIPE} bytes", where="standard input")
    with tempfile.TemporaryFile() as stream:
        stream.write(content)
        stream.seek(0)
        yield stream


def suffix_of(path: Path) -> str:
    """Return the suffix of a path in small letters; of standard input the one that its content resembles.

    That is .json for what begins with a bracket, .yaml for keys with a colon, otherwise .csv.
    """
    if str(path) != STANDARD:
        return path.suffix.lower()
    with opened(path) as stream:
        head = stream.read(_HEAD)
    if head.lstrip().startswith((b"{", b"[")):
        return ".json"
    lines = [line for line in head.splitlines() if line.strip() and not line.startswith(b"#")]
    return ".yaml" if lines and re.match(rb"%YAML|---|[\w.]+:(\s|$)", lines[0]) else ".csv"


def stem_of(name: str) -> str:
    """Return the name of an object as a part of a file's name: letters, digits, -, _ and . stay."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)


def require_content(path: Path) -> None:
    """Raise FileError if the suffix of a text file and its content contradict each other, as YAML in a .json does."""
    suffix = {".yml": ".yaml"}.get(path.suffix.lower(), path.suffix.lower())
    if suffix not in _KINDS or not path.is_file():
        return
    with unwatched(), opened(path) as stream:
        head = stream.read(_HEAD).removeprefix(codecs.BOM_UTF8)
    found = next((kind for kind, start in _STARTS if start.match(head)), None)
    if head and found != suffix and (found or suffix in _UNMISTAKABLE):
        held = f"holds {_KINDS[found]}" if found else f"does not begin as {_KINDS[suffix]} does"
        raise FileError(f"the suffix is {path.suffix} and the file {held}; rename it", where=str(path))


def _require_readable(stream: BinaryIO, path: Path) -> None:
    mode = os.fstat(stream.fileno()).st_mode
    if stat.S_ISDIR(mode):
        raise FileError("is a folder, not a file", where=str(path))
    if _is_pipe(stream):
        if not system.wait_for_data(stream, _PIPE_TIMEOUT_S if _is_named(path) else None):
            raise FileError(f"is a named pipe without data for {_PIPE_TIMEOUT_S:g} s", where=str(path))
    elif not stat.S_ISREG(mode):
        raise FileError("is a device, not a file", where=str(path))


def _read_up_to(stream: BinaryIO, most: int) -> bytes:
    content = bytearray()
    while len(content) < most and (chunk := stream.read(min(_CHUNK, most - len(content)))):
        content += chunk
    return bytes(content)


def _is_pipe(stream: BinaryIO) -> bool:
    return stat.S_ISFIFO(os.fstat(stream.fileno()).st_mode)


def _is_named(path: Path) -> bool:
    """Return whether a pipe stands in a folder; that of a shell, or standard input, has a writer and may take long."""
    with suppress(OSError):  # there may be no standard input
        if os.path.samestat(path.stat(), os.fstat(0)):
            return False
    return Path(os.path.realpath(path)).exists()


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hex digits; raises FileError if it cannot be read."""
    digest = hashlib.sha256()
    with opened(path) as stream:
        for chunk in iter(lambda: stream.read(_CHUNK), b""):
            digest.update(chunk)
    return digest.hexdigest()


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key that puts image2 before image10; no two names have the same one."""
    parts = (
        (0, len(part.lstrip("0")), part.lstrip("0")) if part.isdigit() and part.isascii() else (1, 0, part.casefold())
        for part in re.split(r"([0-9]+)", name)
        if part
    )
    return *parts, (-1, 0, name)
