"""Settings files of one command (`--config settings.yaml`), and the files that its options name: read, and written.

Keys that begin with x_ are notes: users may keep anything there, and nothing of it is read.
"""

import json
import os
import re
import shlex
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from camcal import files, system
from camcal.errors import CamcalError, InvalidInput
from camcal.files import STANDARD
from camcal.formats import documents
from camcal.formats.documents import Fault, child
from camcal.options import GENERAL, OUTPUT, Declared, Option, OptionsRecord, ValueType, by_group
from camcal.parsing import did_you_mean, in_one_line

Value = str | bool | list[str]

_NOTE = "x_"
_WIDTH = 110  # columns of a file that is written


@dataclass(frozen=True)
class Settings:
    """The values of a settings file as typed on a command line, by option name with underscores.

    where: the file's name for messages. lines: the line of every option.
    """

    where: str
    values: Mapping[str, Value]
    lines: Mapping[str, int]


def read_settings(path: Path, options: Mapping[str, bool]) -> Settings:
    """Return the settings in a YAML file whose keys are option names, written with - or _.

    options: the names (with underscores) the command has, and whether they take several values.
    A file of comments alone sets nothing.
    Raises FileError if it is no YAML mapping, InvalidInput listing with file and line every key that is unknown or
    given twice and every value that is not a plain one.
    """
    text = files.read_text(path)
    if not any(line.strip() and not line.lstrip().startswith("#") for line in text.splitlines()):
        return Settings(str(path), {}, {})
    document = documents.parse(text, str(path), lambda data, _: wrong_settings(data, options))
    named = {key.replace("-", "_"): key for key in document if not is_note(key)}
    return Settings(
        where=document.where,
        values={name: typed(document[key], several=options[name]) for name, key in named.items()},
        lines={name: document.line(key) for name, key in named.items()},
    )


def is_note(key: str) -> bool:
    """Return whether a key holds a note of the user."""
    return key.startswith(_NOTE)


def wrong_settings(data: Any, options: Mapping[str, bool], above: str = "") -> Iterator[Fault]:
    """Yield what is wrong with the keys of a mapping and their values; options: as in `read_settings`.

    above: the key path of the mapping.
    """
    seen: set[str] = set()
    for key, value in data.items() if isinstance(data, dict) else ():
        if is_note(key):
            continue
        name = key.replace("-", "_")
        if name not in options:
            known = [option.replace("_", "-") for option in options]
            said = did_you_mean(name.replace("_", "-"), known, otherwise="; --write-config lists those of the command")
            yield Fault(child(above, key), f"unknown key{said}")
        elif name in seen:
            yield Fault(child(above, key), "given twice, once with - and once with _")
        elif problem := _problem(value, several=options[name]):
            yield Fault(child(above, key), problem)
        seen.add(name)


def _problem(value: Any, *, several: bool) -> str | None:
    if isinstance(value, list):
        if not several:
            return "takes one value, not a list"
        return next((problem for item in value if (problem := _problem(item, several=False))), None)
    if isinstance(value, dict):
        return "expects a plain value: one option per line"
    return "has no value; remove the line for the default" if value is None else None


def typed(value: Any, *, several: bool) -> Value:
    """Return a value of a settings file as typed on a command line."""
    if several:
        return [str(item) for item in (value if isinstance(value, list) else [value])]
    return value if isinstance(value, bool) else str(value)


def write_settings(path: Path, command: str, options: Sequence[Declared], values: Mapping[Declared, Any]) -> None:
    """Write a settings file of a command with every option explained: those with values set, the others commented out.

    Arguments stand in its first line: they belong on the command line.
    """
    arguments = [word for each in options if each.positional for word in _argument_words(each, values)]
    lines = [
        in_one_line(f"# camcal {' '.join((command, *arguments))} --config {shlex.quote(path.name)}"),
        "# An option on the command line comes before the one in this file.",
    ]
    for group, members in by_group([each for each in options if not each.positional]).items():
        lines += ["", f"# ---- {group} ----"]
        for each in members:
            lines += ["", *textwrap.wrap(each.help, _WIDTH, initial_indent="# ", subsequent_indent="# ")]
            value = values.get(each)
            lines.append(f"# {each.key}: {_other(each)}" if value is None else f"{each.key}: {_yaml(each, value)}")
    files.write_text(path, "\n".join([*lines, ""]))


def _argument_words(each: Declared, values: Mapping[Declared, Any]) -> list[str]:
    if each in values:
        return list(map(shlex.quote, each.words(values[each])))
    return [each.name if each.required else f"[{each.name}]"]


def _other(each: Declared) -> str:
    """Return what an option that is not set could say: its default, or what stands for its value."""
    if each.required or each.default in (None, "", (), float("inf")):
        return each.option.metavar or ("true" if each.flag else "…")
    return _yaml(each, each.default)


def _yaml(each: Declared, value: Any) -> str:
    """Return a value as a settings file has it."""
    setting = each.setting(value)
    if isinstance(setting, bool):
        return "true" if setting else "false"
    return f"[{', '.join(map(_scalar, setting))}]" if isinstance(setting, list) else _scalar(setting)


def _scalar(text: str) -> str:
    return text if _is_plain(text) else json.dumps(text, ensure_ascii=False)


def _is_plain(text: str) -> bool:
    """Return whether YAML gives a text back as it stands, in a list and with a comment behind it too."""
    try:
        value = documents.parse(f"value: [{text}] # note\n", text).data["value"]
    except CamcalError:
        return False
    return len(value) == 1 and isinstance(value[0], (str, int, float)) and str(value[0]) == text


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
