"""The paths that options name: what is read, and what is written."""

import os
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import Any

from camcal import files, system
from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.options import GENERAL, OUTPUT, Declared


def inputs_of(each: Declared, value: Any) -> list[Path]:
    """Return the paths that the value of an option may name as what is read: any text that is no output may.

    That of FILE#NAME and of NAME=FILE is among them.
    """
    if each.option.choices or each.option.group in (OUTPUT, GENERAL):
        return []
    items = value if isinstance(value, tuple) else (value,)
    given = [str(item) for item in items if isinstance(item, str | Path)]
    texts = [text for one in given for text in (one, one.partition("=")[2])]
    return [Path(path) for text in texts for path in (text, text.rpartition("#")[0]) if path]


def outputs_of(each: Declared, value: Any) -> list[Path]:
    """Return the paths that the value of an option names as what is written."""
    written = each.option.written
    if written is None or value is None:
        return []
    return [Path(text) for text in each.texts(value) if text not in written.words]


def is_folder(each: Declared, path: Path) -> bool:
    """Return whether an output is a folder; raises InvalidInput for a file that the option does not write."""
    written = each.option.written
    assert written is not None
    suffix, known = path.suffix.lower(), written.known
    if str(path) == STANDARD:
        if not written.stdout:
            raise InvalidInput(f"{each.name} does not write to standard output; name a file")
        return False
    if files.is_stream(path):
        return False
    if written.folder and (path.is_dir() or not suffix or not known):
        if path.name.lower() in known and not path.is_dir():
            raise InvalidInput(f"is a suffix without a name; write NAME{path.name}, or a folder", where=str(path))
        return True
    if suffix in known or not known:
        return False
    listed_suffixes = ", ".join(name for name in known if name)
    raise InvalidInput(f"{suffix or 'a name without a suffix'} is not written; use {listed_suffixes}", where=str(path))


def require_folder(path: Path, option: str) -> None:
    """Raise InvalidInput, naming the option, if files cannot go to this folder because it is a file."""
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"{option} takes a folder, this is a file", where=str(path))


def refuse_one_place(outputs: Iterable[tuple[Declared, Path]]) -> None:
    """Raise InvalidInput if two options name one place for their outputs."""
    for (one, path), (other, same) in combinations(outputs, 2):
        if system.place_of(path) == system.place_of(same) and str(path) != os.devnull:
            raise InvalidInput(f"{one.name} and {other.name} would both be written to it", where=str(path))
