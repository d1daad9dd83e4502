"""Fingerprints: hashes that tell whether something would be made again as it was.

They are made of contents, settings and versions, never of times or places: a file that was copied elsewhere has the
same one.
"""

import hashlib
import json
from collections.abc import Collection
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import camcal
from camcal import files, urls
from camcal.arrays import Array
from camcal.formats import provenance
from camcal.options import GENERAL, PATH, Declared, declared

_ALSO = ("rawpy", "onnxruntime")  # libraries that decode or match, beside those that every result names


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


def counts(each: Declared) -> bool:
    """Return whether the files or the exit code of a command depend on an option; others only say how it works."""
    return each.option.recorded or (each.option.group != GENERAL and each.name != "--overwrite")


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
