"""Files that URLs name, by way of fsspec: s3://, gs://, and whatever else it knows.

A URL gets a path in a temporary folder that stands for it, since all of camcal works with paths. What is at the URL is
listed there by names and sizes. A file is copied when it is opened, and the copy removed with the item that needed it;
what is written goes to its URL as a whole, under its final name. Messages and files name the URL (`urls.named`).

This module is imported when a URL is given; nothing is asked for but what is at such URLs, beside and below them.
"""

import atexit
import glob
import re
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any

from camcal import urls
from camcal.errors import CamcalError, FileError, InvalidInput

_URL = re.compile(r"(?<![\w.+-])([A-Za-z][A-Za-z0-9+.-]+)://(/)?")
_PASSWORD = re.compile(r"[^/@]*:[^/@]*@")
_WITHOUT_FOLDERS = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "adl", "http", "https"})
_SLASH = "@"  # for the third slash of URLs such as file:///data
_LONGEST = 255  # bytes of a file's name
_SEND_S = 10.0  # between two uploads of a file that grows
_SENDING = 20.0  # and so many times what one takes
_COPIES: ContextVar[dict[Path, Path] | None] = ContextVar("copies", default=None)  # of the item at work


def given(text: str) -> str:
    """Return a text that a user gave with paths in place of its URLs, after listing what is at them.

    Raises InvalidInput for a URL that cannot be used, FileError for one that cannot be listed.
    """
    remote = urls.REMOTE.get()
    if not isinstance(remote, RemoteFiles):
        remote = RemoteFiles(_new_folder() / "urls")
        urls.REMOTE.set(remote)
    return remote.given(text)


class RemoteFiles:
    """The files of URLs. root: the folder that has a path for each; in another process it may not be there."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._copies: dict[Path, Path] = {}
        self._unsent: set[Path] = set()
        self._send_again = float("-inf")
        self._spelled = re.compile(re.escape(root.as_posix()) + rf"/([\w+.-]+)/({_SLASH}/)?")

    def __reduce__(self) -> tuple[type["RemoteFiles"], tuple[Path]]:
        return RemoteFiles, (self.root,)

    def given(self, text: str) -> str:
        """Return a text with paths in place of its URLs; see the function of this name."""
        found = _URL.search(text)
        if found is None:
            return text
        protocol, rest = found[1].lower(), text[found.end(1) + len("://") :]
        url, path = f"{protocol}://{rest}", self._path_of(protocol, rest)
        with _reach(url):
            self._list(url, path)
        return f"{text[: found.start()]}{path}"

    def _path_of(self, protocol: str, rest: str) -> Path:
        if _PASSWORD.match(rest):
            place = f"{protocol}://…@{rest.partition('@')[2]}"
            raise InvalidInput("results would record this password; give it by the environment", where=place)
        if any(part in (".", "..") for part in rest.split("/")) or "//" in rest or "::" in rest or not rest.strip("/"):
            raise InvalidInput("is not the URL of a file or folder", where=f"{protocol}://{rest}")
        return self.root / protocol / (f"{_SLASH}{rest}" if rest.startswith("/") else rest)

    def _list(self, url: str, path: Path) -> None:
        """Note what is beside a URL and below it; of a pattern, below the folders before it, of a topic by its bag."""
        system, place = _file_system(url)
        system.invalidate_cache()
        while glob.has_magic(place) or "#/" in place:
            place, path, url = place.rpartition("/")[0], path.parent, url.rpartition("/")[0]
        parent = place.rpartition("/")[0]
        if parent.strip("/"):
            self._note(_list_folder(system, parent), parent, path.parent)
        if path.is_dir() or system.isdir(place):
            self._note(system.find(place, withdirs=True, detail=True).values(), place, path)

    def _note(self, listed: Iterable[Mapping[str, Any]], place: str, path: Path) -> None:
        """Let paths stand for what was listed at a place, which `path` stands for."""
        for each in listed:
            name = each["name"].removeprefix(place).strip("/")
            if not name:
                continue
            if any(part in ("", ".", "..") or len(part.encode()) > _LONGEST for part in name.split("/")):
                raise FileError(f"holds {each['name']!r}, which is no name of a file", where=self.named(str(path)))
            if each["type"] == "directory":
                (path / name).mkdir(parents=True, exist_ok=True)
            else:
                _stand_in(path / name, each.get("size") or 0)

    def holds(self, path: Path) -> bool:
        """Return whether a path stands for a URL."""
        return self.root in path.parents

    def named(self, text: str) -> str:
        """Return a text with URLs in place of the paths that stand for them."""
        return self._spelled.sub(lambda found: f"{found[1]}://{'/' if found[2] else ''}", text)

    def standing(self, text: str) -> str:
        """Return a text with paths in place of the URLs in it, without listing these."""
        root = self.root.as_posix()
        return _URL.sub(lambda found: f"{root}/{found[1].lower()}/{f'{_SLASH}/' if found[2] else ''}", text)

    def local(self, path: Path) -> Path:
        """Return the copy of the file of a URL, made now if there is none; any other path as it is."""
        if not self.holds(path) or (self.root.is_dir() and not path.is_file()):
            return path
        scope = _COPIES.get()
        for copies in (scope, self._copies):
            if copies and path in copies:
                return copies[path]
        copy, url = self.new_file(path), self.named(path.as_posix())
        (self._copies if scope is None else scope)[path] = copy
        with _reach(url):
            system, place = _file_system(url)
            system.get_file(place, str(copy))
        return copy

    @contextmanager
    def item(self) -> Iterator[None]:
        """Remove at the end of the block, the work on one item, the copies that it needed."""
        copies: dict[Path, Path] = {}
        token = _COPIES.set(copies)
        try:
            yield
        finally:
            _COPIES.reset(token)
            for copy in copies.values():
                copy.unlink(missing_ok=True)

    def send(self, temporary: Path, path: Path) -> None:
        """Let the content of a temporary file take the place of the file of a URL."""
        url = self.named(path.as_posix())
        with _reach(url, "cannot be written: no such bucket or folder"):
            _upload(temporary, url)
        self._forget(path)
        if self.root.is_dir():
            _stand_in(path, temporary.stat().st_size)

    def append(self, path: Path, content: bytes) -> None:
        """Add to the copy of the file of a URL; it is sent from time to time, by `flush`, or as the file is written."""
        if not path.is_file():
            self._copies[path] = self.new_file(path)
        copy = self.local(path) if path.is_file() else self._copies[path]
        with copy.open("ab") as stream:
            stream.write(content)
        _stand_in(path, copy.stat().st_size)
        self._unsent.add(path)
        began = time.monotonic()
        if began >= self._send_again:
            try:
                self.flush(path)
            finally:
                now = time.monotonic()
                self._send_again = now + max(_SEND_S, _SENDING * (now - began))

    def flush(self, path: Path) -> None:
        """Let the file of a URL have all that was added to its copy."""
        if path in self._unsent:
            url = self.named(path.as_posix())
            with _reach(url):
                _upload(self.local(path), url)
            self._unsent.remove(path)

    def remove(self, path: Path) -> None:
        """Remove the file of a URL, if it is there."""
        if not path.is_file():
            return
        url = self.named(path.as_posix())
        with _reach(url), suppress(FileNotFoundError):  # of a file that was not sent yet
            system, place = _file_system(url)
            system.rm_file(place)
        self._forget(path)
        path.unlink()

    def _forget(self, path: Path) -> None:
        self._unsent.discard(path)
        for copies in (_COPIES.get(), self._copies):
            if copies and path in copies:
                copies.pop(path).unlink(missing_ok=True)

    def new_file(self, path: Path) -> Path:
        """Return a new file for the content of a path, of the same type."""
        folder = self.root.parent
        handle, name = tempfile.mkstemp(suffix=path.suffix, dir=folder if folder.is_dir() else _folder_of_process())
        with open(handle, "wb"):  # noqa: PTH123 - a handle
            return Path(name)


def _new_folder() -> Path:
    """Return a temporary folder that is removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="camcal-urls-")).resolve()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def _folder_of_process() -> Path:
    return _new_folder()


def _file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and where on it the URL leads."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise InvalidInput("URLs need the extra [cluster]: pip install 'camcal[cluster]'", where=url) from error
    system, place = url_to_fs(url)
    return system, place


@contextmanager
def _reach(url: str, missing: str = "no such file") -> Iterator[None]:
    """Turn what goes wrong at a URL into errors of the user: every file system has exceptions of its own."""
    try:
        yield
    except CamcalError:
        raise
    except FileNotFoundError as error:
        raise FileError(missing, where=url) from error
    except ImportError as error:
        raise InvalidInput(f"needs a package that is not installed: {error}", where=url) from error
    except Exception as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise FileError(f"cannot be reached: {said}", where=url) from error


def _list_folder(system: Any, place: str) -> list[Mapping[str, Any]]:
    """Return what a file system has in a folder; nothing of a folder that is not there, or may not be listed."""
    try:
        found: list[Mapping[str, Any]] = system.ls(place, detail=True)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return []
    return found


def _upload(source: Path, url: str) -> None:
    """Copy a file to a URL, where it appears when it is complete."""
    system, place = _file_system(url)
    if not _WITHOUT_FOLDERS & {system.protocol, *system.protocol}:
        system.makedirs(place.rpartition("/")[0], exist_ok=True)
    with source.open("rb") as content, system.open(place, "wb", autocommit=False) as stream:
        shutil.copyfileobj(content, stream)
    stream.commit()


def _stand_in(path: Path, size: int) -> None:
    """Make a file of a size, without content, in the folder of the paths that stand for URLs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        stream.truncate(size)
