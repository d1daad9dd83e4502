"""What was made: its fingerprint, itself as plain data and back, and the list of it in a folder.

Fingerprints, which tell whether something would be made again as it was, are made of contents, settings and versions,
never of times or places: a file that was copied elsewhere has the same one. A record is written by the names of its
fields and read by their types, so that reading makes nothing but the record that was asked for. Paths are not kept but
referred to: by their place among those that the item has anyway.

The list, `.camcal-output`, has a line for every file that camcal wrote into a folder: the name alone, of a file that is
being written or whose content nobody asks for, or before the name what is known of it: hash, size, the hash of all that
it was made from, and the result of its item as JSON, with tabs between. While a run goes on, lines are added at the
end, and the last one of a name counts; what a killed run left of a line is ignored. When it is over, the lines are
those of the files in natural order: nothing tells of times or places.
"""

import dataclasses
import hashlib
import json
import os
import re
import sys
import types
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

import camcal
from camcal import files, system, urls
from camcal.arrays import Array
from camcal.errors import CamcalError, FileError, reason
from camcal.formats import provenance
from camcal.images.videos import address_of
from camcal.options import PATH, Declared, declared
from camcal.parsing import in_one_line
from camcal.run.process import over_threads

_ALSO = ("rawpy", "onnxruntime")  # libraries that decode or match, beside those that every result names


def as_plain(value: Any, paths: Sequence[Path] = ()) -> Any:
    """Return a value as plain data: of records, tuples, mappings, arrays, numbers and texts, and some paths.

    Raises TypeError for a value of another kind, or another path: that is a bug.
    """
    if dataclasses.is_dataclass(value):
        kept = [field.name for field in dataclasses.fields(value) if field.init]
        return {name: as_plain(getattr(value, name), paths) for name in kept}
    if isinstance(value, Mapping):
        return {str(key): as_plain(each, paths) for key, each in value.items()}
    if isinstance(value, (tuple, list)):
        return [as_plain(each, paths) for each in value]
    return _single(value, paths)


def _single(value: Any, paths: Sequence[Path]) -> Any:
    if isinstance(value, np.ndarray):
        return {"type": value.dtype.str, "shape": list(value.shape), "values": value.ravel().tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path) and value in paths:
        return list(paths).index(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{value!r} is not kept as plain data")


def value_of_plain(kind: Any, data: Any, paths: Sequence[Path] = ()) -> Any:
    """Return the value of a type from its plain data; raises KeyError, TypeError or ValueError if it is another's."""
    if data is None or kind is Any:
        return data
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Annotated, Union, types.UnionType):
        return _one_of(arguments[:1] if origin is Annotated else arguments, data, paths)
    if origin is np.ndarray:
        return np.array(data["values"], dtype=data["type"]).reshape(data["shape"])
    if isinstance(data, (dict, list)):
        return _several(arguments, data, paths) if origin else _record(kind, data, paths)
    return paths[data] if kind is Path else kind(data)


def _one_of(kinds: Sequence[Any], data: Any, paths: Sequence[Path]) -> Any:
    """Return a value of a union: of the one type that is not None, or as it is where plain types are meant."""
    some = [kind for kind in kinds if kind is not types.NoneType]
    if len(some) == 1:
        return value_of_plain(some[0], data, paths)
    return tuple(data) if isinstance(data, list) else data


def _several(kinds: Sequence[Any], data: Any, paths: Sequence[Path]) -> Any:
    """Return a mapping, whose keys are texts, or a tuple."""
    if isinstance(data, dict):
        return {key: value_of_plain(kinds[1], each, paths) for key, each in data.items()}
    each = kinds if len(kinds) == len(data) and ... not in kinds else [kinds[0]] * len(data)
    return tuple(value_of_plain(kind, item, paths) for kind, item in zip(each, data, strict=True))


def _record(kind: Any, data: Any, paths: Sequence[Path]) -> Any:
    """Return a record from its fields by name, a named tuple from those in their order."""
    hints = _hints(kind)
    if isinstance(data, list):
        return kind(*(value_of_plain(hints[name], each, paths) for name, each in zip(kind._fields, data, strict=True)))
    return kind(**{name: value_of_plain(hints[name], each, paths) for name, each in data.items()})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def of_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hex digits; raises FileError if it cannot be read."""
    return files.sha256(path)


def of_folder(path: Path) -> str:
    """Return the hash of the names and contents of the files in a folder, hidden ones and folders below it left out."""
    inside = sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))
    return of_data([[each.name, of_file(each)] for each in inside])


def of_source(path: Path) -> str:
    """Return the hash of an image or a video: of its file, or of a bag and the topic, for bags that do not change."""
    address = address_of(path)
    return of_file(path) if address is None else _of_topic(*address, address[0].stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _of_topic(bag: Path, topic: str, _changed_ns: int) -> str:
    return of_data([of_folder(bag) if bag.is_dir() else of_file(bag), topic])


def of_array(array: Array) -> str:
    """Return the hash of an array: of its type, its shape and its values."""
    values = np.ascontiguousarray(array)
    return of_data([values.dtype.str, list(values.shape), hashlib.sha256(values.data).hexdigest()])


def of_data(data: Any) -> str:
    """Return the hash of plain data: texts, numbers, lists and mappings, of which the order of the keys is no part."""
    text = urls.named(json.dumps(data, sort_keys=True, separators=(",", ":")))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def of_settings(options: Any, without: Collection[str] = ()) -> str:
    """Return the hash of all that a result depends on besides its inputs: the settings, and the versions that use them.

    Only options count that change a result; of one that names a file or a folder the content counts, not the name.
    without: names of fields that are left out, such as the one that lists the inputs.
    Raises FileError if such a file cannot be read.
    """
    kept = [each for each in declared(type(options)) if each.option.recorded and ".".join(each.path) not in without]
    values = {".".join(each.path): (each, each.of(options)) for each in kept}
    settings = {name: _texts(each, value) for name, (each, value) in values.items() if value is not None}
    return of_data([type(options).__name__, settings, versions()])


def versions() -> dict[str, str]:
    """Return the versions of camcal and of the libraries that results depend on, and the date that files are given."""
    from importlib import metadata  # imports the e-mail package: who writes nothing does not wait for it

    found = {"camcal": camcal.__version__, **provenance.libraries()}
    for distribution in _ALSO:
        try:
            found[distribution] = metadata.version(distribution)
        except metadata.PackageNotFoundError:
            continue
    date = provenance.created()
    return found if date is None else found | {"created": date}


def _texts(each: Declared, value: Any) -> list[str]:
    """Return the words that give an option, with hashes in place of files and folders."""
    if each.flag or each.option.choices:
        return each.words(value)
    return [_with_content(text, folders=each.type is PATH) for text in each.texts(value)]


def _with_content(text: str, folders: bool) -> str:
    """Return a text with a hash for the file that it names as FILE, FILE#NAME or NAME=FILE; itself if there is none."""
    name, equals, named = text.partition("=")
    for before, rest in (("", text), (name + equals, named)):
        for path, after in ((rest, ""), (rest.rpartition("#")[0], rest[rest.rfind("#") :])):
            if path and (found := _of_path(Path(path), folders)) is not None:
                return before + found + after
    return text


def _of_path(path: Path, folders: bool) -> str | None:
    try:
        if path.is_file():
            return of_file(path)
        return of_folder(path) if folders and path.is_dir() else None
    except OSError:  # too long for a path, so it is none
        return None


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
