"""Pose files: what `camcal pnp` found, as YAML, JSON or CSV by the file's suffix.

YAML and JSON hold the same: `frames` names the transform, such as camera_T_object, which takes points of the object
to the camera; `poses` has one item for each object in an image. A CSV has one row for each of them, what is not known
left empty; see COLUMNS. Its first line is a comment with the frames, the unit and the noise; `# none` lines say which
images have no pose. Of other poses that fit nearly as well, the most probable one is there, in the columns that begin
with alt_.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.estimate.poses.records import Alternative
from camcal.formats import emit
from camcal.formats.covariance import ORDER, PAIRS, POSITION, QUATERNION, from_upper, names_of_pairs, why_no_covariance
from camcal.formats.documents import load_either
from camcal.formats.poses.record import (
    FORMAT,
    UNIT_LENGTH,
    UNITS,
    VERSION,
    PixelNoise,
    PoseKey,
    PoseRecord,
    Poses,
    check,
    check_frames,
    document,
    from_document,
)
from camcal.formats.tables import Lines, Table, cell, csv_rows, numbered_lines
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.parsing import LARGEST, parse_integer, parse_number

__all__ = ["SUFFIXES", "PoseKey", "PoseRecord", "Poses", "document", "read", "require_suffix", "write"]

SUFFIXES = (".yaml", ".yml", ".json", ".csv")
_MAX_VALUES = 20_000_000  # some 100 000 poses

_POSE = (*POSITION, *QUATERNION)
_VECTOR = ORDER[3:]
_CENTRE = ("x", "y", "z")
_FIT = ("rms_px", "max_px", "p_wrong")
_COUNTS = ("n_points", "n_inliers")
_OTHER = (*(f"alt_{name}" for name in _POSE), "dchi2", "alt_probability")
_FIGURES = ("error_ratio", "planarity", "least_depth", "view_angle_deg", "image_share", "condition")
_TOTAL, _NOISE = names_of_pairs("cov"), names_of_pairs("noise")
COLUMNS = (
    *("image", "object", "status", *_POSE, *_VECTOR, *_CENTRE, *_FIT, *_COUNTS, "outliers"),
    *(*_OTHER, *_FIGURES, *_TOTAL, *_NOISE),
)

_HEAD = re.compile(
    rf"# {FORMAT} (?P<version>[0-9]{{1,9}}) frames=(?P<frames>\S+) unit=(?P<unit>\S+) sigma_px=(?P<sigma_px>\S+)"
    r"(?: scale=(?P<scale>\S+))?(?: degrees_of_freedom=(?P<dof>[0-9]{1,9}))?\s*\Z"
)
_NONE = "# none "
_MAX_COUNT = 10**9


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
        return _read_csv(path)
    return from_document(load_either(path, check, _MAX_VALUES))


def write(path: str | Path, poses: Poses) -> None:
    """Write poses in the form the file's suffix says, to standard output as YAML."""
    path = Path(path)
    if not files.is_stream(path):
        require_suffix(path)
    if path.suffix.lower() == ".csv":
        text = "".join(f"{line}\n" for line in _csv_lines(poses))
    else:
        text = emit.text_for(path, document(poses), _comment(poses))
    files.write_text(path, text)


def _comment(poses: Poses) -> str:
    a, b = poses.frames.split("_T_")
    lengths = "metres" if poses.unit == "m" else poses.unit
    return f"camcal poses. Lengths: {lengths}; angles: radians. {poses.frames} takes points in {b} to points in {a}."


def _csv_lines(poses: Poses) -> Iterator[str]:
    """Yield the lines of a file, without their ends."""
    known = {name: value for name, value in vars(poses.noise).items() if value is not None}
    noise = " ".join(f"{name}={value:.12g}" for name, value in known.items())
    yield f"# {FORMAT} {VERSION} frames={poses.frames} unit={poses.unit} {noise}"
    yield ",".join(COLUMNS)
    for pose_key, record in poses.estimates.items():
        yield ",".join(_cells(poses, pose_key, record))
    for pose_key, reason in poses.missing.items():
        yield _NONE + ",".join(cell(" ".join(part.split())) for part in (*pose_key, reason))


def _cells(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> list[str]:
    named = [cell(pose_key.image), cell(pose_key.object), cell(record.status)]
    numbers = [*_seven(record.transform), *record.transform.vector(), *poses.position(record)]
    fit = [record.rms_px, record.max_px, record.p_wrong]
    counts = [str(record.n_points), str(record.n_inliers), " ".join(map(str, record.outliers))]
    angle = None if record.tilt_rad is None else math.degrees(record.tilt_rad)
    figures = [record.error_ratio, record.planarity, record.least_depth, angle, record.image_share, record.condition]
    covariances = [matrix[pair] for matrix in (record.covariance, record.noise_covariance) for pair in PAIRS]
    return [*named, *_texts([*numbers, *fit]), *counts, *_texts([*_alternative(record), *figures, *covariances])]


def _alternative(record: PoseRecord) -> list[float | None]:
    if not record.alternatives:
        return [None] * len(_OTHER)
    other = record.alternatives[0]
    return [*_seven(other.transform), other.chi_square_difference, other.probability]


def _seven(pose: Pose) -> list[float]:
    return [*pose.translation, *so3.to_quaternion(pose.rotation)]


def _texts(numbers: Sequence[float | None]) -> list[str]:
    return ["" if number is None else f"{number:.12g}" for number in numbers]


def _read_csv(path: Path) -> Poses:
    """Return the poses in a CSV; raises InvalidInput with file and line for the first row that breaks a rule."""
    where, content = str(path), numbered_lines(path)
    frames, unit, noise = _head(where, content)
    table = Table.from_csv(where, content, [name for name in COLUMNS if name not in _VECTOR + _CENTRE], COLUMNS)
    estimates: dict[PoseKey, PoseRecord] = {}
    for row, record in enumerate(_records(table)):
        pose_key = PoseKey(table.columns["image"][row], table.columns["object"][row])
        if pose_key in estimates:
            raise InvalidInput(f"{pose_key} occurs twice", where=f"{where}:{table.lines[row]}")
        estimates[pose_key] = record
    return Poses(frames, unit, noise, estimates, dict(_missing(where, content)))


def _head(where: str, content: Lines) -> tuple[str, str, PixelNoise]:
    found = _HEAD.match(content[0][1]) if content else None
    if found is None:
        raise FileError(f"not a pose file of camcal: its first line begins with '# {FORMAT} {VERSION}'", where=where)
    if int(found["version"]) > VERSION:
        raise InvalidInput(f"version {found['version']} is newer than this camcal (reads {VERSION})", where=where)
    faults = list(check_frames(found["frames"], "frames"))
    if faults or found["unit"] not in UNITS:
        raise InvalidInput(faults[0].text if faults else f"unit {found['unit']!r} is unknown", where=f"{where}:1")
    sigma, scale = (_of_head(where, found, name) for name in ("sigma_px", "scale"))
    dof = int(found["dof"]) if found["dof"] else None
    return found["frames"], found["unit"], PixelNoise(sigma or 0.0, scale, dof)


def _of_head(where: str, found: re.Match[str], name: str) -> float | None:
    try:
        return parse_number(found[name]) if found[name] else None
    except ValueError as error:
        raise InvalidInput(f"{name}: {found[name]!r} is not a number", where=f"{where}:1") from error


def _missing(where: str, content: Lines) -> Iterator[tuple[PoseKey, str]]:
    for number, line in content:
        if line.startswith(_NONE):
            (cells,) = csv_rows(where, [(number, line.removeprefix(_NONE))]) or [[]]
            if len(cells) != 3:
                raise InvalidInput("a '# none' line has image,object,reason", where=f"{where}:{number}")
            yield PoseKey(cells[0], cells[1]), cells[2]


def _records(table: Table) -> Iterator[PoseRecord]:
    if not len(table):
        return
    transforms = _transforms(table, np.column_stack([table.numbers(name) for name in _POSE]))
    alternatives = _alternatives(table)
    total, noise = _covariances(table, _TOTAL), _covariances(table, _NOISE)
    fit = np.column_stack([table.numbers(name) for name in _FIT]).tolist()
    counts = np.column_stack([table.integers(name, 0, _MAX_COUNT) for name in _COUNTS]).tolist()
    figures = np.column_stack([table.numbers_or_empty(name) for name in _FIGURES]).tolist()
    for row, (status, outliers) in enumerate(zip(table.columns["status"], table.columns["outliers"], strict=True)):
        ratio, planarity, depth, angle, share, condition = (
            None if math.isnan(value) else value for value in figures[row]
        )
        rms, largest, p_wrong = fit[row]
        yield PoseRecord(
            transforms[row],
            total[row],
            noise[row],
            status,
            rms_px=rms,
            max_px=largest,
            n_points=counts[row][0],
            n_inliers=counts[row][1],
            p_wrong=p_wrong,
            error_ratio=ratio,
            alternatives=alternatives[row],
            outliers=_ids(table, row, outliers),
            planarity=planarity,
            least_depth=depth,
            tilt_rad=None if angle is None else math.radians(angle),
            image_share=share,
            condition=condition,
        )


def _transforms(table: Table, numbers: Array) -> list[Pose]:
    off = np.abs(np.linalg.norm(numbers[:, 3:7], axis=1) - 1)
    table.refuse(off > UNIT_LENGTH, lambda _row: "quaternion norm is not 1")
    farthest = np.abs(numbers[:, :3]).max(axis=1)
    table.refuse(farthest > LARGEST, lambda row: f"a translation of {farthest[row]:g} is implausible")
    return [Pose(so3.from_quaternion(row[3:7]), row[:3]) for row in numbers]


def _alternatives(table: Table) -> list[tuple[Alternative, ...]]:
    """Return the alternative of every row, none where its cells are empty."""
    there = np.flatnonzero([bool(text) for text in table.columns["dchi2"]])
    some = table.rows(there)
    result: list[tuple[Alternative, ...]] = [()] * len(table)
    if len(some):
        numbers = np.column_stack([some.numbers(name) for name in _OTHER])
        for row, pose, figures in zip(there, _transforms(some, numbers), numbers[:, 7:].tolist(), strict=True):
            result[row] = (Alternative(pose, *figures),)
    return result


def _covariances(table: Table, names: Sequence[str]) -> Array:
    """Return matrices (N, 6, 6) from the columns of their upper triangles."""
    result = from_upper(np.column_stack([table.numbers(name) for name in names]))
    reasons = [why_no_covariance(matrix) for matrix in result]
    table.refuse(np.array([reason is not None for reason in reasons]), lambda row: str(reasons[row]))
    return result


def _ids(table: Table, row: int, text: str) -> tuple[int, ...]:
    try:
        return tuple(map(parse_integer, text.split()))
    except ValueError as error:
        where = f"{table.path}:{table.lines[row]}"
        raise InvalidInput(f"outliers: {text!r} are not numbers of points", where=where) from error
