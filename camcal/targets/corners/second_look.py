"""A board looked at once more, by who knows the lens and where the board is: corners that were found are measured again
along the edges as the lens bends them, corners that were missed are looked for where they must be.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, readonly
from camcal.targets.corners.cells import Cells
from camcal.targets.corners.measure import blur_of, clear
from camcal.targets.corners.refine import refine
from camcal.targets.detection import Detection
from camcal.targets.samples import Samples

_SURE = 3.0  # times the median of the noise and of the blur that a corner nobody had found may have
_FAINT = 0.3  # of the median contrast that it must have
_OFF = 0.15  # steps from where it must be, or
_OFF_PX = 1.0
_DRAWN = 0.5  # px that a corner which was found may move: further, it was another


@dataclass(frozen=True, eq=False)
class Expected:
    """What a calibration expects of an image: the pixels (C, 2) of all points of the board and their cells.

    inside: (C,) which of them are in the image, with room for a window. signs: (C,) see board_edges.signs.
    """

    pixels: Array
    cells: Cells
    inside: Array
    signs: Array

    def __post_init__(self) -> None:
        count = len(self.cells)
        object.__setattr__(self, "pixels", readonly(self.pixels, (count, 2), "pixels"))
        object.__setattr__(self, "inside", readonly(self.inside, (count,), "inside", np.bool_))
        object.__setattr__(self, "signs", readonly(self.signs, (count,), "signs"))


def look_again(samples: Samples, view: Detection, expected: Expected) -> Detection:
    """Return a view of a board that has been calibrated with, its corners measured again and those that were missed
    added; as it was where none is seen again. Corners that the model does not bear out, along the edges that are
    expected, are left out.
    """
    ids, pixels = view.ids, view.pixels
    start = expected.pixels.copy()
    start[ids] = pixels
    known = np.zeros(len(start), np.bool_)
    known[ids] = True
    chosen = np.flatnonzero((known | expected.inside) & np.isfinite(expected.cells.bends).all(axis=1))
    blur = blur_of(samples.values, pixels)
    corners = refine(samples.values, start[chosen], expected.cells.take(chosen), blur, samples.sites)
    good = clear(corners)
    contrast = np.where(good, corners.contrast * expected.signs[chosen], 0.0)
    good &= contrast * np.sign(contrast[known[chosen]].sum()) > 0
    moved = np.linalg.norm(corners.pixels - start[chosen], axis=1)
    before = good & known[chosen] & (moved < _DRAWN)
    if not before.any():
        return view
    step = np.linalg.norm(expected.cells.steps[chosen], axis=1).min(axis=1)
    fresh = good & ~known[chosen] & (moved < np.maximum(_OFF * step, _OFF_PX))
    fresh &= np.abs(contrast) > _FAINT * np.median(np.abs(contrast[before]))
    fresh &= corners.noise < _SURE * np.median(corners.noise[before])
    fresh &= (corners.blur < _SURE * np.median(corners.blur[before])).all(axis=1)
    kept = before | fresh
    return replace(view, ids=chosen[kept], pixels=corners.pixels[kept], covariance=corners.covariance[kept])
