"""What is weak about a calibration, in plain words, and whether it must not be trusted."""

from dataclasses import dataclass

import numpy as np

from camcal.calibrate.degeneracy import tilt_spread
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.validity import folds_inside
from camcal.quality.coverage import coverage, radial_trend
from camcal.targets.boards.types import BOARD_TYPES


@dataclass(frozen=True)
class Advice:
    """reasons: why the result must not be trusted (none: it may be). remarks: what is weak but usable."""

    reasons: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def trustworthy(self) -> bool:
        return not self.reasons


def advise(calibration: Calibration) -> Advice:
    """Return what a careful engineer would say of a calibration on seeing its numbers."""
    reasons = [*_lens_reasons(calibration), *_focal_reasons(calibration)]
    remarks = [*_view_remarks(calibration), *_noise_remarks(calibration), *_board_remarks(calibration)]
    return Advice(tuple(reasons), tuple(remarks))


def misfits(calibration: Calibration) -> bool:
    """Return whether the residuals follow the distance from the centre: the lens model is too poor for the lens."""
    trend = radial_trend(calibration)
    return trend.chance < 1e-6 and abs(trend.largest_px) > 0.3 * calibration.sigma_px


def _lens_reasons(calibration: Calibration) -> list[str]:
    result = []
    fold = folds_inside(calibration.camera)
    if fold.folds:
        result.append(
            f"distortion is not invertible beyond {fold.radius_px:.0f} px from the centre; "
            f"the image corner is at {fold.corner_px:.0f} px: use fewer coefficients or cover the corners"
        )
    if misfits(calibration):
        trend = radial_trend(calibration)
        way = "outwards" if trend.largest_px > 0 else "inwards"
        result.append(
            f"residuals point {way} by {abs(trend.largest_px):.2f} px at {trend.ring[0]:.0f} to {trend.ring[1]:.0f} px "
            f"from the centre: {calibration.camera.model.name} does not describe this lens; "
            "try opencv8, or kannala_brandt4 for a wide one"
        )
    return result


def _focal_reasons(calibration: Calibration) -> list[str]:
    camera = calibration.camera
    share = max((camera.std(name) or 0.0) / camera.value(name) for name in ("fx", "fy"))
    if share > 0.01:
        return [
            f"the focal length is known to {100 * share:.1f} % only: add views tilted by 20° to 45° about both axes"
        ]
    return []


def _view_remarks(calibration: Calibration) -> list[str]:
    result, views = [], calibration.used
    if len(views) < 10:
        result.append(f"{len(views)} views are few; 15 to 40 in varied positions are better")
    spread = tilt_spread(np.stack([view.camera_T_board.rotation for view in views if view.camera_T_board]))
    if spread < np.radians(15):
        result.append(f"the board was tilted by {np.degrees(spread):.0f}° at most; 30° to 45° fix the focal length")
    seen = coverage(calibration)
    if seen.reach < 0.8:
        result.append(
            f"no corner lies beyond {100 * seen.reach:.0f} % of the way to the image corner: "
            "the lens is extrapolated there"
        )
    elif seen.cells < 0.6:
        result.append(f"only {100 * seen.cells:.0f} % of the image was covered by the board")
    return result


def _noise_remarks(calibration: Calibration) -> list[str]:
    result = []
    if calibration.sigma_px > 0.5:
        result.append(
            f"corners scatter by {calibration.sigma_px:.2f} px, where 0.1 px is usual: "
            "blur, a wrong lens model or a wrong board"
        )
    total = sum(view.points for view in calibration.views if view.kept)
    if calibration.rejected and len(calibration.rejected) > 0.02 * total:
        result.append(f"{len(calibration.rejected)} corners ({100 * len(calibration.rejected) / total:.1f} %) rejected")
    return result


def _board_remarks(calibration: Calibration) -> list[str]:
    result, surface, board = [], calibration.surface, calibration.board
    if board.square is None:
        result.append(f"the {BOARD_TYPES[board.type].element}'s size is unknown: every length is in squares")
    if surface.deflection > 3 * surface.deflection_std and surface.deflection > 0.002 * max(board.extent):
        millimetres = f"{1e3 * surface.deflection:.2f} mm" if board.unit == "m" else f"{surface.deflection:.3f} squares"
        result.append(f"the board is bent by {millimetres}: accounted for, but a stiffer board is better")
    for (term, focal), value in calibration.correlations.items():
        if abs(value) > 0.9:
            result.append(
                f"{term} of the board and {focal} are correlated by {value:+.2f}: turn the board in some views"
            )
    return result
