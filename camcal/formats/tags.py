"""Tag files: the YAML form of TagObjects, and its short form as text.

family: tag36h11
size_mm: 53.0                # or size_cm, size_m, size_in: the side of every tag on no bundle, each its own object
ids: [0, 1, 5]               # optional: the only ones of those that count
sizes:                       # optional: tags of another side
  - {id: 7, size_mm: 80.0}
tag_frame: opencv            # optional: z out of the tag, y up; apriltag: z into it, y down
bundles:                     # optional: rigid objects with several tags
  cube:
    - {id: 20, corners_mm: [[-20.0, 20.0, 0.0], …]}      # four, clockwise from the tag's top-left as printed
    - id: 21                                             # or where the tag's own frame is
      size_mm: 40.0
      translation_mm: [0.0, 0.0, -20.0]                  # of its middle
      rotation_vector: [0.0, 3.14159265359, 0.0]         # rad, or quaternion: {w: …, x: …, y: …, z: …}; object_T_tag
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats import documents, emit
from camcal.formats.documents import Check, Fault, child
from camcal.formats.schema import integer, items, mapping, number, one_of, text
from camcal.geometry import rotation
from camcal.geometry.pose import Pose
from camcal.parsing import parse_integer, parse_number
from camcal.targets.board_types import METRES, without_unit
from camcal.targets.markers import OPENCV, TAG_FRAMES, TagObjects, require_id, require_quadrangle, tag_corners
from camcal.targets.pattern import Family, family_named

SUFFIXES = (".yaml", ".yml")
SHORT = "FAMILY:SIZE[:IDS], such as tag36h11:53mm or DICT_4X4_50:40mm:0,1,5"

_LENGTH = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(mm|cm|m|in)\Z")
_IDS = re.compile(r"[0-9]{1,6}(,[0-9]{1,6})*\Z")
_POSITION = items(number(), 3)
_KINDS: dict[str, Check] = {
    "size": number(positive=True),
    "corners": items(_POSITION, 4),
    "translation": _POSITION,
}
_LENGTHS = {kind: {f"{kind}_{unit}": check for unit in METRES} for kind, check in _KINDS.items()}
_ROTATIONS: dict[str, Check] = {
    "rotation_vector": _POSITION,
    "quaternion": mapping(dict.fromkeys("wxyz", number())),
}
_SHORTEST_QUATERNION = 1e-3


def read(path: Path) -> TagObjects:
    """Return the tags of a YAML file.

    Raises InvalidInput with a line for every fault, FileError if the file cannot be read.
    """
    return from_block(documents.load(path, check).data)


def write(path: Path, tags: TagObjects) -> None:
    """Write tags as a YAML file; bundles by their corners, in metres."""
    files.write_text(path, emit.document(block(tags), "camcal tag file"))


def load_tags(text: str | Path) -> TagObjects:
    """Return the tags that `text` means: the path of a YAML file, or a short form such as tag36h11:53mm:0,1,5."""
    path = Path(text)
    if path.suffix.lower() in SUFFIXES or path.is_file():
        return read(path)
    return parse_tags(str(text))


def parse_tags(text: str) -> TagObjects:
    """Return the tags of a short form, FAMILY:SIZE[:IDS]. Raises InvalidInput that names the part at fault."""
    parts = text.split(":")
    if not 2 <= len(parts) <= 3:
        raise InvalidInput(f"tags {text!r}: expected {SHORT}, or a YAML file")
    length = _LENGTH.match(parts[1])
    if not length:
        raise InvalidInput(f"tags {text!r}: {without_unit(parts[1])}")
    if len(parts) == 3 and not _IDS.match(parts[2]):
        raise InvalidInput(f"tags {text!r}: {parts[2]!r} is not a list of ids; write 0,1,5")
    ids = tuple(map(parse_integer, parts[2].split(","))) if len(parts) == 3 else None
    try:
        return TagObjects(parts[0], parse_number(length[1]) * METRES[length[2]], ids)
    except InvalidInput as error:
        raise InvalidInput(f"tags {text!r}: {error.message}") from error


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a tag file."""
    faults = list(_SHAPE(data, path))
    yield from faults or _check_meaning(data, path)


def _check_family(value: Any, path: str) -> Iterator[Fault]:
    faults = list(text(value, path))
    if not faults:
        try:
            family_named(value)
        except InvalidInput as error:
            faults = [Fault(path, error.message)]
    yield from faults


_TAG = mapping(
    {"id": integer(0)}, {key: check for keys in _LENGTHS.values() for key, check in keys.items()} | _ROTATIONS
)
_SHAPE = mapping(
    {"family": _check_family},
    {
        **_LENGTHS["size"],
        "ids": items(integer(0)),
        "sizes": items(mapping({"id": integer(0)}, _LENGTHS["size"])),
        "tag_frame": one_of(TAG_FRAMES, "tag frame"),
        "bundles": mapping({}, others=items(_TAG)),
    },
)


def _check_meaning(data: Mapping[str, Any], path: str) -> Iterator[Fault]:
    """Check what the keys, each of its kind, say together."""
    family = family_named(data["family"])
    faults = list(_one_length(data, path, "size"))
    faults += _check_ids(data, path, family)
    for place, tag in enumerate(data.get("sizes", [])):
        faults += _one_length(tag, child(child(path, "sizes"), place), "size", needed="size_mm")
    for name, tags in data.get("bundles", {}).items():
        for place, tag in enumerate(tags):
            faults += _check_tag(tag, child(child(child(path, "bundles"), name), place), data)
    if not faults:
        try:
            from_block(data)
        except InvalidInput as error:
            faults = [Fault(path, error.message)]
    yield from faults


def _check_ids(data: Mapping[str, Any], path: str, family: Family) -> Iterator[Fault]:
    """Check that ids are of the family, and given once."""
    first: dict[int, str] = {}
    for where, tag in _ids(data, path):
        try:
            require_id(tag, family)
        except InvalidInput as error:
            yield Fault(where, error.message)
        if tag in first:
            yield Fault(where, f"id {tag} is given already, at {first[tag]}; each tag belongs to one object")
        first.setdefault(tag, where)
    listed = data.get("ids", [])
    for place, tag in enumerate(listed):
        where = child(child(path, "ids"), place)
        if tag >= family.count:
            yield Fault(where, f"id {tag} is not in {family.name}, whose ids are 0 to {family.count - 1}")
        elif tag in listed[:place]:
            yield Fault(where, f"id {tag} is listed twice")


def _ids(data: Mapping[str, Any], path: str) -> Iterator[tuple[str, int]]:
    """Yield the path and the id of every tag that is described by itself."""
    groups = {"sizes": data.get("sizes", [])}
    groups |= {child("bundles", name): tags for name, tags in data.get("bundles", {}).items()}
    for name, tags in groups.items():
        for place, tag in enumerate(tags):
            yield child(child(child(path, name), place), "id"), tag["id"]


def _check_tag(tag: Mapping[str, Any], path: str, data: Mapping[str, Any]) -> Iterator[Fault]:
    """Check a tag of a bundle: four corners, or a side and where it is."""
    yield from (fault for kind in _LENGTHS for fault in _one_length(tag, path, kind))
    placed = [key for key in tag if key.startswith(("size", "translation")) or key in _ROTATIONS]
    corners = _length(tag, "corners")
    if corners is not None and placed:
        yield Fault(child(path, placed[0]), "redundant with the corners; give one of them")
    elif corners is None and _length(tag, "translation") is None:
        yield Fault(path, "needs corners_mm, or translation_mm with a size")
    elif corners is None and _length(tag, "size") is None and _length(data, "size") is None:
        yield Fault(path, "needs its side: size_mm here, or for all tags at the top")
    elif len([key for key in tag if key in _ROTATIONS]) > 1:
        yield Fault(path, "rotation_vector and quaternion: give one of them")
    elif "quaternion" in tag and np.linalg.norm(list(tag["quaternion"].values())) < _SHORTEST_QUATERNION:
        yield Fault(child(path, "quaternion"), "is zero and not a rotation")
    elif corners is not None:
        try:
            require_quadrangle(corners)
        except InvalidInput as error:
            yield Fault(path, error.message)


def _one_length(data: Mapping[str, Any], path: str, kind: str, needed: str = "") -> Iterator[Fault]:
    given = [key for key in _LENGTHS[kind] if key in data]
    if len(given) > 1:
        yield Fault(path, f"{' and '.join(given)}: give one of them")
    elif needed and not given:
        yield Fault(path, f"missing key {needed!r}")


def from_block(data: Mapping[str, Any]) -> TagObjects:
    """Return the tags of plain data that has passed `check`."""
    size, frame = _side(data), data.get("tag_frame", OPENCV)
    ids = data.get("ids")
    return TagObjects(
        data["family"],
        size,
        None if ids is None else tuple(ids),
        {tag["id"]: _side(tag) or 0.0 for tag in data.get("sizes", [])},
        {
            name: {tag["id"]: _corners(tag, size, frame) for tag in tags}
            for name, tags in data.get("bundles", {}).items()
        },
        frame,
    )


def _side(data: Mapping[str, Any]) -> float | None:
    side = _length(data, "size")
    return None if side is None else float(side)


def _corners(tag: Mapping[str, Any], size: float | None, frame: str) -> Array:
    """Return the corners (4, 3) of a tag of a bundle, m."""
    corners = _length(tag, "corners")
    if corners is not None:
        return corners
    turn = np.eye(3)
    if "rotation_vector" in tag:
        turn = rotation.exp(np.array(tag["rotation_vector"], dtype=float))
    elif "quaternion" in tag:
        turn = rotation.from_quaternion(np.array([tag["quaternion"][part] for part in "wxyz"], dtype=float))
    middle = _length(tag, "translation")
    object_T_tag = Pose(turn, np.zeros(3) if middle is None else middle)
    return object_T_tag.apply(tag_corners(_side(tag) or size or 0.0, frame))


def _length(data: Mapping[str, Any], kind: str) -> Array | None:
    """Return the value of a length's key in metres, None without one."""
    found = (np.array(data[key], dtype=float) * METRES[key[len(kind) + 1 :]] for key in _LENGTHS[kind] if key in data)
    return next(found, None)


def block(tags: TagObjects) -> dict[str, Any]:
    """Return tags as plain data with the keys of a tag file."""
    data: dict[str, Any] = {"family": tags.family}
    if tags.size is not None:
        data["size_m"] = tags.size
    if tags.ids is not None:
        data["ids"] = list(tags.ids)
    if tags.sizes:
        data["sizes"] = [{"id": tag, "size_m": size} for tag, size in tags.sizes.items()]
    data["tag_frame"] = tags.tag_frame
    if tags.bundles:
        data["bundles"] = {
            name: [{"id": tag, "corners_m": corners.tolist()} for tag, corners in bundle.items()]
            for name, bundle in tags.bundles.items()
        }
    return data
