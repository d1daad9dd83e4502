"""Errors of a trajectory against a reference: absolute and relative error.

Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, 2012; Umeyama, Least-squares estimation of
transformation parameters between two point patterns, 1991. Pairs and defaults are those of evo, so that numbers agree.
"""

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass, field
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.records import Brief, entry

ALIGNMENTS = ("none", "se3", "sim3", "yaw")
UNITS = ("frames", "m", "s")

_TOLERANCE = 0.1  # of a distance: how far a pair's may be from it when all pairs are taken
_FLAT = 1e-12  # singular value of positions on a line, relative to the largest


@dataclass(frozen=True)
class ErrorFigures:
    """Root mean square, mean, median, standard deviation, least and largest of errors, in m or rad."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float

    @classmethod
    def of(cls, errors: Array) -> "ErrorFigures":
        """Return the figures of errors (N,)."""
        values = (
            np.sqrt(np.mean(errors**2)),
            np.mean(errors),
            np.median(errors),
            np.std(errors),
            errors.min(),
            errors.max(),
        )
        return cls(*map(float, values))


@dataclass(frozen=True, eq=False)
class Similarity:
    """A rotation (3, 3), a translation (3,) and a scale: p' = scale R p + t."""

    rotation: FloatArray
    translation: FloatArray
    scale: float = 1.0

    def apply(self, trajectory: Trajectory) -> Trajectory:
        """Return the trajectory in the frame this leads to; covariances and velocities are left out."""
        return Trajectory(
            trajectory.frames,
            trajectory.stamps,
            self.rotation @ trajectory.rotations,
            self.scale * trajectory.translations @ self.rotation.T + self.translation,
        )


@dataclass(frozen=True, eq=False)
class TrajectoryError:
    """A trajectory compared with its reference.

    poses: how many were compared. alignment: what took the estimate to the reference. translation, rotation: absolute
    errors (m, rad) of the aligned poses. relative_translation, relative_rotation: those of motions over `delta`, or
    None if no two poses are so far apart. pairs: how many motions.
    """

    poses: int
    alignment: Similarity
    translation: ErrorFigures = field(metadata=entry("ate_m"))
    rotation: ErrorFigures = field(metadata=entry("ate_rad"))
    relative_translation: ErrorFigures | None = field(metadata=entry("rpe_m"))
    relative_rotation: ErrorFigures | None = field(metadata=entry("rpe_rad"))
    pairs: int


def _require_alignment(kind: str) -> None:
    if kind not in ALIGNMENTS:
        raise InvalidInput(f"alignment {kind!r}: use one of {', '.join(ALIGNMENTS)}")


def _require_motion(delta: float, unit: str) -> None:
    if unit not in UNITS or not 0 < delta < np.inf:
        raise InvalidInput(f"motions over {delta:g} {unit}: a positive number of {', '.join(UNITS)} is needed")
    if unit == "frames" and delta != int(delta):
        raise InvalidInput(f"motions over {delta:g} frames: a whole number of frames is needed, or metres or seconds")


@dataclass(frozen=True)
class ErrorOptions(Brief):
    """How to compare: alignment of ALIGNMENTS; motions over `delta` in a unit of UNITS.

    all_pairs: motions begin at every pose, not where the one before ended. max_difference: of stamps that belong
    together, s. Raises InvalidInput for anything else.
    """

    alignment: str = "se3"
    delta: float = 1.0
    unit: str = "frames"
    all_pairs: bool = False
    max_difference: float = 0.01

    def __post_init__(self) -> None:
        _require_alignment(self.alignment)
        _require_motion(self.delta, self.unit)


def trajectory_error(
    estimate: Trajectory, reference: Trajectory, options: ErrorOptions = ErrorOptions()
) -> TrajectoryError:
    """Return how far an estimate is from a reference of the same pose.

    Raises InsufficientData if less than two stamps agree, or the positions do not determine the alignment.
    """
    compared, truth, alignment = aligned(estimate, reference, options)
    first, second = pairs(compared, options.delta, options.unit, options.all_pairs)
    moved, turned = _motions(compared, first, second)
    truly_moved, truly_turned = _motions(truth, first, second)
    shift, turn = np.linalg.norm(moved - truly_moved, axis=1), so3.angle_between(truly_turned, turned)
    return TrajectoryError(
        len(compared),
        alignment,
        translation=ErrorFigures.of(np.linalg.norm(compared.translations - truth.translations, axis=1)),
        rotation=ErrorFigures.of(so3.angle_between(truth.rotations, compared.rotations)),
        relative_translation=ErrorFigures.of(shift) if len(first) else None,
        relative_rotation=ErrorFigures.of(turn) if len(first) else None,
        pairs=len(first),
    )


def aligned(
    estimate: Trajectory, reference: Trajectory, options: ErrorOptions = ErrorOptions()
) -> tuple[Trajectory, Trajectory, Similarity]:
    """Return the poses of an estimate that have one in the reference, aligned, these, and the alignment.

    Raises as `trajectory_error`.
    """
    of_estimate, of_reference = associate(estimate.stamps, reference.stamps, options.max_difference)
    if len(of_estimate) < 2:
        raise InsufficientData(
            f"{len(of_estimate)} stamps agree within {options.max_difference:g} s: check that both use one clock"
        )
    compared, truth = estimate.rows(of_estimate), reference.rows(of_reference)
    alignment = align(compared.translations, truth.translations, options.alignment)
    return alignment.apply(compared), truth, alignment


def associate(first: Array, second: Array, max_difference: float) -> tuple[Array, Array]:
    """Return the indices of stamps (M,) and (N,) that belong together: every stamp of the fewer with its nearest."""
    if len(second) < len(first):
        of_second, of_first = associate(second, first, max_difference)
        return of_first, of_second
    after = np.clip(np.searchsorted(second, first, side="right"), 1, len(second) - 1)
    nearest = np.where(np.abs(second[after] - first) < np.abs(first - second[after - 1]), after, after - 1)
    near = np.abs(second[nearest] - first) <= max_difference
    return np.flatnonzero(near), nearest[near]


def align(positions: Array, reference: Array, kind: str) -> Similarity:
    """Return what takes positions (N, 3) to reference positions (N, 3) with the least squared error.

    kind: none; se3, a rotation and a translation; sim3, with scale; yaw, a rotation about z and a translation.
    Raises InsufficientData if they lie on a line, about which any rotation is as good.
    """
    if kind == "none":
        return Similarity(np.eye(3), np.zeros(3))
    _require_alignment(kind)
    middle, target = positions.mean(axis=0), reference.mean(axis=0)
    cross = (reference - target).T @ (positions - middle) / len(positions)
    if kind == "yaw":
        rotation, scale = so3.about_z(float(np.arctan2(cross[1, 0] - cross[0, 1], cross[0, 0] + cross[1, 1]))), 1.0
        return Similarity(rotation, target - rotation @ middle)
    u, values, vt = np.linalg.svd(cross)
    if not values[1] > _FLAT * values[0]:
        raise InsufficientData("the positions lie on a line or a point: alignment none or yaw is possible")
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    variance = np.mean(np.sum((positions - middle) ** 2, axis=1))
    scale = float(np.sum(values * sign) / variance) if kind == "sim3" else 1.0
    return Similarity(rotation, target - scale * rotation @ middle, scale)


def pairs(trajectory: Trajectory, delta: float, unit: str, all_pairs: bool) -> tuple[Array, Array]:
    """Return the indices (M,) of poses where motions over `delta` begin and end.

    unit: frames, m along the way, or s. all_pairs: one from every pose, to that nearest to `delta` away (within 10 %);
    else each begins where the one before ended.
    """
    _require_motion(delta, unit)
    way = _way(trajectory, unit)
    if all_pairs:
        return _every_pair(way, delta, exact=unit == "frames")
    chosen = [0]
    while (index := int(np.searchsorted(way, way[chosen[-1]] + delta - 1e-12 * delta))) < len(way):
        chosen.append(index)
    return np.array(chosen[:-1], int), np.array(chosen[1:], int)


def _way(trajectory: Trajectory, unit: str) -> Array:
    """Return how far along every pose is, (N,), from the first."""
    if unit == "frames":
        return np.arange(len(trajectory), dtype=float)
    if unit == "s":
        return np.asarray(trajectory.stamps - trajectory.stamps[0])
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(trajectory.translations, axis=0), axis=1)))


def _every_pair(way: Array, delta: float, exact: bool) -> tuple[Array, Array]:
    first = np.arange(len(way) - 1)
    after = np.searchsorted(way, way[first] + delta)
    before = np.clip(after - 1, first + 1, len(way) - 1)
    after = np.clip(after, first + 1, len(way) - 1)
    miss = np.abs(way[[before, after]] - way[first] - delta)
    second = np.where(miss[0] <= miss[1], before, after)
    good = miss.min(axis=0) <= (1e-9 if exact else _TOLERANCE * delta)
    return first[good], second[good]


def _motions(poses: Trajectory, first: Array, second: Array) -> tuple[Array, Array]:
    back = np.swapaxes(poses.rotations[first], 1, 2)
    moved = poses.translations[second] - poses.translations[first]
    return (back @ moved[:, :, None])[:, :, 0], back @ poses.rotations[second]
