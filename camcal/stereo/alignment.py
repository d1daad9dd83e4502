"""Row offsets of a rectified pair, their trend over the image, and the correction of the right image.

Rows are compared by features, or in a tenth of the time by corners of the left image followed into the right one.
"""

from math import sqrt
from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.images.remap import Maps
from camcal.opencv import resized
from camcal.stereo.coarse import Matches, coarse_map, contrast_of, even_out, halve, match_features, require_pair
from camcal.stereo.disparity import LIMITS

NEGLIGIBLE = 0.1  # px; matching loses less by it than by drawing the image again
WORTH_RECTIFYING = 0.5  # px; from here on matching loses more than all else that can be set
LARGEST_CORRECTION = LIMITS.rows_px  # a pair that is off by more is not a rectified one

_FEWEST = 12  # matches in agreement, three for each number of the trend and its scatter
_FEWEST_SHARE = 0.15  # of all; two images of different things reach 0.05, good pairs 0.6
_SMALL = 64  # px of width or height, below which a scene hardly has features enough
_FLAT = 4.0  # counts; the noise of a camera alone has less
_SIGNIFICANT = 3.0  # standard errors at which a trend is no chance
_FOLLOWED = 2.0  # px; of rows that are off by more too many corners are lost
_SHARP = 0.6  # px; corners that are found scatter by 0.1 to 0.3 px, those that are lost by more than 1
_SEED = 1
_GUESSES = 500  # of three matches; if only a third of all is right, eighteen guesses are
# guesses that are enough where so many of the matches agree: one in 1e7 times none is right
_FEW_GUESSES, _MOSTLY = 40, 0.7
_NEAR = 1.0  # px features are searched for in, about a guess; matches that are right scatter by 0.1 to 0.4 px
_ROUNDS, _SETTLED = 20, 1e-3  # rounds, and the change of a weight that ends them
_BREAK = 4.685  # deviations beyond which Tukey's biweight takes a match for wrong; the usual choice for normal errors
_NORMAL = 1.4826  # standard deviation over median absolute deviation
_LEAST_SCATTER = 1e-3  # px; of images made by shifting one of them
_LEAST_SPREAD = 1.0  # px by which disparities must vary to tell how rows depend on them

# corners that are followed
_TRACKED = 5e5  # pixels of the image they are followed in: of a larger one it is reduced to that
_MOST = 400
_QUALITY = 0.01  # of the best corner's
_APART = 2.5  # px at half the size: what is a corner there is one to the windows that follow it
_BLOCK = 3
_WINDOW = 15  # px; single corners are followed to 0.1 px
_EVENED = 31  # px; where it is less than texture is coarse, what remains is the rounding of counts
_LEVELS = 0  # beyond the image itself: guesses are good to a pixel or two, and rows beyond two compared otherwise
_TRACKING_ROUNDS, _STEP = 20, 0.005  # px
_ASTRAY = 2.0  # columns of the coarse map, and pixels, that the right place may be off from the guess


class Measured(NamedTuple):
    """A value and its standard error."""

    value: float
    std: float


@dataclass(frozen=True)
class Trend:
    """Rows as a plane over the image, pixels: at its centre, and from edge to edge; right minus left.

    tilt: from the left edge to the right one. scale: from the top to the bottom.
    """

    centre: Measured
    tilt: Measured
    scale: Measured

    @property
    def rms(self) -> float:
        """Root mean square over the image, pixels."""
        return sqrt(self.centre.value**2 + (self.tilt.value**2 + self.scale.value**2) / 12)

    @property
    def largest(self) -> float:
        """Its amount at the worst corner, pixels."""
        return abs(self.centre.value) + (abs(self.tilt.value) + abs(self.scale.value)) / 2


@dataclass(frozen=True, eq=False)
class Residual:
    """How far the rows of the features that both images show are off.

    pixels: (N, 2) of the left image. dy: (N,) row in the right image minus row in the left one, pixels. disparity: (N,)
    column in the left minus column in the right one, pixels. Matches that contradict the rest are left out; `agreeing`
    is their number without those, `seen` with them. largest: of |dy|, pixels. scatter: standard deviation about the
    trend, pixels. convergence: dy per pixel of disparity, None where disparities hardly vary; not 0 where the cameras
    do not stand side by side along the rows. rows: the affine map (3,) that gives dy as rows[0] u + rows[1] v + rows[2]
    for pixel (u, v) of the right image, were its rows those of the left one.
    """

    size: tuple[int, int]
    pixels: Array
    dy: Array
    disparity: Array
    seen: int
    agreeing: int
    largest: float
    median: Measured
    rms: float
    p95: float
    scatter: float
    trend: Trend
    convergence: Measured | None
    rows: Array

    def __post_init__(self) -> None:
        count = len(self.pixels)
        object.__setattr__(self, "pixels", readonly(self.pixels, (count, 2), "pixels"))
        object.__setattr__(self, "dy", readonly(self.dy, (count,), "dy"))
        object.__setattr__(self, "disparity", readonly(self.disparity, (count,), "disparity"))
        object.__setattr__(self, "rows", readonly(self.rows, (3,), "rows"))

    @property
    def partners(self) -> Array:
        """Where the pixels are in the right image, (N, 2) pixels."""
        return np.asarray(self.pixels + np.column_stack([-self.disparity, self.dy]))

    def figures(self) -> "Residual":
        """Return the figures without the features, of which N is 0."""
        return replace(self, pixels=np.empty((0, 2)), dy=np.empty(0), disparity=np.empty(0))


def vertical_residual(left: Array, right: Array) -> Residual:
    """Return how far the rows of a pair are off. left, right: (H, W) uint8.

    Raises InvalidInput for images of different sizes, InsufficientData if they share too few features.
    """
    return residual_of(match_features(left, right))


def quick_residual(left: Array, right: Array, coarse: Array | None = None) -> Residual:
    """Return how far the rows of a pair are off, as `vertical_residual` does but in a tenth of its time.

    left, right: (H, W) uint8. coarse: the disparities of `coarse_map`, if they are known. Corners are followed from
    image to image, which is done for rows off by two pixels; beyond that features are compared after all.
    Raises as `vertical_residual`.
    """
    matches = track_corners(left, right, coarse)
    try:
        residual = residual_of(matches)
    except InsufficientData:
        return vertical_residual(left, right)
    sound = residual.trend.largest < _FOLLOWED and residual.scatter < _SHARP * matches.coarseness
    return residual if sound else vertical_residual(left, right)


def residual_of(matches: Matches) -> Residual:
    """Return how far the rows of matches are off; raises InsufficientData if too few agree."""
    dy = matches.right[:, 1] - matches.left[:, 1]
    at = _normalise(np.column_stack([matches.right[:, 0], matches.left[:, 1]]), matches.size)
    plane = np.column_stack([np.ones(len(at)), at])
    weights = _agreement(plane, dy, _NEAR * matches.coarseness)
    kept = weights > 0
    needed = max(_FEWEST, round(_FEWEST_SHARE * len(dy)))
    if kept.sum() < needed:
        raise InsufficientData(
            f"{len(dy)} matched features, {kept.sum()} of them with consistent rows (minimum {needed}); "
            f"{_why_so_few(matches)}"
        )
    disparity = matches.left[:, 0] - matches.right[:, 0]
    values, covariance = _solve(plane, dy, weights)
    deviations = np.sqrt(np.diag(covariance))
    slopes = values[1:] / np.maximum(np.subtract(matches.size, 1), 1)  # by pixels, where places are -1/2 to 1/2
    off = dy[kept]
    return Residual(
        matches.size,
        matches.left[kept],
        dy=off,
        disparity=disparity[kept],
        seen=len(dy),
        agreeing=len(off),
        largest=float(np.abs(off).max()),
        median=Measured(float(np.median(off)), _std_of_median(off)),
        rms=float(np.sqrt(np.mean(off**2))),
        p95=float(np.quantile(np.abs(off), 0.95)),
        scatter=_NORMAL * float(np.median(np.abs(off - plane[kept] @ values))),
        trend=Trend(*(Measured(*map(float, pair)) for pair in zip(values, deviations, strict=True))),
        convergence=_convergence(plane, disparity, dy, weights),
        rows=np.array([*slopes, values[0] - values[1:].sum() / 2]),
    )


def row_correction(residual: Residual) -> Array | None:
    """Return what brings the rows of the right image to the left one's, for `align_rows`; None if they may stay.

    They may where the trend over the image is less than 0.1 px (RMS), or than three of its standard errors.
    Raises InvalidInput if it exceeds 5 px.
    """
    trend = residual.trend
    if trend.largest > LARGEST_CORRECTION:
        raise InvalidInput(
            f"rows differ by up to {trend.largest:.1f} px, more than the {LARGEST_CORRECTION:g} px that can be put "
            "right without a camera file; rectify the pair first"
        )
    sure = any(abs(value) > _SIGNIFICANT * std for value, std in (trend.centre, trend.tilt, trend.scale))
    return residual.rows if sure and trend.rms > NEGLIGIBLE else None


def align_rows(right: Array, correction: Array) -> Array:
    """Return the right image (H, W[, C]) with its rows where the left image has them, in its own type.

    correction: (3,) as `row_correction` gives it. Beyond the upper and lower edge the first and last row go on.
    """
    height, width = right.shape[:2]
    across, down = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    down += correction[0] * across + correction[1] * down + correction[2]
    return Maps(across, np.clip(down, 0, height - 1), (width, height), "linear").apply(right)


def _why_so_few(matches: Matches) -> str:
    width, height = matches.size
    if min(width, height) < _SMALL:
        return f"images of {width}x{height} pixels are too small"
    if matches.contrast < _FLAT:
        return f"image without texture: standard deviation of the gray levels {matches.contrast:.1f} of 255"
    return "check that both images show the same scene"


def _normalise(pixels: Array, size: tuple[int, int]) -> Array:
    """Return pixels (N, 2) as places from -1/2 to 1/2 across the image."""
    return np.asarray(pixels / np.maximum(np.subtract(size, 1), 1) - 0.5)


def _agreement(plane: Array, dy: Array, near: float) -> Array:
    """Return the weights (N,) from 0 to 1 of matches about the plane that most of them agree on to `near` pixels.

    Source: Beaton and Tukey, The Fitting of Power Series, Technometrics 1974, for the biweight.
    """
    if len(dy) < _FEWEST:
        return np.zeros(len(dy))
    weights: Array = (np.abs(dy - plane @ _most_agreed(plane, dy, near)) < near).astype(float)
    for _ in range(_ROUNDS):
        weighted = weights[:, None] * plane
        off = np.abs(dy - plane @ (np.linalg.pinv(plane.T @ weighted) @ (weighted.T @ dy)))
        scatter = float(np.clip(_NORMAL * np.median(off[weights > 0]), _LEAST_SCATTER, near))
        before, weights = weights, np.maximum(1 - (off / (_BREAK * scatter)) ** 2, 0) ** 2
        if np.abs(weights - before).max() < _SETTLED:
            break
    return weights


def _most_agreed(plane: Array, dy: Array, near: float) -> Array:
    """Return the plane (3,) through three matches that the most others lie near."""
    triples = np.random.default_rng(_SEED).integers(len(dy), size=(_GUESSES, 3))
    for some in (triples[:_FEW_GUESSES], triples):
        level = np.column_stack([dy, np.zeros_like(dy), np.zeros_like(dy)])[some[:, 0]]
        corners = plane[some]
        firm = np.abs(np.linalg.det(corners)) > 1e-3  # others hardly span the image
        level[firm] = np.linalg.solve(corners[firm], dy[some[firm]][..., None])[..., 0]
        off = np.minimum(np.abs(level @ plane.T - dy), near)
        best = int(np.argmin(off.sum(axis=1)))
        if np.mean(off[best] < near) > _MOSTLY:
            break
    return np.asarray(level[best])


def _solve(design: Array, dy: Array, weights: Array) -> tuple[Array, Array]:
    """Return the values (K,) of a weighted fit and their covariance (K, K)."""
    normal = np.linalg.pinv(design.T @ (weights[:, None] * design))
    values = normal @ (design.T @ (weights * dy))
    off = dy - design @ values
    dof = max(float(weights.sum()) - design.shape[1], 1.0)
    # Huber, Robust Statistics, eq. 6.5 without its small-sample factor: how much the weighted sums themselves scatter.
    spread = normal @ (design.T @ ((weights * off)[:, None] ** 2 * design)) @ normal
    return values, spread * weights.sum() / dof


def _std_of_median(values: Array) -> float:
    """Return the standard error of a median of normal values."""
    scatter = _NORMAL * float(np.median(np.abs(values - np.median(values))))
    return max(scatter, _LEAST_SCATTER) * sqrt(np.pi / 2 / len(values))


def _convergence(plane: Array, disparity: Array, dy: Array, weights: Array) -> Measured | None:
    """Return how rows depend on disparity where the plane is allowed for, None where the two cannot be told apart."""
    flat, _ = _solve(plane, disparity, weights)
    own = disparity - plane @ flat
    if np.sqrt(np.average(own**2, weights=weights)) < _LEAST_SPREAD:
        return None
    values, covariance = _solve(np.column_stack([plane, own]), dy, weights)
    return Measured(float(values[3]), float(np.sqrt(covariance[3, 3])))


def track_corners(left: Array, right: Array, coarse: Array | None = None) -> Matches:
    """Return the corners of the left image, where the right image has them.

    left, right: (H, W) uint8, rows aligned to two pixels. coarse: the disparities of `coarse_map`, if they are known.
    Raises InvalidInput for images of different sizes. Source: Bouguet, Pyramidal Implementation of the Lucas Kanade
    Feature Tracker, 2000.
    """
    left, right = require_pair(left, right)
    coarse = coarse_map(left, right).disparities if coarse is None else coarse
    size = left.shape[1], left.shape[0]
    scale = min(1.0, sqrt(_TRACKED / left.size))
    first, second = (image if scale == 1 else resized(image, scale) for image in (left, right))
    corners = _corners(first, np.isfinite(coarse))
    guesses = corners - np.column_stack([_look_up(coarse, corners, first.shape) * scale, np.zeros(len(corners))])
    found, kept = _follow(first, second, corners, guesses.astype(np.float32))
    astray = np.hypot(*(found - guesses).T)
    kept &= astray < _ASTRAY * (first.shape[1] / coarse.shape[1] + 1)
    ratio = np.array(size) / first.shape[::-1]
    return Matches(
        (corners[kept] + 0.5) * ratio - 0.5,
        (found[kept] + 0.5) * ratio - 0.5,
        np.zeros(int(kept.sum())),
        size,
        contrast_of(left, right),
        _TRACKED,
    )


def _corners(gray: Array, known: Array) -> Array:
    """Return the corners (N, 2) float32 of an image where its reduced mask is set, pixels."""
    small = halve(gray)
    mask = cv2.resize(known.astype(np.uint8), small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    corners = cv2.goodFeaturesToTrack(small, _MOST, _QUALITY, _APART, mask=mask, blockSize=_BLOCK)
    if corners is None:
        return np.zeros((0, 2), np.float32)
    ratio = np.array(gray.shape[::-1]) / small.shape[::-1]
    return np.asarray((corners.reshape(-1, 2) + 0.5) * ratio - 0.5, np.float32)


def _look_up(coarse: Array, pixels: Array, shape: tuple[int, ...]) -> Array:
    """Return the values (N,) of a reduced map at pixels (N, 2) of the image it is of."""
    places = (pixels + 0.5) * (np.array(coarse.shape[::-1]) / shape[::-1])
    columns, rows = np.minimum(places.astype(int), np.subtract(coarse.shape[::-1], 1)).T
    return np.asarray(np.nan_to_num(coarse[rows, columns]))


def _follow(first: Array, second: Array, corners: Array, guesses: Array) -> tuple[Array, Array]:
    """Return where corners (N, 2) of the first image are in the second, pixels, and the mask (N,) of those found."""
    if not len(corners):
        return guesses, np.zeros(0, bool)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        even_out(first, _EVENED),
        even_out(second, _EVENED),
        corners,
        guesses.copy(),
        winSize=(_WINDOW, _WINDOW),
        maxLevel=_LEVELS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _TRACKING_ROUNDS, _STEP),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32).reshape(-1, 2), np.asarray(status).ravel() > 0
