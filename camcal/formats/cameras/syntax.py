"""The texts of camera files as plain data, and the reverse: JSON, TOML, XML and lines with a key and numbers.

YAML is read by `documents`. A reader says what is wrong in the words of the syntax, with the line where there is one.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

from camcal.errors import FileError, InvalidInput
from camcal.formats.cameras.record import Source
from camcal.formats.cameras.values import Values
from camcal.formats.documents import Document
from camcal.formats.emit import exact_text

_LARGEST_DEPTH = 64
_LARGEST_TEXT = 100_000  # characters of a file of a few numbers


def json_values(source: Source) -> Values:
    """Return the values of a JSON object; NaN and infinities are read as texts, which are no numbers."""
    where = str(source.path)
    try:
        data = json.loads(source.text, parse_constant=str)
    except json.JSONDecodeError as error:
        raise FileError(f"invalid or truncated JSON: {error.msg}", where=f"{where}:{error.lineno}") from error
    except (RecursionError, ValueError) as error:
        raise FileError("is nested too deeply, or has numbers of too many digits", where=where) from error
    if not isinstance(data, dict):
        raise FileError("is not a JSON object {…}", where=where)
    return Values(Document(where, data, {}))


def json_text(data: Mapping[str, Any]) -> str:
    """Return JSON with all digits of its numbers, lists of numbers in a line each."""
    text = json.dumps(data, indent=2, ensure_ascii=False)
    return re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text) + "\n"


def toml_values(source: Source) -> Values:
    """Return the values of a TOML file."""
    import tomllib

    where = str(source.path)
    try:
        data = tomllib.loads(source.text)
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"invalid or truncated TOML: {error}", where=where) from error
    except RecursionError as error:
        raise FileError("is nested too deeply", where=where) from error
    return Values(Document(where, data, {}))


def toml_text(tables: Mapping[str, Mapping[str, Any]], comment: str = "") -> str:
    """Return TOML of tables by name, with all digits of its numbers."""
    blocks = [f"# {line}" for line in comment.splitlines()]
    for name, table in tables.items():
        blocks += [f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items()), ""]
    return "\n".join(blocks) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, float):
        return exact_text(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)  # texts, whole numbers, truth values


class _Tree(ET.TreeBuilder):
    """Builds elements, without document types, and so without entities to expand, of a limited depth."""

    depth = 0

    def doctype(self, _name: str, _public: str | None, _system: str | None) -> None:
        raise FileError("has a document type (<!DOCTYPE), which files of cameras never have")

    def start(self, tag: Any, attrs: Any) -> Any:
        self.depth += 1
        if self.depth > _LARGEST_DEPTH:
            raise FileError(f"more than {_LARGEST_DEPTH} levels of elements")
        return super().start(tag.rpartition("}")[2], attrs)  # names without their space

    def end(self, tag: Any) -> Any:
        self.depth -= 1
        return super().end(tag.rpartition("}")[2])


def xml_root(source: Source) -> ET.Element:
    """Return the root element of an XML file, or of a part of one without a root."""
    where = str(source.path)
    try:
        parser = ET.XMLParser(target=_Tree())  # noqa: S314 - document types are refused, and so entities
        parser.feed(source.text)
        return parser.close()
    except ET.ParseError as error:
        line = error.position[0]
        raise FileError(f"invalid or truncated XML: {str(error).partition(':')[0]}", where=f"{where}:{line}") from error
    except FileError as error:
        raise FileError(error.message, where=where) from error


def xml_values(source: Source, element: ET.Element) -> Values:
    """Return the texts of the children of an element, numbers as lists of texts, and its attributes as @NAME."""
    data: dict[str, Any] = {f"@{name}": value for name, value in element.attrib.items()}
    data |= {child.tag: (child.text or "").strip() for child in element}
    return Values(Document(str(source.path), data, {}), f"<{element.tag}>")


def xml_lines(items: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Yield the lines of elements by their names: texts, numbers with all digits, and elements in them."""
    for name, item in items.items():
        if isinstance(item, Mapping):
            yield f"{indent}<{name}>"
            yield from xml_lines(item, indent + "  ")
            yield f"{indent}</{name.split()[0]}>"
        else:
            text = exact_text(item) if isinstance(item, float) else escape(str(item))
            yield f"{indent}<{name}>{text}</{name}>"


def assigned(source: Source, pattern: str) -> Values:
    """Return the values of lines KEY = NUMBERS or KEY: NUMBERS, rows of a matrix between semicolons.

    pattern: of a key and its numbers. Raises InvalidInput for a file too large to be one of these.
    """
    if len(source.text) > _LARGEST_TEXT:
        raise InvalidInput(f"more than {_LARGEST_TEXT} characters, which no such file has", where=str(source.path))
    data: dict[str, Any] = {}
    for key, text in re.findall(pattern, source.text, re.MULTILINE):
        rows = [row.split() for row in re.split(r"[;\n]", text.strip(" \t\r[]").replace(",", " ")) if row.strip()]
        data[key] = rows[0] if len(rows) == 1 else rows
    return Values(Document(str(source.path), data, {}))
