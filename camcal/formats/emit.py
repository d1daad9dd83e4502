"""Plain data as YAML text that every reader opens: PyYAML, yaml-cpp, ruamel and OpenCV's FileStorage.

OpenCV reads less than YAML: no empty values, no quoted keys, no comment after a value, no text of 4 096 bytes or
more, nested lists only indented. Numbers have 12 significant digits and a dot, since YAML 1.1 takes 1e-05 for text.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files, records
from camcal.errors import InvalidInput

NumberText = Callable[[float], str]

HEADER = "%YAML 1.1\n---\n"
LINE = 120
MAX_TEXT = 4000

_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_.()/+-]*\Z")
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*\Z")
WORDS = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}
_ILLEGIBLE = "\u2028\u2029\ufeff\ufffe\uffff"  # line breaks and what is no character
_ESCAPES = {"\\": r"\\", '"': r"\"", "\n": r"\n", "\t": r"\t", "\r": r"\r"}


def document(data: Mapping[str, Any], comment: str = "", number: NumberText | None = None) -> str:
    """Return the text of a YAML file that holds `data`, keys in their order, below the lines of `comment`.

    Keys whose value is None are left out, arrays are lists and paths texts. number: how numbers are written, by
    default as `number_text` does.
    Raises InvalidInput for a key or a text that OpenCV could not read.
    """
    remarks = "".join(f"# {line}\n" for line in comment.splitlines())
    return HEADER + remarks + "".join(f"{line}\n" for line in _block(plain(data), "", number or number_text))


def text_for(path: Path, data: Mapping[str, Any], comment: str = "") -> str:
    """Return the text of a file that holds `data`: JSON where the suffix says so, otherwise YAML below a comment."""
    return json_text(data) if path.suffix.lower() == ".json" else document(data, comment)


def json_text(data: Mapping[str, Any]) -> str:
    """Return the text of a JSON file that holds `data`, numbers at 12 significant digits."""
    return json.dumps(rounded(data), indent=1, ensure_ascii=False) + "\n"


def number_text(value: float) -> str:
    """Return a number at 12 significant digits, or all of an `Exact` one, and with a dot."""
    if isinstance(value, Exact):
        return exact_text(value)
    return _with_dot(f"{value + 0.0:.12g}")  # + 0.0 drops the sign of a zero


class Exact(float):
    """A number that is written with all its digits, such as a time since 1970."""


def exact_text(value: float) -> str:
    """Return the shortest text, with a dot, that gives the very same number back: at most 17 significant digits."""
    return _with_dot(repr(float(value) + 0.0))


def _with_dot(text: str) -> str:
    mantissa, exponent, power = text.partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + exponent + power


def rounded(value: Any) -> Any:
    """Return data with numbers at 12 significant digits, and mappings in the place of records."""
    if records.is_record(value):
        value = records.document(value)
    if isinstance(value, Mapping):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    return float(f"{value:.12g}") if isinstance(value, float) and not isinstance(value, Exact) else value


def plain(value: Any) -> Any:
    """Return data as dicts, lists and Python scalars, keys whose value is None left out."""
    if records.is_record(value):
        value = records.document(value)
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def _block(data: Mapping[str, Any], indent: str, number: NumberText) -> Iterator[str]:
    for key, value in data.items():
        start = f"{indent}{_key(key)}:"
        line = f"{start} {_flow(value, number)}"
        if not _is_container(value) or _on_one_line(value, line):
            yield line
        elif isinstance(value, Mapping):
            yield start
            yield from _block(value, indent + "  ", number)
        else:
            yield start
            for item in value:
                yield from _item(item, f"{indent}  ", number)


def _item(value: Any, indent: str, number: NumberText) -> Iterator[str]:
    """Yield the lines of an item of a list: one, or a block for a mapping that holds more than scalars."""
    if isinstance(value, Mapping) and any(map(_is_container, value.values())):
        first, *rest = _block(value, f"{indent}  ", number)
        yield f"{indent}- {first.lstrip()}"
        yield from rest
    else:
        yield f"{indent}- {_flow(value, number)}"


def _on_one_line(value: Mapping[str, Any] | Sequence[Any], line: str) -> bool:
    """Return whether a container stands on its key's line: short ones, and lists of numbers whatever their length."""
    if isinstance(value, Mapping):
        return len(line) <= LINE and all(not _is_container(part) or _holds_scalars(part) for part in value.values())
    return _holds_scalars(value) and (len(line) <= LINE or not any(isinstance(item, str) for item in value))


def _holds_scalars(value: Any) -> bool:
    return not isinstance(value, Mapping) and not any(map(_is_container, value))


def _is_container(value: Any) -> bool:
    return isinstance(value, (Mapping, list, tuple))


def _flow(value: Any, number: NumberText) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return number(value)
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)}: {_flow(item, number)}" for key, item in value.items()) + "}"
    return "[" + ", ".join(_flow(item, number) for item in value) + "]"


def _key(key: str) -> str:
    if not _KEY.match(key) or key.lower() in WORDS:
        raise InvalidInput(f"invalid key {key!r}: use letters, digits and _ . ( ) / + -")
    return key


def _text(text: str) -> str:
    if not _PLAIN.match(text) or text.lower() in WORDS:
        text = '"' + "".join(_ESCAPES.get(letter) or _legible(letter) for letter in text) + '"'
    if len(files.utf8(text)) > MAX_TEXT:
        raise InvalidInput(f"a text of more than {MAX_TEXT} bytes cannot be written: {text[:40]}…")
    return text


def _legible(letter: str) -> str:
    r"""Return a letter as it is, or spelt out as \x07 where YAML or OpenCV would not take it in a text."""
    if " " <= letter <= "~" or (letter >= "\xa0" and letter not in _ILLEGIBLE and not "\ud800" <= letter <= "\udfff"):
        return letter
    return f"\\\\x{ord(letter):02x}" if letter < "\x80" else f"\\\\u{ord(letter):04x}"
