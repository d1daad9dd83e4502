"""Pose files: what `camcal pnp` found, as YAML, JSON or CSV by the file's suffix.

YAML and JSON hold the same: `frames` names the transform, such as camera_T_object, which takes points of the object
to the camera; `poses` has one item an image. A CSV has one row an image and the covariance's upper triangle.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.estimate.pnp import PoseEstimate
from camcal.formats import emit
from camcal.formats.tables import cell
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

FORMAT = "camcal-poses"
VERSION = 1
QUATERNION = ("qw", "qx", "qy", "qz")  # a bare y is a truth value to YAML 1.1
ORDER = ("tx", "ty", "tz", "rx", "ry", "rz")
STEPS = "R <- Exp(dr) R, t <- t + dt"
SUFFIXES = (".yaml", ".yml", ".json", ".csv")

_PAIRS = tuple(combinations_with_replacement(range(6), 2))
_COLUMNS = (
    *("image", "points", "tx", "ty", "tz", *QUATERNION, "rx", "ry", "rz", "rms_px", "p_wrong", "status"),
    *(f"cov_{ORDER[i]}_{ORDER[j]}" for i, j in _PAIRS),
)


@dataclass(frozen=True)
class Poses:
    """Poses by image, in order; why other images have none; the unit of all lengths ('m' or 'squares')."""

    frames: str
    unit: str
    estimates: Mapping[str, PoseEstimate]
    missing: Mapping[str, str]


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless poses can be written under this name."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"poses are written as {', '.join(SUFFIXES)}", where=str(path))


def write(path: Path, poses: Poses) -> None:
    """Write poses in the form the file's suffix says."""
    require_suffix(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        text = "\n".join(_csv_lines(poses)) + "\n"
    elif suffix == ".json":
        text = json.dumps(emit.rounded(document(poses)), indent=1, ensure_ascii=False) + "\n"
    else:
        text = emit.document(document(poses), _comment(poses))
    files.write_text(path, text)


def document(poses: Poses) -> dict[str, Any]:
    """Return poses as plain data."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "frames": poses.frames,
        "unit": poses.unit,
        "covariance_order": list(ORDER),
        "covariance_steps": STEPS,
        "noise": _noise(poses),
        "poses": [_block(image, estimate) for image, estimate in poses.estimates.items()],
        "missing": [{"image": image, "reason": reason} for image, reason in poses.missing.items()],
    }


def _noise(poses: Poses) -> dict[str, Any]:
    """Return the noise of a pixel coordinate, which all images share; without degrees of freedom where it was given."""
    estimate = next(iter(poses.estimates.values()))
    freedom = {} if estimate.freedom is None else {"degrees_of_freedom": estimate.freedom}
    return {"sigma_px": estimate.sigma_px, **freedom}


def _block(image: str, estimate: PoseEstimate) -> dict[str, Any]:
    block = {
        "image": image,
        "status": estimate.status,
        "points": estimate.used,
        "rms_px": estimate.rms_px,
        estimate.frames: _transform(estimate.transform),
        "std": np.sqrt(np.diag(estimate.covariance)).tolist(),
        "covariance": estimate.covariance.tolist(),
    }
    if (other := estimate.alternative) is not None:
        block["alternative"] = {
            estimate.frames: _transform(other.transform),
            "chi_square_difference": other.chi_square_difference,
            "probability": other.probability,
        }
    return block


def _transform(a_T_b: Pose) -> dict[str, Any]:
    quaternion = so3.to_quaternion(a_T_b.rotation).tolist()
    return {
        "translation": a_T_b.translation.tolist(),
        "quaternion": dict(zip(QUATERNION, quaternion, strict=True)),
        "rotation_vector": a_T_b.vector().tolist(),
    }


def _comment(poses: Poses) -> str:
    a, b = poses.frames.split("_T_")
    lengths = "metres" if poses.unit == "m" else poses.unit
    return f"camcal poses. Lengths: {lengths}; angles: radians. {poses.frames} takes points in {b} to points in {a}."


def _csv_lines(poses: Poses) -> Iterator[str]:
    noise = " ".join(f"{name}={value:.12g}" for name, value in _noise(poses).items())
    yield f"# {FORMAT} {VERSION} frames={poses.frames} unit={poses.unit} {noise}"
    yield ",".join(_COLUMNS)
    for image, estimate in poses.estimates.items():
        pose = estimate.transform
        numbers = [*pose.translation, *so3.to_quaternion(pose.rotation), *pose.vector()]
        numbers += [estimate.rms_px, estimate.p_wrong]
        texts = [f"{number:.12g}" for number in numbers]
        covariance = [f"{estimate.covariance[pair]:.12g}" for pair in _PAIRS]
        yield ",".join([cell(image), str(estimate.used), *texts, cell(estimate.status), *covariance])
    for image, reason in poses.missing.items():
        yield f"# none {cell(image)},{cell(' '.join(reason.split()))}"
