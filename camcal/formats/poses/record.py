"""A pose file: poses by image and object, what is known of each, why others are missing; the same as plain data."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import FloatArray, readonly
from camcal.dataclass import dataclass, field, replace
from camcal.estimate.poses.records import Alternative
from camcal.formats.covariance import ORDER, QUATERNION, STEPS, why_no_covariance
from camcal.formats.documents import Check, Document, Fault, child
from camcal.formats.native import NAME
from camcal.formats.schema import (
    COVARIANCE_OF_POSE,
    STATISTIC,
    STD,
    integer,
    items,
    mapping,
    number,
    one_of,
    text,
    unchecked,
)
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, inverse_jacobian

FORMAT = "camcal-poses"
VERSION = 1
UNITS = ("m", "squares")
UNIT_LENGTH = 1e-6  # how far the length of a quaternion may be from 1

_FIGURES = ("planarity", "least_depth", "image_share", "condition")
_COVARIANCES = ("covariance", "covariance_noise")
_FIT = {"rms_px": number(0), "max_px": number(0), "n_points": integer(0), "n_inliers": integer(0)}
_TRANSFORM = mapping(
    {
        "translation": items(number(), 3),
        "quaternion": mapping(dict.fromkeys(QUATERNION, number(-1.1, 1.1))),
    },
    {"rotation_vector": items(number(), 3)},
)


class PoseKey(NamedTuple):
    """An object in an image; its name is empty where a run knows one object only."""

    image: str
    object: str = ""

    def __str__(self) -> str:
        return f"{self.image}, {self.object}" if self.object else self.image


@dataclass(frozen=True, eq=False)
class PoseRecord:
    """A pose, its uncertainty and how well it fits.

    covariance, noise_covariance: (6, 6), of everything that is known to be uncertain, and of the pixels' noise alone;
    order tx ty tz rx ry rz, R ← Exp(δr) R, t ← t + δt. p_wrong: probability that one of the alternatives, the likeliest
    of which comes first, is the true pose. error_ratio: RMS of this pose over that of the likeliest of them.
    n_points, n_inliers: points, and those that the pose follows from. outliers: ids of the rest. rms_px, max_px: of the
    inliers' residuals. planarity: smallest over largest spread of the points. least_depth: of the nearest point.
    tilt_rad: between the plane's normal and the line of sight. image_share: of the image that the points span.
    condition: of the scaled normal matrix. What is None does not apply.
    """

    transform: Pose
    covariance: FloatArray
    noise_covariance: FloatArray
    status: str
    rms_px: float
    max_px: float
    n_points: int
    n_inliers: int
    p_wrong: float = 0.0
    error_ratio: float | None = None
    alternatives: tuple[Alternative, ...] = ()
    outliers: tuple[int, ...] = ()
    planarity: float | None = None
    least_depth: float | None = None
    tilt_rad: float | None = None
    image_share: float | None = None
    condition: float | None = None

    def __post_init__(self) -> None:
        for name in ("covariance", "noise_covariance"):
            object.__setattr__(self, name, readonly(getattr(self, name), (6, 6), name))

    @property
    def std(self) -> FloatArray:
        """The standard deviations (6,) of the pose's steps."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def inverse(self) -> "PoseRecord":
        """Return the same estimate of the transform in the other direction."""
        jacobian = inverse_jacobian(self.transform)
        return replace(
            self,
            transform=self.transform.inverse(),
            covariance=jacobian @ self.covariance @ jacobian.T,
            noise_covariance=jacobian @ self.noise_covariance @ jacobian.T,
            alternatives=tuple(other.inverse() for other in self.alternatives),
        )


@dataclass(frozen=True)
class PixelNoise:
    """The standard deviation of a pixel coordinate, root mean square over all that poses follow from.

    scale: that over what the pixels came with, None if they came with nothing. degrees_of_freedom: of its estimation,
    None where it was given.
    """

    sigma_px: float
    scale: float | None = None
    degrees_of_freedom: int | None = None


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses by image and object, in order, and why others have none.

    frames: what every transform maps, such as camera_T_object, which takes points of the object to the camera.
    unit: of all lengths, 'm' or 'squares'. noise: of the pixels.
    """

    frames: str
    unit: str
    noise: PixelNoise
    estimates: Mapping[PoseKey, PoseRecord]
    missing: Mapping[PoseKey, str] = field(default_factory=dict)

    @property
    def of_object(self) -> bool:
        """Whether the transforms take points of the object to the camera or rig, not the other way."""
        return self.frames.endswith("_T_object")

    def position(self, record: PoseRecord) -> FloatArray:
        """Return where the camera or rig stands (3,) in the object's frame."""
        return record.transform.inverse().translation if self.of_object else record.transform.translation

    def inverse(self) -> "Poses":
        """Return the same poses in the other direction."""
        estimates = {pose_key: record.inverse() for pose_key, record in self.estimates.items()}
        return replace(self, frames="_T_".join(reversed(self.frames.split("_T_"))), estimates=estimates)


def document(poses: Poses) -> dict[str, Any]:
    """Return poses as plain data."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "frames": poses.frames,
        "unit": poses.unit,
        "covariance_order": list(ORDER),
        "covariance_steps": STEPS,
        "noise": {name: value for name, value in vars(poses.noise).items() if value is not None},
        "poses": [_block(poses, pose_key, record) for pose_key, record in poses.estimates.items()],
        "missing": [_named(pose_key) | {"reason": reason} for pose_key, reason in poses.missing.items()],
    }


def _named(pose_key: PoseKey) -> dict[str, Any]:
    return {"image": pose_key.image} | ({"object": pose_key.object} if pose_key.object else {})


def _block(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> dict[str, Any]:
    return {
        **_named(pose_key),
        "status": record.status,
        poses.frames: _transform(record.transform),
        "position": poses.position(record).tolist(),
        "std": record.std.tolist(),
        "rms_px": record.rms_px,
        "max_px": record.max_px,
        "n_points": record.n_points,
        "n_inliers": record.n_inliers,
        "outliers": list(record.outliers),
        "p_wrong": record.p_wrong,
        **({} if record.error_ratio is None else {"error_ratio": record.error_ratio}),
        "alternatives": [_alternative(poses.frames, other) for other in record.alternatives],
        **{name: value for name in _FIGURES if (value := getattr(record, name)) is not None},
        **({} if record.tilt_rad is None else {"view_angle_deg": math.degrees(record.tilt_rad)}),
        "covariance": record.covariance.tolist(),
        "covariance_noise": record.noise_covariance.tolist(),
    }


def _alternative(frames: str, other: Alternative) -> dict[str, Any]:
    covariances = {"covariance": other.covariance, "covariance_noise": other.noise_covariance}
    return {
        frames: _transform(other.transform),
        "dchi2": other.chi_square_difference,
        "probability": other.probability,
        **{name: matrix.tolist() for name, matrix in covariances.items() if matrix is not None},
    }


def _transform(a_T_b: Pose) -> dict[str, Any]:
    quaternion = so3.to_quaternion(a_T_b.rotation).tolist()
    return {
        "translation": a_T_b.translation.tolist(),
        "quaternion": dict(zip(QUATERNION, quaternion, strict=True)),
        "rotation_vector": a_T_b.vector().tolist(),
    }


def check(data: Any, path: str = "") -> Iterator[Fault]:
    """Check the data of a pose file."""
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        yield Fault("format" if "format" in data else "", f"not a pose file of camcal: 'format: {FORMAT}' is missing")
        return
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        yield Fault("version", f"version {version} is newer than this camcal (reads {VERSION}); upgrade camcal")
        return
    faults = list(check_frames(data.get("frames"), "frames"))
    yield from faults
    yield from _FILE(data, path)
    if not faults:
        yield from _check_poses(data.get("poses", []), "poses", str(data["frames"]))


def check_frames(value: Any, path: str) -> Iterator[Fault]:
    """Check the name of a transform between an object and a camera or rig."""
    parts = value.split("_T_") if isinstance(value, str) else []
    if len(parts) != 2 or "object" not in parts or not all(map(NAME.match, parts)):
        yield Fault(path, f"{value!r} is not camera_T_object or object_T_camera")


def _pose_block(frames: str) -> Check:
    covariances = dict.fromkeys(_COVARIANCES, COVARIANCE_OF_POSE)
    alternative = mapping({frames: _TRANSFORM, "dchi2": STATISTIC, "probability": number(0, 1)}, covariances)
    return mapping(
        {"image": text, "status": text, frames: _TRANSFORM, "covariance": COVARIANCE_OF_POSE, **_FIT},
        {
            "object": text,
            "position": items(number(), 3),
            "std": items(STD, 6),
            "outliers": items(integer()),
            "p_wrong": number(0, 1),
            "error_ratio": STATISTIC,
            "alternatives": items(alternative),
            "view_angle_deg": number(0, 180),
            "covariance_noise": COVARIANCE_OF_POSE,
            **dict.fromkeys(_FIGURES, STATISTIC),
        },
    )


def _only(wanted: Any) -> Check:
    """Return a check for the one value that is supported."""

    def check(value: Any, path: str) -> Iterator[Fault]:
        if value != wanted:
            yield Fault(path, f"{value!r} is not supported; use {wanted!r}")

    return check


_FILE = mapping(
    {
        "format": text,
        "version": integer(1),
        "frames": unchecked,
        "unit": one_of(UNITS, "unit"),
        "noise": mapping({"sigma_px": number(0)}, {"scale": number(0), "degrees_of_freedom": integer(0)}),
        "poses": unchecked,
    },
    {
        "covariance_order": _only(list(ORDER)),
        "covariance_steps": _only(STEPS),
        "missing": items(mapping({"image": text, "reason": text}, {"object": text})),
    },
)


def _check_poses(blocks: Any, path: str, frames: str) -> Iterator[Fault]:
    if not isinstance(blocks, list):
        yield Fault(path, "a list of poses is needed")
        return
    whole, seen = _pose_block(frames), set()
    for index, block in enumerate(blocks):
        place = child(path, index)
        faults = list(whole(block, place)) or list(_check_block(block, place, frames))
        yield from faults
        if not faults and (pose_key := _sight(block)) in seen:
            yield Fault(place, f"{pose_key} occurs twice")
        elif not faults:
            seen.add(pose_key)


def _check_block(block: Mapping[str, Any], path: str, frames: str) -> Iterator[Fault]:
    """Check what no single value shows: lengths of quaternions, and whether covariances are some."""
    others = child(path, "alternatives")
    alternatives = [(child(others, index), other) for index, other in enumerate(block.get("alternatives", []))]
    for place, holder in [(path, block), *alternatives]:
        length = math.hypot(*holder[frames]["quaternion"].values())
        if abs(length - 1) > UNIT_LENGTH:
            yield Fault(child(place, f"{frames}.quaternion"), f"has length {length:.6g}, not 1")
        for name in _COVARIANCES:
            reason = why_no_covariance(np.array(holder[name], dtype=float)) if name in holder else None
            if reason:
                yield Fault(child(place, name), reason)


def from_document(data: Document) -> Poses:
    """Return the poses of data that has passed `check`."""
    frames = data["frames"]
    noise = data["noise"]
    scale = noise.get("scale")
    return Poses(
        frames,
        data["unit"],
        PixelNoise(float(noise["sigma_px"]), None if scale is None else float(scale), noise.get("degrees_of_freedom")),
        {_sight(block): _record(block, frames) for block in data["poses"]},
        {_sight(block): block["reason"] for block in data.get("missing", [])},
    )


def _sight(block: Mapping[str, Any]) -> PoseKey:
    return PoseKey(block["image"], block.get("object", ""))


def _record(block: Mapping[str, Any], frames: str) -> PoseRecord:
    angle = block.get("view_angle_deg")
    return PoseRecord(
        _pose(block[frames]),
        block["covariance"],
        noise_covariance=block.get("covariance_noise", block["covariance"]),
        status=block["status"],
        rms_px=float(block["rms_px"]),
        max_px=float(block["max_px"]),
        n_points=block["n_points"],
        n_inliers=block["n_inliers"],
        p_wrong=float(block.get("p_wrong", 0.0)),
        error_ratio=float(block["error_ratio"]) if "error_ratio" in block else None,
        alternatives=tuple(_read_alternative(other, frames) for other in block.get("alternatives", [])),
        outliers=tuple(block.get("outliers", [])),
        tilt_rad=None if angle is None else math.radians(angle),
        **{name: float(block[name]) for name in _FIGURES if name in block},
    )


def _read_alternative(block: Mapping[str, Any], frames: str) -> Alternative:
    covariances = [block.get(name) for name in _COVARIANCES]
    return Alternative(_pose(block[frames]), float(block["dchi2"]), float(block["probability"]), *covariances)


def _pose(block: Mapping[str, Any]) -> Pose:
    return Pose(so3.from_quaternion(np.array([block["quaternion"][name] for name in QUATERNION])), block["translation"])
