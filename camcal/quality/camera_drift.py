"""Whether a calibration still holds: what new views say of lenses and places against what it leaves open.

With the information A and the score y of new views (see calibrate/known_cameras.py) and the covariance S of the
calibration, y = A (change + error of the calibration) + noise has the covariance A + A S A where nothing has changed.
In the coordinates in which S is the identity and A has the eigenvalues l, each y² / (l + l²) is then chi square.
"""

from math import inf, sqrt

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, readonly
from camcal.calibrate.known_cameras import KnownCamera, NewViews, changes
from camcal.cameras.directions import GRID, camera_axes, direction_displacements, grid_pixels
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.geometry.pose import Pose
from camcal.quality.camera_comparison import CHANCE
from camcal.records import Brief
from camcal.solve.losses import variance_ratio_beyond

_LEAST = 0.1  # of what a calibration knows along a direction: less by new views tells nothing of a change
# With which the smallest drift that is stated would have been found, if none of it passed for errors within views: as
# some does, nine of ten are found.
_POWER = 0.97
# What cannot be chance: with so small a chance of it, or with a smaller drift that is so many times its own deviation.
_CERTAIN, _SIGMAS = 1e-5, 3.0
LEAST_PX, LEAST_STD = 0.5, 3.0  # px, and standard deviations of the calibration, of a drift that counts by default


@dataclass(frozen=True)
class Estimated:
    """A value and its standard deviation."""

    value: float
    std: float

    @property
    def sigmas(self) -> float:
        """The value in standard deviations, 0 for a value of 0."""
        return abs(self.value) / self.std if self.std > 0 else inf if self.value else 0.0

    def scaled(self, factor: float) -> "Estimated":
        """Return the same in another unit."""
        return Estimated(factor * self.value, factor * self.std)


@dataclass(frozen=True)
class Drift(Brief):
    """By how much projections have moved since a calibration.

    rms_px, worst_px: of the displacements. chance: of what the views show without any drift. smallest_px: RMS, the
    smallest drift that the views would have shown with a probability of 90 %. calibration_px: the standard deviation of
    a coordinate that the calibration leaves open, RMS.
    """

    rms_px: Estimated
    worst_px: Estimated
    chance: float
    smallest_px: float
    calibration_px: float

    def limit(self, most: float | None) -> float:
        """Return the drift (px) that is one: `most`, or by default what matters and a calibration would show."""
        return max(LEAST_PX, LEAST_STD * self.calibration_px) if most is None else most

    def beyond(self, most: float | None) -> bool:
        """Return whether there is a drift of more than `most`, as in `limit`, that is no chance."""
        shown = self.chance < _CERTAIN or (self.chance < CHANCE and self.rms_px.sigmas > _SIGMAS)
        return shown and self.rms_px.value > self.limit(most)


@dataclass(frozen=True, eq=False)
class LensDrift(Drift):
    """The drift of a lens over the part of the image in which its calibration holds, after the best rotation.

    focal: relative change of the focal length. shift: px of the principal point. distortion_px: RMS of what these two
    do not explain. u, v: (columns,), (rows,) of a grid over the image, px. moved: (N, 2) px the displacements of
    its pixels, std: (N,) px their standard deviations in the direction of the displacement; NaN where the lens is not
    valid. inside: (N,) bool, the part of the image.
    """

    focal: Estimated
    shift: tuple[Estimated, Estimated]
    distortion_px: float
    u: FloatArray
    v: FloatArray
    moved: FloatArray
    std: FloatArray
    inside: BoolArray

    def __post_init__(self) -> None:
        count = len(self.u) * len(self.v)
        object.__setattr__(self, "moved", readonly(self.moved, (count, 2), "moved"))
        object.__setattr__(self, "std", readonly(self.std, (count,), "std"))
        object.__setattr__(self, "inside", readonly(self.inside, (count,), "inside", bool))

    @property
    def pixels(self) -> FloatArray:
        """The pixels (N, 2) of the grid, row by row."""
        return grid_pixels(self.u, self.v)


@dataclass(frozen=True, eq=False)
class PlaceDrift(Drift):
    """The drift of where a camera stands, over the corners of the views.

    shift: (3,) m, turn: (3,) rad of camera_T_first with their standard deviations. scale: relative, the change of the
    distance that explains it alone, None where it does not.
    """

    shift: FloatArray
    shift_std: FloatArray
    turn: FloatArray
    turn_std: FloatArray
    scale: Estimated | None = None


def lens_drift(known: KnownCamera, found: NewViews, inside: BoolArray | None, views: float) -> LensDrift:
    """Return the drift of a camera by its views alone.

    inside: (N,) the pixels of the grid of `drift_grid` for which it is, None for all. views: of the calibration.
    """
    camera, free = known.camera, known.free
    chosen = np.ix_(free, free)
    covariance, prior = np.asarray(camera.covariance)[chosen], changes(camera)[chosen]
    information, score = found.information, found.score
    u, v = drift_grid(camera.image_size)
    pixels = grid_pixels(u, v)
    by_lens = direction_displacements(camera, pixels, inside)[:, :, free]
    valid = np.isfinite(by_lens).all(axis=(1, 2))
    over = np.asarray(valid if inside is None or not (valid & inside).any() else valid & inside)
    axes = _axes(camera)[free]
    axes = axes[:, np.any(axes != 0, axis=0)]
    # a lens of which only the distortion was estimated has none of them
    tested = [some for some in (axes, axes[:, :1]) if some.shape[1]]
    chances = [_along(information, score, covariance, some, views) for some in tested]
    chances.append(_chance(information, score, covariance, views))
    # the mean and the covariance of a change that lenses may undergo, given what is seen
    gain = prior @ np.linalg.inv(np.eye(len(free)) + information @ (prior + covariance))
    change, left = gain @ score, prior - gain @ information @ prior
    moved = by_lens @ change
    focal, *centre = (
        Estimated(float(row @ change), sqrt(max(float(row @ left @ row), 0.0))) for row in _rows(camera)[:, free]
    )
    return LensDrift(
        *_extent(by_lens[over], moved[over], left),
        chance=min(1.0, len(chances) * min(chances)),
        smallest_px=_smallest(information, covariance, axes[:, 0], by_lens[over], 1, CHANCE / len(chances))
        if tested
        else inf,
        calibration_px=_rms_std(by_lens[over], covariance),
        focal=focal,
        shift=(centre[0], centre[1]),
        distortion_px=_beyond_axes(camera, pixels[over], moved[over]),
        u=u,
        v=v,
        moved=moved,
        std=_std_along(by_lens, moved, left),
        inside=over,
    )


def place_drift(found: NewViews, covariance: Array, pose: Pose, views: float) -> PlaceDrift:
    """Return the drift of the second of two cameras, whose lenses are as they were.

    covariance: (D, D) of what the views tell of. pose: camera_T_first, as it was.
    """
    axes = np.eye(len(covariance))[:, found.starts[-1] :]
    total = np.linalg.inv(np.eye(len(covariance)) + found.information @ covariance)
    weight = axes.T @ total @ found.information @ axes
    left = np.linalg.inv((weight + weight.T) / 2)
    change = left @ (axes.T @ (total @ found.score))
    by_place = found.by_place.transpose(2, 0, 1)
    std = np.sqrt(np.diag(left))
    own = covariance[found.starts[-1] :, found.starts[-1] :]
    return PlaceDrift(
        *_extent(by_place, by_place @ change, left),
        chance=_along(found.information, found.score, covariance, axes, views),
        smallest_px=_smallest(found.information, covariance, axes[:, 4], by_place @ np.eye(6)[4:5].T, 6, CHANCE),
        calibration_px=_rms_std(by_place, own),
        shift=change[:3],
        shift_std=std[:3],
        turn=change[3:],
        turn_std=std[3:],
        scale=_scale(change, weight, pose, views),
    )


def drift_grid(image_size: tuple[int, int]) -> tuple[Array, Array]:
    """Return the columns and rows of pixels at which drifts are stated."""
    u, v = (np.linspace(0, side - 1, count) for side, count in zip(image_size, GRID, strict=True))
    return u, v


def _scale(change: Array, weight: Array, pose: Pose, views: float) -> Estimated | None:
    """Return the relative change of the distance of two cameras by which alone the change (6,) is explained."""
    away = np.concatenate([pose.translation, np.zeros(3)])
    along = float(away @ weight @ away)
    if along <= 0:
        return None
    value = float(away @ weight @ change) / along
    rest = change - value * away
    explained = _beyond(float(rest @ weight @ rest) / 5, 5, 0.5, views) > CHANCE
    found = Estimated(value, along**-0.5)
    return found if explained and found.sigmas > _SIGMAS else None


def _axes(camera: Camera) -> Array:
    """Return what a relative change of the focal length, and px by which the principal point moves, do to parameters
    (K, 3).
    """
    result = np.zeros((len(camera.parameters), 3))
    for place, name in enumerate(camera.model.parameter_names):
        if name in ("fx", "fy"):
            result[place, 0] = camera.parameters[place]
        elif name in ("cx", "cy"):
            result[place, 1 + ("cx", "cy").index(name)] = 1.0
    return result


def focal_axis(camera: Camera) -> Array:
    """Return what a relative change of the focal length does to the parameters (K,)."""
    return _axes(camera)[:, 0]


def _rows(camera: Camera) -> Array:
    """Return the derivatives (3, K) of the relative focal length and of the principal point by the parameters."""
    axes = _axes(camera).T.copy()
    focal = axes[0] != 0
    axes[0, focal] = 1 / (axes[0, focal] * focal.sum())
    return axes


def _chance(information: Array, score: Array, covariance: Array, views: float) -> float:
    """Return the chance of what new views see, in the directions that they determine, without any change."""
    root = np.linalg.cholesky(covariance)
    known, along = np.linalg.eigh(root.T @ information @ root)
    chosen = known > _LEAST
    if not chosen.any():
        return 1.0
    known, seen = known[chosen], (along.T @ (root.T @ score))[chosen]
    squares = seen**2 / (known + known**2)
    return _beyond(float(squares.mean()), len(known), float(np.mean(known / (1 + known))), views)


def _along(information: Array, score: Array, covariance: Array, axes: Array, views: float) -> float:
    """Return the chance of the change along axes (D, m) that new views see, without any."""
    total = np.linalg.inv(np.eye(len(covariance)) + information @ covariance)
    weight, count = total @ information, axes.shape[1]
    seen, known = axes.T @ (total @ score), axes.T @ weight @ axes
    of_calibration = np.linalg.solve(known, axes.T @ weight @ covariance @ weight.T @ axes)
    ratio = float(seen @ np.linalg.solve(known, seen)) / count
    return _beyond(ratio, count, float(np.trace(of_calibration)) / count, views)


def _beyond(ratio: float, dof: int, share: float, views: float) -> float:
    """Return the chance of a larger mean square; share: of its expectation that is the calibration's, of so many views.

    Source: Satterthwaite 1946, for a variance of which a part is estimated.
    """
    return variance_ratio_beyond(ratio, dof, max(views - 1, 1) / max(share, 1e-9) ** 2)


def _extent(by: Array, moved: Array, covariance: Array) -> tuple[Estimated, Estimated]:
    """Return the RMS and the largest length of displacements (N, 2), whose derivatives are (N, 2, F)."""
    lengths = np.linalg.norm(moved, axis=1)
    rms, place = float(np.sqrt(np.mean(lengths**2))), int(np.argmax(lengths))
    if rms == 0:
        return Estimated(0.0, 0.0), Estimated(0.0, 0.0)
    along = np.einsum("nif,ni->f", by, moved) / (len(moved) * rms)
    worst = by[place].T @ (moved[place] / lengths[place])
    std = [sqrt(max(float(row @ covariance @ row), 0.0)) for row in (along, worst)]
    return Estimated(rms, std[0]), Estimated(float(lengths[place]), std[1])


def _std_along(by: Array, moved: Array, covariance: Array) -> Array:
    """Return the standard deviations (N,) of displacements (N, 2) in their own direction."""
    lengths = np.linalg.norm(moved, axis=1)
    rows = np.einsum("nif,ni->nf", by, moved / np.maximum(lengths, 1e-300)[:, None])
    return np.asarray(np.sqrt(np.maximum(np.einsum("nf,fg,ng->n", rows, covariance, rows), 0.0)))


def _beyond_axes(camera: Camera, pixels: Array, moved: Array) -> float:
    """Return the RMS of displacements (N, 2) that focal length and principal point do not explain."""
    axes = camera_axes(camera, pixels).reshape(-1, 3)
    left = moved.ravel() - axes @ np.linalg.lstsq(axes, moved.ravel(), rcond=1e-6)[0]
    return float(np.sqrt(np.mean(np.sum(left.reshape(-1, 2) ** 2, axis=1))))


def _rms_std(by: Array, covariance: Array) -> float:
    """Return the RMS of the standard deviation of a coordinate of displacements, as camera files state it."""
    variances = np.einsum("nif,fg,nig->n", by, covariance, by) / 2
    return float(np.sqrt(np.mean(np.maximum(variances, 0.0))))


def _smallest(information: Array, covariance: Array, axis: Array, by: Array, dof: int, chance: float) -> float:
    """Return the smallest change along an axis (D,), px RMS, that is found with a probability of _POWER by a test of so
    many degrees of freedom, in which less than a `chance` is no chance.

    by: (N, 2, F) the derivatives of pixels by the parameters that the axis is of, or (N, 2, 1) by a step along it.
    """
    from scipy.special import chdtri, chndtrinc  # here: it takes longer to import than a check

    weight = np.linalg.inv(np.eye(len(covariance)) + information @ covariance) @ information
    known = float(axis @ weight @ axis)
    needed = float(chndtrinc(chdtri(dof, chance), dof, 1 - _POWER))
    moved = by[:, :, 0] if by.shape[2] == 1 else by @ axis
    per_unit = float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
    return sqrt(needed / known) * per_unit if known > 0 else inf
