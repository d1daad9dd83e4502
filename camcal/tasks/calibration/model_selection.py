"""Lens model selection: the first of the candidates, in their order, whose calibration passes the verdict."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING

from camcal.calibrate import intrinsics
from camcal.calibrate.fit import CalibrationFit, ShapeOptions
from camcal.calibrate.intrinsics import Calibration, CandidateModel, FittedModel, compare_models
from camcal.cameras.catalogue import DEFAULT_MODEL, SPLINE_MODEL, WIDE_MODEL, model_named
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InsufficientData, InvalidInput, NotConverged
from camcal.messages import Message
from camcal.progress import SILENT, Progress, stage
from camcal.quality.assess import Assessment, assess, judge
from camcal.quality.lens_choice import GAIN, other_models, passing_model, rank_models
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

if TYPE_CHECKING:
    from camcal.calibrate.timing.record import CameraTimes

# the simplest first: by the number of their parameters
CANDIDATES = ("pinhole", "opencv4", "kannala_brandt4", "opencv5", "kannala_brandt5t", "opencv8")
_FIRST = (WIDE_MODEL, DEFAULT_MODEL)  # those that are looked at first
_CONTAINED = ("pinhole", "opencv4")  # DEFAULT_MODEL with coefficients at zero
_TELECENTRIC, _NO_FOCAL = "telecentric", "undetermined_focal_length"  # a lens, and how others are refused for it
# Refusals and failures that another lens model may remedy; a lens that does not fit may have an infinite focal length.
_OF_VIEWS = {"no_tilted_views", _NO_FOCAL}  # where two lens models, one of them for wide lenses, have it
_OF_THE_LENS = {
    *_OF_VIEWS,
    "lens_model_does_not_fit",
    "lens_model_or_blur",
    "lens_model",
    "not_invertible",
    "known_region",
}
# What neither another lens model nor further passes remedy: a brief fit is enough to refuse views for it, or, for the
# last, to say what is wrong with a calibration from them.
_FINAL = {"board_does_not_fit", "views_of_two_cameras"}
_TWO_CAMERAS = "several_cameras_by_name"
_TRIES = 2  # calibrations at most, where the first is not to be trusted
_FAILURES = (InvalidInput, InsufficientData, NotConverged)


@dataclass(frozen=True, eq=False)
class Selection:
    """A calibration with its assessment, and the models that it was chosen from: none where the model was given.

    warnings: where the best model could not be used. lines: why another one than the default is used. times: when rows
    were taken, where that was estimated.
    """

    calibration: Calibration
    assessment: Assessment
    candidates: tuple[CandidateModel, ...] = ()
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    times: "CameraTimes | None" = None


def solve(
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    *,
    choose: bool = True,
    progress: Progress = SILENT,
) -> Selection:
    """Return the calibration by `select`, or by `solve_given` with the lens model of the options where that is not to
    be chosen. A bend of the board that is held flat is named as the cause where a calibration without that passes.
    """
    try:
        found = (select if choose else solve_given)(views, board, options, circle, progress)
    except (InsufficientData, NotConverged) as error:
        if (bent := _bend(views, board, options, circle)) is None:
            raise
        raise type(error)(bent.text, where=error.where, failures=[bent]) from error
    if not found.assessment.trustworthy:
        used = replace(options, model=found.calibration.camera.model)
        if (bent := _bend(views, board, used, circle)) is not None:
            return replace(found, assessment=replace(found.assessment, failures=(bent,), warnings=()))
    return found


def _bend(
    views: Sequence[BoardDetection], board: Board, options: intrinsics.Options, circle: ImageCircle | None
) -> Message | None:
    """Return that the board is not flat, as the options say, None where a brief calibration that estimates its shape
    does not pass either, or the options do so already.
    """
    if options.shape.smooth:
        return None
    [own] = judge(compare_models(views, board, replace(options, shape=ShapeOptions()), [options.model]), circle)
    if own.calibration is None or own.failures:
        return None
    bend = own.calibration.surface.deflection
    size = f"{1e3 * bend:.2f} mm" if board.unit == "m" else f"{bend:.3f} squares"
    text = f"the board is bent by {size}, and --flat-board holds it flat: calibrate without it, which passes all checks"
    return Message("board_not_flat", f"{text} in a brief calibration", {"deflection": bend})


def select(
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    progress: Progress = SILENT,
) -> Selection:
    """Return the calibration with the lens model that predicts views best and passes the verdict, DEFAULT_MODEL unless
    another one is clearly better; options.model does not matter. circle: the image circle, outside of which no lens
    need be invertible.

    Where the first one does not pass, the next one of those whose brief calibration does is tried; if that does not
    pass either, the first is returned. Raises InsufficientData, InvalidInput or NotConverged where no model leads to a
    calibration.
    """
    with stage(progress, "choosing the lens model"):
        found = _look_briefly(views, board, [replace(options, model=model_named(name)) for name in _FIRST], circle)
        *_, last = found
        every = compared(views, board, options, circle, _fit_of(last), found) if _lens_matters(last) else found
        candidates = _with_spline(every, views, board, options, circle)
    if candidates[-1].calibration is not None and _TWO_CAMERAS in candidates[-1].failures:
        return Selection(candidates[-1].calibration, assess(candidates[-1].calibration, circle))
    order = rank_models(candidates, DEFAULT_MODEL)
    failure: CamcalError | None = None
    taken: Selection | None = None
    refused: dict[str, tuple[str, ...]] = {}
    for own in order:
        if taken is not None and (own.failures or len(refused) >= _TRIES):
            break
        if failure is not None and own.calibration is None:
            continue  # refused already when it was compared
        try:
            how = replace(options, model=model_named(own.name))
            with stage(progress, "solving"):
                start = own.fit if isinstance(own, FittedModel) else None
                calibration = intrinsics.calibrate(views, board, how, start)
        except _FAILURES as error:
            failure = failure or error
            refused[own.name] = tuple(message.code for message in error.failures) or ("not_converged",)
            continue
        named = tuple(each.without_fit() if isinstance(each, FittedModel) else each for each in candidates)
        with stage(progress, "checking"):
            made = Selection(calibration, assess(calibration, circle, _without(refused, order)), named)
        if taken is None or made.assessment.trustworthy:
            taken = _with_reason(made, order[0].name, failure if taken is None else None)
        if made.assessment.trustworthy:
            return taken
        refused[own.name] = tuple(message.code for message in made.assessment.failures)
        if not _OF_THE_LENS.intersection(refused[own.name]):
            break
    if taken is None:
        failure = failure or NotConverged("no lens model converged")
        tried = _without(refused, order)
        telecentric = partial(_try_telecentric, views, board, options, circle)
        raise _with_remedy(failure, order[0].name, tried, telecentric) from failure
    return replace(taken, assessment=assess(taken.calibration, circle, _without(refused, order)))


def _look_briefly(
    views: Sequence[BoardDetection], board: Board, ways: Sequence[intrinsics.Options], circle: ImageCircle | None
) -> tuple[CandidateModel, ...]:
    """Return brief calibrations, in turn until one is not refused, or refused for what no lens model remedies. Raises
    InsufficientData for what further passes do not remedy either: of views, if two lens models have it.
    """
    found: tuple[CandidateModel, ...] = ()
    for options in ways:
        found += compare_models(views, board, options, [options.model])
        refusal = found[-1].refusal if isinstance(found[-1], FittedModel) else None
        if refusal is not None and _FINAL.intersection(found[-1].failures):
            raise refusal
        if found[-1].calibration is not None or not _lens_matters(found[-1]):
            break
        if refusal is not None and len(found) > 1 and all(_OF_VIEWS.intersection(each.failures) for each in found):
            telecentric = partial(_try_telecentric, views, board, options, circle)
            raise _with_remedy(refusal, options.model.name, (), telecentric)
    *others, own = found
    mixed = own.calibration is not None and own.calibration.two_cameras is not None
    return (*others, *judge([own], circle)) if mixed else found


def _lens_matters(own: CandidateModel) -> bool:
    """Return whether other lens models are worth a look: not where one is refused for what none of them remedies."""
    alone = own.calibration is not None or not own.failures or bool(_OF_THE_LENS.intersection(own.failures))
    return alone and _TWO_CAMERAS not in own.failures


def _without(refused: Mapping[str, tuple[str, ...]], order: Sequence[CandidateModel]) -> list[CandidateModel]:
    """Return the candidates with why some were refused in full: none to name, however brief ones are judged."""
    return [replace(own, failures=refused.get(own.name, own.failures)) for own in order]


def solve_given(
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    progress: Progress = SILENT,
) -> Selection:
    """Return the calibration with the lens model of the options, assessed beside the usual models, which may predict
    better unless parameters are held; where it is not to be trusted, with what other models would lead to. Raises as
    `intrinsics.calibrate` does.
    """
    free = replace(options, fixed=(), guess=None)
    with stage(progress, "solving briefly"):
        other = DEFAULT_MODEL if options.model.name == WIDE_MODEL else WIDE_MODEL
        own, *others = _look_briefly(views, board, [options, replace(free, model=model_named(other))], circle)
    if own.calibration is not None and _TWO_CAMERAS in own.failures:
        return Selection(own.calibration, assess(own.calibration, circle))
    # what is held is known better than other models know it
    beside: list[CandidateModel] = others if options.fixed else [own, *others]

    @cache
    def rank_all() -> list[CandidateModel]:
        wide = next((_fit_of(each) for each in beside if each.name == WIDE_MODEL), None)
        every = compared(views, board, free, circle, wide, beside)
        every = _with_spline(every, views, board, free, circle)
        return rank_models([each for each in every if own in beside or each.name != own.name], DEFAULT_MODEL)

    refusal = own.refusal if isinstance(own, FittedModel) else None
    telecentric = partial(_try_telecentric, views, board, free, circle)
    if refusal is not None and _is_of_the_lens(refusal):
        # further passes close nothing that is open for a lens model, nor do models with more parameters than the usual
        final, ranked = _OF_VIEWS.intersection(own.failures), rank_beside(own, views, board, free, circle, others)
        if not final and not passing_model(own.name, ranked):
            ranked = rank_all()
        if final or passing_model(own.name, ranked):
            raise _with_remedy(refusal, own.name, ranked, telecentric)
    try:
        with stage(progress, "solving"):
            start = own.fit if isinstance(own, FittedModel) else None
            calibration = intrinsics.calibrate(views, board, options, start)
    except (InsufficientData, NotConverged) as error:
        tried = rank_all() if _is_of_the_lens(error) else ()
        raise _with_remedy(error, own.name, tried, telecentric) from error
    if not options.fixed:
        with stage(progress, "choosing the lens model"):
            beside = rank_beside(own, views, board, free, circle)
    with stage(progress, "checking"):
        found = Selection(calibration, assess(calibration, circle, beside))
    return found if found.assessment.trustworthy else replace(found, assessment=assess(calibration, circle, rank_all()))


def rank_beside(
    own: CandidateModel,
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    known: Sequence[CandidateModel] = (),
) -> list[CandidateModel]:
    """Return a candidate and the usual models, which it is compared with, in their order; known: some of the latter."""
    done = {each.name for each in (own, *known)}
    usual = [model_named(name) for name in _FIRST if name not in done]
    others = compare_models(views, board, options, usual, next(filter(None, map(_fit_of, (own, *known))), None))
    return rank_models([own, *judge([*known, *others], circle)], DEFAULT_MODEL)


def _fit_of(own: CandidateModel) -> CalibrationFit | None:
    """Return the brief fit of a candidate that other models may go on from, None where it is refused."""
    return own.fit if isinstance(own, FittedModel) and own.calibration is not None else None


def compared(
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    start: CalibrationFit | None = None,
    known: Sequence[CandidateModel] = (),
) -> tuple[CandidateModel, ...]:
    """Return the candidates, the simplest first; models that DEFAULT_MODEL contains only where it fails.

    start: as of `compare_models`. known: those that are compared already, which are among the candidates.
    """
    found = {own.name: own for own in known}
    for names in ([name for name in CANDIDATES if name not in _CONTAINED], _CONTAINED):
        models = [model_named(name) for name in names if name not in found]
        found |= {own.name: own for own in compare_models(views, board, options, models, start)}
        if found[DEFAULT_MODEL].scores is not None:
            break
    return judge([found[name] for name in dict.fromkeys((*CANDIDATES, *found)) if name in found], circle)


def _with_spline(
    candidates: Sequence[CandidateModel],
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None,
) -> tuple[CandidateModel, ...]:
    """Return the candidates, with a spline where even that which predicts best leaves a pattern of residuals, or does
    not fit: it takes longer than all the others.
    """
    best = max(candidates, key=lambda own: own.score)
    needed = best.pattern or "lens_model_does_not_fit" in best.failures
    if not needed or SPLINE_MODEL in {own.name for own in candidates}:
        return tuple(candidates)
    made = compare_models(views, board, options, [model_named(SPLINE_MODEL)], _fit_of(best))
    return (*candidates, *judge(made, circle))


def brief_calibration(
    views: Sequence[BoardDetection],
    board: Board,
    options: intrinsics.Options,
    circle: ImageCircle | None = None,
    *,
    choose: bool = True,
) -> Calibration | None:
    """Return a brief calibration by which corners can be expected well enough to measure them, None where there is
    none: with DEFAULT_MODEL, or with WIDE_MODEL where that does not pass, unless the lens model is not to be chosen.
    """
    found: list[CandidateModel] = []
    for name in (DEFAULT_MODEL, WIDE_MODEL) if choose else (options.model.name,):
        found += judge(compare_models(views, board, replace(options, named_groups=()), [model_named(name)]), circle)
        if found[-1].calibration is not None and not found[-1].failures:
            return found[-1].calibration
    return rank_models(found, DEFAULT_MODEL)[0].calibration


def _is_of_the_lens(error: CamcalError) -> bool:
    """Return whether another lens model may be the remedy of a refusal."""
    return isinstance(error, NotConverged) or any(message.code in _OF_THE_LENS for message in error.failures)


def _with_remedy(
    error: CamcalError,
    used: str,
    candidates: Sequence[CandidateModel],
    telecentric: Callable[[], Sequence[CandidateModel]] = tuple,
) -> CamcalError:
    """Return the refusal with a lens model that was tried and passes, which is the cause then, or that none of those
    that were tried does; of a focal length that is not determined, with the telecentric one, whose own is infinite, if
    that passes. telecentric: tries it.
    """
    if not _is_of_the_lens(error):
        return error
    remedy, text = other_models(used, candidates), error.message
    if passing_model(used, candidates):
        text = f"the lens model {used} does not fit these views: {remedy}"
    else:
        text += f"; {remedy}" if remedy else ""
        own = telecentric() if any(message.code == _NO_FOCAL for message in error.failures) else ()
        text += f"; if the lens is telecentric, {other_models(used, own)}" if passing_model(used, own) else ""
    if text == error.message:
        return error
    return type(error)(text, where=error.where, failures=[replace(each, text=text) for each in error.failures])


def _try_telecentric(
    views: Sequence[BoardDetection], board: Board, options: intrinsics.Options, circle: ImageCircle | None
) -> tuple[CandidateModel, ...]:
    free = replace(options, fixed=(), guess=None)
    return judge(compare_models(views, board, free, [model_named(_TELECENTRIC)]), circle)


def _with_reason(selection: Selection, first: str, failure: CamcalError | None) -> Selection:
    """Return the selection with why another model than the default one was taken.

    first: the model that was to be used; failure: what became of it, None if it led to a calibration.
    """
    name = selection.calibration.camera.model.name
    if failure is not None:
        return replace(selection, warnings=(_failed(name, first, failure.message),))
    scores = {own.name: own for own in selection.candidates}
    if name == DEFAULT_MODEL:
        return selection
    default, taken = scores.get(DEFAULT_MODEL), scores[name]
    if default is None:
        return selection
    if default.scores is None:
        return replace(selection, warnings=(_failed(name, DEFAULT_MODEL, str(default.reason)),))
    words = f"lens model {name}: prediction error of left-out views {taken.sigma_px:.2g} px, {DEFAULT_MODEL} "
    words += f"{default.sigma_px:.2g} px"
    if taken.map_px is not None and default.map_px is not None and taken.score < default.score + GAIN:
        words += f"; projection uncertainty over the image {taken.map_px:.2g} px, {default.map_px:.2g} px"
    return replace(selection, lines=(words,))


def _failed(used: str, failed: str, why: str) -> Message:
    return Message("lens_model_failed", f"lens model {failed} failed, {used} is used instead: {why}")
