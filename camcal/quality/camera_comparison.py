"""Comparison of two calibrations: by how much their projections differ, and whether that is more than is uncertain.

What a camera measures does not depend on its own axes: the rotation of all directions, or the rigid motion of all
points, that best undoes the difference of the two is taken out of it and of its uncertainty.
"""

from collections.abc import Sequence
from math import inf, sqrt

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, readonly
from camcal.cameras.directions import (
    GRID,
    camera_axes,
    covariance_root,
    direction_displacements,
    grid_pixels,
    lens_difference,
)
from camcal.cameras.model import Camera, resized
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.messages import counted
from camcal.quality.projection_uncertainty import in_polygon
from camcal.records import Brief
from camcal.solve.losses import variance_ratio_beyond

SAME, MOVED, OTHER, UNKNOWN = "same", "moved", "other", "unknown"
WORDS = {
    SAME: "the same camera within what is known",
    MOVED: "the lens moved",
    OTHER: "another camera",
    UNKNOWN: "cannot be compared",
}
CHANCE = 1e-3  # of two calibrations of one camera to be told apart
_FLOOR = 0.01  # of the variance of a difference: less along a direction is not relied on
_LEAST = 1e-6  # of the mean variance over the image, of a pixel that hardly moves
_RANK = 1e-6  # of changes of a camera's axes: less is a rotation
_EQUAL_PX = 1e-3  # RMS: the same lens, written in another way
_ROUNDING_PX = 1e-9  # what two projections of one ray differ by
MOST_ZOOM, MOST_SHIFT = 0.03, 0.03  # of the focal length, of the image's diagonal: more is no lens that moved


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A camera, what messages call it, and what is known of its calibration.

    region: (N, 2) px, the part of the image in which its verdict holds, None if it is not known. views: of its
    calibration. images: their hashes.
    """

    name: str
    camera: Camera
    region: FloatArray | None = None
    circle: ImageCircle | None = None
    views: float = inf
    images: frozenset[str] = field(default_factory=frozenset)

    def knows(self, pixels: Array) -> BoolArray:
        """Return which pixels (N, 2) the calibration is known for."""
        lit = np.ones(len(pixels), bool) if self.circle is None else self.circle.contains(pixels)
        region = self.region
        return lit if region is None or len(region) < 3 else np.asarray(lit & in_polygon(pixels, region))


@dataclass(frozen=True)
class Excess:
    """A difference in terms of its uncertainty.

    sigmas: its root mean square in standard deviations, about 1 for two calibrations of one camera. chance: of a larger
    one for these. dof: of the mean square, dof_below: of its expectation.
    """

    sigmas: float
    chance: float
    dof: float
    dof_below: float


@dataclass(frozen=True, eq=False)
class CameraComparison(Brief):
    """The difference of two cameras over the image of the first.

    u, v: (columns,), (rows,) of the grid, px of the first camera. distances: (D,) m, infinity for directions.
    difference: (D, N, 2) px, from the first to the second, NaN where one of the lenses is not valid. std: (D, N) px,
    RMS of the image directions, its standard deviation, None where that is not known. compared: (N,) bool, where both
    cameras are known, over which the motion is taken out. verdict: one of WORDS; reason: why.
    total: the excess of the difference, distortion: of what a change of focal length and principal point leaves of it.
    focal: relative change of the focal length, shift: (2,) px of the principal point. common_images: of both.
    """

    u: FloatArray
    v: FloatArray
    distances: tuple[float, ...]
    difference: FloatArray
    compared: BoolArray
    focal: float
    shift: tuple[float, float]
    verdict: str = UNKNOWN
    reason: str = ""
    std: FloatArray | None = None
    total: Excess | None = None
    distortion: Excess | None = None
    common_images: int = 0

    def __post_init__(self) -> None:
        shape = len(self.distances), len(self.u) * len(self.v)
        object.__setattr__(self, "difference", readonly(self.difference, (*shape, 2), "difference"))
        object.__setattr__(self, "compared", readonly(self.compared, shape[1:], "compared", bool))
        if self.std is not None:
            object.__setattr__(self, "std", readonly(self.std, shape, "std"))

    @property
    def words(self) -> str:
        """The verdict in words."""
        return f"{WORDS[self.verdict]}{', because ' if self.verdict == UNKNOWN else ': '}{self.reason}"

    @property
    def lengths(self) -> FloatArray:
        """The lengths of the differences (D, N), px."""
        return np.asarray(np.linalg.norm(self.difference, axis=2))

    @property
    def sigmas(self) -> FloatArray:
        """The lengths in terms of their root mean square (D, N), √2 `std`; NaN where that is not known."""
        return np.asarray(self.lengths / (np.nan if self.std is None else sqrt(2) * self.std))

    @property
    def agree(self) -> bool:
        """Whether the projections are the same: one lens, perhaps written in two ways."""
        return _rms(self.lengths[:, self.compared]) <= _EQUAL_PX

    def figures(self, index: int) -> dict[str, float | None]:
        """Return RMS and largest difference, px, at one of the distances: over the image where both lenses are valid,
        and (`compared`) where both are known; std_px, the RMS standard deviation of a difference there.
        """
        lengths = self.lengths[index]
        chosen = np.isfinite(lengths)
        known = chosen & self.compared
        std = None if self.std is None else _rms(self.std[index][known]) * sqrt(2)
        parts = {"": lengths[chosen], "compared_": lengths[known]}
        figures: dict[str, float | None] = {f"{part}rms_px": _rms(values) for part, values in parts.items()}
        figures |= {f"{part}worst_px": float(values.max(initial=0.0)) for part, values in parts.items()}
        return figures | {"std_px": std, "valid_share": float(chosen.mean())}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def compare(
    first: Calibrated, second: Calibrated, distances: Sequence[float] = (), grid: tuple[int, int] = GRID
) -> CameraComparison:
    """Return the difference of two cameras over the image of the first, and what it means.

    distances: m, of points for which the best rigid motion is taken out, none for directions, for which it is the best
    rotation. A camera of another size is taken for one of resized images. See docs/mathematics.md, "Comparison of two
    cameras". Raises InvalidInput for images of other shapes, and lenses that are valid nowhere together.
    """
    one, both = first.camera, f"{first.name} and {second.name} cannot be compared"
    try:
        other = resized(second.camera, one.image_size)
    except InvalidInput as error:
        raise InvalidInput(f"{both}, because {error.message}") from error
    u, v = (np.linspace(0, side - 1, count) for side, count in zip(one.image_size, grid, strict=True))
    ranges = tuple(map(float, distances)) or (inf,)
    shape = len(ranges), len(u) * len(v)
    pixels = np.tile(grid_pixels(u, v), (len(ranges), 1))
    away = np.repeat(ranges, shape[1]) if distances else None
    found = lens_difference(one, other, pixels, None, away)
    valid = np.asarray(np.isfinite(found).all(axis=1).reshape(shape).all(axis=0))
    scale = np.array(one.image_size) / second.camera.image_size
    moved = np.nan_to_num((pixels + found + 0.5) / scale - 0.5)
    known = np.asarray(valid & (first.knows(pixels) & second.knows(moved)).reshape(shape).all(axis=0))
    if not valid.any():
        raise InvalidInput(f"{both}, because the two lenses are valid nowhere in the image together")
    compared = known if known.any() else valid
    chosen = np.tile(compared, len(ranges))
    found = lens_difference(one, other, pixels, chosen, away)
    focal = float(np.sqrt(np.prod(other.focal_lengths()[0]) / np.prod(one.focal_lengths()[0])) - 1)
    shift = (other.parameters[2:4] - one.parameters[2:4]).tolist()
    result = CameraComparison(
        u=u,
        v=v,
        distances=ranges,
        difference=np.where(np.abs(found) < _ROUNDING_PX, 0.0, found).reshape(*shape, 2),
        compared=compared,
        focal=focal,
        shift=(shift[0], shift[1]),
        common_images=len(first.images & second.images),
    )
    if result.agree:
        return replace(result, verdict=SAME, reason=f"the projections agree within {_EQUAL_PX:g} px (RMS)")
    if reason := _obstacle(first, second, result, known):
        return replace(result, reason=reason)
    moving = [
        direction_displacements(camera, at, chosen, away) @ covariance_root(np.asarray(camera.covariance))
        for camera, at in ((one, pixels), (other, pixels + np.nan_to_num(found)))
    ]
    variances = np.sum(np.concatenate(moving, axis=2) ** 2, axis=(1, 2))
    result = replace(result, std=np.sqrt(variances / 2).reshape(shape))
    variances = np.maximum(variances, _LEAST * np.mean(variances[chosen]))
    axes, *flat = (
        (each[chosen] / np.sqrt(variances[chosen, None, None])).reshape(2 * int(chosen.sum()), -1)
        for each in (camera_axes(one, pixels, chosen, away), *moving, found[:, :, None])
    )
    left, sizes, _ = np.linalg.svd(axes, full_matrices=False)
    basis = left[:, sizes > _RANK * sizes[0]]
    views = first.views, second.views
    total = _excess(flat, views)
    rest = _excess([each - basis @ (basis.T @ each) for each in flat], views)
    verdict, reason = _judge(total, rest, result)
    return replace(result, total=total, distortion=rest, verdict=verdict, reason=reason)


def _obstacle(first: Calibrated, second: Calibrated, found: CameraComparison, known: BoolArray) -> str:
    """Return why a difference cannot be judged, empty if it can."""
    unknown = [
        each.name for each in (first, second) if each.camera.covariance is None or not each.camera.covariance.any()
    ]
    if unknown:
        return f"{' and '.join(unknown)} states no covariance"
    if found.common_images:
        images = counted(found.common_images, "image")
        return f"both are calibrated from the same {images}: their errors are correlated and do not add up"
    return "" if known.any() else "the verdicts of the two hold in different parts of the image"


def _excess(flat: Sequence[Array], views: Sequence[float]) -> Excess:
    """Return a weighted difference (2N, 1), the last of three, in terms of what two calibrations of so many views leave
    of it: (2N, K) each per standard deviation of their parameters.

    Source: Satterthwaite 1946, for the sum of squares of several scales and for the sum of two estimated variances.
    """
    directions, scales, _ = np.linalg.svd(np.concatenate(flat[:2], axis=1), full_matrices=False)
    variance = float(np.sum(scales**2))
    weights = 1 / (scales**2 / variance + _FLOOR)
    parts = [float(np.sum(weights[:, None] * (directions.T @ each) ** 2)) for each in flat[:2]]
    along = (directions.T @ flat[2])[:, 0] ** 2
    beyond = max(float(np.sum(flat[2] ** 2) - np.sum(along)), 0.0)
    expected = sum(parts)
    dof = expected**2 / float(np.sum((weights * scales**2) ** 2))
    unsure = sum(part**2 / max(count - 1, 1) for part, count in zip(parts, views, strict=True))
    below = expected**2 / unsure if unsure else inf
    ratio = float(np.sum(weights * along) + beyond / _FLOOR) / expected
    return Excess(sqrt(ratio), variance_ratio_beyond(ratio, dof, below), dof, below)


def _judge(total: Excess, rest: Excess, found: CameraComparison) -> tuple[str, str]:
    """Return the verdict on a difference, and why."""
    reason = f"the difference is {total.sigmas:.1f} times its standard deviation"
    if total.chance >= CHANCE:
        return SAME, reason
    shift, diagonal = found.shift, float(np.hypot(found.u[-1], found.v[-1]))
    reason += f"; focal length {100 * found.focal:+.2f} %, principal point by ({shift[0]:+.1f}, {shift[1]:+.1f}) px"
    if rest.chance < CHANCE:
        return OTHER, f"{reason}, and distortion differs by {rest.sigmas:.1f} times its standard deviation"
    moved = abs(found.focal) <= MOST_ZOOM and np.hypot(*shift) <= MOST_SHIFT * diagonal
    return MOVED if moved else OTHER, reason
