"""The options of commands that work on many items, and the paths that options name: what is read, what is written."""

import os
import re
from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from camcal import files, system
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.files import STANDARD
from camcal.options import GENERAL, OUTPUT, Declared, Option, OptionsRecord, ValueType

LOCAL = "dask://local"

_SHORTEST_S = 1e-3  # a limit below says nothing of the item
_SCHEDULER = re.compile(rf"{LOCAL}|dask(?:\+tls)?://(?:[^\s/@:\[\]]+|\[[0-9A-Fa-f:]+\]):([0-9]{{1,5}})")
_LARGEST_PORT = 65535


def _scheduler(text: str) -> str:
    """Return the URL of a scheduler without a slash at its end; raises ValueError for any other text."""
    url = text.removesuffix("/")
    found = _SCHEDULER.fullmatch(url)
    if found is None or int(found[1] or 0) > _LARGEST_PORT:
        raise ValueError(text)
    return url


@dataclass(frozen=True)
class BatchOptions(OptionsRecord):
    """How the items of a command are worked on; none of it changes a result.

    timeout: seconds for one item, None without limit. scheduler: URL of a Dask scheduler, None for the cores of this
    machine.
    """

    timeout: Annotated[
        float | None,
        Option(
            "Stop an item that takes longer; it counts as failed. By default no limit.",
            metavar="S",
            group=GENERAL,
            least=_SHORTEST_S,
            recorded=False,
        ),
    ] = None
    fail_fast: Annotated[
        bool, Option("Stop at the first item that fails; what is written is kept.", group=GENERAL, recorded=False)
    ] = False
    resume: Annotated[
        bool,
        Option(
            "Skip outputs that are complete and still match input, camera and settings; redo the others.",
            group=GENERAL,
            recorded=False,
        ),
    ] = False
    scheduler: Annotated[
        str | None,
        Option(
            "Work on a Dask cluster: dask://HOST:PORT, dask+tls://HOST:PORT, or dask://local for one of its own.",
            metavar="URL",
            group=GENERAL,
            type=ValueType(_scheduler, str, f"dask://HOST:PORT, dask+tls://HOST:PORT or {LOCAL}"),
            recorded=False,
        ),
    ] = None

    @property
    def keep_going(self) -> "BatchOptions":
        """The same for work on a sample, or once more: a failure there does not end it."""
        return replace(self, fail_fast=False)

    def raise_first(self, errors: Sequence[CamcalError]) -> None:
        """Raise the first error of items where one ends the batch: there is no result of the others alone."""
        if errors and self.fail_fast:
            raise errors[0]


DEFAULT_BATCH = BatchOptions()


def located(each: Declared, given: Any) -> Any:
    """Return the text or texts of an option with paths in place of URLs; see `run.remote`, which only these import."""
    texts = given if isinstance(given, (list, tuple)) else [given]
    if each.option.group == GENERAL or not any(isinstance(text, str) and "://" in text for text in texts):
        return given
    from camcal.run import remote

    found = [remote.given(text) for text in texts]
    return found if isinstance(given, (list, tuple)) else found[0]


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


def counts(each: Declared) -> bool:
    """Return whether the files or the exit code of a command depend on an option; others only say how it works."""
    return each.option.recorded or (each.option.group != GENERAL and each.name != "--overwrite")
