"""Preparation of a pair for matching: gray conversion, exposure, row alignment, disparity range."""

import cv2
import numpy as np

from camcal.arrays import Array, BoolArray
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import Message
from camcal.stereo.alignment import Residual, align_rows, quick_residual, row_correction
from camcal.stereo.coarse import CoarseMap, coarse_map, default_range, range_in
from camcal.stereo.pair_check import SWAPPED, exposure_of, failure_of

_DARKEST, _BRIGHTEST = 0.1, 99.9  # percentiles of deep images that become 0 and 255
_DIFFERENT = 5.0  # gray levels of 255, RMS; where two exposures differ by less, correcting them gains nothing
_EXPLAINED = 0.5  # share of the difference of matched pixels that may be left; what is no exposure leaves nearly all
_COMPARED = 500  # matches that exposures are compared at
_MOST = 1 << 18  # pixels that ranges of gray levels are taken from
_LEAST_SPAN = 1e-30  # of brightness; keeps the numbers of float images finite where all pixels are alike
_NOISE_SIDE = 256  # pixels: half the side of the square in the middle whose noise is measured
NOISY = 4.0  # gray levels, from which images are denoised; the finest texture of sharp photographs counts as up to 3
_STRENGTH, _TEMPLATE, _SEARCHED = 0.8, 5, 11  # times the noise; pixels
_FEWEST = 4  # disparities; with fewer there is nothing between them
_WIDEST = 1 << 14


Masks = tuple[BoolArray, BoolArray]  # of the left and of the right image


@dataclass(frozen=True, eq=False)
class GrayPair:
    """A pair as matchers take it.

    left, right: (H, W) uint8. deep_left, deep_right: (H, W) uint8 or uint16, as they were taken unless they are noisy.
    noise: standard deviation before that, gray levels of 255.
    """

    left: Array
    right: Array
    deep_left: Array
    deep_right: Array
    noise: float


def gray_pair(left: Array, right: Array) -> GrayPair:
    """Return both images (H, W), (H, W, 3) BGR or (H, W, 4), of uint8, uint16 or float32, as matchers take them.

    Deep images become 8 bits by one straight line for both. Noisy ones are denoised by non-local means.
    Raises InvalidInput for images of different sizes.
    """
    deep_left, deep_right = _gray(left), _gray(right)
    if deep_left.shape != deep_right.shape:
        sizes = ["{1} × {0}".format(*image.shape) for image in (deep_left, deep_right)]
        raise InvalidInput(f"the left image has {sizes[0]} pixels, the right one {sizes[1]}: sizes must be equal")
    deep_left, deep_right = _whole_numbers(deep_left, deep_right)
    first, second = _eight_bits(deep_left, deep_right)
    noise = noise_of(first)
    if noise <= NOISY:
        return GrayPair(first, second, deep_left, deep_right, noise)
    first, second = (
        np.asarray(cv2.fastNlMeansDenoising(image, None, _STRENGTH * noise, _TEMPLATE, _SEARCHED))
        for image in (first, second)
    )
    return GrayPair(first, second, first, second, noise)  # deeper counts hold but noise


def noise_of(gray: Array) -> float:
    """Return the standard deviation of the noise of an image (H, W) uint8, gray levels; fine texture counts as noise.

    Source: Immerkær, Fast noise variance estimation, CVIU 1996, with a median for the mean.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # blind to slopes and to even curvature
    middle = tuple(slice(max(0, length // 2 - _NOISE_SIDE), length // 2 + _NOISE_SIDE) for length in gray.shape)
    below = np.cumsum(np.bincount(np.abs(cv2.filter2D(gray[middle], cv2.CV_16S, mask)).ravel()))
    median = int(np.searchsorted(below, below[-1] / 2))
    return median / (0.6745 * 6)


def _gray(pixels: Array) -> Array:
    if pixels.ndim == 2:
        return pixels
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), cv2.COLOR_BGR2GRAY))


def _whole_numbers(left: Array, right: Array) -> tuple[Array, Array]:
    """Return images of 8 or 16 bits as they are, others as 16 bits over the range of both; what is no number as 0."""
    if all(image.dtype in (np.uint8, np.uint16) for image in (left, right)):
        return (left, right) if left.dtype == right.dtype else (_sixteen_bits(left), _sixteen_bits(right))
    pair = [np.nan_to_num(image.astype(np.float32), posinf=0.0, neginf=0.0) for image in (left, right)]
    low, high = min(float(image.min()) for image in pair), max(float(image.max()) for image in pair)
    scale = np.iinfo(np.uint16).max / max(high - low, _LEAST_SPAN)
    first, second = (np.rint((image - low) * scale).astype(np.uint16) for image in pair)
    return first, second


def _sixteen_bits(image: Array) -> Array:
    return image if image.dtype == np.uint16 else image.astype(np.uint16) * np.uint16(257)


def _eight_bits(left: Array, right: Array) -> tuple[Array, Array]:
    if left.dtype == np.uint8:
        return left, right
    sample = np.concatenate([_sample(left), _sample(right)])
    low, high = np.percentile(sample, (_DARKEST, _BRIGHTEST))
    scale = 255 / max(float(high - low), 1.0)
    first, second = (
        np.asarray(cv2.convertScaleAbs(np.maximum(image, low), alpha=scale, beta=-low * scale))
        for image in (left, right)
    )
    return first, second


def _expose_alike(pair: GrayPair, coarse: CoarseMap) -> GrayPair:
    """Return the pair with the image of less contrast in the other one's exposure, itself where theirs hardly differ.

    Only what both images show is compared: a camera that sees more of a bright wall is not exposed differently.
    """
    shape = coarse.disparities.shape
    left, right = (cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA) for image in (pair.left, pair.right))
    rows, columns = np.nonzero(np.isfinite(coarse.disparities))
    some = slice(None, None, max(1, len(rows) // _COMPARED))
    pixels = np.column_stack([columns, rows])[some].astype(float)
    moved = coarse.disparities[rows, columns][some] * (shape[1] / pair.left.shape[1])
    sides = [(right, pixels - np.column_stack([moved, np.zeros_like(moved)])), (left, pixels)]
    if left.std() < right.std():
        sides.reverse()
    (first, here), (second, there) = sides
    exposure = exposure_of(first, second, here, there)
    if exposure is None or exposure.moved < _DIFFERENT or exposure.scatter > _EXPLAINED * exposure.apart:
        return pair
    curve = np.clip(np.rint(exposure.curve(np.arange(256.0))), 0, 255).astype(np.uint8)
    if first is right:
        return replace(pair, right=np.asarray(cv2.LUT(pair.right, curve)))
    stretched = np.asarray(cv2.LUT(pair.left, curve))
    return replace(pair, left=stretched, noise=noise_of(stretched))


def _sample(image: Array) -> Array:
    """Return pixels spread evenly over an image, few enough for statistics to take no time."""
    step = max(1, int(np.sqrt(image.size / _MOST)))
    return image[::step, ::step]


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is matched.

    first, count: the smallest disparity to search for, pixels, and how many. rows: of the right image, px RMS, by which
    they were aligned; 0 if they were not. warnings: of the range. failures: why the pair cannot be matched.
    """

    pair: GrayPair
    first: int
    count: int
    rows: float
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...] = ()


def prepare(
    left: Array,
    right: Array,
    search: tuple[int, int] | None = None,
    *,
    align: bool = True,
    expose: bool = True,
    farthest: float = 0.0,
) -> Prepared:
    """Return a pair ready to be matched.

    left, right: (H, W), (H, W, 3) BGR or (H, W, 4), uint8, uint16 or float32. search: smallest and largest disparity,
    pixels, None for what the images show. align: put the rows right if they are measurably off. expose: bring the
    right image to the left one's exposure. farthest: disparity of what is infinitely far, pixels, by the geometry; left
    and right are taken for swapped if all lies below it, unless the range begins there.
    Raises InvalidInput for images of different sizes, and for a range that is empty or wider than any image.
    """
    pair = gray_pair(left, right)
    coarse = coarse_map(pair.left, pair.right) if align or expose or search is None else None
    if expose and coarse is not None and not coarse.periodic:
        pair = _expose_alike(pair, coarse)
    residual = _residual(pair, coarse) if align else None
    warnings, failures = list[Message](), list[Message]()
    if residual is not None and not (coarse is not None and coarse.periodic):
        behind = farthest if search is None else min(farthest, search[0])
        failure = failure_of(residual, behind)
        failures += [failure] if failure else []
    rows = 0.0
    if residual is not None:
        try:
            pair, rows = _align(pair, residual)
        except InvalidInput as error:
            failures.append(Message("rows_not_aligned", error.message))
    if search is None:
        found = None if coarse is None else range_in(coarse, pair.left.shape[1])
        search = found or default_range(pair.left.shape[1])
        if search[1] <= farthest and SWAPPED not in failures:
            failures.append(SWAPPED)
        if found is None:
            why = " (periodic texture)" if coarse is not None and coarse.periodic and not failures else ""
            text = f"disparity range not measurable{why}: {search[0]} to {search[1]} is used; set --range"
            warnings.append(Message("unknown_range", text, {"first": search[0], "last": search[1]}))
    return Prepared(pair, *_range(search), rows, tuple(warnings), tuple(failures))


def _range(search: tuple[int, int]) -> tuple[int, int]:
    """Return the first disparity and their number."""
    first, last = search
    if first > last:
        raise InvalidInput(f"the range {first} to {last} is empty: write MIN:MAX")
    if max(abs(first), abs(last)) > _WIDEST:
        raise InvalidInput(f"a range of {first} to {last} px exceeds any image")
    return first, max(last - first + 1, _FEWEST)


def _residual(pair: GrayPair, coarse: CoarseMap | None) -> Residual | None:
    """Return how far the rows are off, None where the images do not tell."""
    try:
        return quick_residual(pair.left, pair.right, None if coarse is None else coarse.disparities)
    except InsufficientData:
        return None


def _align(pair: GrayPair, residual: Residual) -> tuple[GrayPair, float]:
    """Return the pair with its rows put right, and by how many pixels (RMS); see `row_correction`."""
    correction = row_correction(residual)
    if correction is None:
        return pair, 0.0
    right, left = align_rows(pair.right, correction), _without_partnerless_rows(pair.left, correction)
    deep_right, deep_left = right, left
    if pair.deep_right is not pair.right:
        deep_right = align_rows(pair.deep_right, correction)
    if pair.deep_left is not pair.left:
        deep_left = _without_partnerless_rows(pair.deep_left, correction)
    return GrayPair(left, right, deep_left, deep_right, pair.noise), residual.trend.rms


def _without_partnerless_rows(left: Array, correction: Array) -> Array:
    """Return the left image with the first and last rows going on as `align_rows` lets those of the right one."""
    height, width = left.shape
    ends = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]]) @ correction[:2] + correction[2]
    above, below = max(0, int(np.ceil(-ends[:2].min()))), max(0, int(np.ceil(ends[2:].max())))
    rows = np.clip(np.arange(height), min(above, height - 1), max(height - 1 - below, 0))
    return np.ascontiguousarray(left[rows])
