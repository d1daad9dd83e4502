"""The data that a report page carries, with which it is run again.

Three elements of the page hold them, and nothing else of it is read: `camcal-run`, JSON (command, options, board, what
was recorded, the result); `camcal-detections`, a detections file as CSV, deflated, in base64; and the photographs of
`<image data-photo="KEY">`, JPEG in base64. A page comes from anywhere: it is read with limits, and checked as any file.
"""

import base64
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats import boards, detections, documents
from camcal.formats.schema import integer, items, mapping, number, one_of, plain, text
from camcal.targets.detection import Detections

FORMAT, VERSION = "camcal-report", 1
RUN, DETECTIONS = "camcal-run", "camcal-detections"
RUN_TYPE, DETECTIONS_TYPE = "application/json", "text/plain"
CALIBRATE, RIG = "calibrate", "rig"

_LARGEST = 64 << 20  # bytes of a page
_LARGEST_TABLE = 256 << 20  # bytes of its detections
_MOST_PHOTOS = 1000
_ESCAPES = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}

_MESSAGE = mapping({"code": text, "text": text}, {"values": mapping({}, others=plain), "where": text})
_CANDIDATE = mapping(
    {"name": text, "corners": integer(0)},
    {"total": number(), "sigma_px": number(0), "reason": text, "map_px": number(0), "failures": items(text)},
)
_CAPTURES = mapping(
    {
        "cameras": items(text),
        "names": items(text),
        "images": items(items(text)),  # of each capture by camera, "" for none
        "matched_by": text,
        "unmatched": items(text),
    },
    {"largest_s": number(0)},
)
_RUN = mapping(
    {
        "format": one_of([FORMAT], "format"),
        "version": integer(1),
        "command": one_of([CALIBRATE, RIG], "command"),
        "words": items(text),
        "options": mapping({}, others=plain),
        "board": boards.check,
        "environment": mapping({}, others=text),
        "result": text,
    },
    {
        "refusal": text,
        "models": mapping({}, others=text),
        "guess": items(mapping({"name": text, "content": text})),
        "hashes": mapping({}, others=text),
        "lines": items(text),
        "warnings": items(_MESSAGE),
        "failed": items(text),
        "refinement": mapping({}, others=number()),
        "candidates": items(mapping({"cameras": items(text), "models": items(_CANDIDATE)})),
        "captures": _CAPTURES,
    },
)


@dataclass(frozen=True, eq=False)
class PageData:
    """What a page carries. run: plain data that has passed its check. photos: data URIs by their keys."""

    run: Mapping[str, Any]
    detections: Detections
    photos: Mapping[str, str] = field(default_factory=dict)


def run_text(run: Mapping[str, Any]) -> str:
    """Return the text of the `camcal-run` element: JSON without a letter that HTML gives a meaning."""
    return json.dumps(run, ensure_ascii=False, allow_nan=False, separators=(",", ":")).translate(_ESCAPES)


def detections_text(found: Detections) -> str:
    """Return the text of the `camcal-detections` element."""
    return base64.b64encode(zlib.compress(files.utf8(detections.csv_text(found)), 9)).decode("ascii")


def read(path: Path, photo: re.Pattern[str]) -> PageData:
    """Return what a page carries; photo: what the data URI of a photograph looks like.

    Raises FileError if it is no report of camcal, or damaged; InvalidInput for data that break a rule.
    """
    page = _Elements()
    page.feed(files.read_text(path, _LARGEST))
    page.close()
    if RUN not in page.texts or DETECTIONS not in page.texts:
        raise FileError("is no report that can be run again: it carries no detections", where=str(path))
    where = f"{path}: {RUN}"
    run = documents.parse_json(page.texts[RUN], where)
    if not isinstance(run, dict):
        raise FileError("damaged: not a JSON object", where=where)
    document = documents.Document(where, run, {})
    if isinstance(version := run.get("version"), int) and version > VERSION:
        raise InvalidInput(
            f"version {version} is newer than this camcal (reads {VERSION}); upgrade camcal", where=where
        )
    if faults := list(_RUN(run, "")):
        raise document.error(faults)
    with Located(f"{path}: {DETECTIONS}"):
        table = _inflated(page.texts[DETECTIONS])
    photos = {key: uri for key, uri in page.photos.items() if photo.fullmatch(uri)}
    return PageData(run, detections.parse_csv(table, f"{path}: {DETECTIONS}", boards.from_block(run["board"])), photos)


def _inflated(content: str) -> str:
    """Return the text that deflated bytes in base64 hold; raises FileError if they are damaged or hold too much."""
    try:
        packed = base64.b64decode(content.strip(), validate=True)
        stream = zlib.decompressobj()
        data = stream.decompress(packed, _LARGEST_TABLE)
        if stream.unconsumed_tail:
            raise FileError(f"more than {_LARGEST_TABLE} bytes of detections")
        if not stream.eof:
            raise FileError("damaged: the detections end too early")
        return data.decode("utf-8")
    except (ValueError, zlib.error) as error:
        raise FileError(f"damaged: the detections cannot be unpacked ({error})") from error


def file_content(content: str, where: str) -> bytes:
    """Return the bytes of a file in base64; raises FileError if they are damaged."""
    try:
        return base64.b64decode(content, validate=True)
    except ValueError as error:
        raise FileError(f"damaged: {error}", where=where) from error


class _Elements(HTMLParser):
    """The elements of a page that hold data."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.texts: dict[str, str] = {}
        self.photos: dict[str, str] = {}
        self._open: str | None = None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the beginning of a data element, and photographs."""
        given = dict(attrs)
        if tag == "script" and (name := given.get("id")) in (RUN, DETECTIONS):
            self._open = name
            self.texts.setdefault(str(name), "")
        key, uri = given.get("data-photo"), given.get("href")
        if tag == "image" and key is not None and uri and len(self.photos) < _MOST_PHOTOS:
            self.photos[key] = uri

    def handle_endtag(self, tag: str) -> None:
        """Note the end of a data element."""
        if tag == "script":
            self._open = None

    def handle_data(self, data: str) -> None:
        """Keep the text of a data element."""
        if self._open is not None:
            self.texts[self._open] += data
