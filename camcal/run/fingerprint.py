"""Fingerprints, which tell whether something would be made again as it was; what was made, as plain data and back.

Fingerprints are made of contents, settings and versions, never of times or places: a file that was copied elsewhere has
the same one. A record is written by the names of its fields and read by their types, so that reading makes nothing but
the record that was asked for. Paths are not kept but referred to: by their place among those that the item has anyway.
"""

import dataclasses
import hashlib
import json
import types
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

import camcal
from camcal import files, urls
from camcal.arrays import Array
from camcal.formats import provenance
from camcal.options import PATH, Declared, declared

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
