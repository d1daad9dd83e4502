"""The images of a pair as they are matched, and their disparity; images that are not rectified are rectified first."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import floor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, PixelArray
from camcal.errors import InvalidInput
from camcal.images.files import load
from camcal.messages import Message
from camcal.raw.tiles import one_by_one
from camcal.run.process import over_threads
from camcal.stereo.disparity import Confidence, Disparity, too_few
from camcal.stereo.matching.learned import learned_disparity
from camcal.stereo.matching.match import match_prepared, within
from camcal.stereo.matching.preparation import Masks, prepare
from camcal.stereo.options import BEST, MatchOptions
from camcal.tasks.stereo.rectified_pair import RectifiedPair
from camcal.tasks.stereo.rig_pair import RigPair

_ADVICE = "an unrectified pair needs a rig file: camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml"
_BEHIND = 4  # pixels behind what is infinitely far, so that its matches are not at the end of the range
_UNRECTIFIED = ("rows_not_aligned", "swapped_images")  # failures that a rig file may mend


@dataclass(frozen=True, eq=False)
class PairImages:
    """The rectified images (H, W[, C]) of a pair and what is known of it.

    paths: of the left and the right image, in the order of the pair. image: the file of the rectified left image, None
    if it was rectified here. valid: masks of what they show, None for all of it.
    """

    paths: tuple[Path, Path]
    left: PixelArray
    right: PixelArray
    known: RectifiedPair
    image: Path | None = None
    valid: Masks | None = None


def read_pair(
    paths: Sequence[Path],
    rig: RigPair | None,
    known_of: Callable[[tuple[int, int]], RectifiedPair] = lambda _size: RectifiedPair(None),
) -> PairImages:
    """Return the images of a pair, rectified if a rig is given; else known_of tells what is known for their size.

    Raises InvalidInput for images of another size than the cameras', FileError.
    """
    if rig is None:
        left, right = (load(path).pixels for path in paths)
        return PairImages((paths[0], paths[1]), left, right, known_of((left.shape[1], left.shape[0])), paths[0])
    ordered = rig.in_order(paths)
    return rectified_pair(ordered, load(ordered[0]).pixels, load(ordered[1]).pixels, rig)


def rectified_pair(paths: tuple[Path, Path], left: PixelArray, right: PixelArray, rig: RigPair) -> PairImages:
    """Return a pair rectified, its images in the order of the rectification; raises InvalidInput as `read_pair`."""
    images = []
    for path, pixels, maps in zip(paths, (left, right), (rig.maps.left, rig.maps.right), strict=True):
        try:
            images.append(maps.apply(pixels))
        except InvalidInput as error:
            raise InvalidInput(error.message, where=error.where or str(path)) from error
    return PairImages(paths, images[0], images[1], rig.known, valid=rig.maps.valid)


class Matched(NamedTuple):
    """A map, by how much the rows were aligned (px RMS), how many pixels show something, its warnings and failures."""

    disparity: Disparity
    rows: float
    pixels: int
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...]


def match_images(
    images: PairImages, matching: MatchOptions, model: Path | None = None, jobs: int | None = 1
) -> Matched:
    """Return the disparity of the left image; jobs: threads for one pair. model: a network in place of the matchers.

    Of a pair above each other the images are matched on their side, and the map is upright again.
    """
    left, right, valid, geometry = images.left, images.right, images.valid, images.known.geometry
    upright = geometry is not None and geometry.upright
    if upright:
        left, right = (_transposed(image) for image in (left, right))
        valid = valid and (_transposed(valid[0]), _transposed(valid[1]))
    pixels = int(np.count_nonzero(valid[0])) if valid else left.shape[0] * left.shape[1]
    if model is not None:
        found = Matched(_by_network(left, right, model), 0.0, pixels, (), ())
    else:
        found = _match(left, right, matching, jobs, images)
    disparity = found.disparity
    if valid is not None:
        # that the range ends at what is infinitely far is no fault of the range
        disparity = replace(within(disparity, valid), at_ends=(0.0, disparity.at_ends[1]))
    if model is None:
        share = np.count_nonzero(disparity.confidence > Confidence.FILLED) / max(pixels, 1)
        found = found._replace(failures=found.failures + too_few(float(share), by_rig=images.valid is not None))
    if upright:
        parts = (disparity.values, disparity.sigma, disparity.confidence)
        values, sigma, confidence = (_transposed(part) for part in parts)
        disparity = replace(disparity, values=values, sigma=sigma, confidence=confidence)
    return found._replace(disparity=disparity, pixels=pixels)


def _transposed(image: Array) -> Array:
    return np.ascontiguousarray(image.swapaxes(0, 1))


def _match(left: Array, right: Array, matching: MatchOptions, jobs: int | None, images: PairImages) -> Matched:
    prepared = prepare(
        left,
        right,
        matching.search,
        align=matching.align_rows,
        expose=matching.expose_alike,
        farthest=images.known.farthest,
    )
    if images.valid is not None and matching.search is None:
        # the range ends at what is infinitely far: in images rectified here nothing is behind the cameras
        first = max(prepared.first, floor(images.known.farthest) - _BEHIND)
        prepared = replace(prepared, first=first, count=max(prepared.first + prepared.count - first, _BEHIND))
    if jobs != 1 and matching.quality == BEST:
        with over_threads(jobs) as each:
            disparity = match_prepared(prepared, matching, each)
    else:
        disparity = match_prepared(prepared, matching, one_by_one)
    failures = prepared.failures if images.known.geometry else tuple(map(_with_advice, prepared.failures))
    return Matched(disparity, prepared.rows, 0, prepared.warnings, failures)


def _with_advice(failure: Message) -> Message:
    """Return a failure of images without a camera file with what to do if they were never rectified."""
    return replace(failure, text=f"{failure.text}; {_ADVICE}") if failure.code in _UNRECTIFIED else failure


def _by_network(left: Array, right: Array, model: Path) -> Disparity:
    values = learned_disparity(left, right, model)
    known = np.isfinite(values)
    confidence = np.where(known, Confidence.SINGLE, Confidence.NONE)
    ends = (int(np.floor(values[known].min())), int(np.ceil(values[known].max()))) if known.any() else (0, 0)
    return Disparity(values, np.full_like(values, np.nan), confidence, ends)
