"""Strict YAML and JSON as plain data: ambiguous values are refused.

Of YAML the line of every key is kept. Refused: duplicate keys, aliases, anchors, tags, a second document, dates and
numbers that YAML 1.1 reads in its own way (yes, 012, 0x1F, 1_000, 12:30), more than 100 000 values, 64 MB or 32 levels.
A text such as 1e-05, which YAML 1.1 does not take for a number, stays text; the checks in `schema` say so where a
number is needed.

JSON is taken as strictly: no duplicate keys, no NaN, every fault named by its key path.

Files of other programs are read more leniently, see `parse_foreign`.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import yaml

from camcal import files
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InvalidInput
from camcal.messages import Message

MAX_VALUES = 100_000
MAX_FOREIGN_VALUES = 300_000  # OpenCV's files may hold every corner of every image
MAX_DEPTH = 32
_MAX_LISTED = 50
_LONGEST = 19  # characters of a whole number in JSON, as 64 bits have them

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml where the wheel has it: 25 times faster
_TAG = "tag:yaml.org,2002:"
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})\Z")
_FLOAT = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+][0-9]+)?\Z")
_WORDS: dict[str, dict[str, Any]] = {
    "bool": {"true": True, "false": False},
    "float": {".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf, ".nan": math.nan},
}
_ADVICE = {
    "bool": "a boolean in YAML 1.1 only; write true or false, or quote it if it is text",
    "int": "a number in YAML 1.1 only; write it with decimal digits, or quote it if it is text",
    "float": "a number in YAML 1.1 only; write it with decimal digits, or quote it if it is text",
    "timestamp": "a date in YAML 1.1; quote it",
}


class Fault(NamedTuple):
    """One thing that is wrong: the key path, what and what to do, and the line if it is not the path's own."""

    path: str
    text: str
    line: int | None = None


Check = Callable[[Any, str], Iterable[Fault]]


@dataclass(frozen=True, eq=False)
class Document(Mapping[str, Any]):
    """The mapping a file holds, as dicts, lists, strings, numbers, truth values and None.

    where: the file's name for messages. lines: the line of every key path, such as 'cameras.left.fixed[0]', of YAML;
    faults of JSON are named by key path alone.
    """

    where: str
    data: dict[str, Any]
    lines: Mapping[str, int]

    def __getitem__(self, key: str) -> Any:
        return self.data[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def __len__(self) -> int:
        return len(self.data)

    def line(self, path: str = "") -> int:
        """Return the line of a key path, or of the innermost part of it that the file has."""
        while path and path not in self.lines:
            path = path[: max(path.rfind("."), path.rfind("["), 0)]
        return self.lines.get(path, 1)

    def message(self, fault: Fault) -> str:
        """Return a fault as one line: file:line: path: text."""
        place = self._place(fault)
        return f"{place}: {fault.path}: {fault.text}" if fault.path else f"{place}: {fault.text}"

    def located(self, message: Message) -> Message:
        """Return a message about a key path with the file and the line before the path."""
        place = self._place(Fault(message.where or "", ""))
        return replace(message, where=f"{place}: {message.where}" if message.where else place)

    def _place(self, fault: Fault) -> str:
        return f"{self.where}:{fault.line or self.line(fault.path)}" if self.lines else self.where

    def error(self, faults: Iterable[Fault]) -> InvalidInput:
        """Return one error that lists all faults, a line each, in the order of the file."""
        found = sorted(faults, key=lambda fault: fault.line or self.line(fault.path))
        lines = [self.message(fault) for fault in found[:_MAX_LISTED]]
        if len(found) > _MAX_LISTED:
            lines.append(f"{self.where}: and {len(found) - _MAX_LISTED} more")
        where = self._place(found[0])
        return InvalidInput("\n".join(lines).removeprefix(f"{where}: "), where=where)


def load_either(path: Path, check: Check | None = None, max_values: int = MAX_VALUES) -> Document:
    """Return the document in a file, JSON where its suffix says so, otherwise YAML; see `load` and `load_json`."""
    return load_json(path, check) if files.suffix_of(path) == ".json" else load(path, check, max_values)


def load(path: Path, check: Check | None = None, max_values: int = MAX_VALUES) -> Document:
    """Return the document in a YAML file; see `parse`. Raises FileError also if the file cannot be read."""
    return parse(files.read_text(path), str(path), check, max_values)


def parse(text: str, where: str, check: Check | None = None, max_values: int = MAX_VALUES) -> Document:
    """Return the document in `text`, having passed `check` over its data.

    max_values: how many it may hold, for files that are tables.
    Raises FileError if it is no YAML mapping, InvalidInput with one line for every fault found.
    """
    if text.startswith("%YAML:"):
        raise FileError("starts with %YAML:, which only OpenCV reads; camcal files start with %YAML 1.1", where=where)
    return _parse(text, _Builder(where, max_values), check)


def parse_foreign(text: str, where: str) -> Document:
    """Return the document in YAML or JSON as other programs write it.

    Beyond `parse`: a first line %YAML:1.0 or %YAML 1.2 and tags are passed over, and what only YAML 1.1 takes for a
    number or a date is text; so is NaN of JSON. Raises as `parse` does.
    """
    if text.lstrip()[:1] == "{":
        with suppress(InvalidInput, ValueError, RecursionError):  # numbers as OpenCV writes them, 1., are none of JSON
            data = json.loads(text, object_pairs_hook=_json_mapping, parse_constant=str, parse_int=_json_integer)
            return Document(where, data, {})
    text = re.sub(r"\A%YAML[^\n]*", "", text)  # the line stays, so that others keep their numbers
    return _parse(text, _Builder(where, MAX_FOREIGN_VALUES, foreign=True), None)


def _parse(text: str, builder: "_Builder", check: Check | None) -> Document:
    """Return the document of a text, having passed `check` over its data."""
    where, kind = builder.where, "text" if builder.foreign else "YAML"
    try:
        data = builder.document(yaml.parse(text, Loader=_LOADER))
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise FileError(f"invalid or truncated {kind}: {error.problem}", where=f"{where}:{line}") from error
    except yaml.YAMLError as error:
        raise FileError(f"invalid {kind}: {str(error).splitlines()[0]}", where=where) from error
    if not isinstance(data, dict):
        raise FileError(f"not a {kind} mapping (key: value): check that this is the right file", where=where)
    document = Document(where, data, builder.lines)
    findings = check(data, "") if check else ()
    faults = [*builder.faults, *(fault for fault in findings if fault.path not in builder.without_value)]
    if faults:
        raise document.error(faults)
    return document


def child(path: str, key: str | int) -> str:
    """Return the path of a key or of a list's item below `path`."""
    if isinstance(key, int):
        return f"{path}[{key}]"
    return f"{path}.{key}" if path else key


class _Builder:
    """Builds plain data from parser events, noting lines and faults on the way."""

    def __init__(self, where: str, max_values: int, *, foreign: bool = False) -> None:
        self.where = where
        self.max_values = max_values
        self.foreign = foreign
        self.lines: dict[str, int] = {}
        self.faults: list[Fault] = []
        self.without_value: set[str] = set()
        self.count = 0
        self.resolver: Any = yaml.resolver.Resolver()

    def document(self, events: Iterator[Any]) -> Any:
        data = None
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                if self.count:
                    raise InvalidInput("more than one YAML document", where=self.at(event))
                data = self.value(next(events), events, "", 0)
        return data

    def at(self, event: Any) -> str:
        return f"{self.where}:{_line(event)}"

    def fault(self, event: Any, path: str, text: str) -> None:
        self.faults.append(Fault(path, text, _line(event)))

    def unreadable(self, event: Any, path: str, text: str) -> None:
        self.fault(event, path, text)
        self.without_value.add(path)

    def value(self, event: Any, events: Iterator[Any], path: str, depth: int) -> Any:
        self.count += 1
        if self.count > self.max_values or depth > MAX_DEPTH:
            limit = f"{MAX_DEPTH} levels" if depth > MAX_DEPTH else f"{self.max_values} values"
            raise InvalidInput(f"more than {limit}", where=self.at(event))
        self.lines.setdefault(path, _line(event))
        if isinstance(event, yaml.AliasEvent):
            return self.unreadable(event, path, f"alias *{event.anchor} not supported; write the value")
        if event.anchor or (event.tag and not self.foreign):
            what = f"anchor &{event.anchor}" if event.anchor else f"tag {event.tag}"
            self.fault(event, path, f"{what} not supported; remove it")
        if isinstance(event, yaml.ScalarEvent):
            return self.scalar(event, path)
        if isinstance(event, yaml.SequenceStartEvent):
            return self.sequence(events, path, depth)
        return self.mapping(events, path, depth)

    def sequence(self, events: Iterator[Any], path: str, depth: int) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            items.append(self.value(event, events, child(path, len(items)), depth + 1))
        return items

    def mapping(self, events: Iterator[Any], path: str, depth: int) -> dict[str, Any]:
        result: dict[str, Any] = {}
        while not isinstance(event := next(events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise InvalidInput("keys must be plain text", where=self.at(event))
            key, where = event.value, child(path, event.value)
            if key in result:
                self.fault(event, path, f"duplicate key {key!r} (first at line {self.lines[where]})")
                self.value(next(events), events, where, depth + 1)
            else:
                self.lines[where] = _line(event)
                result[key] = self.value(next(events), events, where, depth + 1)
        return result

    def scalar(self, event: Any, path: str) -> Any:
        text = event.value
        tag = self.resolver.resolve(yaml.ScalarNode, text, event.implicit).removeprefix(_TAG)
        if tag == "null":
            return None
        if tag == "int" and _INTEGER.match(text):
            return int(text)
        if tag == "float" and _FLOAT.match(text):
            return float(text)
        words = _WORDS.get(tag, {})
        if text.lower() in words:
            return words[text.lower()]
        if tag in _ADVICE and not self.foreign:
            return self.unreadable(event, path, f"{text!r} is {_ADVICE[tag]}")
        return text


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def load_json(path: Path, check: Check | None = None) -> Document:
    """Return the document in a JSON file, having passed `check` over its data.

    Raises FileError if it cannot be read or is no JSON object, InvalidInput with one line for every fault found.
    """
    where = str(path)
    data = parse_json(files.read_text(path), where)
    if not isinstance(data, dict):
        raise FileError("not a JSON object {…}: check that this is the right file", where=where)
    document = Document(where, data, {})
    if faults := list(check(data, "") if check else ()):
        raise document.error(faults)
    return document


def parse_json(text: str, where: str | None = None) -> Any:
    """Return the data in a JSON text as dicts, lists, strings, numbers, truth values and None.

    Raises FileError if it is no JSON or nested too deeply, InvalidInput for a duplicate key or what is no number.
    """
    try:
        return json.loads(text, object_pairs_hook=_json_mapping, parse_constant=_json_refuse, parse_int=_json_integer)
    except json.JSONDecodeError as error:
        line = where and f"{where}:{error.lineno}"
        raise FileError(f"invalid or truncated JSON: {error.msg}", where=line) from error
    except RecursionError as error:
        raise FileError("is nested too deeply", where=where) from error
    except InvalidInput as error:
        raise InvalidInput(error.message, where=where) from error


def _json_integer(text: str) -> int:
    if len(text) > _LONGEST:
        raise InvalidInput(f"a whole number of {len(text)} digits; numbers here have at most {_LONGEST}")
    return int(text)


def _json_mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        raise InvalidInput(f"duplicate key {max(names, key=names.count)!r}")
    return result


def _json_refuse(text: str) -> NoReturn:
    raise InvalidInput(f"{text} is not a JSON number; leave the item out")
