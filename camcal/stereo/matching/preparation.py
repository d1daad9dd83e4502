"""A pair made ready to be matched: gray, of one exposure, its rows aligned, and the range to look through."""

from dataclasses import dataclass, replace

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.stereo.matching.gray import GrayPair, gray_pair
from camcal.stereo.pair.alignment import Residual, align_rows, quick_residual, row_correction
from camcal.stereo.pair.coarse import coarse_map
from camcal.stereo.pair.pair_order import FINDINGS, SWAPPED, finding_of
from camcal.stereo.pair.search_range import default_range, range_in

_FEWEST = 4  # disparities; with fewer there is nothing between them
_WIDEST = 1 << 14


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is matched.

    first, count: the smallest disparity to look for, pixels, and how many. rows: of the right image, px RMS, by which
    they were put right; 0 if they were not. remarks: what whoever asked should know.
    """

    pair: GrayPair
    first: int
    count: int
    rows: float
    remarks: tuple[str, ...]


def prepare(
    left: Array, right: Array, search: tuple[int, int] | None = None, *, align: bool = True, expose: bool = True
) -> Prepared:
    """Return a pair ready to be matched.

    left, right: (H, W), (H, W, 3) BGR or (H, W, 4), uint8, uint16 or float32. search: smallest and largest disparity,
    pixels, None for what the images show. align: put the rows right if they are measurably off. expose: bring the
    right image to the left one's exposure.
    Raises InvalidInput for images of different sizes, and for a range that is empty or wider than any image.
    """
    pair = gray_pair(left, right, expose=expose)
    coarse = coarse_map(pair.left, pair.right) if align or search is None else None
    residual = _residual(pair, coarse) if align else None
    rows, remarks = 0.0, list[str]()
    if residual is not None:
        pair, rows, remarks = _aligned(pair, residual)
    if search is None:
        found = None if coarse is None else range_in(coarse, pair.left.shape[1])
        search = found or default_range(pair.left.shape[1])
        if search[1] <= 0 and FINDINGS[SWAPPED] not in remarks:
            remarks.append(FINDINGS[SWAPPED])
        if found is None:
            remarks.append(f"the images do not tell the range of disparities; taken is {search[0]} to {search[1]}")
    return Prepared(pair, *_range(search), rows, tuple(remarks))


def _range(search: tuple[int, int]) -> tuple[int, int]:
    """Return the first disparity and their number."""
    first, last = search
    if first > last:
        raise InvalidInput(f"the range {first} to {last} is empty; write the smallest disparity first")
    if max(abs(first), abs(last)) > _WIDEST:
        raise InvalidInput(f"a range of {first} to {last} px is wider than any image")
    return first, max(last - first + 1, _FEWEST)


def _residual(pair: GrayPair, coarse: Array | None) -> Residual | None:
    """Return how far the rows are off, None where the images do not tell."""
    try:
        return quick_residual(pair.left, pair.right, coarse)
    except InsufficientData:
        return None


def _aligned(pair: GrayPair, residual: Residual) -> tuple[GrayPair, float, list[str]]:
    """Return the pair with its rows put right, by how many pixels (RMS), and what there is to say of it."""
    finding = finding_of(residual)
    remarks = [FINDINGS[finding]] if finding else []
    try:
        correction = row_correction(residual)
    except InvalidInput as error:
        return pair, 0.0, [*remarks, error.message]
    if correction is None:
        return pair, 0.0, remarks
    right, deep = (align_rows(image, correction) for image in (pair.right, pair.deep_right))
    return replace(pair, right=right, deep_right=deep), residual.trend.rms, remarks
