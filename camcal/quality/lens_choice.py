"""Choice of the lens model: each candidate is estimated briefly and assessed by the criteria of the verdict.

Those that meet a criterion come before those that do not; of those that predict left-out views alike, the one that is
known best over the whole image is taken, as coefficients that the data do not determine cost what they leave open.
"""

from collections.abc import Sequence

import numpy as np

from camcal.calibrate.intrinsics import CandidateModel

# By how much a lens model must predict left-out views better than another to be much better: nats a corner (0.1 is 5 %
# of the prediction error), and standard errors of the difference between views; less if that is clearer.
GAIN = 0.10
MUCH = ((GAIN, 1.5), (0.02, 2.5))
# By how much a model must predict better, as MUCH: than the preferred one by that, than a simpler one by little: a lens
# that is described badly at the edge of the image costs its few corners there no more.
_LITTLE = ((0.005, 1.5),)
# Of models that predict alike: the share of the map's standard deviation below which another one is better known, as
# single lenses differ by chance; and that deviation, px, below which it is known well enough, as it is below the
# prediction error.
_BETTER_KNOWN, _WELL_KNOWN_PX = 0.7, 0.02


def rank_models(candidates: Sequence[CandidateModel], preferred: str) -> list[CandidateModel]:
    """Return the candidates in the order in which they are to be used; candidates: the simplest first."""
    scored = [own for own in candidates if own.scores is not None]
    result: list[CandidateModel] = []
    for group in ([own for own in scored if not own.failures], [own for own in scored if own.failures]):
        first = [chosen(group, preferred)] if group else []
        result += first + sorted((own for own in group if own not in first), key=lambda own: -own.score)
    return result + sorted((own for own in candidates if own.scores is None), key=lambda own: own.name != preferred)


def chosen(candidates: Sequence[CandidateModel], preferred: str) -> CandidateModel:
    """Return the candidate to use; candidates: the simplest first.

    The preferred one stays unless the best predicts much better; else the simplest one that the best does not beat.
    One that the best does not beat by much either, and that is known much better over the image, replaces it.
    """
    best = max(candidates, key=lambda own: own.score)
    first = next((own for own in candidates if own.name == preferred), None)
    if first is None or beats(best, first, MUCH):
        first = next(own for own in candidates if not beats(best, own, _LITTLE))
    if first.map_px is None or first.sigma_px is None or first.map_px <= max(first.sigma_px, _WELL_KNOWN_PX):
        return first
    alike = [own for own in candidates if own.map_px is not None and not beats(best, own, MUCH)]
    # what priors hold may seem to be known well
    alike = [own for own in alike if own.calibration is None or not own.calibration.held_by_prior]
    known = min(alike, key=lambda own: own.map_px or 0.0, default=first)
    return known if (known.map_px or 0.0) < _BETTER_KNOWN * first.map_px else first


def alternative(candidates: Sequence[CandidateModel], used: str) -> CandidateModel | None:
    """Return the best candidate beside the one that is used that predicts about alike and meets the criteria, None if
    there is none.
    """
    own = next((each for each in candidates if each.name == used and each.scores is not None), None)
    others = [each for each in candidates if each.name != used and each.scores is not None and not each.failures]
    alike = [each for each in others if own is not None and not beats(own, each, MUCH)]
    return max(alike, key=lambda each: each.score, default=None)


def passing_model(used: str, candidates: Sequence[CandidateModel]) -> str | None:
    """Return the first lens model other than the one in use that passes, None if there is none."""
    return next(
        (own.name for own in candidates if own.name != used and own.scores is not None and not own.failures), None
    )


def better_model(used: str, candidates: Sequence[CandidateModel]) -> CandidateModel | None:
    """Return the first candidate that passes and predicts much better than the lens model in use, None if there is none
    or that is none of them.
    """
    own = next((each for each in candidates if each.name == used and each.scores is not None), None)
    passing = [each for each in candidates if each.calibration is not None and not each.failures]
    return next((each for each in passing if own is not None and beats(each, own, MUCH)), None)


def other_models(used: str, candidates: Sequence[CandidateModel]) -> str:
    """Return what to do about the lens model: one that passes, or that none of those that were tried does, or "" where
    none was tried.
    """
    passing = passing_model(used, candidates)
    if passing is not None:
        return f"use --model {passing}, which passes all checks in a brief calibration"
    names = ", ".join(own.name for own in candidates if own.name != used and own.scores is not None)
    remedy = "add views with the board all over the image"
    return f"none of {names} passes all checks in a brief calibration either: {remedy}" if names else ""


def beats(one: CandidateModel, other: CandidateModel, margins: Sequence[tuple[float, float]]) -> bool:
    """Return whether a model predicts better than another by any of the margins: nats a corner, standard errors."""
    if one.scores is None or other.scores is None:
        return one.scores is not None
    gains = one.scores - other.scores
    error = float(np.std(gains, ddof=1)) * np.sqrt(len(gains)) if len(gains) > 1 else np.inf
    return any(gains.sum() > max(least * one.corners, errors * error) for least, errors in margins)
