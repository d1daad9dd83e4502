"""The data that a report page carries, with which it is run again.

Three elements of the page hold them, and nothing else of it is read: `camcal-run`, JSON (command, options, board, what
was recorded, the result); `camcal-detections`, a detections file as CSV, deflated, in base64; and the photographs of
`<image data-photo="KEY">`, JPEG in base64. A page comes from anywhere: it is read with limits, and checked as any file.
Options are carried as settings, with what cannot be found out from detections.
"""

import base64
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.calibrate.intrinsics import CandidateModel
from camcal.dataclass import dataclass, field
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats import boards, detections, documents, split_address
from camcal.formats.detections_text import csv_text
from camcal.formats.schema import integer, items, mapping, number, one_of, plain, text
from camcal.messages import Message, as_data
from camcal.options import Declared, assembled, declared
from camcal.parsing import did_you_mean
from camcal.report.page.record import DataBlock
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.tasks.calibration.camera_result import RefinementSummary
from camcal.tasks.reports.closing import environment

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

_GUESS = "guess"
Candidates = Mapping[tuple[str, ...], Sequence[CandidateModel]]


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
    return base64.b64encode(zlib.compress(files.utf8(csv_text(found)), 9)).decode("ascii")


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
        table = _inflate(page.texts[DETECTIONS])
    photos = {key: uri for key, uri in page.photos.items() if photo.fullmatch(uri)}
    return PageData(run, detections.parse_csv(table, f"{path}: {DETECTIONS}", boards.from_block(run["board"])), photos)


def _inflate(content: str) -> str:
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


def blocks(run: Mapping[str, Any], found: Detections) -> tuple[DataBlock, ...]:
    """Return the data elements of a page."""
    return (
        DataBlock(RUN, RUN_TYPE, run_text(run)),
        DataBlock(DETECTIONS, DETECTIONS_TYPE, detections_text(found)),
    )


def run_of(
    command: str,
    words: Sequence[str],
    options: Any,
    board: Board,
    images: Iterable[Mapping[str, Any]],
    result: str = "",
) -> dict[str, Any]:
    """Return what every report carries.

    words: the command line that is recorded. images: as the provenance lists them. result: the text of the camera file,
    "" without one.
    """
    hashes = {hash_key(image.get("camera"), image["file"]): image["sha256"] for image in images if "sha256" in image}
    return {
        "format": FORMAT,
        "version": VERSION,
        "command": command,
        "words": list(words),
        "options": settings_of(options),
        "board": boards.block(board),
        "guess": [
            {"name": name, "content": base64.b64encode(files.read_bytes(split_address(value)[0])).decode("ascii")}
            for name, value in _guesses(options)
        ],
        "hashes": hashes,
        "environment": environment(),
        "result": result,
    }


def hash_key(camera: str | None, image: str) -> str:
    """Return the key under which the hash of an image is carried; camera: of a rig, None where there is only one."""
    return image if camera is None else f"{camera}/{image}"


def settings_of(options: Any) -> dict[str, Any]:
    """Return the recorded options that differ from their defaults as settings files have them, arguments too."""
    given = ((each, each.of(options)) for each in declared(type(options)) if each.option.recorded)
    return {
        _key(each): each.setting(value)
        for each, value in given
        if value is not None and value not in (each.default, ())
    }


def _key(each: Declared) -> str:
    """Return the key of an option: its fields."""
    return ".".join(each.path)


def options_of(record: type, settings: Mapping[str, Any]) -> Any:
    """Return the options record of settings; raises InvalidInput for one that it does not have, or its value."""
    known = {_key(each): each for each in declared(record) if each.option.recorded}
    values = {}
    for key, given in settings.items():
        if key not in known:
            raise InvalidInput(f"options.{key}: unknown option{did_you_mean(key, list(known))}")
        values[known[key].path] = known[key].read(_require_type(known[key], given))
    return assembled(record, values)


def _require_type(each: Declared, given: Any) -> Any:
    """Return a setting if it is of the type that the option takes; raises InvalidInput."""
    many = each.several or each.option.values > 1
    if each.flag:
        fits = isinstance(given, bool)
    elif many:
        fits = isinstance(given, list) and all(isinstance(item, str) for item in given)
    else:
        fits = isinstance(given, str)
    if not fits:
        raise InvalidInput(f"options.{_key(each)}: {given!r} is not a value of this option")
    return given


def _guesses(options: Any) -> list[tuple[str, str]]:
    """Return the guesses of options, each as it is given and as FILE or FILE#NAME."""
    values = [each.of(options) for each in declared(type(options)) if each.path[-1] == _GUESS]
    texts = [text for value in values if value for text in ((value,) if isinstance(value, str) else value)]
    return [(text, text.partition("=")[2] or text) for text in texts]


def unpacked_guesses(run: Mapping[str, Any], options: Any, folder: Path) -> list[str]:
    """Return the guesses of options with their files in a folder, after writing these there."""
    carried = {each["name"]: each["content"] for each in run.get(_GUESS, [])}
    result = []
    for index, (name, address) in enumerate(_guesses(options)):
        if name not in carried:
            raise InvalidInput(f"carries no content of --guess {name}")
        path, camera = split_address(address)
        # the name comes from the page and may be "..": only its suffix says what the file is
        copy = folder / f"{index}{files.stem_of(path.suffix)}"
        copy.write_bytes(file_content(carried[name], name))
        start = name.partition("=")[0] + "=" if "=" in name else ""
        result.append(f"{start}{copy}" + (f"#{camera}" if camera else ""))
    return result


def messages_data(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """Return messages as plain data without empty values."""
    return [
        {key: _plain(value) for key, value in each.items() if value is not None and value != {}}
        for each in as_data(messages)
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value


def messages_of(data: Sequence[Mapping[str, Any]]) -> tuple[Message, ...]:
    """Return the messages of plain data."""
    return tuple(
        Message(
            each["code"],
            each["text"],
            {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in each.get("values", {}).items()
            },
            each.get("where"),
        )
        for each in data
    )


def candidates_data(candidates: Candidates) -> list[dict[str, Any]]:
    """Return lens models that were compared as plain data, by the cameras they were compared for."""
    return [
        {"cameras": list(names), "models": [_candidate_data(own) for own in models]}
        for names, models in candidates.items()
    ]


def _candidate_data(own: CandidateModel) -> dict[str, Any]:
    total = None if own.scores is None else float(own.scores.sum())
    data = {"name": own.name, "corners": own.corners, "total": total, "sigma_px": own.sigma_px, "reason": own.reason}
    judged = {"map_px": own.map_px, "failures": list(own.failures) or None}
    return {key: value for key, value in (data | judged).items() if value is not None}


def candidates_of(data: Sequence[Mapping[str, Any]]) -> dict[tuple[str, ...], tuple[CandidateModel, ...]]:
    """Return the lens models of plain data."""
    return {tuple(each["cameras"]): tuple(map(_candidate, each["models"])) for each in data}


def _candidate(data: Mapping[str, Any]) -> CandidateModel:
    scores = np.array([data["total"]]) if "total" in data else None
    return CandidateModel(
        data["name"],
        scores,
        data["corners"],
        data.get("sigma_px"),
        data.get("reason"),
        map_px=data.get("map_px"),
        failures=tuple(data.get("failures", ())),
    )


def refinement_of(data: Mapping[str, Any] | None) -> RefinementSummary | None:
    """Return what the second pass of corner refinement changed, as it was recorded."""
    if not data:
        return None
    try:
        return RefinementSummary(int(data["added"]), int(data["removed"]))
    except KeyError as error:
        raise InvalidInput(f"refinement: missing key {error}") from None
