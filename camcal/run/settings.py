"""Settings files of one command (`--config settings.yaml`): option names and values.

Keys that begin with x_ are notes: whoever wrote the file may keep anything there, and nothing of it is read.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camcal.formats import strict_yaml
from camcal.formats.strict_yaml import Fault

Value = str | bool | list[str]

_NOTE = "x_"


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
    Raises FileError if it is no YAML mapping, InvalidInput listing with file and line every key that is unknown or
    given twice and every value that is not a plain one.
    """
    document = strict_yaml.load(path, lambda data, _: _faults(data, options))
    named = {key.replace("-", "_"): key for key in document if not key.startswith(_NOTE)}
    return Settings(
        where=document.where,
        values={name: _typed(document[key], several=options[name]) for name, key in named.items()},
        lines={name: document.line(key) for name, key in named.items()},
    )


def _faults(data: Any, options: Mapping[str, bool]) -> Iterator[Fault]:
    seen: set[str] = set()
    for key, value in data.items() if isinstance(data, dict) else ():
        if key.startswith(_NOTE):
            continue
        name = key.replace("-", "_")
        if name not in options:
            near = strict_yaml.nearest(name, options)
            yield Fault(key, "unknown key." + (f" Did you mean {near.replace('_', '-')!r}?" if near else ""))
        elif name in seen:
            yield Fault(key, "given twice, once with - and once with _")
        elif problem := _problem(value, several=options[name]):
            yield Fault(key, problem)
        seen.add(name)


def _problem(value: Any, *, several: bool) -> str | None:
    if isinstance(value, list):
        if not several:
            return "takes one value, not a list"
        return next((problem for item in value if (problem := _problem(item, several=False))), None)
    if isinstance(value, dict):
        return "takes a plain value; settings are flat, one option a line"
    return "has no value; leave the line out to have the default" if value is None else None


def _typed(value: Any, *, several: bool) -> Value:
    if several:
        return [str(item) for item in (value if isinstance(value, list) else [value])]
    return value if isinstance(value, bool) else str(value)
