"""The list of what camcal wrote into a folder, `.camcal-output`: a line for every file.

A line is the name alone, of a file that is being written or whose content nobody asks for, or before the name what is
known of it: hash, size, the hash of all that it was made from, and the result of its item as JSON, with tabs between.
While a run goes on, lines are added at the end, and the last one of a name counts; what a killed run left of a line is
ignored. When it is over, the lines are those of the files in natural order: nothing tells of times or places.
"""

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from camcal import files, system, urls
from camcal.errors import CamcalError, FileError, reason
from camcal.parsing import in_one_line
from camcal.run.process import over_threads

MANIFEST = ".camcal-output"

_CHUNK = 1 << 20
_MANY = 8  # files that are better read by several threads
_LINE = re.compile(r"([0-9a-f]{64})\t([0-9]{1,18})\t([0-9a-f]{64}|)\t([^\t]*)\t(.+)", re.DOTALL)


class Entry(NamedTuple):
    """What is known of an output.

    made_from: the fingerprint of its inputs and settings, empty where it is none of many alike. result: of its item, as
    JSON; empty for the other files of an item.
    """

    sha256: str
    size: int
    made_from: str = ""
    result: str = ""

    @classmethod
    def of(cls, path: Path) -> "Entry":
        """Return the entry of a file, which is read; raises FileError if it cannot be."""
        with files.unwatched():
            return cls(files.sha256(path), path.stat().st_size)

    def is_of(self, path: Path) -> bool:
        """Return whether a file has this content; one of another size is not read."""
        return path.stat().st_size == self.size and self.same_content(Entry.of(path))

    def same_content(self, other: "Entry") -> bool:
        """Return whether two files have the same content."""
        return (self.size, self.sha256) == (other.size, other.sha256)


Entries = Mapping[str, Entry | None]


def entries(folder: Path) -> dict[str, Entry | None]:
    """Return the files of a folder that are listed, by name; None for those of which nothing is known."""
    return dict(_parse(_text(folder)))


def change(folder: Path, added: Entries, removed: AbstractSet[str] = frozenset()) -> None:
    """Add files to the list of a folder, or change what is known of them, and remove others; runs at once lose none.

    Raises FileError if it cannot be written.
    """
    with _changing(folder):
        text = _text(folder)
        known = dict(_parse(text)) | {in_one_line(name): entry for name, entry in added.items()}
        for name in removed:
            known.pop(in_one_line(name), None)
        lines = "".join(_line(name, known[name]) for name in sorted(known, key=files.natural_key))
        if lines and lines != text:
            files.write_bytes(folder / MANIFEST, os.fsencode(lines))  # a file name need not be UTF-8
        elif not lines:
            urls.remove(folder / MANIFEST)


def append(folder: Path, added: Entries) -> None:
    """Add lines to the list of a folder, which is not read for it; raises FileError if it cannot be written."""
    lines = "".join(_line(in_one_line(name), entry) for name, entry in added.items())
    with _changing(folder):
        urls.append(folder / MANIFEST, os.fsencode(lines))


def begins_with(path: Path, other: Path) -> bool:
    """Return whether a file begins with the content of another one."""
    with path.open("rb") as whole, other.open("rb") as part:
        while chunk := part.read(_CHUNK):
            if whole.read(len(chunk)) != chunk:
                return False
    return True


def unchanged(known: Sequence[tuple[Path, Entry]]) -> list[bool]:
    """Return of each of some files whether it has the content that is known of it."""
    if len(known) < _MANY:
        return [entry.is_of(path) for path, entry in known]
    same = [False] * len(known)

    def compare(number: int) -> None:
        path, entry = known[number]
        with suppress(CamcalError):
            same[number] = entry.is_of(path)

    with over_threads() as over:
        over(compare, range(len(known)))
    return same


@contextmanager
def _changing(folder: Path) -> Iterator[None]:
    try:
        system.prepare(folder)
        with system.locked(folder), files.unwatched():
            yield
    except OSError as error:
        raise FileError(f"cannot be written: {reason(error)}", where=str(folder / MANIFEST)) from error


def _text(folder: Path) -> str:
    path = folder / MANIFEST
    with files.unwatched():
        return os.fsdecode(files.read_bytes(path)) if path.is_file() and path.stat().st_size else ""


def _parse(text: str) -> Iterable[tuple[str, Entry | None]]:
    """Yield the files of whole lines; lists of earlier versions hold names alone."""
    for line in text.split("\n")[:-1]:
        if found := _LINE.fullmatch(line):
            sha256, size, made_from, result, name = found.groups()
            yield name, Entry(sha256, int(size), made_from, sys.intern(result))  # most items of a run have the same
        elif line:
            yield line, None


def _line(name: str, entry: Entry | None) -> str:
    return f"{name}\n" if entry is None else "\t".join((*map(str, entry), name)) + "\n"
