"""A pair made ready to be matched: gray, of one exposure, its rows aligned, and the range to look through."""

from dataclasses import dataclass, replace

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.stereo.matching.gray import GrayPair, gray_pair
from camcal.stereo.pair.alignment import Residual, align_rows, quick_residual, row_correction
from camcal.stereo.pair.coarse import CoarseMap, coarse_map, default_range, range_in
from camcal.stereo.pair.pair_check import FINDINGS, SWAPPED, finding_of

_FEWEST = 4  # disparities; with fewer there is nothing between them
_WIDEST = 1 << 14


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is matched.

    first, count: the smallest disparity to look for, pixels, and how many. rows: of the right image, px RMS, by which
    they were put right; 0 if they were not. remarks: what whoever asked should know. failures: why it is no pair.
    """

    pair: GrayPair
    first: int
    count: int
    rows: float
    remarks: tuple[str, ...]
    failures: tuple[str, ...] = ()


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
    pair = gray_pair(left, right, expose=expose)
    coarse = coarse_map(pair.left, pair.right) if align or search is None else None
    residual = _residual(pair, coarse) if align else None
    remarks, failures = list[str](), list[str]()
    if residual is not None and not (coarse is not None and coarse.periodic):
        behind = farthest if search is None else min(farthest, search[0])
        finding = finding_of(residual, behind)
        failures += [FINDINGS[finding]] if finding else []
    rows = 0.0
    if residual is not None:
        try:
            pair, rows = _aligned(pair, residual)
        except InvalidInput as error:
            failures.append(error.message)
    if search is None:
        found = None if coarse is None else range_in(coarse, pair.left.shape[1])
        search = found or default_range(pair.left.shape[1])
        if search[1] <= farthest and FINDINGS[SWAPPED] not in failures:
            failures.append(FINDINGS[SWAPPED])
        if found is None:
            why = "periodic texture: " if coarse is not None and coarse.periodic and not failures else ""
            remarks.append(f"{why}the images do not tell the range of disparities; taken is {search[0]} to {search[1]}")
    return Prepared(pair, *_range(search), rows, tuple(remarks), tuple(failures))


def _range(search: tuple[int, int]) -> tuple[int, int]:
    """Return the first disparity and their number."""
    first, last = search
    if first > last:
        raise InvalidInput(f"the range {first} to {last} is empty; write the smallest disparity first")
    if max(abs(first), abs(last)) > _WIDEST:
        raise InvalidInput(f"a range of {first} to {last} px is wider than any image")
    return first, max(last - first + 1, _FEWEST)


def _residual(pair: GrayPair, coarse: CoarseMap | None) -> Residual | None:
    """Return how far the rows are off, None where the images do not tell."""
    try:
        return quick_residual(pair.left, pair.right, None if coarse is None else coarse.disparities)
    except InsufficientData:
        return None


def _aligned(pair: GrayPair, residual: Residual) -> tuple[GrayPair, float]:
    """Return the pair with its rows put right, and by how many pixels (RMS); see `row_correction`."""
    correction = row_correction(residual)
    if correction is None:
        return pair, 0.0
    right, deep = (align_rows(image, correction) for image in (pair.right, pair.deep_right))
    return replace(pair, right=right, deep_right=deep), residual.trend.rms
