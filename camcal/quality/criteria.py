"""The criteria of the verdict of a calibration: limit, failure or warning, and source of each.

A failure makes a result untrustworthy; a warning says what is weak but usable. Faults between views are found here:
focal length, board and sharpness that are not the same in all of them.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from camcal.calibrate.between_views import BetweenViews, Change
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.refusals import tilt_spread
from camcal.calibrate.view_records import names_of, shown_name
from camcal.dataclass import dataclass
from camcal.messages import Message, Value
from camcal.quality.lens_choice import GAIN

_SETS = "24 real sets, halves of them, and simulations"
_RULE = "usual practice"
# Standard deviations of the map, and px: a change of the focal length that moves corners by less, RMS, is what these
# state, or does not matter.
_STATED, _LEAST_MOVED_PX = 3.0, 0.3


@dataclass(frozen=True)
class Criterion:
    """One rule of the verdict.

    limit: beyond which it applies, in `unit`. minimum_px: however small the noise, less than this is not worth a word.
    source: where the limit is from.
    """

    code: str
    failure: bool
    limit: float
    unit: str
    means: str
    source: str
    minimum_px: float = 0.0


_ALL = (
    Criterion(
        "not_invertible",
        True,
        1.05,
        "distance to the outermost corner",
        "the distortion is invertible to less than this distance",
        _SETS,
    ),
    Criterion(
        "lens_model",
        True,
        3.0,
        "projection uncertainty",
        "the mean radial residual of a ring about the principal point exceeds this (RMS where corners were seen), with "
        "a significance of 1e-6, or the mean residual that views share in a cell of the image, with 1e-3",
        _SETS,
        minimum_px=0.3,
    ),
    Criterion(
        "known_region",
        True,
        0.5,
        "area with corners",
        "the share of it where the projection uncertainty is below 1 px in any direction (less by the ratio of "
        "Student's and the normal distribution with fewer than 10 views)",
        _SETS,
    ),
    Criterion(
        "several_cameras",
        True,
        1.4,
        "",
        "the ratio of reprojection errors with one lens to those with a lens for each of two groups of views, minus a "
        "standard error",
        "24 real sets of one camera (at most 1.31), 23 mixtures of similar cameras (19 above 1.5), and simulations",
        minimum_px=0.02,
    ),
    Criterion(
        "several_cameras_by_name",
        True,
        1.2,
        "",
        "the ratio of reprojection errors with one lens to those with a lens for each of two groups of file names, "
        "minus a standard error",
        "the same sets, split by the order of their views (at most 1.07)",
        minimum_px=0.02,
    ),
    Criterion(
        "focal_change",
        True,
        3.6,
        "standard deviations",
        "significance of a step or drift of the focal length between views, where half of it moves corners by more "
        "than 3 standard deviations of the projection uncertainty, unless known_region fails, and 0.3 px (RMS)",
        _SETS,
    ),
    Criterion(
        "partly_invertible",
        False,
        0.99,
        "distance to the image corner",
        "the distortion is invertible to less than this distance, but beyond all corners; pixels there are masked",
        _SETS,
    ),
    Criterion(
        "residual_pattern",
        False,
        0.3,
        "noise",
        "the same as lens_model, less than the projection uncertainty allows: included in it",
        _SETS,
        minimum_px=0.02,
    ),
    Criterion(
        "better_model",
        False,
        GAIN,
        "log likelihood of a corner",
        "another lens model, which passes, predicts left-out views better by this and 1.5 standard errors, or by 0.02 "
        "and 2.5: what the two differ by is included in the projection uncertainty",
        _SETS,
    ),
    Criterion("few_views", False, 10, "views", "fewer views than this", _RULE),
    Criterion("tilt", False, 15, "degrees", "the board was never tilted by more than this", _RULE),
    Criterion(
        "extrapolated", False, 0.8, "distance to the image corner", "no corner lies further out than this", _RULE
    ),
    Criterion("coverage", False, 0.6, "image", "the share of a 10 x 8 grid with a corner in it", _RULE),
    Criterion("noise", False, 0.5, "px", "the noise of a corner coordinate (0.1 px is usual)", _RULE),
    Criterion("rejected", False, 0.02, "corners", "the share of rejected corners", _RULE),
    Criterion(
        "rolling_shutter",
        False,
        0.5,
        "px",
        "the displacement between rows of a typical image by a rolling shutter",
        _SETS,
    ),
    Criterion(
        "board_bends",
        False,
        2e-4,
        "board's longer side",
        "the RMS height of the change of the board's shape between views",
        _SETS,
    ),
    Criterion(
        "focal_varies",
        False,
        3.0,
        "standard deviations",
        "significance of a different focal length of single views, or of a variation, step or drift below the limit of "
        "focal_change",
        _SETS,
        minimum_px=2.5,
    ),
    Criterion(
        "two_boards",
        False,
        3.7,
        "standard deviations",
        "significance of a change of the board between views; a change of single corners has a minimum RMS as well",
        _SETS,
        minimum_px=0.08,
    ),
    Criterion(
        "motion_blur",
        False,
        4.0,
        "ratio of variances",
        "the residual variance of a view in one direction over that across, and over that of a typical view; the "
        "standard deviation has a minimum as well",
        _SETS,
        minimum_px=0.1,
    ),
    Criterion("board_scale", True, 30.0, "m", "the longer side of the board is longer, or shorter than 1 mm", _RULE),
    Criterion("board_size", False, 3.0, "m", "the longer side of the board (given in mm?)", _RULE),
    Criterion("focal_ratio", False, 0.05, "", "the relative difference of fx and fy (pixels not square?)", _RULE),
    Criterion(
        "principal_point",
        False,
        0.15,
        "image size",
        "the distance of the principal point from the image centre (cropped image?)",
        _RULE,
    ),
    Criterion("unit", False, 0, "", "the metric size of the board is not known", _RULE),
    Criterion("bent_board", False, 0.002, "board's longer side", "the deflection of the board, if significant", _RULE),
    Criterion("correlation", False, 0.9, "", "the correlation of a scale of the board and a focal length", _RULE),
)
KNOWN_PX = 1.0  # standard deviation of a projection, in any direction, below which it is known
CRITERIA = {criterion.code: criterion for criterion in _ALL}


def message(code: str, text: str, value: float, images: Sequence[str] = ()) -> Message:
    """Return the message of a criterion that applies.

    text: what was found and what to do. value: what was found, in the criterion's unit. images: those concerned, none
    where it is all of them.
    """
    criterion = CRITERIA[code]
    values: dict[str, Value] = {"value": float(value), "limit": float(criterion.limit), "unit": criterion.unit}
    return Message(code, text, values | ({"images": tuple(images)} if images else {}))


def between_views(calibration: Calibration, stated_px: float) -> Iterator[Message]:
    """Yield what differs between views and ought to be the same, and whether the views are nearly parallel; stated_px:
    RMS standard deviation of projections where corners were seen, 0 where it is too large to excuse anything.
    """
    ratio = calibration.between_views.proportions
    for clear, focal in _focal_length(calibration, stated_px):
        # a board of other proportions resembles another focal length, which is less clear then
        if not _beyond("two_boards", ratio.clear) or clear > ratio.clear:
            yield focal
    yield from _boards(calibration.between_views)
    yield from _blur(calibration.between_views)
    spread = largest_tilt_deg(calibration)
    if spread < CRITERIA["tilt"].limit:
        text = f"largest board tilt {spread:.0f}°: tilt it by 30° to 45° to determine the focal length"
        yield message("tilt", text, spread)


def _beyond(code: str, clear: float, px: float = np.inf) -> bool:
    return clear > CRITERIA[code].limit and px > CRITERIA[code].minimum_px


def _focal_length(calibration: Calibration, stated_px: float) -> Iterator[tuple[float, Message]]:
    """Yield how clear a change of the focal length is, and the message about it."""
    found = calibration.between_views
    corner_px = float(np.hypot(*calibration.camera.image_size)) / 2
    offsets = calibration.pixels - [calibration.camera.value("cx"), calibration.camera.value("cy")]
    radius_px = float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))

    def applies(code: str, change: Change) -> bool:
        return _beyond(code, change.clear, abs(change.share) * corner_px)

    def moves_the_map(change: Change) -> bool:
        # the lens lies between those of the views, half the change from each
        return abs(change.share) / 2 * radius_px > max(_STATED * math.sqrt(2) * stated_px, _LEAST_MOVED_PX)

    step, drift, views, unordered = found.step, found.drift, found.outlying, found.unordered
    change = max(step, drift, key=lambda change: change.clear)
    words = _change_words(found, change)
    if applies("focal_change", change) and moves_the_map(change):
        yield change.clear, message("focal_change", f"the focal length {words}", change.clear, change.images)
    elif applies("focal_varies", views) and views.clear > change.clear:
        text = (
            f"the focal length of {names_of(views.images)} differs by {100 * views.share:+.2g} %: leave out "
            f"{_these(views.images)}, and lock focus and zoom"
        )
        yield views.clear, message("focal_varies", text, views.clear, views.images)
    elif applies("focal_varies", unordered) and unordered.clear > change.clear:
        text = (
            f"the focal length varies by {100 * unordered.share:.2g} % from view to view, possibly autofocus: lock "
            "focus and zoom, and take all images again"
        )
        yield unordered.clear, message("focal_varies", text, unordered.clear)
    elif applies("focal_varies", change):
        yield (
            change.clear,
            message("focal_varies", f"the focal length probably {words}", change.clear, change.images),
        )


def _change_words(found: BetweenViews, change: Change) -> str:
    """Return how the focal length changes, by the step or by the drift of what was found, and what to do."""
    if change is not found.drift:
        return (
            f"changes by {100 * change.share:+.2g} % {_near(change.images)}: lock focus and zoom and take all "
            f"images again, or {_by_themselves(found.images, change.images)}"
        )
    where = f" from {shown_name(change.images[0])} to {shown_name(change.images[-1])}" if change.images else ""
    return (
        f"drifts by {100 * change.share:+.2g} %{where}: lock focus and zoom, let the camera warm up, and take all "
        "images again"
    )


def _boards(found: BetweenViews) -> Iterator[Message]:
    ratio, boards = found.proportions, found.boards
    if _beyond("two_boards", ratio.clear) and ratio.clear >= boards.clear:
        what, second, clear = f"its proportions by {100 * abs(ratio.share):.2g} %", ratio.images, ratio.clear
    elif _beyond("two_boards", boards.clear, boards.px):
        what, second, clear = f"its corners by {boards.px:.2g} px RMS", boards.images, boards.clear
    else:
        return
    if second == found.images[-len(second) :]:
        where, remedy = f"changes {_near(second)}", _by_themselves(found.images, second)
    else:
        where, remedy = f"differs in {names_of(second)}", f"leave out {_these(second)}"
    text = f"the board {where}, {what}, possibly two boards: use one board, or {remedy}"
    yield message("two_boards", text, clear, second)


def _blur(found: BetweenViews) -> Iterator[Message]:
    blurred = [view for view in found.blurred if _beyond("motion_blur", view.ratio, view.px)]
    if blurred:
        images = tuple(view.image for view in blurred)
        text = (
            f"motion blur: corners of {names_of(images)} scatter in one direction, by up to "
            f"{max(view.px for view in blurred):.2g} px: leave out {_these(images)}, or hold camera and board still"
        )
        yield message("motion_blur", text, max(view.ratio for view in blurred), images)


def largest_tilt_deg(calibration: Calibration) -> float:
    """Return the largest angle between the board's normal in any view and their mean direction."""
    poses = [view.camera_T_board for view in calibration.used if view.camera_T_board]
    return float(np.degrees(tilt_spread(np.stack([pose.rotation for pose in poses]))))


def _near(after: Sequence[str]) -> str:
    """Return where a change is, in words: one view more or less is often as likely; after: the images from it on."""
    return f"near {shown_name(after[0])}" if after else ""


def _by_themselves(images: Sequence[str], after: Sequence[str]) -> str:
    return f"calibrate the images before it ({len(images) - len(after)}) and from it on ({len(after)}) separately"


def _these(images: Sequence[str]) -> str:
    return "this view" if len(images) == 1 else "these views"
