"""Corners that are wrong, not merely noisy: where a calibration must be refused, and what is likely to be wrong."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.outliers import row_medians
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.several_cameras import SMOOTH, TwoCameras, smoothness
from camcal.calibrate.words import names_of, px_words
from camcal.cameras.catalogue import WIDE_MODEL
from camcal.errors import InsufficientData
from camcal.targets.board_map import polynomial_terms

# A corner is wrong if it is off by more than this many pixels and this share of a square; a board, if the median corner
# is.
_GROSS_PX, _GROSS_SHARE = 1.0, 0.04
_MEDIAN_PX, _MEDIAN_SHARE = 0.5, 0.02
_WRONG_VIEW = 0.5  # of its corners
# Corner errors with one lens over those with two, beyond which two cameras are the reason: 2 of the smallest that is
# told, corners that are wrong by a share of a square are wrong by more.
_TWO_CAMERAS = 2.0
# The median corner's distance from a smooth map of its view, in squares: real boards, seen by any lens, stay below
# 0.04; corners numbered for another board are off by more than one.
_ROUGH, _DEGREE, _FEW = 0.3, 3, 16  # of the polynomial; corners of a view


@dataclass(frozen=True, eq=False)
class Misfit:
    """distances: (V, P) px between corners and their projections, inf without one. sides: (V,) px of a square.
    roughness: see `roughness`, where the median is too large; smoothness: of residuals, see `smoothness`, likewise.
    """

    distances: Array
    sides: Array
    present: Array
    roughness: float = np.nan
    smoothness: float = np.nan

    @property
    def gross(self) -> Array:
        """Which corners (V, P) are wrong."""
        limit = np.maximum(_GROSS_PX, _GROSS_SHARE * self.sides)[:, None]
        return np.asarray(self.present & (self.distances > limit))

    @property
    def medians(self) -> Array:
        """The median (V,) of the distances in every view."""
        return row_medians(self.distances, self.present)

    @property
    def median_px(self) -> float:
        """The median of the distances."""
        return float(np.median(self.distances[self.present]))

    @property
    def median_limit_px(self) -> float:
        """What the median may be, by the size of the squares in the images."""
        return max(_MEDIAN_PX, _MEDIAN_SHARE * float(np.median(np.repeat(self.sides, self.present.sum(axis=1)))))


def misfit(problem: BoardProblem, state: State, residuals: Array, present: Array) -> Misfit:
    """Return how far the corners are off at a solution; residuals: (2, V, P) px, NaN without an image."""
    axes = problem.board.pitch * problem.derivatives(state).by_board(state.rotations)[..., :2]
    areas = np.where(present, np.abs(np.linalg.det(axes)), np.nan)
    distances = np.where(np.isfinite(residuals).all(axis=0), np.hypot(*residuals), np.inf)
    found = Misfit(distances, np.sqrt(np.nanmedian(areas, axis=1)), present)
    if found.median_px > found.median_limit_px:
        smooth = smoothness(problem, state, present.astype(float))
        return replace(found, roughness=roughness(problem, present), smoothness=smooth)
    return found


def roughness(problem: BoardProblem, present: Array) -> float:
    """Return how far corners are from a polynomial map of degree 3, in squares: the median over views, NaN if none has
    enough corners. No lens matters here, only whether neighbours on the board are neighbours in the image.
    """
    points, seen = problem.board.points()[:, :2] / problem.board.pitch, problem.observations
    found = []
    for view in np.flatnonzero(present.sum(axis=1) >= _FEW):
        places, pixels = points[seen.ids[view, present[view]]], seen.pixels[:, view, present[view]].T
        terms = polynomial_terms((places - places.mean(axis=0)) / np.maximum(np.ptp(places, axis=0), 1.0), _DEGREE)
        left = pixels - terms @ np.linalg.lstsq(terms, pixels, rcond=None)[0]
        affine = np.column_stack([places, np.ones(len(places))])
        axes = np.linalg.lstsq(affine, pixels, rcond=None)[0][:2]
        found.append(np.median(np.hypot(*left.T)) / np.sqrt(max(abs(np.linalg.det(axes)), 1e-12)))
    return float(np.median(found)) if found else np.nan


def require_one_camera(cameras: TwoCameras | None, how: str = "the views do not fit together") -> None:
    """Raise InsufficientData where views are clearly those of two cameras; how: what is wrong, in words."""
    if cameras is not None and cameras.ratio >= _TWO_CAMERAS:
        raise InsufficientData(f"{how}: {cameras.words}")


def require_fit(
    found: Misfit, images: Sequence[str], most: float, model: str, cameras: TwoCameras | None = None
) -> None:
    """Raise InsufficientData where more than a share `most` of the corners are wrong, or the typical one is; images:
    the names of the views. cameras: the groups that they may fall into.
    """
    gross, total = found.gross, int(found.present.sum())
    share = float(gross.sum()) / total
    if share <= most and found.median_px <= found.median_limit_px:
        return
    how = (
        f"{int(gross.sum())} of {total} corners ({100 * share:.0f} %, limit {100 * most:g} %) are off by more than "
        f"{100 * _GROSS_SHARE:g} % of a square and {_GROSS_PX:g} px"
    )
    if np.isfinite(found.median_px):
        how += f", the median by {px_words(found.median_px)} (limit {px_words(found.median_limit_px)})"
    require_one_camera(cameras, how)
    wrong = gross.sum(axis=1) > _WRONG_VIEW * found.present.sum(axis=1)
    if 0 < wrong.sum() <= len(wrong) / 2 and gross[~wrong].sum() <= most * found.present[~wrong].sum():
        names = names_of([images[index] for index in np.flatnonzero(wrong).tolist()])
        raise InsufficientData(
            f"{how}: {int(wrong.sum())} of {len(wrong)} views do not fit the others (ids in another order, another "
            f"board or another camera): leave out {names}"
        )
    if found.median_px <= found.median_limit_px:
        raise InsufficientData(
            f"{how}: most corners fit, so board and lens model do; corners of many views are wrong: look at them with "
            "camcal detect --draw, use sharper images, or let them be rejected with --max-rejected"
        )
    order = "corners are in the order of the board"
    if found.roughness <= _ROUGH and found.smoothness > SMOOTH:
        raise InsufficientData(
            f"{how}: {order} and errors are smooth over it, so the lens model ({model}) is wrong: try another --model "
            f"({WIDE_MODEL} for wide lenses), or none"
        )
    if found.roughness <= _ROUGH and found.smoothness > 0:
        raise InsufficientData(
            f"{how}: {order} and errors are random, as in blurred images: use sharper images, and look at the corners "
            "with camcal detect --draw"
        )
    if found.roughness <= _ROUGH:
        raise InsufficientData(
            f"{how}: {order}, so the lens model ({model}) is wrong, or images are "
            f"blurred: try another --model ({WIDE_MODEL} for wide lenses), or none, and use sharper images"
        )
    raise InsufficientData(
        f"{how}: the board is not the one that --board describes, several cameras are mixed, or the lens model "
        f"({model}) is wrong: check columns, rows and type of the board, and calibrate each camera by itself"
    )
