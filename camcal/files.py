"""Writing without half files, hashing, and the order people expect of numbered files."""

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from camcal.errors import FileError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` (same suffix) that takes its place when the block succeeds.

    The file is flushed to disk before the rename, so a killed run leaves the old file or the new one, never half.
    Raises FileError if the folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise FileError(f"cannot be written: {error.strerror}", where=str(path)) from error
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise FileError(f"cannot be written: {error.strerror}", where=str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path` in one step; see `replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write `content` as UTF-8 with Unix line ends to `path` in one step; see `replacing`."""
    write_bytes(path, content.encode("utf-8"))


def read_text(path: Path, limit: int = 64 << 20) -> str:
    """Return the text of a UTF-8 file (a byte-order mark is dropped).

    Raises FileError if it is missing, a folder, empty, larger than `limit` bytes or not UTF-8.
    """
    content = read_bytes(path, limit)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"not a text file (byte {error.start} is not UTF-8)", where=str(path)) from error


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """Return the bytes of a file; raises FileError if it is missing, a folder, empty or larger than `limit`."""
    try:
        size = path.stat().st_size
        if limit is not None and size > limit:
            raise FileError(f"{size} bytes is more than the limit of {limit}", where=str(path))
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise FileError("no such file", where=str(path)) from error
    except IsADirectoryError as error:
        raise FileError("is a folder, a file is needed", where=str(path)) from error
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if not content:
        raise FileError("is empty", where=str(path))
    return content


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hex digits."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        for chunk in iter(lambda: stream.read(1 << 20), b""):
            digest.update(chunk)
    return digest.hexdigest()


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key that puts image2 before image10."""
    return tuple(
        (0, int(part), "") if part.isdigit() and part.isascii() else (1, 0, part.casefold())
        for part in re.split(r"([0-9]+)", name)
        if part
    )
