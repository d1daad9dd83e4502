"""Calibration of a spline: from that of a parametric lens, with as many knots and as much freedom as the data hold.

How far the lens may differ from the parametric one, τ, and how finely, the spacing of the knots, are those with which
views are predicted best by the other views, in blocks: errors within a view are alike for neighbouring corners, so that
the likelihood of corners would have a spline follow them. With the poses eliminated, and base lens and board following,
view v says Hᵥ c = hᵥ of the amplitudes c of the modes. The others give c = (H₋ᵥ + 1/τ²)⁻¹ h₋ᵥ, with which the view's
cost falls by hᵥᵀ c - cᵀ Hᵥ c / 2.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.estimator import Estimate, estimate
from camcal.calibrate.jackknife import influence, predict_views
from camcal.calibrate.noise import robust_sigma
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import DEFAULT_MODEL, MODELS, WIDE_MODEL, model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.spline import CUBIC, SplinedStereographic
from camcal.cameras.spline_modes import ReducedSpline, reduced_spline
from camcal.cameras.validity import rim
from camcal.errors import InsufficientData
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import SingularError, lower_inverse

# Lenses that a spline may start from: the first, unless another one predicts views better by so many standard errors.
_BASES = (WIDE_MODEL, DEFAULT_MODEL, "kannala_brandt5t")
_CLEARLY = 1.5
_SIZES = (8, 11, 15, 20)  # knots across the part of the plane that corners show
_ALIKE = 1.0  # nat: of sizes that predict views alike, the coarsest is taken
_SPREADS = np.geomspace(1e-6, 0.1, 51)  # of differences from the base lens, in units of the plane
_ROUNDS, _SETTLED = 4, 0.1  # of the spread
_FINE = Stopping(relative_decrease=1e-6, iterations=30)
_LOSS = Cauchy(3.0)
_WIDEST = 2 * np.tan(np.radians(345) / 4)  # half of the plane at most
_MARGIN = 1.02  # of a corner's place, to be within the knots
_AROUND = 1.08  # of the angle that the image shows: the end of the knots is no fold near the corners
_BEYOND = 1.5  # of the outermost corner: no farther do the knots reach into an image that shows more
_BLOCKS = 10  # of views, each predicted by the others
_SEEN = 1e-6  # of the largest eigenvalue


Fitted: TypeAlias = tuple[Estimate, Array]


class Normal(NamedTuple):
    """What blocks of views say of the modes, all else following.

    matrices: (B, m, m) and the sides (B, m) that they stand against. cost: of all views without modes.
    """

    matrices: Array
    sides: Array
    cost: float


class Evidence(NamedTuple):
    """How far a lens may differ from its base.

    spread: τ. score: how well views are predicted with it, nat. noise_ratio: by how much the sides of blocks scatter
    more than noise would have it.
    """

    spread: float
    score: float
    noise_ratio: float


def fit_spline_briefly(
    model: SplinedStereographic,
    image_size: tuple[int, int],
    fit_base: Callable[[CameraModel, Fitted | None], Fitted],
    other: Fitted | None = None,
) -> Fitted:
    """Return the brief estimate of a spline that goes on from that of the parametric lens that predicts views best, and
    its symmetries (V,).

    fit_base: makes that of a parametric lens, going on from another one. other: one that there is. Raises
    InsufficientData where there is no such lens.
    """
    start = None if other is None or isinstance(other[0].problem.model, ReducedSpline) else other
    best: tuple[Array, Fitted] | None = None
    for base in map(model_named, _BASES):
        try:
            brief = start if start is not None and start[0].problem.model is base else fit_base(base, start)
            scores, _ = predict_views(brief[0], influence(brief[0]))
        except (SingularError, np.linalg.LinAlgError, InsufficientData):
            continue
        start = start or brief
        # the first one unless another one is clearly better
        if best is None or np.sum(scores - best[0]) > _CLEARLY * np.std(scores - best[0]) * np.sqrt(len(scores)):
            best = scores, brief
    if best is None:
        raise InsufficientData("no parametric lens was found that a spline could start from: add views")
    return fit_spline(*best[1], model, image_size, chosen=model is not MODELS[model.name])


def fit_spline(
    other: Estimate, turns: Array, model: SplinedStereographic, image_size: tuple[int, int], *, chosen: bool
) -> Fitted:
    """Return a brief estimate of a spline that goes on from one with a parametric lens, and its symmetries (V,).

    chosen: whether the knots of the model are wanted; else they are as the data have it.
    """
    start = _robust_problem(other)
    camera = Camera(other.problem.model, image_size, other.state.parameters)
    splines = [model] if chosen else _splines(camera, start, other.state)
    used = splines[len(splines) > 1]
    problem, state = _fitted(start, other.state, camera, used)
    rest = splines
    while len(rest) > 1:
        # all sizes are compared at the same place, with the noise of a lens that fits
        weighed = _as_weighed(problem, state)
        found = [_evidence(_normal(*_of_spline(weighed, other.state, camera, spline))) for spline in rest]
        scores = np.array([each.score for each in found])
        best = rest[int(np.argmax(scores > scores.max() - _ALIKE))]
        if best == used:
            break
        used = best
        problem, state = _fitted(replace(start, sigma=problem.sigma), other.state, camera, used)
        rest = splines[splines.index(used) :]  # with less noise finer ones may be better
    whole = replace(problem, observations=start.observations)
    return estimate(whole, state, other.additional, brief=True), turns


def _robust_problem(other: Estimate) -> BoardProblem:
    """Return the problem of an estimate with every corner counting alike, as far as it fits."""
    problem = other.problem
    everything = replace(problem.observations, weights=problem.observations.present.astype(float), whitening=None)
    problem = replace(problem, loss=_LOSS, observations=everything, noise=None, offsets=False)
    problem = problem.within_domain(other.state)
    return replace(problem, sigma=_sigma(problem, other.state))


def _splines(camera: Camera, problem: BoardProblem, state: State) -> list[SplinedStereographic]:
    """Return splines with few and with many knots over what the image and the corners show."""
    rays = camera.unproject(rim(camera)[0])
    both = (rays.directions[rays.valid], _corners(problem, state)[0])
    image, seen = (
        np.abs(2 * each[:, :2] / (np.linalg.norm(each, axis=1) + each[:, 2])[:, None]).max(axis=0, initial=0.0)
        for each in both
    )
    shown = np.maximum(np.minimum(image, _BEYOND * seen), seen)
    reach = 2 * np.tan(np.minimum(_AROUND * np.arctan(shown / 2), np.arctan(_WIDEST / 2)))
    found = []
    for size in _SIZES:
        per_unit = (size - CUBIC) / (2 * _MARGIN * seen.max())
        columns, rows = (int(np.ceil(2 * own * per_unit)) + CUBIC for own in reach)
        fov = np.ceil(np.degrees(4 * np.arctan(reach[0] / 2)))  # a whole number of degrees, as in files of mrcal
        found.append(SplinedStereographic(knots=(columns, rows), fov_x_deg=float(fov)))
    return found


def _corners(problem: BoardProblem, state: State) -> tuple[Array, Array]:
    """Return the corners that count in the camera frame (M, 3), and their weights (M,)."""
    weights = problem.observations.weights
    return problem.camera_points(state)[:, weights > 0].T, weights[weights > 0]


def _fitted(
    problem: BoardProblem, state: State, camera: Camera, spline: SplinedStereographic
) -> tuple[BoardProblem, State]:
    """Return problem and state of a spline, with its likeliest spread."""
    own, here = _of_spline(problem, state, camera, spline)
    spread = 0.0
    for _ in range(_ROUNDS):
        before, found = spread, _evidence(_normal(_as_weighed(own, here), here))
        spread = found.spread
        own = _with_spread(own, spread, found.noise_ratio, camera.image_size)
        here = minimise(own.within_domain(here), here, _FINE).state
        own = replace(own, sigma=_sigma(own, here))
        if abs(spread - before) < _SETTLED * spread:
            break
    return own, here


def _of_spline(
    problem: BoardProblem, state: State, camera: Camera, spline: SplinedStereographic
) -> tuple[BoardProblem, State]:
    reduced = reduced_spline(camera, *_corners(problem, state), spline)
    problem = replace(problem, model=reduced, free=np.arange(len(reduced.parameter_names)))
    problem = _with_spread(problem, _SPREADS[-1], 1.0, camera.image_size)
    problem = replace(problem, observations=_inside(problem, state, spline))
    return problem, replace(state, parameters=reduced.start_values.copy())


def _inside(problem: BoardProblem, state: State, spline: SplinedStereographic) -> Observations:
    """Return the observations without the corners at the edge of the knots, which would hold it inside them."""
    points = problem.camera_points(state)
    places = np.abs(2 * points[:2] / (np.linalg.norm(points, axis=0) + points[2]))
    near = (places * _MARGIN > np.array(spline.grid.half)[:, None, None]).any(axis=0)
    return replace(problem.observations, weights=np.where(near, 0.0, problem.observations.weights))


def _with_spread(problem: BoardProblem, spread: float, noise_ratio: float, image_size: tuple[int, int]) -> BoardProblem:
    assert isinstance(problem.model, ReducedSpline)
    model = replace(problem.model, spread=spread, noise_ratio=noise_ratio)
    stds = model.prior_std(image_size, float(model.start_values[0]))
    return replace(problem, model=model, lens_spread=stds, lens_mean=None)


def _as_weighed(problem: BoardProblem, state: State) -> BoardProblem:
    """Return the problem with the weights that its loss gives to the corners at a state."""
    squared = (problem.distances(problem.residuals(state)) / problem.sigma) ** 2
    weights = problem.observations.weights * np.nan_to_num(_LOSS.weight(squared))
    return replace(problem, loss=None, observations=replace(problem.observations, weights=weights))


def _normal(problem: BoardProblem, state: State) -> Normal:
    """Return what the views say of the modes, at a state of a spline."""
    model = problem.model
    assert isinstance(model, ReducedSpline)
    assert problem.lens_spread is not None
    equations = problem.equations(state, problem.derivatives(state))
    inverse = lower_inverse(np.linalg.cholesky(equations.group_group))
    reduced = inverse @ equations.group_shared
    gone = (inverse @ equations.gradient.groups[..., None])[..., 0]
    parts = equations.group_gradients - np.einsum("gis,gi->gs", reduced, gone)
    blocks = np.array_split(np.arange(len(parts)), min(len(parts), _BLOCKS))
    matrices = np.empty((len(blocks), *equations.shared_shared.shape))
    for matrix, block in zip(matrices, blocks, strict=True):
        rows = reduced[block].reshape(-1, reduced.shape[2])
        matrix[:] = equations.group_products[block].sum(axis=0) - rows.T @ rows
    prior = problem.prior_precision(state)
    whole = matrices.sum(axis=0) + prior
    modes = np.arange(model.first_mode, len(problem.free))
    others = np.setdiff1d(np.arange(len(whole)), modes)
    scale = np.sqrt(np.diag(whole)[others])
    inner = np.linalg.pinv(whole[np.ix_(others, others)] / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    follow = np.zeros((len(whole), len(modes)))  # what all parameters do for a change of the modes
    follow[modes] = np.eye(len(modes))
    follow[others] = -(inner / np.outer(scale, scale)) @ whole[np.ix_(others, modes)]
    matrices = follow.T @ matrices @ follow
    gradient, values = equations.gradient.shared - np.einsum("gis,gi->s", reduced, gone), state.parameters[modes]
    pull = gradient[others] / scale
    # of the modes' own prior in the cost nothing is left
    lowest = equations.cost - 0.5 * float(np.sum(gone**2) + pull @ inner @ pull)
    lowest -= 0.5 * float(np.sum((values / problem.lens_spread[modes]) ** 2))
    sides = matrices @ values - np.stack([parts[block].sum(axis=0) for block in blocks]) @ follow
    cost = lowest + float(values @ sides.sum(axis=0)) - 0.5 * float(values @ matrices.sum(axis=0) @ values)
    return Normal(matrices, sides, cost)


def _evidence(normal: Normal) -> Evidence:
    """Return the spread with which the other views predict every block of views best."""
    whole, side = normal.matrices.sum(axis=0), normal.sides.sum(axis=0)
    gains = np.zeros((len(normal.sides), len(_SPREADS)))
    for block, (matrix, pull) in enumerate(zip(normal.matrices, normal.sides, strict=True)):
        values, vectors = np.linalg.eigh(whole - matrix)
        amplitudes = ((side - pull) @ vectors) / (np.maximum(values, 0.0) + _SPREADS[:, None] ** -2)
        moved = amplitudes @ (vectors.T @ matrix @ vectors)
        gains[block] = amplitudes @ (pull @ vectors) - 0.5 * np.sum(moved * amplitudes, axis=1)
    total = gains.sum(axis=0)
    behind = gains[:, [int(np.argmax(total))]] - gains
    # the least spread with which views are predicted about as well as with any
    allowed = np.std(behind, axis=0, ddof=1) * np.sqrt(len(gains))
    best = int(np.argmax(behind.sum(axis=0) <= allowed))
    values, vectors = np.linalg.eigh(whole)
    seen = values > _SEEN * values[-1]
    amplitudes = vectors / (values + _SPREADS[best] ** -2) @ (side @ vectors)
    left = (normal.sides - normal.matrices @ amplitudes) @ vectors[:, seen]
    ratio = max(float(np.mean((left**2).sum(axis=0) / values[seen])), 1.0)
    return Evidence(float(_SPREADS[best] * np.sqrt(ratio)), float(total[best]) - normal.cost, ratio)


def _sigma(problem: BoardProblem, state: State) -> float:
    return robust_sigma(problem.distances(problem.residuals(state)), problem.observations.weights > 0)
