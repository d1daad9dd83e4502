"""Conditions under which a calibration is refused, with the likely cause.

Either corners are wrong, not merely noisy, or the observations cannot hold a calibration, however small the residuals
would be.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import FINEST, row_medians
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.several_cameras import SMOOTH, TwoCameras, smoothness
from camcal.calibrate.view_records import CellSums, names_of, px_words
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.messages import Message, Value
from camcal.targets.board import Board
from camcal.targets.board_map import polynomial_terms
from camcal.targets.detection import BoardDetection

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
ROUGH, _DEGREE, _FEW = 0.3, 3, 16  # of the polynomial; corners of a view
# What the residuals of different views have in common, over their own squares (0 to 0.1 of two cameras, above 0.9 of a
# lens model that does not fit), and its chance.
_SHARED = 0.5
_CHANCE = 0.05
_FARTHEST = 10.0  # medians: a corner counts with no more
_OUTWARDS = 0.8  # probability: wrong corners are anywhere (0.5), those that a lens model does not reach are outside (1)

MIN_VIEWS = 3
MIN_CORNERS = 6
SAME_VIEW_PX = 0.02  # detectors differ by more than this between two frames of a still camera
_MIN_TILT_SPREAD = np.radians(5.0)
_MAX_FOCAL_ERROR = 0.05


@dataclass(frozen=True, eq=False)
class Misfit:
    """distances: (V, P) px between corners and their projections, inf without one. sides: (V,) px of a square.
    roughness: see `roughness`, where too many corners are wrong or the median is too large; smoothness: of residuals,
    see `smoothness`, likewise: it tells a lens model that does not fit from corners that are wrong, and so does
    outwards: the probability that a wrong corner is farther from the principal point than one that is not, and shared:
    whether the residuals of different views are alike at the same place of the image.
    """

    distances: Array
    sides: Array
    present: Array
    roughness: float = np.nan
    smoothness: float = np.nan
    outwards: float = np.nan
    shared: bool = False

    @property
    def gross(self) -> Array:
        """Which corners (V, P) are wrong."""
        limit = np.maximum(_GROSS_PX, _GROSS_SHARE * self.sides)[:, None]
        return np.asarray(self.present & (self.distances > limit))

    @property
    def share(self) -> float:
        """The share of the corners that are wrong."""
        return float(self.gross.sum()) / int(self.present.sum())

    def fits(self, most: float) -> bool:
        """Whether no more than a share `most` of the corners are wrong, and the typical one is not."""
        return self.share <= most and self.median_px <= self.median_limit_px

    def may_be_mixed(self, most: float) -> bool:
        """Whether two cameras are a likely reason why views do not fit one lens."""
        return not self.fits(most) and self.roughness <= ROUGH and not self.of_lens

    @property
    def of_lens(self) -> bool:
        """Whether ids are consistent and wrong corners are far from the centre, as those are that a lens model does not
        reach, or views have the same residuals.
        """
        return self.roughness <= ROUGH and (self.outwards > _OUTWARDS or self.shared)

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


def misfit(problem: BoardProblem, state: State, residuals: Array, most: float = 1.0) -> Misfit:
    """Return how far the corners are off at a solution; residuals: (2, V, P) px, NaN without an image.

    most: the share of wrong corners beyond which it is asked why.
    """
    present = problem.observations.present
    posed = replace(problem, free=np.zeros(0, np.intp)).derivatives(state)  # those of the lens are not asked for
    axes = problem.board.spacing * posed.by_board(state.rotations)[..., :2]
    areas = np.abs(axes[..., 0, 0] * axes[..., 1, 1] - axes[..., 0, 1] * axes[..., 1, 0])
    areas = np.where(present, areas, np.nan)
    distances = np.where(np.isfinite(residuals).all(axis=0), np.hypot(*residuals), np.inf)
    found = Misfit(distances, np.sqrt(np.nanmedian(areas, axis=1)), present)
    if not found.fits(most):
        smooth = smoothness(problem, state, present.astype(float))
        centre = state.parameters[[problem.model.parameter_names.index(name) for name in ("cx", "cy")]]
        radii = np.hypot(*(problem.observations.pixels[:, present].T - centre).T)
        wrong, right = radii[found.gross[present]], np.sort(radii[~found.gross[present]])
        # Mann and Whitney, On a test of whether one of two random variables is stochastically larger, 1947
        outwards = float(np.searchsorted(right, wrong).mean() / len(right)) if len(wrong) and len(right) else np.nan
        # corners that are numbered otherwise point to the middle of their board, which views may have in common as well
        numbered = present & (distances < ROUGH * found.sides[:, None])
        shared = _are_alike(problem.observations.pixels, residuals, numbered)
        return replace(found, roughness=roughness(problem), smoothness=smooth, outwards=outwards, shared=shared)
    return found


def _are_alike(pixels: Array, residuals: Array, present: Array) -> bool:
    """Return whether residuals (2, V, P) of different views are alike at the same place of the image."""
    seen = present & np.isfinite(residuals).all(axis=0)
    if not seen.any():
        return False
    places, left = pixels[:, seen].T, residuals[:, seen].T
    length = np.hypot(*left.T)
    left = left * np.minimum(1.0, _FARTHEST * np.median(length) / np.maximum(length, FINEST))[:, None]
    width, height = (int(side) + 1 for side in places.max(axis=0))
    found = CellSums.of(places, left, np.nonzero(seen)[0], (width, height))
    return found.share > _SHARED and found.chance < _CHANCE


def roughness(problem: BoardProblem) -> float:
    """Return how far corners are from a polynomial map of degree 3, in squares: the median over views, NaN if none has
    enough corners. No lens matters here, only whether neighbours on the board are neighbours in the image.
    """
    points, seen = problem.board.points()[:, :2] / problem.board.spacing, problem.observations
    present, found = seen.present, []
    for view in np.flatnonzero(present.sum(axis=1) >= _FEW):
        places, pixels = points[seen.ids[view, present[view]]], seen.pixels[:, view, present[view]].T
        terms = polynomial_terms((places - places.mean(axis=0)) / np.maximum(np.ptp(places, axis=0), 1.0), _DEGREE)
        left = pixels - terms @ np.linalg.lstsq(terms, pixels, rcond=None)[0]
        affine = np.column_stack([places, np.ones(len(places))])
        axes = np.linalg.lstsq(affine, pixels, rcond=None)[0][:2]
        found.append(np.median(np.hypot(*left.T)) / np.sqrt(max(abs(np.linalg.det(axes)), 1e-12)))
    return float(np.median(found)) if found else np.nan


def require_one_camera(cameras: TwoCameras | None, how: str = "inconsistent views") -> None:
    """Raise InsufficientData where views are clearly those of two cameras; how: what is wrong, in words."""
    if cameras is not None and cameras.ratio >= _TWO_CAMERAS:
        raise _refused("views_of_two_cameras", f"{how}: {cameras.words}", {"ratio": cameras.ratio})


def require_fit(
    found: Misfit, images: Sequence[str], most: float, model: str, cameras: TwoCameras | None = None
) -> None:
    """Raise InsufficientData where more than a share `most` of the corners are wrong, or the typical one is; images:
    the names of the views. cameras: the groups that they may fall into.
    """
    gross, total, share = found.gross, int(found.present.sum()), found.share
    if found.fits(most):
        return
    how = (
        f"{int(gross.sum())} of {total} corners ({100 * share:.0f} %, limit {100 * most:g} %) are off by more than "
        f"{100 * _GROSS_SHARE:g} % of a square and {_GROSS_PX:g} px"
    )
    if np.isfinite(found.median_px):
        how += f", the median by {px_words(found.median_px)} (limit {px_words(found.median_limit_px)})"
    order = "corner ids are consistent"
    if found.of_lens:
        far = found.outwards > _OUTWARDS
        why = "the wrong ones are far from the image centre" if far else "residuals of different views are alike"
        text = f"{how}: {order} and {why}, so the lens model ({model}) does not fit"
        raise _refused("lens_model_does_not_fit", text)
    require_one_camera(cameras, how)
    wrong = gross.sum(axis=1) > _WRONG_VIEW * found.present.sum(axis=1)
    if 0 < wrong.sum() <= len(wrong) / 2 and gross[~wrong].sum() <= most * found.present[~wrong].sum():
        names = names_of([images[index] for index in np.flatnonzero(wrong).tolist()])
        text = f"{how}: {int(wrong.sum())} of {len(wrong)} views rejected (other order of ids, board or camera)"
        raise _refused("inconsistent_views", f"{text}: leave out {names}", {"views": int(wrong.sum())})
    if found.roughness <= ROUGH and found.smoothness > SMOOTH:
        text = f"{how}: {order} and residuals vary smoothly, so the lens model ({model}) does not fit"
        raise _refused("lens_model_does_not_fit", text)
    if found.median_px <= found.median_limit_px:
        text = "board and lens model fit most corners, but many views have wrong corners: check them with"
        text = f"{how}: {text} camcal detect --draw, use sharper images, or set --max-rejected"
        raise _refused("wrong_corners", text, {"share": share, "limit": most})
    if found.roughness <= ROUGH and found.smoothness > 0:
        text = (
            f"{how}: {order} and residuals are random, as in blurred images: use sharper images, and check the corners"
        )
        raise _refused("blurred_images", f"{text} with camcal detect --draw")
    if found.roughness <= ROUGH:
        text = f"{how}: {order}, so the lens model ({model}) does not fit, or images are blurred: use sharper images"
        raise _refused("lens_model_or_blur", text)
    text = (
        f"{how}: --board describes another board, several cameras are mixed, or the lens model ({model}) does not fit"
    )
    text = f"{text}: check columns, rows and type of the board, and calibrate each camera separately"
    raise _refused("board_does_not_fit", text)


def _refused(code: str, text: str, values: Mapping[str, Value] | None = None) -> InsufficientData:
    """Return the error of views that cannot be calibrated from, with the failure."""
    return InsufficientData(text, failures=[Message(code, text, values or {})])


def reason_unusable(view: BoardDetection, board: Board) -> str | None:
    """Return why a view's points cannot give a pose, or None if they can."""
    if not view.found:
        return view.reason or "no board found"
    if len(view.ids) < MIN_CORNERS:
        return f"only {len(view.ids)} corners, {MIN_CORNERS} are needed: show more of the board"
    places = board.points()[view.ids, :2] / board.spacing
    x, y = (places - places.mean(axis=0)).T
    if (x @ x) * (y @ y) - (x @ y) ** 2 < 1e-6:
        return "all corners are collinear: show more of the board"
    return None


def repeated(views: Sequence[BoardDetection]) -> dict[int, int]:
    """Return for each view (by index) that repeats an earlier one the index of that one."""
    tables: dict[bytes, list[tuple[int, Array]]] = {}
    for index, view in enumerate(views):
        order = np.argsort(view.ids, kind="stable")
        tables.setdefault(view.ids[order].tobytes(), []).append((index, view.pixels[order]))
    result: dict[int, int] = {}
    for table in tables.values():
        indices, pixels = np.array([index for index, _ in table]), np.stack([pixels for _, pixels in table])
        # repeats agree in their first corner, so only neighbours in its order need a closer look
        rank = np.argsort(pixels[:, 0, 0], kind="stable")
        ends = np.searchsorted(pixels[rank, 0, 0], pixels[rank, 0, 0] + SAME_VIEW_PX)
        for place in np.flatnonzero(ends > np.arange(len(rank)) + 1):
            near = rank[place + 1 : ends[place]]
            same = near[np.abs(pixels[near] - pixels[rank[place]]).max(axis=(1, 2)) < SAME_VIEW_PX]
            for pair in (np.sort(indices[[rank[place], other]]) for other in same):
                result[int(pair[1])] = min(int(pair[0]), result.get(int(pair[1]), int(pair[0])))
    return result


def usable_views(detections: Sequence[BoardDetection], board: Board) -> tuple[tuple[int, int], list[str | None]]:
    """Return the image size of the majority and, for every view, why it cannot be used (None if it can)."""
    reasons = [reason_unusable(view, board) for view in detections]
    sizes = Counter(view.size for view, reason in zip(detections, reasons, strict=True) if reason is None)
    if not sizes:
        require_views(0, len(detections), 0)
    size = sizes.most_common(1)[0][0]
    for index, view in enumerate(detections):
        if reasons[index] is None and view.size != size:
            reasons[index] = (
                f"image {view.size[0]}x{view.size[1]} differs from the others' {size[0]}x{size[1]}: see --mixed-sizes"
            )
    usable = [index for index, reason in enumerate(reasons) if reason is None]
    repeats = repeated([detections[index] for index in usable])
    for index, first in repeats.items():
        reasons[usable[index]] = (
            f"duplicate of {detections[usable[first]].image} (all corners within {SAME_VIEW_PX:g} px)"
        )
    require_views(len(usable) - len(repeats), len(detections), len(repeats))
    return size, reasons


def require_views(usable: int, total: int, repeats: int) -> None:
    """Raise InsufficientData unless at least MIN_VIEWS views that differ are at hand."""
    if usable < MIN_VIEWS:
        aside = f" ({repeats} more are duplicates)" if repeats else ""
        text = (
            f"{usable} usable view{'s' * (usable != 1)}{aside} of {total}, at least {MIN_VIEWS} different ones are "
            "needed; take more images with the board tilted in different directions (camcal detect lists why others "
            "are not used)"
        )
        raise _refused("too_few_views", text, {"views": usable, "limit": MIN_VIEWS})


def tilt_spread(rotations: Array) -> float:
    """Return the largest angle (rad) between the board's normals of any view and their mean direction."""
    normals = rotations[:, :, 2]
    mean = normals.mean(axis=0)
    cosines = normals @ (mean / max(float(np.linalg.norm(mean)), 1e-12))
    return float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))


def require_tilts(rotations: Array) -> None:
    """Raise InsufficientData when the board was never tilted: focal length and distance then trade freely."""
    spread = tilt_spread(rotations)
    if spread < _MIN_TILT_SPREAD:
        text = (
            f"nearly parallel views (board tilts below {np.degrees(_MIN_TILT_SPREAD):.0f}°): focal length and distance "
            "are not separable; add views tilted by 20° to 45° about both axes, or give a known lens with --guess and "
            "--fix fx,fy"
        )
        raise _refused("no_tilted_views", text, {"tilt_deg": float(np.degrees(spread))})


def require_focal(focal: float, std: float) -> None:
    """Raise InsufficientData when the focal length (px) is not determined to better than a twentieth."""
    if not std < _MAX_FOCAL_ERROR * focal:
        text = f"focal length not determined by the views ({focal:.0f} ± {std:.0f} px)"
        values = {"focal_px": focal, "std_px": std}
        advice = "add views tilted by 20° to 45° about both axes"
        raise _refused("undetermined_focal_length", f"{text}: {advice}", values)
