"""Rigid poses, single, over time or named by frames: `a_T_b` takes coordinates in frame b to coordinates in a.

Directions of the axes of a frame: from text such as "x forward, y left, z up", and by names of programs.
"""

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Generic, TypeVar

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.records import Brief

_IDENTITY = np.eye(3)
JOINT = "_T_"
Key = TypeVar("Key")


@dataclass(frozen=True, eq=False)
class Pose(Brief):
    """A rotation (3, 3) and a translation (3,): p_a = rotation @ p_b + translation."""

    rotation: FloatArray
    translation: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", readonly(self.rotation, (3, 3), "rotation"))
        object.__setattr__(self, "translation", readonly(self.translation, (3,), "translation"))
        error = np.abs(self.rotation @ self.rotation.T - _IDENTITY).max()
        if not error < 1e-6 or _determinant(self.rotation) < 0:
            raise InvalidInput(f"not a rotation (orthonormality error {error:.1e}); see nearest()")

    @classmethod
    def identity(cls) -> "Pose":
        """Return the pose that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_vector(cls, rotation_vector: Array, translation: Array) -> "Pose":
        """Return the pose of a rotation vector (3,) in radians and a translation (3,)."""
        return cls(so3.exp(np.asarray(rotation_vector, dtype=float)), translation)

    @classmethod
    def from_matrix(cls, matrix: Array) -> "Pose":
        """Return the pose of a homogeneous matrix (4, 4), or (3, 4)."""
        matrix = np.asarray(matrix, dtype=float)
        if matrix.shape not in ((4, 4), (3, 4)) or (matrix[3:] != [0, 0, 0, 1]).any():
            raise InvalidInput(f"not a homogeneous matrix (4, 4) with the last row 0 0 0 1: shape {matrix.shape}")
        return cls(matrix[:3, :3], matrix[:3, 3])

    def __repr__(self) -> str:
        """Return the translation and the rotation vector."""
        shift, turn = (", ".join(f"{value:.6g}" for value in own) for own in (self.translation, self.vector()))
        return f"Pose(translation=({shift}) m, rotation_vector=({turn}) rad)"

    def __matmul__(self, other: "Pose") -> "Pose":
        """Return a_T_c from a_T_b @ b_T_c."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def inverse(self) -> "Pose":
        """Return b_T_a from a_T_b."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: Array) -> FloatArray:
        """Return points (..., 3) given in b in the coordinates of a."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def vector(self) -> FloatArray:
        """Return the rotation vector (3,) in radians."""
        return so3.log(self.rotation)

    def matrix(self) -> FloatArray:
        """Return the homogeneous matrix (4, 4)."""
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.rotation, self.translation
        return result

    def retract(self, step: Array) -> "Pose":
        """Return the pose moved by a step (6,) in the order tx ty tz rx ry rz: R ← Exp(δr) R, t ← t + δt."""
        rotation, translation = retract(self.rotation, self.translation, step)
        return Pose(rotation, translation)


def _determinant(matrix: Array) -> float:
    """Return the determinant of a matrix (3, 3): numpy's takes several times as long for one."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def retract(rotation: Array, translation: Array, step: Array) -> tuple[Array, Array]:
    """Return rotations (..., 3, 3) and translations (..., 3) moved by steps (..., 6), order tx ty tz rx ry rz."""
    return so3.exp(step[..., 3:]) @ rotation, translation + step[..., :3]


def point_jacobian(rotated: Array) -> Array:
    """Return d(R p + t)/d(step) as (..., 3, 6) from the rotated points R p (..., 3), before the translation."""
    result = np.zeros((*rotated.shape, 6))
    result[..., :3] = np.eye(3)
    result[..., 3:] = -so3.hat(rotated)
    return result


def inverse_jacobian(a_T_b: Pose) -> Array:
    """Return d(step of b_T_a)/d(step of a_T_b) as (6, 6): it takes the covariance of a pose to that of its inverse."""
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = -a_T_b.rotation.T
    result[:3, 3:] = -a_T_b.rotation.T @ so3.hat(a_T_b.translation)
    return result


def compose_jacobians(a_T_b: Pose, b_T_c: Pose) -> tuple[Array, Array]:
    """Return d(step of a_T_c)/d(step of a_T_b) and d(step of a_T_c)/d(step of b_T_c), (6, 6) each.

    With covariances S and T of the two, that of a_T_b @ b_T_c is A S A.T + B T B.T, exact to first order.
    """
    first, second = np.eye(6), np.zeros((6, 6))
    first[:3, 3:] = -so3.hat(a_T_b.rotation @ b_T_c.translation)
    second[:3, :3] = second[3:, 3:] = a_T_b.rotation
    return first, second


@dataclass(frozen=True, eq=False)
class Trajectory(Brief):
    """Poses a_T_b at increasing times; `frames` is their name, such as object_T_camera.

    stamps: (N,) s. rotations: (N, 3, 3). translations: (N, 3), m. covariances: (N, 6, 6) of the poses' steps, order
    tx ty tz rx ry rz, m and rad, or None. velocities: (N, 6) m/s and rad/s, R' = hat(w) R, or None.
    segments: (N,) whole numbers that never fall, poses of one segment belong together; None: all do.
    Raises InvalidInput unless stamps increase and every rotation is one.
    """

    frames: str
    stamps: FloatArray
    rotations: FloatArray
    translations: FloatArray
    covariances: FloatArray | None = None
    velocities: FloatArray | None = None
    segments: IntArray | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {"stamps": (count,), "rotations": (count, 3, 3), "translations": (count, 3)}
        optional = {"covariances": (count, 6, 6), "velocities": (count, 6), "segments": (count,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        late = np.flatnonzero(~(np.diff(self.stamps) > 0))
        if len(late):
            raise InvalidInput(
                f"pose {late[0] + 1} at {self.stamps[late[0] + 1]:.9g} s is not later than the one before"
            )
        error = np.abs(self.rotations @ self.rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero(~((error < 1e-6) & (np.linalg.det(self.rotations) > 0)))
        if len(bad):
            raise InvalidInput(f"pose {bad[0]} has no rotation (orthonormality error {error[bad[0]]:.1e})")

    @classmethod
    def of(cls, frames: str, stamps: Array, poses: Sequence[Pose]) -> "Trajectory":
        """Return the trajectory of single poses."""
        rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
        return cls(frames, stamps, rotations, np.array([pose.translation for pose in poses]).reshape(-1, 3))

    def __len__(self) -> int:
        return len(self.stamps)

    def pose(self, index: int) -> Pose:
        """Return one of the poses."""
        return Pose(self.rotations[index], self.translations[index])

    def rows(self, chosen: Array) -> "Trajectory":
        """Return some of the poses, by their indices (M,), which increase, or a mask (N,)."""
        names = ("stamps", "rotations", "translations", "covariances", "velocities", "segments")
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{name: value[chosen] for name, value in values.items() if value is not None})


@dataclass(frozen=True, eq=False)
class NamedTransform(Brief):
    """target_T_source: takes coordinates in `source` to coordinates in `target`; both empty where they have no names.

    covariance: (6, 6) of the pose's step, order tx ty tz rx ry rz, m and rad; None: not known. where: it stands.
    cross: (6, 6) covariances of the step with those of other transforms, by where these stand, as far as they are not
    independent.
    """

    target: str
    source: str
    pose: Pose
    covariance: FloatArray | None = None
    where: str = ""
    cross: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "covariance"))

    @property
    def name(self) -> str:
        """The name a_T_b, empty without the frames' names."""
        return f"{self.target}{JOINT}{self.source}" if self.target and self.source else ""

    @property
    def called(self) -> str:
        """The name, or else where the transform stands."""
        return self.name or self.where

    def inverse(self) -> "NamedTransform":
        """Return source_T_target."""
        return replace(
            self,
            target=self.source,
            source=self.target,
            pose=self.pose.inverse(),
            covariance=carried(inverse_jacobian(self.pose), self.covariance),
            cross={},
        )


def frames_of(name: str) -> tuple[str, str]:
    """Return the frames (a, b) of a name a_T_b; raises InvalidInput if it is none."""
    target, joint, source = name.partition(JOINT)
    if not (joint and target and source) or JOINT in source:
        raise InvalidInput(f"{name!r} is not a transform name such as a_T_b (takes points in b to points in a)")
    return target, source


def carried(jacobian: Array, covariance: Array | None) -> Array | None:
    """Return the covariance (n, n) of what follows another quantity with a Jacobian (n, m), None if none is known."""
    return None if covariance is None else np.asarray(jacobian @ covariance @ jacobian.T)


@dataclass(frozen=True, eq=False)
class Derived(Generic[Key]):
    """A pose made of others, and the derivatives (6, 6) of its step by theirs, by the key of each.

    A transform that occurs twice is one quantity, not two: a_T_b @ a_T_b.inverse() is certain, whatever a_T_b is.
    """

    pose: Pose
    by: Mapping[Key, FloatArray]

    @classmethod
    def of(cls, key: Key, pose: Pose) -> "Derived[Key]":
        """Return a pose that stands for itself."""
        return cls(pose, {key: np.eye(6)})

    def __matmul__(self, other: "Derived[Key]") -> "Derived[Key]":
        """Return a_T_c from a_T_b @ b_T_c."""
        first, second = compose_jacobians(self.pose, other.pose)
        by = {key: first @ jacobian for key, jacobian in self.by.items()}
        for key, jacobian in other.by.items():
            by[key] = by.get(key, 0.0) + second @ jacobian
        return Derived(self.pose @ other.pose, by)

    def inverse(self) -> "Derived[Key]":
        """Return b_T_a from a_T_b."""
        jacobian = inverse_jacobian(self.pose)
        return Derived(self.pose.inverse(), {key: jacobian @ own for key, own in self.by.items()})

    def covariance(
        self, covariances: Mapping[Key, Array | None], cross: Mapping[tuple[Key, Key], Array] = MappingProxyType({})
    ) -> FloatArray | None:
        """Return the covariance (6, 6), to first order, from those of the poses it is made of.

        None counts as exact; where no pose has a covariance, the result has none. cross: (6, 6) those of two poses,
        in both orders; poses without are independent.
        """
        parts = [carried(jacobian, covariances.get(key)) for key, jacobian in self.by.items()]
        known = [part for part in parts if part is not None]
        both = [self.by[one] @ own @ self.by[other].T for (one, other), own in cross.items()]
        return np.sum([*known, *both], axis=0) if known else None

    def covariance_of(self, factors: Mapping[Key, NamedTransform]) -> FloatArray | None:
        """Return the covariance (6, 6) from the transforms it is made of and what they have in common."""
        used = {key: factors[key] for key in self.by if factors[key].covariance is not None}
        cross = {
            (one, other): used[one].cross[used[other].where]
            for one in used
            for other in used
            if one != other and used[other].where in used[one].cross
        }
        return self.covariance({key: item.covariance for key, item in used.items()}, cross)


_AXES = re.compile(r"\bx (\w+), y (\w+), z (\w+)")
_DIRECTIONS = {
    **dict.fromkeys(("right", "east"), (1, 0, 0)),
    **dict.fromkeys(("left", "west"), (-1, 0, 0)),
    **dict.fromkeys(("forward", "north"), (0, 0, 1)),
    **dict.fromkeys(("back", "backward", "south"), (0, 0, -1)),
    "down": (0, 1, 0),
    "up": (0, -1, 0),
}


@dataclass(frozen=True)
class Axes:
    """A habit of pointing axes. pixel_centre: where the centre of the top-left pixel is, None without pixels."""

    name: str
    words: str
    pixel_centre: float | None = None

    @property
    def directions(self) -> Array:
        """The matrix (3, 3) from these axes to x right, y down, z forward; its determinant is -1 if left-handed."""
        return _matrix(self.words)

    @property
    def left_handed(self) -> bool:
        """Whether x, y, z are those of the left hand."""
        return bool(np.linalg.det(self.directions) < 0)


CONVENTIONS = MappingProxyType(
    {
        axes.name: axes
        for axes in (
            Axes("opencv", "x right, y down, z forward", 0.0),
            Axes("colmap", "x right, y down, z forward", 0.5),
            Axes("ros_optical", "x right, y down, z forward", 0.0),  # REP 103, frames that end in _optical
            Axes("opengl", "x right, y up, z backward"),
            Axes("blender", "x right, y up, z backward"),
            Axes("nerf", "x right, y up, z backward", 0.5),  # transforms.json of nerfstudio and instant-ngp
            Axes("unity", "x right, y up, z forward"),
            Axes("ros", "x forward, y left, z up"),  # REP 103
            Axes("enu", "x east, y north, z up"),
            Axes("ned", "x north, y east, z down"),
        )
    }
)


def convention_named(name: str) -> Axes:
    """Return the convention of a name; raises InvalidInput for an unknown one."""
    if name not in CONVENTIONS:
        raise InvalidInput(f"axes {name!r} are unknown; use one of {', '.join(CONVENTIONS)}")
    return CONVENTIONS[name]


def rotation_of(frame: str) -> Array:
    """Return the rotation (3, 3) from a frame described in words to x right, y down, z forward.

    East counts as right and north as forward. A frame that says nothing of its axes, or not three that are at right
    angles and right-handed, is taken for that of a camera.
    """
    matrix = _matrix(frame)
    return matrix if np.isclose(np.linalg.det(matrix), 1.0) else np.eye(3)


def _matrix(words: str) -> Array:
    found = _AXES.search(words)
    if found is None or not all(word in _DIRECTIONS for word in found.groups()):
        return np.eye(3)
    return np.array([_DIRECTIONS[word] for word in found.groups()], dtype=np.float64).T


def change(before: Axes, after: Axes) -> Array:
    """Return the matrix (3, 3) of 0, 1 and -1 that takes coordinates along the axes before to those after."""
    return np.asarray(after.directions.T @ before.directions)


def reexpress(a_T_b: Pose, change_a: Array, change_b: Array) -> Pose:
    """Return the pose between the same two frames with other axes: a is changed by a matrix (3, 3), b by another.

    Raises InvalidInput if one changes the hand and the other does not: no rotation joins them.
    """
    if np.linalg.det(change_a) * np.linalg.det(change_b) < 0:
        raise InvalidInput("one frame would be left-handed and the other right-handed: change the axes of both")
    return Pose(change_a @ a_T_b.rotation @ change_b.T, change_a @ a_T_b.translation)


def reexpress_jacobian(change_a: Array) -> Array:
    """Return d(step after)/d(step before) as (6, 6) where frame a of a_T_b is changed by a matrix (3, 3).

    A turn is an axial vector: a mirror reverses it once more than a translation.
    """
    result = np.zeros((6, 6))
    result[:3, :3] = change_a
    result[3:, 3:] = np.linalg.det(change_a) * change_a
    return result
