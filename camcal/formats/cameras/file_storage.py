"""The files of OpenCV's FileStorage as plain data, and the reverse: YAML, XML and JSON.

OpenCV itself is not asked: a damaged file may end the process there. Read are mappings, sequences, texts, numbers and
matrices {rows, cols, dt, data} or {sizes, dt, data}. Written are numbers, texts and matrices of double precision, with
all digits, the same bytes whatever OpenCV is installed; 4.x and 5.x read them.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.formats.documents import MAX_DEPTH, MAX_FOREIGN_VALUES, Document, parse_foreign
from camcal.formats.emit import exact_text
from camcal.parsing import parse_integer, parse_number

ROOT = "opencv_storage"

_LISTS = ("data", "sizes")
_LONGEST = 8 << 20  # characters of an element: of as many numbers as are read
_XML_START = re.compile(r"\s*(<\?xml|<!--|<opencv_storage)")

Item = float | str | Array


def is_xml(text: str) -> bool:
    """Return whether a text begins as XML does."""
    return _XML_START.match(text) is not None


def parse(text: str, where: str) -> Document:
    """Return the document of a FileStorage text.

    Raises FileError if it is neither YAML, JSON nor XML of OpenCV's, InvalidInput for a duplicate key.
    """
    return Document(where, _parse_xml(text, where), {}) if is_xml(text) else parse_foreign(text, where)


def text_of(items: Mapping[str, Item], suffix: str, comment: str) -> str:
    """Return the text of items by their keys: XML or JSON where the suffix says so, otherwise YAML.

    comment: a line for people, without double hyphens; in JSON, which has none, it is the first item.
    """
    return _WRITERS.get(suffix.lower(), _yaml)(items, comment)


def _parse_xml(text: str, where: str) -> dict[str, Any]:
    builder = _Builder(where)
    parser = ET.XMLParser(target=builder)  # noqa: S314 - the builder refuses document types, and so entities
    try:
        parser.feed(text)
        parser.close()
    except ET.ParseError as error:
        line = error.position[0]
        raise FileError(f"invalid or truncated XML: {str(error).partition(':')[0]}", where=f"{where}:{line}") from error
    return builder.result


class _Builder:
    """Builds plain data from the events of an XML parser; without document types, there are no entities to expand."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.open: list[_Element] = []
        self.count = 0
        self.result: dict[str, Any] = {}

    def doctype(self, _name: str, _public: str, _system: str) -> None:
        raise FileError("has a document type (<!DOCTYPE), which OpenCV's files never have", where=self.where)

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self.count += 1
        if len(self.open) > MAX_DEPTH or self.count > MAX_FOREIGN_VALUES:
            raise FileError(f"more than {MAX_DEPTH} levels or {MAX_FOREIGN_VALUES} values", where=self.where)
        if not self.open and tag != ROOT:
            raise FileError(f"is XML with the root <{tag[:40]}>; OpenCV's has <{ROOT}>", where=self.where)
        self.open.append(_Element(tag, attributes.get("type_id", "")))

    def data(self, text: str) -> None:
        if self.open and self.open[-1].append(text) > _LONGEST:
            raise FileError(f"more than {_LONGEST} characters in <{self.open[-1].tag[:40]}>", where=self.where)

    def end(self, tag: str) -> None:
        element = self.open.pop()
        value = element.value()
        if not self.open:
            self.result = value if isinstance(value, dict) else {}
        elif not self.open[-1].add(tag, value):
            raise FileError(f"<{tag[:40]}> occurs twice", where=self.where)

    def close(self) -> None:
        """Do nothing; the parser calls it."""


class _Element:
    """An element of XML that is being read."""

    def __init__(self, tag: str, kind: str) -> None:
        self.tag, self.kind = tag, kind
        self.text: list[str] = []
        self.length = 0
        self.keys: dict[str, Any] = {}
        self.items: list[Any] = []

    def append(self, text: str) -> int:
        """Add text, and return how much there is."""
        self.text.append(text)
        self.length += len(text)
        return self.length

    def add(self, tag: str, value: Any) -> bool:
        """Add what stands inside; return whether it was not there yet."""
        if tag == "_":
            self.items.append(value)
            return True
        is_new = tag not in self.keys
        self.keys[tag] = value
        return is_new

    def value(self) -> Any:
        if self.keys:
            return self.keys
        if self.items:
            return self.items
        words = "".join(self.text).split()
        if self.tag in _LISTS:
            return [_scalar(word) for word in words]
        return _scalar(" ".join(words)) if words else None


def _scalar(word: str) -> Any:
    for read in (parse_integer, parse_number):
        try:
            return read(word)
        except ValueError:
            continue
    return word.strip('"')


def _yaml(items: Mapping[str, Item], comment: str) -> str:
    """Return the text as OpenCV 2 to 5 read it: the header of YAML 1.0 as OpenCV writes it."""
    lines = [line for key, item in items.items() for line in _yaml_lines(key, item)]
    return "\n".join(["%YAML:1.0", "---", f"# {comment}", *lines, ""])


def _yaml_lines(key: str, item: Item) -> Iterator[str]:
    if not isinstance(item, np.ndarray):
        yield f"{key}: {_text(item)}"
        return
    rows, columns = item.shape
    yield f"{key}: !!opencv-matrix"
    yield from (f"   rows: {rows}", f"   cols: {columns}", "   dt: d")
    yield f"   data: [ {_numbers(item, ', ', '       ')} ]"


def _xml(items: Mapping[str, Item], comment: str) -> str:
    lines = ['<?xml version="1.0"?>', f"<{ROOT}>", f"<!-- {comment} -->"]
    for key, item in items.items():
        if isinstance(item, np.ndarray):
            rows, columns = item.shape
            lines += [f'<{key} type_id="opencv-matrix">', f"  <rows>{rows}</rows>", f"  <cols>{columns}</cols>"]
            lines += ["  <dt>d</dt>", "  <data>", f"    {_numbers(item, ' ', '    ')}</data></{key}>"]
        else:
            lines.append(f"<{key}>{_text(item)}</{key}>")
    return "\n".join([*lines, f"</{ROOT}>", ""])


def _json(items: Mapping[str, Item], comment: str) -> str:
    blocks = []
    for key, item in {"comment": comment, **items}.items():
        if isinstance(item, np.ndarray):
            rows, columns = item.shape
            head = f'"type_id": "opencv-matrix", "rows": {rows}, "cols": {columns}, "dt": "d"'
            blocks.append(
                f'    "{key}": {{\n        {head},\n        "data": [ {_numbers(item, ", ", " " * 12)} ]\n    }}'
            )
        else:
            blocks.append(f'    "{key}": {_text(item)}')
    return "{\n" + ",\n".join(blocks) + "\n}\n"


def _numbers(matrix: Array, separator: str, indent: str) -> str:
    """Return the elements of a matrix, four a line."""
    texts = [exact_text(value) for value in matrix.ravel().tolist()]
    lines = [separator.join(texts[start : start + 4]) for start in range(0, len(texts), 4)]
    return f"{separator.rstrip()}\n{indent}".join(lines)


def _text(item: float | str) -> str:
    if isinstance(item, str):
        return f'"{item}"'
    return str(item) if isinstance(item, int) else exact_text(item)


_WRITERS: Mapping[str, Callable[[Mapping[str, Item], str], str]] = {".xml": _xml, ".json": _json}
