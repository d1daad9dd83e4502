"""Errors of a disparity map against ground truth, as defined by Middlebury and KITTI.

Every figure is given for the non-occluded pixels, which the right camera sees as well, and for all that have a truth,
and there twice: with pixels without a disparity counted as bad, and among those that have one. Sparsification tells
whether the pixels that a matcher calls uncertain are the ones that are wrong.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.stereo.depth import StereoImage
from camcal.stereo.disparity import Confidence, StereoGeometry

_STEPS = 100
_LARGEST = 1 << 20  # pixels; of more than that every n-th is enough and sorted in no time
NON_OCCLUDED = "nocc"
ALL = "all"
AMONG_VALID = "-valid"
THRESHOLDS = (0.5, 1.0, 2.0, 3.0, 4.0)
FIGURES = (
    "density", *(f"bad{threshold:g}" for threshold in THRESHOLDS), "d1", "avg", "rms", "a50", "a90", "a99",
    "z_avg_m", "z_a50_m", "z_a90_m", "z_avg_percent", "z_a50_percent", "z_a90_percent", "within1", "within2", "ause",
)  # fmt: skip
AT_LEAST = ("density", "within1", "within2")  # of all other figures less is better
_QUANTILES = (50, 90, 99)
_ONE_SIGMA = 68  # percent
_MEANS = ("error68", "bad1", "bad2", "sigma", "within1", "within2")
_SAME_VIEW = 0.01  # of the ratio of width to height: the same images at another size
_TOLERANCE = 1.0  # pixels: what quarter-pixel truths and slanted surfaces leave between the two views


@dataclass(frozen=True, eq=False)
class Sparsification:
    """What average error is left when the least certain pixels are taken out, a hundredth of them at a time.

    by_sigma, by_error: (N,) pixels: with the largest sigma taken out first, and with the largest errors, which no
    sigma can do better. Ilg et al., ECCV 2018, sec. 4.
    """

    by_sigma: Array
    by_error: Array

    def __post_init__(self) -> None:
        for name in ("by_sigma", "by_error"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None,), name))

    @property
    def area(self) -> float:
        """The area between the curves, AUSE, pixels: the mean over the shares taken out."""
        return float(np.mean(self.by_sigma - self.by_error))


def sparsify(error: Array, sigma: Array) -> Sparsification:
    """Return the curves of some pixels; those without sigma do not count, and without any the curves are NaN.

    error, sigma: (N,) pixels, the error without a sign, sigma NaN where it is not known.
    """
    predicted = np.isfinite(sigma)
    step = 1 + np.count_nonzero(predicted) // _LARGEST
    error, sigma = error[predicted][::step], sigma[predicted][::step]
    if not error.size:
        return Sparsification(np.full(_STEPS, np.nan), np.full(_STEPS, np.nan))
    kept = np.maximum(len(error) - np.arange(_STEPS) * len(error) // _STEPS, 1)
    by_sigma, by_error = (
        np.cumsum(error[np.argsort(certainty, kind="stable")], dtype=np.float64)[kept - 1] / kept
        for certainty in (sigma, error)
    )
    return Sparsification(by_sigma, by_error)


@dataclass(frozen=True)
class ClassErrors:
    """The errors of the pixels of one confidence class that have a truth and a disparity.

    share: of all such pixels, percent. error68: what 68 % of the errors stay below, pixels. sigma: median of what was
    predicted, pixels, None where nothing was. bad1, bad2, within1, within2 (1 and 2 sigma): percent.
    """

    name: str
    pixels: int
    share: float
    error68: float
    bad1: float
    bad2: float
    sigma: float | None = None
    within1: float | None = None
    within2: float | None = None


@dataclass(frozen=True)
class Evaluation:
    """The accuracy of a disparity map, as columns of figures.

    figures: by column, nocc and all with "-valid" appended for the pixels that have a disparity, then by name. In
    percent: bad0.5 … bad4 (error above so many pixels), d1 (above 3 pixels and 5 % of the truth), density. In pixels:
    avg, rms, a50, a90, a99 (what so many percent stay below). z_avg_m, z_a50_m, z_a90_m and z_…_percent: errors of the
    depth, where the geometry is known. within1, within2: percent of errors within 1 and 2 sigma, ause: see
    `Sparsification`, where sigma is known. pixels: how many each column counts.
    """

    figures: Mapping[str, Mapping[str, float]]
    pixels: Mapping[str, int]
    classes: tuple[ClassErrors, ...] = ()
    sparsification: Sparsification | None = None


def evaluate(
    disparity: Array,
    truth: Array,
    visible: Array | None = None,
    geometry: StereoGeometry | None = None,
    sigma: Array | None = None,
    confidence: Array | None = None,
) -> Evaluation:
    """Return the errors of a disparity map.

    disparity, truth: (H, W) pixels, NaN where there is none. visible: (H, W) bool, what both cameras see. sigma: (H, W)
    pixels, NaN where unknown, and confidence: (H, W) classes, what the matcher said of its own errors.
    Raises InvalidInput if the sizes differ, InsufficientData if no pixel to be counted has a truth.
    """
    _require_size("truth", truth, disparity)
    for name, image in (("mask", visible), ("sigma", sigma), ("confidence", confidence)):
        _require_size(name, image, disparity)
    depths = None
    if geometry is not None:
        maps = (StereoImage(values, geometry, signed=True) for values in (disparity, truth))
        depths = np.stack([image.depth(slice(0, len(disparity))) for image in maps])
    known = np.isfinite(truth)
    regions = {ALL: known} if visible is None else {NON_OCCLUDED: known & visible, ALL: known}
    figures: dict[str, Mapping[str, float]] = {}
    pixels: dict[str, int] = {}
    curves = None
    for region, counted in regions.items():
        if not counted.any():
            raise InsufficientData(f"no pixel of {region} has a truth")
        pairs = _Pixels.of(disparity, truth, sigma, confidence, depths, counted)
        valid = pairs.valid()
        curves = None if valid.sigma is None else sparsify(valid.error, valid.sigma)
        figures[region] = {"density": _percent(np.isfinite(pairs.error)), **_shares(pairs)}
        figures[region + AMONG_VALID] = _valid_figures(valid, curves)
        pixels |= {region: len(pairs.error), region + AMONG_VALID: len(valid.error)}
    return Evaluation(figures, pixels, _by_class(valid), curves)


class _Pixels(NamedTuple):
    """The pixels of a region: (N,) each. error: pixels, infinite without a disparity.

    depths: (2, N) m, by the map and by the truth, NaN where there is none; None without a geometry.
    """

    error: Array
    disparity: Array
    truth: Array
    sigma: Array | None
    confidence: Array | None
    depths: Array | None

    @staticmethod
    def of(
        disparity: Array,
        truth: Array,
        sigma: Array | None,
        confidence: Array | None,
        depths: Array | None,
        counted: Array,
    ) -> "_Pixels":
        found, true = disparity[counted], truth[counted]
        error = np.abs(found - true)
        return _Pixels(
            np.where(np.isfinite(error), error, np.inf),
            found,
            true,
            _choose(sigma, counted),
            _choose(confidence, counted),
            _choose(depths, (slice(None), counted)),
        )

    def where(self, chosen: Array) -> "_Pixels":
        error, disparity, truth = self.error[chosen], self.disparity[chosen], self.truth[chosen]
        known = (
            _choose(self.sigma, chosen),
            _choose(self.confidence, chosen),
            _choose(self.depths, (slice(None), chosen)),
        )
        return _Pixels(error, disparity, truth, *known)

    def valid(self) -> "_Pixels":
        return self.where(np.isfinite(self.error))


def _choose(values: Array | None, chosen: Any) -> Array | None:
    return None if values is None else np.asarray(values[chosen])


def mean_of(evaluations: Sequence[Evaluation]) -> Evaluation:
    """Return the mean over several maps: of figures, each map alike; of classes, each pixel alike.

    A figure that not all maps are asked for is left out; one that is NaN for some maps is the mean over the others.
    """
    first = evaluations[0]
    if len(evaluations) == 1:
        return first
    figures = {
        column: {
            name: _mean_known([other.figures[column][name] for other in evaluations])
            for name in names
            if all(name in other.figures[column] for other in evaluations)
        }
        for column, names in first.figures.items()
    }
    pixels = {column: sum(other.pixels[column] for other in evaluations) for column in first.pixels}
    found = [kind for other in evaluations for kind in other.classes]
    names = [kind.name.lower() for kind in sorted(Confidence, reverse=True)]
    same = [[kind for kind in found if kind.name == name] for name in names]
    total = sum(kind.pixels for kind in found)
    return Evaluation(figures, pixels, tuple(_mean_class(kinds, total) for kinds in same if kinds))


def _mean_known(values: Sequence[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else np.nan


def _mean_class(kinds: Sequence[ClassErrors], total: int) -> ClassErrors:
    pixels = [kind.pixels for kind in kinds]

    def mean(name: str) -> float | None:
        values = [getattr(kind, name) for kind in kinds]
        return None if None in values else float(np.average(values, weights=pixels))

    means: dict[str, Any] = {name: mean(name) for name in _MEANS}
    return replace(kinds[0], pixels=sum(pixels), share=100 * sum(pixels) / total, **means)


def _valid_figures(pixels: _Pixels, curves: Sparsification | None) -> dict[str, float]:
    figures = {**_averages(pixels.error), **_shares(pixels)}
    if pixels.depths is not None:
        figures |= _depth_errors(*pixels.depths)
    if curves is not None:
        figures |= _within(pixels) | {"ause": curves.area}
    return figures


def _shares(pixels: _Pixels) -> dict[str, float]:
    """Return percentages of errors above thresholds, and what most errors stay below; infinite where too few do.

    D1: Menze & Geiger, CVPR 2015.
    """
    error = pixels.error
    bad = {f"bad{threshold:g}": _percent(error > threshold) for threshold in THRESHOLDS}
    d1 = _percent((error > 3) & (error > 0.05 * np.abs(pixels.truth)))
    return {**bad, "d1": d1, **_quantiles(error, _QUANTILES)}


def _averages(error: Array) -> dict[str, float]:
    if not error.size:
        return {"avg": np.nan, "rms": np.nan}
    wide = error.astype(np.float64)
    return {"avg": float(wide.mean()), "rms": float(np.sqrt(np.mean(wide**2)))}


def _depth_errors(depth: Array, true_depth: Array) -> dict[str, float]:
    """Return errors of the depth (N,) where both disparities have one."""
    error = np.abs(depth - true_depth)
    there = np.isfinite(error)
    figures: dict[str, float] = {}
    for unit, values in (("m", error[there]), ("percent", 100 * error[there] / true_depth[there])):
        found = {"avg": _averages(values)["avg"], **_quantiles(values, (50, 90))}
        figures |= {f"z_{name}_{unit}": value for name, value in found.items()}
    return figures


def _within(pixels: _Pixels) -> dict[str, float]:
    """Return the percentages of errors within 1 and 2 sigma, of the pixels that have one."""
    assert pixels.sigma is not None
    predicted = np.isfinite(pixels.sigma)
    error, sigma = pixels.error[predicted], pixels.sigma[predicted]
    return {f"within{times}": _percent(error <= times * sigma) for times in (1, 2)}


def _by_class(valid: _Pixels) -> tuple[ClassErrors, ...]:
    """Return the errors of every confidence class that has pixels, the surest first."""
    if valid.confidence is None:
        return ()
    found = {kind.name.lower(): valid.where(valid.confidence == kind) for kind in sorted(Confidence, reverse=True)}
    return tuple(
        _of_class(name, members, len(members.error) / len(valid.error))
        for name, members in found.items()
        if len(members.error)
    )


def _of_class(name: str, members: _Pixels, share: float) -> ClassErrors:
    error, sigma = members.error, members.sigma
    known = sigma is not None and bool(np.isfinite(sigma).any())
    return ClassErrors(
        name,
        pixels=len(error),
        share=100 * share,
        error68=_quantiles(error, (_ONE_SIGMA,))[f"a{_ONE_SIGMA}"],
        bad1=_percent(error > 1),
        bad2=_percent(error > 2),
        sigma=float(np.nanmedian(sigma)) if sigma is not None and known else None,
        **(_within(members) if known else {}),
    )


def _percent(chosen: Array) -> float:
    return 100 * float(np.mean(chosen)) if chosen.size else np.nan


def _quantiles(values: Array, shares: Sequence[int]) -> dict[str, float]:
    """Return, as a50 and so on, the smallest of the values which that many percent do not exceed."""
    if not values.size:
        return {f"a{share}": np.nan for share in shares}
    places = [max(-(-share * values.size // 100) - 1, 0) for share in shares]
    sorted_there = np.partition(values, places)
    return {f"a{share}": float(sorted_there[place]) for share, place in zip(shares, places, strict=True)}


def _require_size(name: str, image: Array | None, disparity: Array) -> None:
    if image is None or image.shape == disparity.shape:
        return
    size, wanted = ("{1} × {0}".format(*array.shape) for array in (image, disparity))
    across, down = disparity.shape[1] / image.shape[1], disparity.shape[0] / image.shape[0]
    advice = ""
    if name == "truth" and abs(across / down - 1) < _SAME_VIEW:
        advice = f"; match images of that size, or make the truth {across:.4g} times as large and its values as well"
    raise InvalidInput(f"the {name} is {size}, the disparity map {wanted}; they must be the same{advice}")


def visible_in_both(truth: Array, right_truth: Array) -> Array:
    """Return where the truths of both images agree within a pixel (H, W), bool.

    truth, right_truth: (H, W) disparity of the left and the right image, pixels, NaN where unknown; both positive for
    what is in front of the cameras. A pixel whose counterpart is unknown or outside does not agree.
    Raises InvalidInput if the sizes differ.
    """
    if truth.shape != right_truth.shape:
        sizes = " and ".join("{1} × {0}".format(*image.shape) for image in (truth, right_truth))
        raise InvalidInput(f"the truths of the left and the right image are {sizes}; they must be the same size")
    column, inside = _counterparts(truth)
    there = np.take_along_axis(right_truth, column, axis=1)
    return np.asarray(inside & (np.abs(truth - there) <= _TOLERANCE))


def unoccluded(truth: Array) -> Array:
    """Return where nothing nearer lies before a pixel in the right image (H, W), bool, by the left truth alone.

    truth: (H, W) pixels, NaN where unknown. What is unknown hides nothing, so this finds less than `visible_in_both`.
    """
    column, inside = _counterparts(truth)
    height, width = truth.shape
    nearest = np.full(truth.size, -np.inf, truth.dtype)
    rows = np.broadcast_to(np.arange(height)[:, None] * width, truth.shape)[inside]
    exact = (np.arange(width) - truth)[inside]
    for side in (np.floor(exact), np.ceil(exact)):  # both, so that what is stretched in the right image has no gaps
        np.maximum.at(nearest, rows + side.astype(np.intp), truth[inside])
    found = np.take_along_axis(nearest.reshape(truth.shape), column, axis=1)
    return np.asarray(inside & (truth >= found - _TOLERANCE))


def _counterparts(truth: Array) -> tuple[Array, Array]:
    """Return the nearest column to the counterpart of each pixel in the right image, and which have one inside it."""
    width = truth.shape[1]
    exact = np.arange(width) - truth
    inside = (exact >= 0) & (exact <= width - 1)  # False for NaN
    return np.where(inside, np.rint(exact), 0).astype(np.intp), inside
