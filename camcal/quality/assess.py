"""The assessment of a calibration: warnings where it is weak, failures where it must not be trusted.

The criteria of criteria.py are applied; coverage is where in the image the corners were, and whether the residuals
depend on it.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from statistics import NormalDist

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.calibrate.view_records import CELLS, cell_numbers, names_of
from camcal.cameras.directions import lens_difference
from camcal.cameras.spline import SplinedStereographic
from camcal.cameras.validity import ImageCircle, folds_inside
from camcal.dataclass import dataclass, replace
from camcal.messages import Message, counted
from camcal.quality.criteria import CRITERIA, KNOWN_PX, between_views, largest_tilt_deg, message
from camcal.quality.lens_choice import Pattern, better_model, find_patterns, other_models
from camcal.quality.projection_uncertainty import (
    KnownRegion,
    ProjectionUncertainty,
    known_region,
    projection_uncertainty,
    with_bias,
)
from camcal.records import Brief
from camcal.targets.board_types import BOARD_TYPES

# Views: a standard deviation from the scatter of fewer is not well known itself, and counts by the half width of its
# interval of this probability under Student's distribution, over that under the normal one.
_FEW_FOR_SCATTER, _INTERVAL = 10, 0.95
# Failures, and what they explain: what would be said of it beside them would lead astray.
_OF_VIEWS = ("focal_change", "focal_varies", "two_boards", "motion_blur", "rolling_shutter", "board_bends")
_EXPLAINED = {
    "several_cameras": (*_OF_VIEWS, "lens_model", "residual_pattern", "known_region"),
    "several_cameras_by_name": (*_OF_VIEWS, "lens_model", "residual_pattern", "known_region"),
    **dict.fromkeys(("not_invertible", "lens_model"), ("known_region",)),
    "focal_change": ("known_region", "rolling_shutter", "board_bends", "motion_blur"),
    "known_region": ("tilt",),
    "board_scale": ("board_size",),
}
_NO_RAY = 0.01  # of the image diagonal: standard deviation that a pixel counts with for which the lens has no ray
_EXACT_PX = 1e-6  # what a projection is known to at best, where all parameters are held
_MOSTLY = 0.5  # of a view's corners
_TILTED_DEG = 20.0  # of the board in some view: beyond it, more tilt is not what is missing
_BOARD_LENGTHS = (1e-3, CRITERIA["board_scale"].limit)  # m, between targets of microscopes and sides of buildings


@dataclass(frozen=True, eq=False)
class Assessment(Brief):
    """failures: why a calibration must not be trusted (none: it may be, within the region). warnings: what is weak.

    uncertainty: of projections, what the residuals and a better lens model say against the one in use included.
    """

    failures: tuple[Message, ...]
    warnings: tuple[Message, ...]
    uncertainty: ProjectionUncertainty
    region: KnownRegion

    @property
    def messages(self) -> tuple[Message, ...]:
        """All of them, failures first."""
        return self.failures + self.warnings

    @property
    def trustworthy(self) -> bool:
        return not self.failures


def assess(
    calibration: Calibration, circle: ImageCircle | None = None, candidates: Sequence[CandidateModel] = ()
) -> Assessment:
    """Return the failures and warnings of a calibration by all criteria.

    circle: the image circle, where there is one: the lens is not assessed outside of it. candidates: other lens models
    that were tried, in their order, which are named where the one in use does not do; the one in use may be among them.
    """
    camera = calibration.camera
    uncertainty = projection_uncertainty(camera, observed=calibration.pixels, circle=circle)
    stated_px = uncertainty.figures().get("inside_rms_px", 0.0)
    patterns = find_patterns(calibration, uncertainty.pixels, stated_px)
    if patterns:
        uncertainty = with_bias(uncertainty, patterns[-1].bias)
    bias, better = np.zeros((len(uncertainty.pixels), 2)), better_model(camera.model.name, candidates)
    if better is not None and better.calibration is not None:
        bias = lens_difference(camera, better.calibration.camera, uncertainty.pixels, uncertainty.inside)
        uncertainty = with_bias(uncertainty, bias)
    region = known_region(uncertainty, KNOWN_PX / _few_views_factor(len(calibration.used)))
    others = other_models(camera.model.name, candidates)
    # where the map states too much, a change of the focal length may be the cause, and is not measured by it
    excused = better is not None or region.of_observed >= _limit("known_region")
    allowed_px = stated_px if excused else 0.0
    parts = (
        partial(_fold, circle=circle, others=others),
        _cameras,
        partial(_lens_model, patterns=patterns, stated_px=stated_px, others=others),
        partial(_better_model, better=better, candidates=candidates, bias=bias[uncertainty.inside]),
        _views,
        partial(_coverage, circle=circle),
        _noise,
        _within_views,
        partial(between_views, stated_px=allowed_px),
        _plausible,
        _board,
        partial(_region, region=region, others=others),
    )
    found = [message for part in parts for message in part(calibration)]
    explained = {code for message in found for code in _EXPLAINED.get(message.code, ())}
    found = [message for message in found if message.code not in explained]
    return Assessment(
        failures=tuple(message for message in found if CRITERIA[message.code].failure),
        warnings=tuple(message for message in found if not CRITERIA[message.code].failure),
        uncertainty=uncertainty,
        region=region,
    )


def judge(candidates: Sequence[CandidateModel], circle: ImageCircle | None = None) -> tuple[CandidateModel, ...]:
    """Return the candidates with what the verdict would be on their brief calibrations; circle: the image circle."""
    return tuple(own if own.scores is None else _judge_one(own, circle) for own in candidates)


def _judge_one(own: CandidateModel, circle: ImageCircle | None) -> CandidateModel:
    if own.calibration is None:
        return own
    assessment, size = assess(own.calibration, circle), own.calibration.camera.image_size
    found = assessment.uncertainty
    lit = found.std_rms if circle is None else found.std_rms[circle.contains(found.pixels)]
    std = np.where(np.isfinite(lit), lit, _NO_RAY * float(np.hypot(*size)))
    failures = tuple(message.code for message in assessment.failures)
    pattern = any(message.code in ("lens_model", "residual_pattern") for message in assessment.messages)
    return replace(own, map_px=float(np.sqrt(np.mean(std**2))), failures=failures, pattern=pattern)


def _limit(code: str) -> float:
    return CRITERIA[code].limit


def _fold(calibration: Calibration, circle: ImageCircle | None, others: str) -> Iterator[Message]:
    fold = folds_inside(calibration.camera, circle)
    if not fold.folds or fold.radius_px >= _limit("partly_invertible") * fold.corner_px:
        return
    centre = [calibration.camera.value("cx"), calibration.camera.value("cy")]
    outermost = float(np.linalg.norm(calibration.pixels - centre, axis=1).max())
    end, edges = (
        ("image corner", "in the image corners") if circle is None else ("end of the image circle", "at its edge")
    )
    where = f"beyond {fold.radius_px:.0f} px from the centre; the {end} is at {fold.corner_px:.0f} px"
    # a spline ends near its corners and does not bend before that
    spline = isinstance(calibration.camera.model, SplinedStereographic)
    if fold.radius_px < outermost * (1.0 if spline else _limit("not_invertible")):
        text = f"distortion is not invertible {where}: {others or f'add views with the board {edges}'}"
        yield message("not_invertible", text, fold.radius_px / outermost)
    else:
        text = f"distortion is not invertible {where}: pixels there are masked; add views with the board there"
        yield message("partly_invertible", text, fold.radius_px / fold.corner_px)


def _cameras(calibration: Calibration) -> Iterator[Message]:
    found, rolling = calibration.two_cameras, calibration.within_views.rolling_px
    if found is None:
        return
    if rolling is not None and not found.by_name and rolling[0] > found.other_px:
        return  # a few views that a rolling shutter has bent alike seem to have a lens of their own
    code = "several_cameras_by_name" if found.by_name else "several_cameras"
    if found.ratio > _limit(code) and found.other_px > CRITERIA[code].minimum_px:
        together = ", or both together with 'camcal rig'" if found.by_name else ""
        yield message(code, f"{found.words}{together}", found.ratio, found.groups[1])


def _lens_model(
    calibration: Calibration, patterns: Sequence[Pattern], stated_px: float, others: str
) -> Iterator[Message]:
    """Yield that residuals depend on the place in the image: a failure where that is more than the uncertainty of the
    map says, else a warning.
    """
    name = calibration.camera.model.name
    least = max(_limit("residual_pattern") * calibration.sigma_px, CRITERIA["residual_pattern"].minimum_px)
    most = max(_limit("lens_model") * stated_px, CRITERIA["lens_model"].minimum_px)
    found = sorted((each for each in patterns if each.largest_px > least), key=lambda each: each.largest_px <= most)
    if not found:
        return
    size = found[0].largest_px
    if size > most:
        text = f"{found[0].words}: {name} does not fit this lens" + (
            f"; {others}" if others else ", try another --model"
        )
        yield message("lens_model", text, size / max(stated_px, _EXACT_PX))
    else:
        text = f"{found[0].words}: included in the projection uncertainty"
        yield message("residual_pattern", text, size / calibration.sigma_px)


def _better_model(
    calibration: Calibration, better: CandidateModel | None, candidates: Sequence[CandidateModel], bias: Array
) -> Iterator[Message]:
    """Yield which lens model predicts better and by how much the two differ: bias (N, 2) px where corners were seen."""
    if better is None:
        return
    own = next(each for each in candidates if each.name == calibration.camera.model.name)
    apart = float(np.sqrt(np.nanmean(np.sum(bias**2, axis=1))))
    text = (
        f"{better.name} predicts left-out views better than {own.name} ({better.sigma_px:.2g} px, {own.sigma_px:.2g} "
        f"px); the two differ by {apart:.2g} px RMS, included in the projection uncertainty: use --model {better.name}"
    )
    yield message("better_model", text, better.score - own.score)


def _region(calibration: Calibration, region: KnownRegion, others: str) -> Iterator[Message]:
    if region.of_observed >= _limit("known_region"):
        return
    focal, std = calibration.camera.focal_lengths()
    share = float(np.max(std / focal))
    tilt, more = largest_tilt_deg(calibration), "add views with the board all over the image"
    remedy = others or (more if tilt > _TILTED_DEG else "add views tilted by 20° to 45° about both axes")
    text = (
        f"projection uncertainty below {region.limit_px:.2g} px in {100 * region.of_observed:.0f} % of the area with "
        f"corners (at least {100 * _limit('known_region'):.0f} % needed; focal length ± {100 * share:.2g} %, board "
        f"tilted by up to {tilt:.0f}°, {counted(len(calibration.used), 'view')}): {remedy}"
    )
    yield message("known_region", text, region.of_observed)


def _few_views_factor(count: int) -> float:
    """Return by how much wider an interval is where the standard deviation is from so many views, 1 for many."""
    if count >= _FEW_FOR_SCATTER:
        return 1.0
    from scipy.special import stdtrit  # here, as importing it takes longer than many commands

    quantile = (1 + _INTERVAL) / 2
    return float(stdtrit(max(count - 1, 1), quantile)) / NormalDist().inv_cdf(quantile)


def _views(calibration: Calibration) -> Iterator[Message]:
    views = calibration.used
    if len(views) < _limit("few_views"):
        text = f"{counted(len(views), 'view')} only: take 15 to 40 in varied positions"
        yield message("few_views", text, len(views))


def _coverage(calibration: Calibration, circle: ImageCircle | None) -> Iterator[Message]:
    cells, reach = coverage(calibration, circle)
    whole, edges = ("diagonal", "in the corners") if circle is None else ("circle", "at the edge of the circle")
    if reach < _limit("extrapolated"):
        text = (
            f"no corners beyond {100 * reach:.0f} % of the image {whole}: distortion is extrapolated there; add "
            f"views with the board {edges} of the image"
        )
        yield message("extrapolated", text, reach)
    elif cells < _limit("coverage"):
        text = f"corners cover {100 * cells:.0f} % of the image: add views with the board in the other parts"
        yield message("coverage", text, cells)


def _noise(calibration: Calibration) -> Iterator[Message]:
    if calibration.sigma_px > _limit("noise"):
        text = (
            f"residual noise {calibration.sigma_px:.2f} px (typical: 0.1 px): use sharper images, and check "
            "--board and --model"
        )
        yield message("noise", text, calibration.sigma_px)
    total = sum(view.points for view in calibration.views if view.used or view.rejected)
    if calibration.rejected and len(calibration.rejected) > _limit("rejected") * total:
        share = len(calibration.rejected) / total
        lost = Counter(corner.image for corner in calibration.rejected)
        # views that lost most of their corners are best left out
        worst = [view.image for view in calibration.views if lost[view.image] > _MOSTLY * max(view.points, 1)]
        remedy = f"leave out {names_of(worst)}" if worst else "check them with camcal detect --draw"
        text = f"{counted(len(calibration.rejected), 'corner')} ({100 * share:.1f} %) rejected: {remedy}"
        yield message("rejected", text, share)


def _within_views(calibration: Calibration) -> Iterator[Message]:
    errors, board = calibration.within_views, calibration.board
    if errors.rolling_px is not None and errors.rolling_px[0] > _limit("rolling_shutter"):
        text = (
            f"rolling shutter: {errors.rolling_px[0]:.2g} px over the image height (median): "
            "hold camera and board still, or use shorter exposures"
        )
        yield message("rolling_shutter", text, errors.rolling_px[0])
    if errors.flex is not None and errors.flex[0] > _limit("board_bends") * max(board.extent):
        share = errors.flex[0] / max(board.extent)
        text = f"board deformation between views {100 * share:.2g} % of its side: use a stiffer board"
        yield message("board_bends", text, share)


def _plausible(calibration: Calibration) -> Iterator[Message]:
    camera, board = calibration.camera, calibration.board
    least, most = _BOARD_LENGTHS
    if board.unit == "m" and not least < max(board.extent) < most:
        text = f"board length {max(board.extent):.3g} m: give the size of its squares with a unit, such as 25mm"
        yield message("board_scale", text, max(board.extent))
    if board.unit == "m" and max(board.extent) > _limit("board_size"):
        text = f"board length {max(board.extent):.3g} m: give --board with a unit, such as 25mm"
        yield message("board_size", text, max(board.extent))
    focal = camera.value("fx"), camera.value("fy")
    excess = max(focal) / min(focal) - 1
    if excess > _limit("focal_ratio"):
        text = (
            f"fx and fy differ by {100 * excess:.0f} %: use images that were not resized, or in proportion, and "
            "check that the board's squares are square"
        )
        yield message("focal_ratio", text, excess)
    size = np.array(camera.image_size)
    offset = np.abs(np.array([camera.value("cx"), camera.value("cy")]) - (size - 1) / 2) / size
    if offset.max() > _limit("principal_point"):
        text = (
            f"the principal point is {100 * offset.max():.0f} % of the image size from the image centre: "
            "if the image is not cropped, add views tilted by 20° to 45° about both axes"
        )
        yield message("principal_point", text, offset.max())


def _board(calibration: Calibration) -> Iterator[Message]:
    surface, board = calibration.surface, calibration.board
    if board.square is None:
        yield message(
            "unit",
            f"the {BOARD_TYPES[board.type].element} size is unknown, lengths are in squares: give it with --board",
            0.0,
        )
    share = surface.deflection / max(board.extent)
    if surface.deflection > 3 * surface.deflection_std and share > _limit("bent_board"):
        millimetres = f"{1e3 * surface.deflection:.2f} mm" if board.unit == "m" else f"{surface.deflection:.3f} squares"
        text = f"board deflection {millimetres}: estimated, but use a stiffer board"
        yield message("bent_board", text, share)
    for (term, focal), value in calibration.correlations.items():
        if abs(value) > _limit("correlation"):
            pair = f"{term} of the board and {focal}"
            text = f"{pair} strongly correlated (r = {value:+.2f}): rotate the board in some views"
            yield message("correlation", text, abs(value))


def coverage(calibration: Calibration, circle: ImageCircle | None = None) -> tuple[float, float]:
    """Return the share of a 10 × 8 grid of the image with a kept corner in it, and how far out corners reach.

    The reach is the largest distance of a corner from the principal point over that of the farthest image corner. Both
    are of what the image circle shows, where there is one.
    """
    width, height = calibration.camera.image_size
    pixels = calibration.pixels
    middles = (np.stack(np.meshgrid(*map(np.arange, CELLS), indexing="ij"), axis=-1) + 0.5) * [width, height] / CELLS
    covered = np.unique(cell_numbers(pixels, (width, height)))
    shown = np.ones(CELLS[0] * CELLS[1], bool) if circle is None else circle.contains(middles - 0.5).ravel()
    shown[covered] = True
    cells = len(covered) / np.count_nonzero(shown)
    corners = np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    centre = _centre(calibration)
    corners = corners if circle is None else circle.clipped(centre, corners)
    farthest = np.linalg.norm(corners - centre, axis=1).max()
    return cells, float(np.linalg.norm(pixels - centre, axis=1).max() / farthest)


def _centre(calibration: Calibration) -> Array:
    return np.array([calibration.camera.value("cx"), calibration.camera.value("cy")])
