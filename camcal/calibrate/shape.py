"""The board's shape: variance of every class of terms, offsets of points, the record of the result.

A class has k coefficients x ~ N(0, τ² I) of which the data say N(Λ⁻¹ g, Λ⁻¹). Its scale τ is 0 with probability ½, else
log-normal. Averaged over what the data leave of τ, each coefficient shrinks continuously from the data's value towards
zero; nothing is kept or dropped by a test of significance. The averaged shrinkage is that of one effective scale, which
is the prior under which the coefficients are then estimated.
Source: Mitchell & Beauchamp 1988 (spike and slab); MacKay 1992 (evidence of a scale).

The offsets of a large board's points are solved for each with everything else held. Solving for all of them together
takes memory and time that grow with the square and the cube of their number. Offsets act on each other only through
lens, poses and the board's smooth shape; of a large board each point has a small part in these, so that solving in turn
for the points and for everything else soon leads to the same minimum.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, Derivatives, State
from camcal.dataclass import dataclass, replace
from camcal.solve import least_squares
from camcal.solve.steps import Block, Factors, Step
from camcal.targets.board import (
    CLASSES,
    CORNER_CLASSES,
    IN_PLANE,
    OUT_OF_PLANE,
    RATIOS,
    SCALE,
    Surface,
    bare_term,
    basis,
    scale_unit,
    terms_of,
)

_POINTS, _REACH = 65, 4.0  # of the grid of scales, and how many standard deviations of their logarithm it holds
_WITHIN = np.linspace(-_REACH, _REACH, _POINTS)
# logarithms of τ over the median, among which the effective scale is searched for, and in how many parts of each step
_COARSE, _PARTS = np.linspace(-14.0, 6.0, 21), 20

SCALE_STD = 0.01  # of a board whose size is measured, about the size that it is given with
_NARROWEST = 1e-4  # of a class's median: a prior this narrow leaves nothing of it
_AXES = {IN_PLANE: (0, 1), OUT_OF_PLANE: (2,)}

# Points at most that are solved for together with everything else: in every pass, and in a last one.
TOGETHER, AT_ALL_TOGETHER = 60, 400


@dataclass(frozen=True)
class Scale:
    """effective: the scale whose shrinkage is the averaged one. mean, std: of the scale itself, given the data.
    present: the probability that there is anything at all.
    """

    effective: float
    mean: float
    std: float
    present: float


def scale_of(information: Array, vector: Array, median: float, spread: float) -> Scale:
    """Return the scale of k coefficients.

    information: Λ (k, k) or, where coefficients are independent, its diagonal (k,). vector: g (k,). median, spread: of
    the log-normal distribution.
    """
    return scales_of([information], [vector], np.array([median]), np.array([spread]))[0]


def scales_of(informations: Sequence[Array], vectors: Sequence[Array], medians: Array, spreads: Array) -> list[Scale]:
    """Return the scales of C classes of coefficients, as `scale_of` has each, side by side: one alone would be many
    operations on few numbers.
    """
    values = np.full((len(vectors), max(map(len, vectors))), 1e-300)
    turned, used = np.zeros(values.shape), np.zeros(values.shape)
    for row, (information, vector) in enumerate(zip(informations, vectors, strict=True)):
        own = slice(len(vector))
        used[row, own] = 1.0
        if information.ndim == 2:
            information, axes = np.linalg.eigh(information)  # noqa: PLW2901 - its axes
            turned[row, own] = axes.T @ vector
        else:
            turned[row, own] = vector
        values[row, own] = np.maximum(information, 1e-300)
    scales = medians[:, None] * np.exp(spreads[:, None] * _WITHIN)
    weights = np.exp(-0.5 * _WITHIN**2)
    weights /= weights.sum()
    evidence = _evidence(values, turned, scales)
    top = np.maximum(evidence.max(axis=1, keepdims=True), 0.0)
    slab, spike = weights * np.exp(evidence - top), np.exp(-top)
    share = slab / (slab.sum(axis=1, keepdims=True) + spike)
    mean = (share * scales).sum(axis=1)
    std = np.sqrt(np.maximum((share * scales**2).sum(axis=1) - mean**2, 0.0))
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    # shrinkage does not depend on the length
    direction = np.where(length > 0, turned / np.where(length > 0, length, 1.0), used)
    kept = (_estimates(values, direction, scales) @ share[:, :, None])[:, :, 0]
    wanted = np.sum(values * kept**2, axis=1)
    reached = _fitted(values, direction, medians[:, None] * np.exp(_COARSE))
    step = np.clip((reached < wanted[:, None]).sum(axis=1), 1, len(_COARSE) - 1)
    parts = np.linspace(_COARSE[step - 1], _COARSE[step], _PARTS + 1, axis=1)
    trial = medians[:, None] * np.exp(parts)
    reached = np.log(np.maximum(_fitted(values, direction, trial), 1e-300))
    sought, trial = np.log(np.maximum(wanted, 1e-300)), np.log(trial)
    effective = [np.exp(np.interp(*each)) for each in zip(sought, reached, trial, strict=True)]
    figures = zip(effective, mean, std, share.sum(axis=1), strict=True)
    return [Scale(*map(float, each)) for each in figures]


def _evidence(values: Array, vectors: Array, scales: Array) -> Array:
    """Return the log likelihood of scales (C, n) against no effect, of coefficients (C, k)."""
    squared = scales[:, None] ** 2 * values[..., None]
    gained = vectors[..., None] ** 2 * scales[:, None] ** 2 / (1 + squared) - np.log1p(squared)
    return np.asarray(0.5 * np.sum(gained, axis=1))


def _fitted(values: Array, vectors: Array, scales: Array) -> Array:
    """Return the squares (C, n) that the estimates under scales (C, n) take from the data; they grow with the scale."""
    return np.asarray(np.sum(values[..., None] * _estimates(values, vectors, scales) ** 2, axis=1))


def _estimates(values: Array, vectors: Array, scales: Array) -> Array:
    """Return the coefficients (C, k, n) under scales (C, n)."""
    squared = scales[:, None] ** 2
    return np.asarray(vectors[..., None] * squared / (1 + squared * values[..., None]))


def first_scales() -> dict[str, Scale]:
    """Return the scales to begin with: those of a board that has something of every class."""
    return {name: Scale(own.median, own.median, 0.0, 0.5) for name, own in (CLASSES | CORNER_CLASSES).items()}


def scales_towards(scales: Mapping[str, Scale], others: Mapping[str, Scale], share: float) -> dict[str, Scale]:
    """Return the scales with others, the effective ones a share of the way to these, in logarithms."""
    return dict(scales) | {
        name: replace(own, effective=scales[name].effective * (own.effective / scales[name].effective) ** share)
        for name, own in others.items()
    }


def with_terms(problem: BoardProblem, state: State) -> tuple[BoardProblem, State]:
    """Return problem and state with every term of the board's shape; known coefficients are kept."""
    known = dict(zip(problem.terms, state.shape, strict=True))
    terms = (*terms_of(problem.board), *(term for term in known if bare_term(term) == SCALE))
    shape = np.array([known.get(term, 0.0) for term in terms])
    return replace(problem, terms=terms), replace(state, shape=shape)


def with_priors(problem: BoardProblem, scales: Mapping[str, Scale]) -> BoardProblem:
    """Return the problem with the priors of these scales on the board's shape, as far as it has terms and offsets and
    is not known.
    """
    if problem.board_known:
        return problem
    if problem.terms:
        class_of = {term: name for name, own in CLASSES.items() for term in own.terms}
        bare = map(bare_term, problem.terms)
        stds = [
            SCALE_STD
            if term == SCALE
            else _std(scales[class_of[term]], CLASSES[class_of[term]].median) * scale_unit(problem.board, term)
            for term in bare
        ]
        problem = replace(problem, term_std=np.array(stds))
    if problem.offsets:
        problem = replace(problem, offset_std=offset_std(scales, max(problem.board.extent)))
    return problem


def offset_std(scales: Mapping[str, Scale], side: float) -> Array:
    """Return the standard deviations (3,) of the prior of a point's offset, for a board of that longer side."""
    flat, height = (side * _std(scales[name], CORNER_CLASSES[name].median) for name in (IN_PLANE, OUT_OF_PLANE))
    return np.array([flat, flat, height])


def _std(scale: Scale, median: float) -> float:
    return max(scale.effective, _NARROWEST * median)


def spent_on_offsets(problem: BoardProblem, state: State, derivatives: Derivatives, factors: Factors) -> Array:
    """Return the degrees of freedom (V,) that the corners of each view spend on offsets solved for together with
    everything else, beyond those that `variances.posterior` counts.

    derivatives: those at the state where the factors' equations were linearised.
    """
    return spent_by_block(problem.data(state, derivatives), problem.observations.ids, factors.shared_covariance())


def spent_by_block(block: Block, ids: Array, covariance: Array) -> Array:
    """Return the degrees of freedom (V,) of `spent_on_offsets` by the derivatives themselves.

    block: whose last derivatives are by the offsets of points ids (V, P). covariance: (n, n) of what its derivatives
    are by, in their order, and of the offsets of all points behind.
    """
    assert block.weights is not None
    *parts, by_offset = (jacobian.values.transpose(1, 2, 0) for jacobian in block.shared)
    dense = np.concatenate(parts, axis=1)
    count = dense.shape[1]
    places = count + 3 * np.arange((len(covariance) - count) // 3) + np.arange(3)[:, None]
    traces = np.zeros(ids.size)
    # of the trace of J C Jᵀ of every corner the parts that the derivatives by its offset have
    for axis in range(3):
        follow = 2 * covariance[:count, places[axis]][:, ids.ravel()]
        own = covariance[places, places[axis]][:, ids.ravel()]
        for by_one, by_own, by_dense in zip(by_offset[:, axis], by_offset, dense, strict=True):
            traces += by_one * (np.sum(follow * by_dense, axis=0) + np.sum(own * by_own, axis=0))
    return np.asarray(np.sum((block.weights * traces).reshape(ids.shape), axis=1))


def board_scales(problem: BoardProblem, state: State, factors: Factors, start: int | None = None) -> dict[str, Scale]:
    """Return the scales of the classes at a minimum, each with everything else following.

    start: the place of the board's first term among the shared parameters; None: behind the free lens parameters.
    """
    start, covariance = len(problem.free) if start is None else start, factors.shared_covariance()
    precision, value = _priors(problem, state, start)
    classes: dict[str, tuple[float, Array]] = {}  # the unit of its coefficients, and their places
    if problem.terms:
        for name, own in CLASSES.items():
            members = [place for place, term in enumerate(problem.terms) if bare_term(term) in own.terms]
            if members:
                classes[name] = scale_unit(problem.board, own.terms[0]), start + np.array(members)
        start += len(problem.terms)
    if problem.offsets:
        side = max(problem.board.extent)
        for name, axes in _AXES.items():
            places = [start + axis + 3 * np.arange(problem.board.count) for axis in axes]
            classes[name] = side, np.sort(np.concatenate(places))
    priors, result = CLASSES | CORNER_CLASSES, dict[str, Scale]()
    for names in (CLASSES.keys() & classes, CORNER_CLASSES.keys() & classes):  # of few coefficients, and of many
        chosen = [name for name in classes if name in names]
        known = [_of_data(precision, value, covariance, classes[name][1]) for name in chosen]
        units = [classes[name][0] for name in chosen]
        informations = [unit**2 * information for unit, (information, _) in zip(units, known, strict=True)]
        vectors = [unit * vector for unit, (_, vector) in zip(units, known, strict=True)]
        medians, spreads = np.array([(priors[name].median, priors[name].spread) for name in chosen]).reshape(-1, 2).T
        result |= zip(chosen, scales_of(informations, vectors, medians, spreads) if chosen else (), strict=True)
    return result


def hold_to_print(
    problem: least_squares.Problem[least_squares.State],
    state: least_squares.State,
    terms: Mapping[str, float],
    covariance: Array,
) -> tuple[least_squares.State, Array]:
    """Return a state where what printers do holds x/y scale and shear of the board, and the covariance (D, D) there.

    terms: values of the terms of the board's shape, the last of the D parameters that all views share. covariance: by
    the scatter from view to view. Where views are nearly parallel these terms trade with the lens, and errors within
    views pass for them. The scales of their classes follow such errors; here they are those of what views know in fact,
    but no narrower than the class's median, as boards that have none of it are no reason to claim more.
    """
    step, names = np.zeros(len(covariance)), list(terms)
    for term in (term for ratio in RATIOS for term in terms if bare_term(term) == ratio):
        place = names.index(term) - len(names)
        own = next(own for own in CLASSES.values() if bare_term(term) in own.terms)
        value, variance = terms[term] + step[place], covariance[place, place]
        scale = scale_of(np.array([1 / variance]), np.array([value / variance]), own.median, own.spread)
        gain = covariance[place] / (variance + max(scale.effective, own.median) ** 2)  # wider where views are sure
        step = step - gain * value
        covariance = covariance - np.outer(gain, covariance[place])
    if not step.any():
        return state, covariance
    step = np.concatenate([step, np.zeros(problem.shared - len(step))])
    return problem.retract(state, Step(step, np.zeros(problem.groups))), covariance


def odd_terms(problem: BoardProblem, state: State, factors: Factors) -> tuple[Array, Array]:
    """Return every view's pull (V, 4) on the cubic terms, and what the data know of them (4, 4)."""
    odd = np.array([index for index, name in enumerate(problem.shared_names) if name in CLASSES["cubic"].terms])
    known = _priors(problem, state, len(problem.free))
    return factors.group_scores()[:, odd], _of_data(*known, factors.shared_covariance(), odd)[0]


def _of_data(precision: Array, value: Array, covariance: Array, chosen: Array) -> tuple[Array, Array]:
    """Return the information of the data on some shared parameters, without their prior and everything else following:
    information Λ (k, k) and vector Λ x, where x is the data's value. precision, value: (S,) of priors and parameters.
    covariance: (S, S) of the shared parameters.
    """
    own = np.linalg.inv(covariance[np.ix_(chosen, chosen)])
    # at a minimum the prior's pull and the data's are equal and opposite
    return (own + own.T) / 2 - np.diag(precision[chosen]), own @ value[chosen]


def _priors(problem: BoardProblem, state: State, start: int) -> tuple[Array, Array]:
    """Return the precision of the board's priors on the shared parameters, and the parameters' values; both are 0 for
    the first `start`.
    """
    precision, value = [np.zeros(start)], [np.zeros(start)]
    if problem.terms and problem.term_std is not None:
        precision.append(problem.term_std**-2)
        value.append(state.shape)
    if problem.offsets and problem.offset_std is not None:
        precision.append(np.tile(problem.offset_std**-2, problem.board.count))
        value.append(state.offsets.ravel())
    return np.concatenate(precision), np.concatenate(value)


def surface_of(problem: BoardProblem, state: State, scales: Mapping[str, Scale], covariance: Array) -> Surface:
    """Return the record of the board's shape from a solution and the covariance of its lens and terms."""
    lens, count = len(problem.free), len(problem.terms)
    by_term = basis(problem.board, problem.terms)[:, 2]
    height = _over_plane(problem, by_term @ state.shape + state.offsets[:, 2])
    top, bottom = np.argmax(height), np.argmin(height)
    flattened = _over_plane(problem, by_term)
    slope = flattened[top] - flattened[bottom]
    own = covariance[lens : lens + count, lens : lens + count]
    spread = 0.0 if problem.offset_std is None or not problem.offsets else float(problem.offset_std[2])
    return Surface(
        problem.board,
        (),
        terms=problem.terms,
        coefficients=state.shape,
        covariance=own,
        offsets=state.offsets if state.offsets.any() else None,
        deflection=float(height[top] - height[bottom]),
        deflection_std=float(np.sqrt(max(slope @ own @ slope, 0.0) + 2 * spread**2)),
        classes={name: (scale.mean, scale.std) for name, scale in scales.items()},
    )


def _over_plane(problem: BoardProblem, heights: Array) -> Array:
    """Return heights of the points (C,) or (C, n) over the plane that fits them best: a pose can take it."""
    left, start = [], 0
    for member in problem.board.members.values():
        own = heights[start : start + member.count]
        plane = np.column_stack([np.ones(member.count), member.points()[:, :2] / member.spacing])
        left.append(own - plane @ np.linalg.lstsq(plane, own, rcond=None)[0])
        start += member.count
    return np.concatenate(left)


@dataclass(frozen=True, eq=False)
class PointEquations:
    """The information on every point: matrix (C, 3, 3) and vector (C, 3), of its offset in the board's unit.

    by_corner: (V, P, 3, 3) what single corners add to the information. ids: (V, P) the points that these are.
    """

    information: Array
    vector: Array
    by_corner: Array
    ids: Array

    def offsets(self, std: Array) -> Array:
        """Return the offsets (C, 3) under a prior of standard deviations (3,)."""
        return np.asarray(np.linalg.solve(self.information + np.diag(std**-2), self.vector[..., None])[..., 0])

    def spent(self, std: Array) -> Array:
        """Return the degrees of freedom (V,) that the corners of each view spend on offsets under this prior."""
        covariance = np.linalg.inv(self.information + np.diag(std**-2))
        return np.asarray(np.sum(self.by_corner * covariance[self.ids], axis=(1, 2, 3)))

    def scales(self, side: float, left: float) -> dict[str, Scale]:
        """Return the scales of the two classes of offsets, for a board of the longer side `side`.

        left: the share of the information that is not spent on lens, poses and effects.
        """
        result = {}
        for name, axes in ((IN_PLANE, slice(0, 2)), (OUT_OF_PLANE, slice(2, 3))):
            values, vectors = np.linalg.eigh(left * side**2 * self.information[:, axes, axes])
            turned = np.einsum("cki,ck->ci", vectors, left * side * self.vector[:, axes])
            prior = CORNER_CLASSES[name]
            result[name] = scale_of(values.ravel(), turned.ravel(), prior.median, prior.spread)
        return result


def point_equations(problem: BoardProblem, state: State, derivatives: Derivatives, field: Array) -> PointEquations:
    """Return the equations of all points at a state; field: (2, V, P) px by which effects move the corners."""
    freed = replace(problem, offsets=True)
    moved = replace(derivatives, residuals=derivatives.residuals + field.reshape(2, -1))
    block = freed.data(state, moved)
    jacobian, weights = block.shared[-1].values, block.weights
    assert weights is not None
    points, ids = problem.board.count, problem.observations.ids.ravel()
    weighted = jacobian * weights[:, None, None]
    by_corner = np.einsum("mda,mdb->abm", weighted, jacobian)
    products = by_corner.reshape(9, -1)
    slopes = np.einsum("mda,md->am", weighted, block.residuals)
    information = np.stack([np.bincount(ids, row, points) for row in products], axis=-1).reshape(points, 3, 3)
    gradient = np.stack([np.bincount(ids, row, points) for row in slopes], axis=-1)
    vector = np.einsum("cij,cj->ci", information, state.offsets) - gradient
    by_corner = by_corner.transpose(2, 0, 1).reshape(*problem.observations.ids.shape, 3, 3)
    return PointEquations(information, vector, by_corner, problem.observations.ids)


def focal_correlations(names: tuple[str, ...], covariance: Array) -> dict[tuple[str, str], float]:
    """Return the correlations of the board's in-plane terms with the focal lengths."""
    index = {name: i for i, name in enumerate(names)}
    pairs = [(term, focal) for term in ("x/y scale", "shear") for focal in ("fx", "fy") if {term, focal} <= set(names)]
    std = np.sqrt(np.diag(covariance))
    return {(a, b): float(covariance[index[a], index[b]] / (std[index[a]] * std[index[b]])) for a, b in pairs}
