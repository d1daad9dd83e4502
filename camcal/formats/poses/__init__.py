"""Pose files: what `camcal pnp` found, as YAML, JSON or CSV by the file's suffix.

YAML and JSON hold the same: `frames` names the transform, such as camera_T_object, which takes points of the object
to the camera; `poses` has one item for each object in an image. A CSV has one row for each of them.
"""

from pathlib import Path

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.documents import load_either
from camcal.formats.poses import plain, table
from camcal.formats.poses.plain import document
from camcal.formats.poses.record import PoseKey, PoseRecord, Poses

__all__ = ["SUFFIXES", "PoseKey", "PoseRecord", "Poses", "document", "read", "require_suffix", "write"]

SUFFIXES = (".yaml", ".yml", ".json", ".csv")
_MAX_VALUES = 20_000_000  # some 100 000 poses


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless poses can be written under this name."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"poses are written as {', '.join(SUFFIXES)}", where=str(path))


def read(path: str | Path) -> Poses:
    """Return the poses in a file.

    Raises InvalidInput with a line for every rule it breaks, FileError if it cannot be read or is of another kind.
    """
    path = Path(path)
    if str(path) != files.STANDARD:
        require_suffix(path)
    if files.suffix_of(path) == ".csv":
        return table.read(path)
    return plain.from_document(load_either(path, plain.check, _MAX_VALUES))


def write(path: str | Path, poses: Poses) -> None:
    """Write poses in the form the file's suffix says, to standard output as YAML."""
    path = Path(path)
    if not files.is_stream(path):
        require_suffix(path)
    if path.suffix.lower() == ".csv":
        text = "".join(f"{line}\n" for line in table.lines(poses))
    else:
        text = emit.text_for(path, document(poses), _comment(poses))
    files.write_text(path, text)


def _comment(poses: Poses) -> str:
    a, b = poses.frames.split("_T_")
    lengths = "metres" if poses.unit == "m" else poses.unit
    return f"camcal poses. Lengths: {lengths}; angles: radians. {poses.frames} takes points in {b} to points in {a}."
