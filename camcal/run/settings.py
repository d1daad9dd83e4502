"""Settings files of one command (`--config settings.yaml`): option names and values.

Keys that begin with x_ are notes: users may keep anything there, and nothing of it is read.
"""

import json
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.dataclass import dataclass
from camcal.errors import CamcalError
from camcal.formats import documents
from camcal.formats.documents import Fault, child
from camcal.options import Declared, by_group
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
