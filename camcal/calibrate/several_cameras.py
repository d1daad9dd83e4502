"""Detection of views of two cameras in one input: two groups of views with different lenses.

A screen that costs little says where to look. From one linearisation it is known how the corners of every view follow a
change of the lens, its pose eliminated; views are sorted into two groups, each view to that of two changes of the lens
that suits it better, in turn. Only where two lenses explain the corners much better than one are both estimated. They
are judged by views that they were not estimated from: in one step, the jackknife's, every view is left out of its own
group, so that a small group gains nothing by following its corners.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import PurePath

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.fit import ShapeOptions, fit_briefly
from camcal.calibrate.noise import FINEST
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.single_views import ViewQuadratics, view_quadratics
from camcal.calibrate.view_records import names_of, px_words
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import counted
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import SingularError
from camcal.targets.board_map import polynomial_terms

LEAST_VIEWS = 3  # of a group: fewer do not hold a lens
# Gain of the log likelihood by a second lens in the screen, nat per coordinate of the smaller group, by which lenses
# are estimated: 20 of 24 real sets of one camera are below the first, all of 23 mixtures of similar cameras above it.
# The second holds for groups by file names, which are not chosen to make it large.
_SUSPICIOUS, _SUSPICIOUS_BY_NAME = 0.4, 0.15
_SCREENED = 60  # views: where there are more, so many tell whether there are two cameras
_DIRECTIONS = 3  # of the views' scores, along each of which their signs are tried as groups
_ROUNDS, _SORTINGS = 20, 3
# RMS residual over what a cubic map of the board leaves of it, under the lens of a group: more is a wrong lens model,
# to which any two groups seem to have two lenses. Mixtures of similar cameras reach 1.6, wrong models 1.8 to 26.
SMOOTH, _DEGREE = 1.8, 3
_LOSS = Cauchy(3.0)
_POSING = Stopping(relative_decrease=1e-6, iterations=20)
_SOLVING = Stopping(relative_decrease=1e-6, iterations=30)
_REACH = 20.0  # px: what a corner is off by at most, or without an image
_LISTED = 3  # images of a group
_PREFERRED = 1.5  # times clearer must groups be that are distinguished by their lenses, where names suggest others
_MOST_VALUES = 4  # of a part of names that tells cameras apart; what has more of them counts images
_TOKENS = re.compile(r"[^\W\d_]+|\d+")
_FAILURES = (InsufficientData, InvalidInput, SingularError, np.linalg.LinAlgError)


@dataclass(frozen=True, eq=False)
class TwoCameras:
    """Two groups of views whose lenses differ.

    groups: their images, the larger one's first. by_name: whether they were distinguished by their names. ratio: errors
    of corners with the lens of all views, and with that of the other group, over those with the lens of their own
    group, the view left out: the least of these, each less its standard error. own_px, other_px: the median error of
    the smaller group's corners with the lens of their own and with that of the larger group. focal_px: fx of both.
    """

    groups: tuple[tuple[str, ...], tuple[str, ...]]
    by_name: bool
    ratio: float
    own_px: float
    other_px: float
    focal_px: tuple[float, float]

    @property
    def words(self) -> str:
        """What was found and what to do."""
        larger, smaller = (f"{counted(len(images), 'view')} ({names_of(images, _LISTED)})" for images in self.groups)
        focal = " and ".join(f"{value:.0f}" for value in self.focal_px)
        return (
            f"views of two cameras, or of one with changed zoom or focus: {larger} and {smaller}, fx {focal} px; "
            f"median error of the latter {px_words(self.other_px)} with the lens of the former, "
            f"{px_words(self.own_px)} with their own: calibrate each group separately"
        )


def two_cameras(
    plain: Estimate,
    images: Sequence[str],
    image_size: tuple[int, int],
    shape: ShapeOptions,
    named: Sequence[frozenset[str]] = (),
    *,
    by_lens: bool = True,
) -> TwoCameras | None:
    """Return the two groups that views fall into, None where nothing supports them; its significance is `ratio`.

    plain: an estimate of all views. images: (V,) names of the views.
    named: groups of images by their names, each of which may be another camera's. by_lens: whether to look for groups
    that are distinguished by their lenses alone.
    """
    if not len(plain.problem.free) or len(images) < 2 * LEAST_VIEWS or not (named or by_lens):
        return None
    bare, state = _bare(plain)
    if len(images) > _SCREENED:
        # at random: of every second view, all may be of the same camera
        some = np.sort(np.random.default_rng(0).permutation(len(images))[:_SCREENED])
        fewer = replace(bare, observations=bare.observations.take(some))
        found = _suspected(fewer, state.take(some), [images[index] for index in some.tolist()], named)
        if all(group is None for group in found):
            return None
    by_name, alike = _suspected(bare, state, images, named)
    if not by_lens or (by_name is not None and alike is not None and (by_name == alike).all()):
        alike = None
    results = [
        _compared(plain, images, image_size, shape, group, by_name=is_named)
        for group, is_named in ((by_name, True), (alike, False))
        if group is not None
    ]
    clearest = (result for result in results if result is not None)
    return max(clearest, key=lambda own: own.ratio * (_PREFERRED if own.by_name else 1.0), default=None)


def _suspected(
    problem: BoardProblem, state: State, images: Sequence[str], named: Sequence[frozenset[str]]
) -> tuple[Array | None, Array | None]:
    """Return the groups (V,) that seem to have a lens of their own, by names and by lenses; None where none does."""
    found = view_quadratics(problem, state)
    groups = [_smaller(np.array([image in group for image in images])) for group in named]
    by_name = _likeliest(found, groups, _SUSPICIOUS_BY_NAME)
    by_lens = _likeliest(found, [_sorted_apart(found, group) for group in _starts(found)], _SUSPICIOUS)
    return by_name, by_lens


def _bare(plain: Estimate) -> tuple[BoardProblem, State]:
    """Return lens and poses alone with the board as it was estimated, all corners that there are counting alike."""
    problem, state, seen = plain.problem, plain.state, plain.problem.observations
    bare = replace(
        problem,
        observations=seen.alike(),
        terms=(),
        offsets=False,
        points=problem.board_points(state),
        noise=None,
        sigma=1.0,
        loss=None,
    )
    return bare, replace(state, shape=np.zeros(0), offsets=0 * state.offsets)


def _starts(found: ViewQuadratics) -> list[Array]:
    """Return groups (V,) to begin with: by the signs of the views' scores along their main directions, and by misfit at
    the largest step between views in the order of theirs.
    """
    scores = found.scores()
    directions = np.linalg.eigh(scores.T @ scores)[1][:, ::-1].T[:_DIRECTIONS]
    misfits = np.log(found.costs(found.best(np.ones(len(scores)))) / np.maximum(found.count, 1))
    order = np.argsort(misfits)
    steps = np.diff(misfits[order])[LEAST_VIEWS - 1 : len(order) - LEAST_VIEWS]
    misfitting = np.zeros(len(order), bool)
    misfitting[order[LEAST_VIEWS + int(np.argmax(steps)) :]] = True
    return [group for group in (*(scores @ own > 0 for own in directions), misfitting) if _large_enough(group)]


def _sorted_apart(found: ViewQuadratics, group: Array) -> Array:
    """Return the smaller of the groups (V,) that views end in when each goes to the lens that suits it better."""
    for _ in range(_ROUNDS):
        without, with_it = (found.costs(found.best(members)) for members in (~group, group))
        following = with_it < without
        if not _large_enough(following) or (following == group).all():
            break
        group = following
    return _smaller(group)


def _smaller(group: Array) -> Array:
    return group if group.sum() <= len(group) / 2 else ~group


def _large_enough(group: Array) -> bool:
    return bool(min(group.sum(), (~group).sum()) >= LEAST_VIEWS)


def _likeliest(found: ViewQuadratics, groups: Sequence[Array], least: float) -> Array | None:
    """Return that of some groups (V,) for which a second lens gains most, None where that is less than `least`."""
    gains = [(found.gain(group), index) for index, group in enumerate(groups) if _large_enough(group)]
    gain, index = max(gains, default=(0.0, 0))
    return groups[index] if gain > least else None


def _compared(
    plain: Estimate,
    images: Sequence[str],
    image_size: tuple[int, int],
    shape: ShapeOptions,
    smaller: Array,
    *,
    by_name: bool,
) -> TwoCameras | None:
    """Return what the lenses of both groups say, estimated each from its own views; None where one has none."""
    everything = _Lens(*_bare(plain))
    for _ in range(1 if by_name else _SORTINGS):
        try:
            larger = _lens_of(plain, image_size, np.flatnonzero(~smaller), shape)
            # on the board of the larger group: three views do not tell its shape from that of the lens
            own = _lens_of(plain, image_size, np.flatnonzero(smaller), shape, larger.problem.points)
        except _FAILURES:
            return None
        ratios, smooth, moved = [], [], np.zeros(len(smaller), bool)
        for members, lens, other in ((~smaller, larger, own), (smaller, own, larger)):
            quadratics = view_quadratics(lens.problem, lens.state)
            left_out = quadratics.left_out()
            by_all, by_other = (_costs(each, lens, quadratics.weights) for each in (everything, other))
            ratios.append([_ratio(costs, left_out, quadratics.count) for costs in (by_all, by_other)])
            smooth.append(smoothness(lens.problem, lens.state, quadratics.weights))
            moved[members] = by_other < quadratics.constant
        if not moved.any() or not _large_enough(smaller ^ moved):
            break
        smaller = _smaller(smaller ^ moved)
    if max(smooth) > SMOOTH:
        return None
    joint, other_lens = np.array(ratios).T
    own_px, other_px = (
        float(np.median(_distances(lens, own)[own.problem.observations.weights > 0])) for lens in (own, larger)
    )
    first, second = (tuple(np.array(images)[group].tolist()) for group in (~smaller, smaller))
    focal_px = float(larger.state.parameters[0]), float(own.state.parameters[0])
    ratio = float(min(joint.max(), other_lens.min()))
    return TwoCameras((first, second), by_name, ratio, own_px, other_px, focal_px)


@dataclass(frozen=True, eq=False)
class _Lens:
    """A lens, with the board that it was estimated with, and views in their poses under it."""

    problem: BoardProblem
    state: State


def _lens_of(
    plain: Estimate,
    image_size: tuple[int, int],
    views: Array,
    shape: ShapeOptions,
    points: Array | None = None,
) -> _Lens:
    """Return the lens that some views alone give; points: (C, 3) those of the board, None: estimated as well."""
    problem, seen = plain.problem, plain.problem.observations
    observations = seen.alike().take(views)
    held = plain.state.parameters.copy()
    held[problem.free] = np.nan
    how = shape if points is None else ShapeOptions(smooth=False, offsets=False)
    found, _ = fit_briefly(
        problem.model,
        problem.board,
        observations=observations,
        image_size=image_size,
        held=held,
        guess=None,
        shape=how,
    )
    bare, state = _bare(found)
    if points is not None:
        robust = replace(bare, points=points, sigma=found.noise.sigma, loss=_LOSS)
        bare, state = replace(bare, points=points), minimise(robust.within_domain(state), state, _SOLVING).state
    return _Lens(bare, state)


def smoothness(problem: BoardProblem, state: State, weights: Array) -> float:
    """Return the RMS residual of a typical view over what a smooth map of the board leaves of it: near 1 where a lens
    describes its views, much more where the lens model is wrong; 0 where views have too few corners. weights: (V, P).
    """
    points, residuals = problem.board.points()[:, :2] / max(problem.board.extent), problem.residuals(state)
    smooth, found = polynomial_terms(points, _DEGREE), []
    count = smooth.shape[1]
    usable = (weights > 0) & np.isfinite(residuals).all(axis=0)  # a poor pose leaves corners behind the camera
    for view in np.flatnonzero(usable.sum(axis=1) > 2 * count):
        shown = usable[view]
        root = np.sqrt(weights[view, shown])[:, None]
        terms = root * smooth[problem.observations.ids[view, shown]]
        values = root * residuals[:, view, shown].T
        left = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
        noise = np.sum(left**2) / (len(values) - count) * len(values)
        found.append(np.sum(values**2) / max(noise, FINEST**2 * len(values)))
    return float(np.sqrt(np.median(found))) if found else 0.0


def _posed(lens: _Lens, views: _Lens, weights: Array) -> tuple[BoardProblem, State]:
    """Return the views of one lens, posed again under another one, with the weights (V, P) of their corners."""
    problem = replace(
        views.problem,
        free=np.zeros(0, np.intp),
        points=lens.problem.points,
        observations=replace(views.problem.observations, weights=weights),
        lens_spread=None,
    )
    state = replace(views.state, parameters=lens.state.parameters)
    return problem, minimise(problem.within_domain(state), state, _POSING).state


def _costs(lens: _Lens, views: _Lens, weights: Array) -> Array:
    """Return the squared residuals (V,) of views under another lens."""
    problem, state = _posed(lens, views, weights)
    squared = np.nan_to_num(np.sum(problem.residuals(state) ** 2, axis=0), nan=np.inf)
    return np.asarray(np.sum(weights * np.minimum(squared, _REACH**2), axis=1))


def _distances(lens: _Lens, views: _Lens) -> Array:
    """Return how far the corners (V, P) of views are off under a lens, px."""
    problem, state = _posed(lens, views, views.problem.observations.weights)
    return np.asarray(np.nan_to_num(np.hypot(*problem.residuals(state)), nan=np.inf))


def _ratio(costs: Array, left_out: Array, count: Array) -> float:
    """Return the ratio of corner errors of views, their geometric mean less its standard error: what a single view says
    may be chance, or that it was blurred.
    """
    logs = 0.5 * np.log(np.maximum(costs, FINEST**2 * count) / left_out)
    return float(np.exp(np.mean(logs) - np.std(logs, ddof=1) / np.sqrt(len(logs))))


def name_groups(images: Sequence[str]) -> tuple[frozenset[str], ...]:
    """Return groups of images, each of which may be another camera's than all the rest, by their paths.

    Images are alike in the letters and numbers of their names but for one that takes two to four values (left and
    right, cam0 and cam1, L and R), in their folder, or in the kind of their names (IMG_0001, scan-3-b).
    """
    groups: dict[frozenset[str], None] = {}
    for keys in _partitions(images):
        counts = Counter(keys)
        if not 1 < len(counts) <= _MOST_VALUES:
            continue
        for value, count in counts.items():
            group = frozenset(image for image, key in zip(images, keys, strict=True) if key == value)
            rest = len(images) - count
            if min(count, rest) >= LEAST_VIEWS and frozenset(images) - group not in groups:
                groups[group] = None
    return tuple(groups)


def _partitions(images: Sequence[str]) -> Iterator[list[str]]:
    """Yield possible names of cameras: a key of every image."""
    paths = [PurePath(image) for image in images]
    depth = max((len(path.parts) for path in paths), default=0)
    for level in range(2, depth + 1):  # the folder itself and those above it
        yield [path.parts[-level] if len(path.parts) >= level else "" for path in paths]
    tokens = [_TOKENS.findall(path.name.lower()) for path in paths]
    kinds = [" ".join("0" if token.isdigit() else token for token in name) for name in tokens]
    yield kinds
    longest = max(map(len, tokens), default=0)
    for place in range(longest):
        yield [name[place] if place < len(name) else "" for name in tokens]
