"""Records as documents: what a record writes follows from its fields, whose metadata name what is written otherwise.

A field is written under its own name and in SI units; `entry` gives it another name, unit or form, and words for a
table. A document holds what its record holds: records in it become documents, and arrays lists, where it is printed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

_ENTRY = "entry"


@dataclass(frozen=True)
class Entry:
    """How a field is written: its key ("" for its name), and the factor from SI units to those of the document, or
    factors of the values of a tuple.

    words, unit: what a table says of it. parts: keys of the values of a tuple. omitted: not at all. merged: its entries
    stand among those of the record.
    """

    key: str = ""
    factor: float | tuple[float, ...] = 1.0
    words: str = ""
    unit: str = ""
    parts: tuple[str, ...] = ()
    omitted: bool = False
    merged: bool = False

    def of(self, value: Any) -> Any:
        """Return a value as it is written; None, what is not known, stays."""
        if value is None:
            return None
        if isinstance(self.factor, tuple):
            value = [factor * part for factor, part in zip(self.factor, value, strict=True)]
        elif self.factor != 1.0:
            value *= self.factor
        return dict(zip(self.parts, value, strict=True)) if self.parts else value


def entry(
    key: str = "", factor: float | tuple[float, ...] = 1.0, words: str = "", unit: str = "", **form: Any
) -> Mapping[str, Entry]:
    """Return the metadata of a field, see `Entry`."""
    return {_ENTRY: Entry(key, factor, words, unit, **form)}


OMITTED, MERGED = entry(omitted=True), entry(merged=True)


def entries(record: Any) -> dict[str, Entry]:
    """Return how those fields of a record, or of its class, are written that say so, by their names, in their order."""
    return {field.name: field.metadata[_ENTRY] for field in fields(record) if _ENTRY in field.metadata}


def figures(record: Any) -> dict[str, Any]:
    """Return what the fields of a record that say how they are written write, by key."""
    return {how.key or name: how.of(getattr(record, name)) for name, how in entries(record).items()}


def document(record: Any) -> dict[str, Any]:
    """Return what all fields of a record write, by key."""
    written: dict[str, Any] = {}
    for field in fields(record):
        how, value = field.metadata.get(_ENTRY, _PLAIN), getattr(record, field.name)
        if how.merged:
            written |= document(value)
        elif not how.omitted:
            written[how.key or field.name] = how.of(value)
    return written


_PLAIN = Entry()


def is_record(value: Any) -> bool:
    """Return whether a value has a document."""
    return is_dataclass(value) and not isinstance(value, type)
