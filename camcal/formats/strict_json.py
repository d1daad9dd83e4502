"""JSON as plain data, as strict as YAML is here: no duplicate keys, no NaN, every fault named by its key path."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats.strict_yaml import MAX_LISTED, Check, Document, Fault

_LONGEST = 19  # characters of a whole number, as 64 bits have them


class Lineless(Document):
    """The mapping a JSON file holds; its faults are named by key path alone."""

    def message(self, fault: Fault) -> str:
        """Return a fault as one line: file: path: text."""
        return f"{self.where}: {fault.path}: {fault.text}" if fault.path else f"{self.where}: {fault.text}"

    def error(self, faults: Iterable[Fault]) -> InvalidInput:
        """Return one error that lists all faults, a line each."""
        found = list(faults)
        lines = [self.message(fault) for fault in found[:MAX_LISTED]]
        if len(found) > MAX_LISTED:
            lines.append(f"{self.where}: and {len(found) - MAX_LISTED} more")
        return InvalidInput("\n".join(lines).removeprefix(f"{self.where}: "), where=self.where)


def load(path: Path, check: Check | None = None) -> Document:
    """Return the document in a JSON file, having passed `check` over its data.

    Raises FileError if it cannot be read or is no JSON mapping, InvalidInput with one line for every fault found.
    """
    where = str(path)
    data = parse(files.read_text(path), where)
    if not isinstance(data, dict):
        raise FileError("holds no JSON mapping {…}; is this the right file?", where=where)
    document = Lineless(where, data, {})
    if faults := list(check(data, "") if check else ()):
        raise document.error(faults)
    return document


def parse(text: str, where: str | None = None) -> Any:
    """Return the data in a JSON text as dicts, lists, strings, numbers, truth values and None.

    Raises FileError if it is no JSON or nested too deeply, InvalidInput for a duplicate key or what is no number.
    """
    try:
        return json.loads(text, object_pairs_hook=_mapping, parse_constant=_refuse, parse_int=_integer)
    except json.JSONDecodeError as error:
        line = where and f"{where}:{error.lineno}"
        raise FileError(f"is not JSON, or cut off: {error.msg}", where=line) from error
    except RecursionError as error:
        raise FileError("is nested too deeply", where=where) from error
    except InvalidInput as error:
        raise InvalidInput(error.message, where=where) from error


def _integer(text: str) -> int:
    if len(text) > _LONGEST:
        raise InvalidInput(f"a whole number of {len(text)} digits; numbers here have at most {_LONGEST}")
    return int(text)


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        raise InvalidInput(f"duplicate key {max(names, key=names.count)!r}")
    return result


def _refuse(text: str) -> NoReturn:
    raise InvalidInput(f"{text} is no number of JSON; leave the item out")
