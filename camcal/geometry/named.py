"""Transforms with the names of their frames, and what is made of them with its covariance."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose, compose_jacobians, inverse_jacobian

JOINT = "_T_"

Key = TypeVar("Key")


@dataclass(frozen=True, eq=False)
class NamedTransform:
    """target_T_source: takes coordinates in `source` to coordinates in `target`; both empty where they have no names.

    covariance: (6, 6) of the pose's step, order tx ty tz rx ry rz, m and rad; None: not known. where: it stands.
    """

    target: str
    source: str
    pose: Pose
    covariance: Array | None = None
    where: str = ""

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
        )


def frames_of(name: str) -> tuple[str, str]:
    """Return the frames (a, b) of a name a_T_b; raises InvalidInput if it is none."""
    target, joint, source = name.partition(JOINT)
    if not (joint and target and source) or JOINT in source:
        raise InvalidInput(f"{name!r} is no transform; write a_T_b, which takes points in b to points in a")
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
    by: Mapping[Key, Array]

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

    def covariance(self, covariances: Mapping[Key, Array | None]) -> Array | None:
        """Return the covariance (6, 6), to first order, from those of the poses it is made of, which are independent.

        None counts as exact; where no pose has a covariance, the result has none.
        """
        parts = [carried(jacobian, covariances.get(key)) for key, jacobian in self.by.items()]
        known = [part for part in parts if part is not None]
        return np.sum(known, axis=0) if known else None
