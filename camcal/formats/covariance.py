"""Covariances as blocks of a file: std by name, the order of the names, the matrix.

    std: {fx: 0.41, fy: 0.4}
    covariance_order: [fx, fy]
    covariance:
      - [0.1681, 0.1602]
      - [0.1602, 0.16]

A matrix of more than 100 names stands in an .npz beside the file instead, under covariance_file, whose name carries
the hash of the numbers. With that of a camera stands where the boards of its calibration were, and three rows: the
covariance of their mean shift x, y, z with the parameters in their order, and with x, y, z.

    boards: {nearest_m: 0.4, farthest_m: 1.1, noise_share: 0.6, shift: [[...], [...], [...]]}

How the numbers of a pose and of its covariance are called and ordered in files is here too.
"""

import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import FileError, InvalidInput
from camcal.formats.documents import Check, Fault, child
from camcal.formats.schema import LARGEST_VARIANCE, STD, VARIANCE, items, mapping, matrix, number, text
from camcal.images.image import arrays_of
from camcal.parsing import did_you_mean
from camcal.quality.range_uncertainty import CalibrationBoards

MAX_INLINE = 100
STD_AGREEMENT = 0.01  # std and the matrix are two views of one number; a hand-edited one shows
NEGATIVE = -1e-9  # smallest eigenvalue of the correlations: rounding to 12 digits moves it by 1e-12 · size

POSITION = ("tx", "ty", "tz")
QUATERNION = ("qw", "qx", "qy", "qz")  # a bare y is a truth value to YAML 1.1
ORDER = (*POSITION, "rx", "ry", "rz")  # of the covariance of a pose
STEPS = "R <- Exp(dr) R, t <- t + dt"
PAIRS = tuple(combinations_with_replacement(range(len(ORDER)), 2))  # of its upper triangle, row by row
KEYS: Mapping[str, Check] = {
    "std": mapping({}, others=STD),
    "covariance_order": items(text),
    "covariance": items(items(VARIANCE)),
    "covariance_file": text,
}
BOARDS = mapping(
    {"nearest_m": number(positive=True), "farthest_m": number(positive=True)},
    {"noise_share": number(0, 1), "shift": items(items(VARIANCE), 3)},
)


def check(block: Mapping[str, Any], path: str, names: Sequence[str], fixed: Sequence[str] = ()) -> Iterator[Fault]:
    """Check a block whose keys have passed KEYS; `names` have a covariance, save those in `fixed`."""
    order = block.get("covariance_order", [])
    listed = [(child(child(path, "std"), name), name) for name in block.get("std", {})]
    listed += [(child(child(path, "covariance_order"), index), name) for index, name in enumerate(order)]
    for where, name in listed:
        if name not in names:
            yield Fault(where, f"no parameter {name!r}{did_you_mean(name, names)}")
        elif name in fixed:
            yield Fault(where, f"{name!r} is fixed and cannot have an uncertainty; leave it out")
    if len(set(order)) < len(order):
        yield Fault(child(path, "covariance_order"), f"{max(order, key=order.count)!r} occurs twice")
    given = {"covariance", "covariance_file"} & block.keys()
    if bool(order) != bool(given) or len(given) > 1:
        yield Fault(path, "covariance_order goes with covariance, or with covariance_file")
    elif Path(block.get("covariance_file", "")).name != block.get("covariance_file", ""):
        yield Fault(child(path, "covariance_file"), "the matrix must be beside the file: give a name without a folder")
    elif "covariance" in block:
        yield from _check_matrix(block, child(path, "covariance"))


def _check_matrix(block: Mapping[str, Any], path: str) -> Iterator[Fault]:
    rows, order = block["covariance"], block["covariance_order"]
    if any(matrix(len(order), len(order), VARIANCE)(rows, path)):
        shape = f"{len(rows)}x{len(rows[0]) if rows else 0}"
        yield Fault(path, f"covariance is {shape} but covariance_order has {len(order)} names")
        return
    found = np.array(rows, dtype=float)
    if (reason := why_no_covariance(found)) is not None:
        yield Fault(path, reason)
        return
    for name, variance in zip(order, np.diag(found), strict=True):
        std = block.get("std", {}).get(name)
        if std is not None and abs(std - np.sqrt(variance)) > STD_AGREEMENT * max(std, np.sqrt(variance)):
            yield Fault(path, f"std.{name} is {std:g}, {np.sqrt(variance):g} by the covariance")


def why_no_covariance(found: Array) -> str | None:
    """Return why a matrix (N, N) of finite numbers is no covariance, None if it is one but for 12-digit rounding."""
    variances = np.diag(found)
    if (variances < 0).any():
        return f"not a covariance: the variance in row {int(np.argmin(variances)) + 1} is negative"
    absurd = (variances > 0) & ~((variances >= 1 / LARGEST_VARIANCE) & (variances <= LARGEST_VARIANCE))
    if absurd.any():
        row = int(np.argmax(absurd))
        return f"not a covariance: the variance in row {row + 1}, {variances[row]:.3g}, is implausible"
    scale = np.where(variances > 0, np.sqrt(variances), 1.0)
    if (np.abs(found) > 2 * np.outer(scale, scale)).any():
        return "not a covariance: a correlation is larger than 1"
    correlations = found / np.outer(scale, scale)
    asymmetry = np.abs(correlations - correlations.T).max(initial=0.0)
    if asymmetry > -NEGATIVE:
        return f"not a covariance: not symmetric (correlations differ by {asymmetry:.1e})"
    smallest = np.linalg.eigvalsh(correlations).min(initial=0.0)
    if smallest < NEGATIVE:
        return f"not a covariance: not positive semidefinite (smallest eigenvalue of the correlations {smallest:.1e})"
    return None


def read(
    block: Mapping[str, Any], names: Sequence[str], folder: Path, fixed: Sequence[str] = ()
) -> tuple[Array | None, tuple[str, ...]]:
    """Return the covariance (N, N) over `names`, rows of fixed names zero, and the names without an uncertainty.

    Where only a std is given, correlations are zero. The covariance is None if a name that is not fixed has neither.
    block: has passed `check`. folder: of the file, for a matrix that stands beside it.
    """
    index = {name: row for row, name in enumerate(names)}
    std = block.get("std", {})
    order = block.get("covariance_order", [])
    unknown = tuple(name for name in names if name not in (*std, *order, *fixed))
    if unknown:
        return None, unknown
    result = np.diag([float(std.get(name, 0.0)) ** 2 for name in names])
    rows = [index[name] for name in order]
    if rows:
        result[np.ix_(rows, rows)] = _matrix(block, folder)
    return result, ()


def _matrix(block: Mapping[str, Any], folder: Path) -> Array:
    if "covariance" in block:
        return np.array(block["covariance"], dtype=float)
    path = folder / block["covariance_file"]
    try:
        found = arrays_of(files.read_bytes(path))["covariance"]
    except (ValueError, LookupError) as error:
        raise FileError("is not a covariance written by camcal, or truncated", where=str(path)) from error
    count = len(block["covariance_order"])
    if found.shape != (count, count) or _digest(found) not in path.name:
        raise InvalidInput("does not match covariance_order and its hash", where=str(path))
    return np.asarray(found)


def block(names: Sequence[str], covariance: Array, beside: Path, fixed: Sequence[str] = ()) -> dict[str, Any]:
    """Return the block of a covariance (N, N) over `names`; writes an .npz beside the file for a large one."""
    free = [row for row, name in enumerate(names) if name not in fixed]
    order = [names[row] for row in free]
    found = np.ascontiguousarray(covariance[np.ix_(free, free)])
    data: dict[str, Any] = {"std": dict(zip(order, np.sqrt(np.diag(found)).tolist(), strict=True))}
    if not order:
        return {}
    data["covariance_order"] = order
    if len(order) <= MAX_INLINE:
        data["covariance"] = found.tolist()
    else:
        data["covariance_file"] = _write_beside(beside, found)
    return data


def check_boards(block: Mapping[str, Any], path: str) -> Iterator[Fault]:
    """Check that the shift of boards has the numbers that go with the order of an uncertainty block."""
    shift = block.get("boards", {}).get("shift", [])
    count = len(block.get("covariance_order", [])) + len(POSITION)
    for index, row in enumerate(shift):
        if len(row) != count:
            place = child(child(child(path, "boards"), "shift"), index)
            yield Fault(place, f"{len(row)} numbers; one for each of covariance_order and x, y, z are {count}")


def read_boards(block: Mapping[str, Any], camera: Camera) -> CalibrationBoards | None:
    """Return what the uncertainty block of a camera says of the boards of its calibration."""
    if "boards" not in block:
        return None
    own, shift = block["boards"], None
    if "shift" in own and camera.covariance is not None:
        shift = np.zeros((3, len(camera.parameters) + 3))
        shift[:, _columns_of_shift(block.get("covariance_order", ()), camera)] = own["shift"]
    return CalibrationBoards(own["nearest_m"], own["farthest_m"], own.get("noise_share", 1.0), shift)


def boards_block(boards: CalibrationBoards, order: Sequence[str], camera: Camera) -> dict[str, Any]:
    """Return what is said of the boards of a camera's calibration; order: of its covariance."""
    data = {"nearest_m": boards.nearest, "farthest_m": boards.farthest, "noise_share": boards.noise_share}
    shift = None if boards.shift is None else boards.shift[:, _columns_of_shift(order, camera)].tolist()
    return data | ({} if shift is None else {"shift": shift})


def _columns_of_shift(order: Sequence[str], camera: Camera) -> list[int]:
    """Return where the columns of a shift stand among all parameters of a camera."""
    names = camera.model.parameter_names
    return [*map(names.index, order), *range(len(names), len(names) + 3)]


def _write_beside(beside: Path, covariance: Array) -> str:
    path = beside.with_name(f"{beside.stem}.covariance-{_digest(covariance)}.npz")
    content = io.BytesIO()
    np.savez_compressed(content, covariance=covariance)
    files.write_bytes(path, content.getvalue())
    return path.name


def _digest(covariance: Array) -> str:
    return hashlib.sha256(covariance.astype("<f8").tobytes()).hexdigest()[:16]


def names_of_pairs(start: str) -> tuple[str, ...]:
    """Return the names of the upper triangle of a pose's covariance in tables, such as cov_tx_ty."""
    return tuple(f"{start}_{ORDER[i]}_{ORDER[j]}" for i, j in PAIRS)


def from_upper(upper: Array) -> Array:
    """Return symmetric matrices (N, 6, 6) of their upper triangles (N, 21), row by row."""
    result = np.empty((len(upper), len(ORDER), len(ORDER)))
    for column, (i, j) in enumerate(PAIRS):
        result[:, i, j] = result[:, j, i] = upper[:, column]
    return result
