"""What a result says about its own quality: warnings (usable, but weak) and failures (why a gate or verdict failed).

Both are the same record. `CODES` is the list of all codes but those of a calibration's verdict, which stand with their
limits in `quality/criteria.py`; docs/messages.md is made from both.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from camcal.errors import in_one_line

Value = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Message:
    """A warning or a failure.

    code: from `CODES`, stable. text: what, how much and what to do, in one line. values: the figures of the text by
    names that carry the unit. where: file, key path, image or object; None where it is about the whole result.
    """

    code: str
    text: str
    values: Mapping[str, Value] = field(default_factory=dict, hash=False)
    where: str | None = None

    def __str__(self) -> str:
        return f"{in_one_line(self.where)}: {self.text}" if self.where else self.text

    def at(self, where: object) -> "Message":
        """Return the message with a place, unless it has one."""
        return self if self.where else replace(self, where=str(where))


def as_data(messages: Iterable[Message]) -> list[dict[str, Any]]:
    """Return messages as plain data for --json."""
    return [
        {"code": each.code, "text": each.text, "values": dict(each.values), "where": each.where} for each in messages
    ]


CODES: Mapping[str, Mapping[str, str]] = {}
