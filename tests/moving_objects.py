"""Moving objects as single frames see them, for tests of what follows them: no pixels, poses with known noise."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses.records import Alternative
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, Trajectory

NOISE = np.array([0.002, 0.002, 0.006, 0.02, 0.02, 0.01])  # m and rad: of a small tag a metre away


@dataclass(frozen=True, eq=False)
class Glance:
    """The pose of one frame, as `FramePose` has it."""

    transform: Pose
    covariance: Array
    noise_covariance: Array
    alternatives: tuple[Alternative, ...] = ()


def glances(
    truth: Trajectory,
    rng: np.random.Generator,
    *,
    dropped: float = 0.0,
    outliers: float = 0.0,
    mirrored: float = 0.0,
    scale: float = 1.0,
    common: Array | None = None,
) -> list[Glance | None]:
    """Return what frames see of a trajectory: noise as claimed times `scale`, and shares of frames that go wrong.

    mirrored: share of frames whose best candidate is the mirrored one, the true one being the alternative.
    common: a covariance (6, 6) of the lens that all share; it is claimed, not drawn.
    """
    covariance = np.diag(NOISE**2)
    seen: list[Glance | None] = []
    for index in range(len(truth)):
        true, wrong, missing, turned = rng.normal(size=6), *(rng.random(3) < (outliers, dropped, mirrored))
        pose = truth.pose(index).retract(
            scale * NOISE * true + wrong * rng.normal(size=6) * [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
        )
        other = Pose(pose.rotation @ so3.about_x(0.8), pose.translation)
        first, second = (other, pose) if turned else (pose, other)
        alternative = Alternative(second, 1.0, 0.4, covariance, covariance)
        total = covariance if common is None else covariance + common
        seen.append(None if missing else Glance(first, total, covariance, (alternative,) if mirrored else ()))
    return seen


def errors(truth: Trajectory, rotations: Array, translations: Array) -> Array:
    """Return the steps (N, 6) from the truth to poses."""
    turns = so3.log(rotations @ truth.rotations.swapaxes(-1, -2))
    return np.concatenate([translations - truth.translations, turns], axis=1)
