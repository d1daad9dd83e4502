"""Choice of the lens model: each candidate is estimated briefly and assessed by the criteria of the verdict.

Those that meet a criterion come before those that do not; of those that predict left-out views alike, the one that is
known best over the whole image is taken, as coefficients that the data do not determine cost what they leave open.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camcal.calibrate.intrinsics import CandidateModel
from camcal.cameras.validity import ImageCircle
from camcal.quality.assess import assess
from camcal.quality.criteria import MUCH, beats

# By how much a model must predict better, as MUCH: than the preferred one by that, than a simpler one by little: a lens
# that is described badly at the edge of the image costs its few corners there no more.
_LITTLE = ((0.005, 1.5),)
# Of models that predict alike: the share of the map's standard deviation below which another one is better known, as
# single lenses differ by chance; and that deviation, px, below which it is known well enough, as it is below the
# prediction error.
_BETTER_KNOWN, _WELL_KNOWN_PX = 0.7, 0.02
_NO_RAY = 0.01  # of the image diagonal: standard deviation that a pixel counts with for which the lens has no ray


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
    return replace(own, map_px=float(np.sqrt(np.mean(std**2))), failures=failures)


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
