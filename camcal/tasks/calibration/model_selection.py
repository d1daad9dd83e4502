"""Lens model selection: by cross-validation, then by the valid domain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.calibrate import intrinsics
from camcal.calibrate.intrinsics import Calibration, compare_models
from camcal.calibrate.jackknife import GAIN, CandidateModel, chosen
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.validity import ImageCircle, folds_inside
from camcal.errors import CamcalError, InsufficientData, InvalidInput, NotConverged
from camcal.messages import Message
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

# the simplest first: by the number of their parameters
CANDIDATES = ("pinhole", "opencv4", "kannala_brandt4", "opencv5", "kannala_brandt5t", "opencv8")
_CONTAINED = ("pinhole", "opencv4")  # DEFAULT_MODEL with coefficients at zero
_KNOWN = 0.01  # of the image diagonal: standard deviation of a projection
_FAILURES = (InvalidInput, InsufficientData, NotConverged)


@dataclass(frozen=True, eq=False)
class Selection:
    """A calibration, the models that it was chosen from (none where the model was given), and why.

    warnings: where the best model could not be used. lines: why another one than the default is used.
    """

    calibration: Calibration
    candidates: tuple[CandidateModel, ...] = ()
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()


def select(
    views: Sequence[BoardDetection], board: Board, options: intrinsics.Options, circle: ImageCircle | None = None
) -> Selection:
    """Return the calibration with the lens model that predicts views best, DEFAULT_MODEL unless another one is clearly
    better; options.model does not matter. circle: the image circle, outside of which no lens need be invertible.

    Raises InsufficientData, InvalidInput or NotConverged where no model leads to a calibration.
    """
    candidates = compared(views, board, options)
    first = chosen(candidates, DEFAULT_MODEL)
    others = sorted((own for own in candidates if own is not first), key=lambda own: -own.score)
    failure: CamcalError | None = None
    for own in (first, *others):
        try:
            calibration = intrinsics.calibrate(views, board, replace(options, model=model_named(own.name)))
        except _FAILURES as error:
            failure = failure or error
            continue
        selection = Selection(calibration, candidates)
        if failure is not None:
            return replace(selection, warnings=(_failed(own.name, first.name, failure.message),))
        return _without_fold(selection, views, board, options, circle)
    raise failure or NotConverged("no lens model converged")


def compared(views: Sequence[BoardDetection], board: Board, options: intrinsics.Options) -> tuple[CandidateModel, ...]:
    """Return the candidates, the simplest first; models that DEFAULT_MODEL contains only where it fails."""
    wide = [name for name in CANDIDATES if name not in _CONTAINED]
    found = {own.name: own for own in compare_models(views, board, options, [model_named(name) for name in wide])}
    if found[DEFAULT_MODEL].scores is None:
        others = compare_models(views, board, options, [model_named(name) for name in _CONTAINED])
        found |= {own.name: own for own in others}
    return tuple(found[name] for name in CANDIDATES if name in found)


def _without_fold(
    selection: Selection,
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None,
) -> Selection:
    """Return the selection, with a model that is invertible in the whole image, or image circle, where one predicts
    about as well and is known there: a lens that might be anything in the corners is no better than one that is not
    invertible.
    """
    taken = selection.calibration.camera.model.name
    best = max(own.score for own in selection.candidates)
    near = [own for own in selection.candidates if own.score >= best - GAIN and own.name != taken]
    folds = folds_inside(selection.calibration.camera, circle).folds
    for own in sorted(near, key=lambda own: -own.score) if folds else ():
        try:
            calibration = intrinsics.calibrate(views, board, replace(options, model=model_named(own.name)))
        except _FAILURES:
            continue
        if not folds_inside(calibration.camera, circle).folds and _known_everywhere(calibration, circle):
            line = f"lens model {own.name}: {taken} predicts as well, but is not invertible in the whole image"
            return Selection(calibration, selection.candidates, lines=(line,))
    return _with_reason(selection)


def _known_everywhere(calibration: Calibration, circle: ImageCircle | None) -> bool:
    """Return whether the projection uncertainty is small in the whole image, or image circle."""
    figures = projection_uncertainty(calibration.camera, observed=calibration.pixels, circle=circle).figures()
    return figures["worst_px"] <= _KNOWN * float(np.hypot(*calibration.camera.image_size))


def _with_reason(selection: Selection) -> Selection:
    """Return the selection with why another model than the default one was taken."""
    name = selection.calibration.camera.model.name
    scores = {own.name: own for own in selection.candidates}
    if name == DEFAULT_MODEL:
        return selection
    default, taken = scores[DEFAULT_MODEL], scores[name]
    if default.scores is None:
        return replace(selection, warnings=(_failed(name, DEFAULT_MODEL, str(default.reason)),))
    errors = f"{taken.sigma_px:.2g} px, {DEFAULT_MODEL} {default.sigma_px:.2g} px"
    gain = f"{taken.score - default.score:.2g} nat per corner"
    return replace(selection, lines=(f"lens model {name}: prediction error of left-out views {errors} ({gain})",))


def _failed(used: str, failed: str, why: str) -> Message:
    return Message("lens_model_failed", f"lens model {failed} failed, {used} is used instead: {why}")
