"""Choice of the lens model: each candidate is estimated briefly and assessed by the criteria of the verdict.

Those that meet a criterion come before those that do not; of those that predict left-out views alike, the one that is
known best over the whole image is taken, as coefficients that the data do not determine cost what they leave open.
What a lens model leaves that does not describe the lens makes patterns of residuals: they follow the radius, or
different views share them at the same place of the image.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.calibrate.view_records import CellSums, cell_numbers
from camcal.solve.losses import chi_square_beyond

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

_CHANCE = 1e-6  # of residuals that follow the radius by so much, if the lens model were right
_RINGS = 8
# Chance of residuals that different views share, if the lens model were right: ten views that all agree have it.
_SHARED_CHANCE = 1e-3
_SHARED = 1 / 3  # of the standard deviation of the map: a pattern below it, RMS, is among what that states
_VIEWS = 3  # of a cell, with fewer there is nothing that they share
_FARTHEST = 10.0  # standard deviations: a rejected corner counts with no more


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


class Pattern(NamedTuple):
    """largest_px: of the mean residuals. words: which way they point there, and where. bias: (M, 2) px, of the pixels
    that were asked for.
    """

    largest_px: float
    words: str
    bias: Array


def find_patterns(calibration: Calibration, pixels: Array, stated_px: float) -> tuple[Pattern, ...]:
    """Return the patterns of residuals that are not by chance, what says least about the place first.

    pixels: (M, 2) at which the bias of the lens is wanted. stated_px: RMS standard deviation of projections where
    corners were seen.
    """
    found = radial_pattern(calibration, pixels), shared_pattern(calibration, pixels, stated_px)
    return tuple(pattern for pattern in found if pattern is not None)


def radial_pattern(calibration: Calibration, pixels: Array) -> Pattern | None:
    """Return how residuals point inwards or outwards by distance from the centre, as a wrong lens model's do, None
    where it may be by chance; beyond the outermost ring the bias is as large as there.
    """
    centre = np.array([calibration.camera.value("cx"), calibration.camera.value("cy")])
    offset = calibration.pixels - centre
    radius = np.linalg.norm(offset, axis=1)
    radial = np.einsum("ni,ni->n", calibration.residuals, offset) / np.maximum(radius, 1e-9)
    edges = np.quantile(radius, np.linspace(0, 1, _RINGS + 1))
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, _RINGS - 1)
    counts = np.maximum(np.bincount(ring, minlength=_RINGS), 1)
    means = np.bincount(ring, radial, _RINGS) / counts
    # corners of one view share its errors, so a ring holds fewer independent values than corners
    per_view = max(len(radius) / max(len(calibration.used), 1) / _RINGS, 1.0)
    statistic = float(np.sum(means**2 * counts / per_view)) / calibration.sigma_px**2
    if chi_square_beyond(statistic, _RINGS) >= _CHANCE:
        return None
    worst = int(np.argmax(np.abs(means)))
    way, size = "outwards" if means[worst] > 0 else "inwards", float(abs(means[worst]))
    words = f"residuals point {way} by {size:.2f} px at {edges[worst]:.0f} to {edges[worst + 1]:.0f} px from the centre"
    outwards = pixels - centre
    distance = np.linalg.norm(outwards, axis=1)
    along = np.interp(distance, (edges[:-1] + edges[1:]) / 2, means) / np.maximum(distance, 1e-9)
    return Pattern(size, words, along[:, None] * outwards)


def shared_pattern(calibration: Calibration, pixels: Array, stated_px: float) -> Pattern | None:
    """Return what the residuals of different views share in the cells of a grid over the image, None where it may be by
    chance or is among what the standard deviation of the map states.
    """
    places, residuals, views = _with_rejected(calibration)
    size = calibration.camera.image_size
    found = CellSums.of(places, residuals, views, size)
    if found.chance >= _SHARED_CHANCE:
        return None
    sums, counts, cells = found.sums, found.counts, cell_numbers(places, size)
    total = counts.sum(axis=0)
    pairs = total**2 - (counts**2).sum(axis=0)
    whole = sums.sum(axis=0)
    squares = np.sum(whole**2, axis=1) - np.sum(sums**2, axis=(0, 2))
    squares = np.where(((counts > 0).sum(axis=0) >= _VIEWS) & (pairs > 0), squares / np.maximum(pairs, 1), 0.0)
    sizes = np.sqrt(np.maximum(squares, 0.0))
    if np.average(squares, weights=total) <= (_SHARED * stated_px) ** 2:
        return None
    means = sizes[:, None] * whole / np.maximum(np.linalg.norm(whole, axis=1), 1e-9)[:, None]
    worst = int(np.argmax(sizes))
    u, v = places[cells == worst].mean(axis=0)
    words = f"residuals of different views point the same way, by {sizes[worst]:.2f} px near ({u:.0f}, {v:.0f})"
    return Pattern(float(sizes[worst]), words, means[cell_numbers(pixels, size)])


def _with_rejected(calibration: Calibration) -> tuple[Array, Array, Array]:
    """Return the pixels (N, 2), residuals (N, 2) px and places of the views (N,) of the corners of views that are
    used: where a lens is described worst, its corners are rejected.
    """
    places = {view.image: place for place, view in enumerate(calibration.views) if view.used}
    lost = [own for own in calibration.rejected if own.image in places and np.isfinite(own.residual).all()]
    most = _FARTHEST * calibration.sigma_px
    near = [own.residual * min(1.0, most / max(own.distance, 1e-9)) for own in lost]
    return (
        np.concatenate([calibration.pixels, np.reshape([own.pixel for own in lost], (-1, 2))]),
        np.concatenate([calibration.residuals, np.reshape(near, (-1, 2))]),
        np.concatenate([calibration.corner_views, np.array([places[own.image] for own in lost], np.intp)]),
    )
