"""Faults between views in words: focal length, board and sharpness that are not the same in all of them."""

from collections.abc import Iterator, Sequence

import numpy as np

from camcal.calibrate.between_views import BetweenViews, Change
from camcal.calibrate.degeneracy import tilt_spread
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.words import names_of
from camcal.quality.criteria import CRITERIA, Finding, finding

_FOCALS = ("fx", "fy")


def between_views(calibration: Calibration) -> Iterator[Finding]:
    """Yield what differs between views and ought to be the same, and whether the views are nearly parallel."""
    ratio = calibration.between_views.proportions
    for focal in _focal_length(calibration):
        # a board of other proportions resembles another focal length, which is less clear then
        if not _beyond("two_boards", ratio.clear) or focal.value > ratio.clear:
            yield focal
    yield from _boards(calibration.between_views)
    yield from _blur(calibration.between_views)
    yield from _parallel(calibration)


def _beyond(code: str, clear: float, px: float = np.inf) -> bool:
    return clear > CRITERIA[code].limit and px > CRITERIA[code].floor_px


def _focal_length(calibration: Calibration) -> Iterator[Finding]:
    found = calibration.between_views
    corner_px = float(np.hypot(*calibration.camera.image_size)) / 2

    def applies(code: str, change: Change) -> bool:
        return _beyond(code, change.clear, abs(change.share) * corner_px)

    step, drift, views, unordered = found.step, found.drift, found.outlying, found.unordered
    change = max(step, drift, key=lambda change: change.clear)
    words = _drift_words(drift) if change is drift else _step_words(found, step)
    if applies("focal_change", change):
        yield finding("focal_change", f"the focal length {words}", change.clear, change.images)
    elif applies("focal_varies", views) and views.clear > change.clear:
        text = (
            f"the focal length of {names_of(views.images)} differs by {100 * views.share:+.2g} %: leave out "
            f"{_these(views.images)}, and lock focus and zoom"
        )
        yield finding("focal_varies", text, views.clear, views.images)
    elif applies("focal_varies", unordered) and unordered.clear > change.clear:
        text = (
            f"the focal length varies by {100 * unordered.share:.2g} % from view to view, as with autofocus: lock "
            "focus and zoom, and take all images again"
        )
        yield finding("focal_varies", text, unordered.clear)
    elif applies("focal_varies", change):
        yield finding("focal_varies", f"it seems that the focal length {words}", change.clear, change.images)


def _step_words(found: BetweenViews, step: Change) -> str:
    return (
        f"changes by {100 * step.share:+.2g} % {_near(step.images)}: lock focus and zoom and take all "
        f"images again, or {_by_themselves(found.images, step.images)}"
    )


def _drift_words(drift: Change) -> str:
    where = f" from {drift.images[0]} to {drift.images[-1]}" if drift.images else ""
    return (
        f"drifts by {100 * drift.share:+.2g} %{where}: lock focus and zoom, let the camera warm up, and take all "
        "images again"
    )


def _boards(found: BetweenViews) -> Iterator[Finding]:
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
        where, remedy = f"is another in {names_of(second)}", f"leave out {_these(second)}"
    text = f"the board {where}, {what}, as where two boards are mixed: use one board, or {remedy}"
    yield finding("two_boards", text, clear, second)


def _blur(found: BetweenViews) -> Iterator[Finding]:
    blurred = [view for view in found.blurred if _beyond("motion_blur", view.ratio, view.px)]
    if blurred:
        images = tuple(view.image for view in blurred)
        text = (
            f"blurred by motion: the corners of {names_of(images)} scatter in one direction, by up to "
            f"{max(view.px for view in blurred):.2g} px: leave out {_these(images)}, or hold camera and board still"
        )
        yield finding("motion_blur", text, max(view.ratio for view in blurred), images)


def _parallel(calibration: Calibration) -> Iterator[Finding]:
    camera, views = calibration.camera, [view for view in calibration.used if view.camera_T_board]
    spread = np.degrees(tilt_spread(np.stack([view.camera_T_board.rotation for view in views if view.camera_T_board])))
    share = max((camera.std(name) or 0.0) / camera.value(name) for name in _FOCALS)
    if spread >= CRITERIA["tilt"].limit:
        return
    if share > CRITERIA["parallel_views"].limit:
        text = (
            f"nearly parallel views: in all {len(views)} the board is within {spread:.0f}° of one direction, and the "
            f"focal length is known to {100 * share:.1f} % only: add views with the board tilted by 30° to 45° about "
            "both axes"
        )
        yield finding("parallel_views", text, share, tuple(view.image for view in views))
    else:
        text = (
            f"the board was tilted by {spread:.0f}° at most: tilt it by 30° to 45°, which determines the focal length"
        )
        yield finding("tilt", text, spread)


def _near(after: Sequence[str]) -> str:
    """Return where a change is, in words: one view more or less is often as likely; after: the images from it on."""
    return f"near {after[0]}" if after else ""


def _by_themselves(images: Sequence[str], after: Sequence[str]) -> str:
    return f"calibrate the images before it ({len(images) - len(after)}) and from it on ({len(after)}) by themselves"


def _these(images: Sequence[str]) -> str:
    return "this view" if len(images) == 1 else "these views"
