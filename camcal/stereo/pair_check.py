"""The check of two images as a rectified pair: rows, order, exposure and range of disparities."""

from math import degrees

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.stereo.alignment import LARGEST_CORRECTION, Measured, Residual, residual_of
from camcal.stereo.coarse import Matches, coarse_map, match_features, range_in
from camcal.stereo.disparity import LIMITS

_WINDOW = 2  # px about a feature; a mean over 5x5 is little moved by a quarter of a pixel
# exposure
_ENDS = (4, 251)  # counts; beyond them pixels may be cut off
_FEWEST = 20
_GAMMAS = np.geomspace(0.4, 2.5, 61)  # steps of 3 %
_ROUNDS = 10
_BREAK = 4.685  # deviations, for Tukey's biweight: what shines, or is in another's shadow, is left out
_NORMAL = 1.4826
_LEAST_SCATTER = 0.5  # counts
_SIGNIFICANT = 3.0
_LEAST_SPREAD = 1e-6  # counts²; images of one gray tell no gain
_NOTICEABLE = 0.05  # of the light
_TAIL = 0.01

SWAPPED = Message("swapped_images", "left and right swapped, or cameras toed in (negative disparities)")
IDENTICAL = Message("identical_images", "both images show the same view: check that one was not given twice")
PERIODIC = Message("periodic_texture", "periodic texture: disparities are ambiguous by multiples of its period")
_TURN = np.radians(10.0)
_TURNED = 0.5  # share of the features that are turned alike


@dataclass(frozen=True)
class Exposure:
    """How the right image's counts come from the left one's: gain · 255 · (left / 255)^gamma + offset.

    brightness: by how much the right image is brighter, 0.1 for 10 %. scatter: counts about the curve, `apart` without
    it. moved: counts by which the curve changes those of the matches, RMS.
    """

    brightness: Measured
    gain: float
    offset: float
    gamma: float
    scatter: float
    apart: float
    moved: float

    def curve(self, counts: Array) -> Array:
        """Return what counts (N,) of the left image are in the right one."""
        return np.asarray(self.gain * 255 * (counts / 255) ** self.gamma + self.offset)

    @property
    def differs(self) -> bool:
        """Whether the difference is significant and large enough to report."""
        value, std = self.brightness
        return abs(value) > max(_NOTICEABLE, _SIGNIFICANT * std)


@dataclass(frozen=True, eq=False)
class PairCheck:
    """What was found of a pair.

    failure: SWAPPED, IDENTICAL, PERIODIC or None. exposure: None where too little is
    neither black nor white. disparities: (N,) pixels, spread over the left image; empty, and searched None, where too
    little of the images can be matched. disparity: the range that 98 % of them lie in, pixels. searched: the range a
    search for disparities would take, pixels. upright: the cameras are above each other, and what stands here as rows
    are the columns of the images.
    """

    residual: Residual
    failure: Message | None
    exposure: Exposure | None
    disparities: Array
    disparity: tuple[float, float]
    searched: tuple[int, int] | None
    upright: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "disparities", readonly(self.disparities, (None,), "disparities", np.float32))

    def figures(self) -> "PairCheck":
        """Return the figures without the features and disparities behind them, for lists of many pairs."""
        return replace(self, residual=self.residual.figures(), disparities=np.empty(0, np.float32))


def check_pair(left: Array, right: Array, farthest: float = 0.0, *, upright: bool = False) -> PairCheck:
    """Return what two images (H, W) uint8 show as a pair.

    farthest: as in `failure_of`. upright: the cameras are above each other, "left" is the upper one, and corresponding
    points are in one column.
    Raises InvalidInput for images of different sizes, or if one is turned against the other; InsufficientData if they
    share too few features.
    """
    if upright:
        left, right = np.ascontiguousarray(left.T), np.ascontiguousarray(right.T)
    matches = match_features(left, right)
    turn = turn_of(matches)
    if turn:
        side = "clockwise" if (turn > 0) != upright else "counter-clockwise"
        raise InvalidInput(
            f"the right image is rotated by {abs(degrees(turn)):.0f}° {side} relative to the left: rotate it back"
        )
    residual = residual_of(matches)
    coarse = coarse_map(left, right)
    disparities = coarse.disparities[np.isfinite(coarse.disparities)]
    low, high = np.quantile(disparities if disparities.size else residual.disparity, [_TAIL, 1 - _TAIL])
    periodic = coarse.periodic and residual.trend.largest <= LARGEST_CORRECTION  # rows far off match by chance
    return PairCheck(
        residual,
        PERIODIC if periodic else failure_of(residual, farthest),
        exposure_of(left, right, residual.pixels, residual.partners),
        disparities,
        (float(low), float(high)),
        range_in(coarse, left.shape[1]),
        upright,
    )


def failure_of(residual: Residual, farthest: float = 0.0) -> Message | None:
    """Return what is wrong with the order of a pair, SWAPPED or IDENTICAL, None if nothing is.

    farthest: disparity of what is infinitely far, pixels; not 0 for cameras whose principal points differ.
    """
    if np.mean(np.abs(residual.disparity) < LIMITS.parallax_px) > LIMITS.alike:
        return IDENTICAL
    if np.mean(residual.disparity < farthest - LIMITS.sideways_px) > LIMITS.wrong_side:
        return SWAPPED
    return None


def turn_of(matches: Matches) -> float:
    """Return by how much the right image is turned against the left one, radians clockwise; 0 below ten degrees."""
    if not len(matches.turns):
        return 0.0
    apart = np.abs(_wrapped(matches.turns[:, None] - matches.turns))
    alike = apart < _TURN
    middle = int(np.argmax(alike.sum(axis=1)))
    turn = float(np.median(matches.turns[middle] + _wrapped(matches.turns[alike[middle]] - matches.turns[middle])))
    return turn if abs(turn) > _TURN and alike[middle].mean() > _TURNED else 0.0


def _wrapped(angles: Array) -> Array:
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)


def exposure_of(left: Array, right: Array, pixels: Array, partners: Array) -> Exposure | None:
    """Return how the exposures of a pair differ; None where too few matches lie between black and white.

    left, right: (H, W) uint8. pixels, partners: (N, 2) of the left image, and where they are in the right one.
    """
    windows = _windows(left, pixels), _windows(right, partners)
    whole = np.logical_and(*((_ENDS[0] < part.min(axis=1)) & (part.max(axis=1) < _ENDS[1]) for part in windows))
    if whole.sum() < _FEWEST:
        return None
    first, second = (part[whole].mean(axis=1) for part in windows)
    gains, offsets, scatters, kept = _fits(first, second)
    best = int(np.argmin(scatters))
    gain, offset, gamma, scatter = (float(each[best]) for each in (gains, offsets, _GAMMAS, scatters))
    first, second = first[kept[best]], second[kept[best]]
    ratio = float(second.mean() / first.mean())
    std = float(np.std(second - ratio * first) / (np.sqrt(len(first)) * first.mean()))
    brightness = Measured(ratio - 1, std)  # how much more light there is in the right image
    exposure = Exposure(brightness, gain, offset, gamma, scatter, apart=0.0, moved=0.0)
    apart = _NORMAL * float(np.median(np.abs(second - first)))
    return replace(exposure, apart=apart, moved=float(np.sqrt(np.mean((exposure.curve(first) - first) ** 2))))


def _windows(gray: Array, pixels: Array) -> Array:
    """Return the counts (N, 25) of the windows about pixels (N, 2)."""
    columns, rows = np.rint(pixels).astype(int).T
    steps = np.arange(-_WINDOW, _WINDOW + 1)
    height, width = gray.shape
    down = np.clip(rows[:, None] + steps, 0, height - 1)
    across = np.clip(columns[:, None] + steps, 0, width - 1)
    return np.asarray(gray[down[:, :, None], across[:, None, :]].reshape(len(pixels), len(steps) ** 2))


def _fits(first: Array, second: Array) -> tuple[Array, Array, Array, Array]:
    """Return gain, offset and scatter about the curve for every gamma, (G,) each, and which counts it keeps (G, N)."""
    curve = 255 * (first / 255) ** _GAMMAS[:, None]
    weights = np.ones_like(curve)
    for _ in range(_ROUNDS):
        share = weights / weights.sum(axis=1, keepdims=True)
        middle, level = (share * curve).sum(axis=1, keepdims=True), (share @ second)[:, None]
        spread = (share * (curve - middle) ** 2).sum(axis=1, keepdims=True)
        gain = (share * (curve - middle) * (second - level)).sum(axis=1, keepdims=True)
        gain /= np.maximum(spread, _LEAST_SPREAD)
        offset = level - gain * middle
        off = np.abs(second - gain * curve - offset)
        scatter = np.maximum(_NORMAL * np.median(off, axis=1, keepdims=True), _LEAST_SCATTER)
        weights = np.maximum(1 - (off / (_BREAK * scatter)) ** 2, 0) ** 2
    return gain[:, 0], offset[:, 0], scatter[:, 0], weights > 0
