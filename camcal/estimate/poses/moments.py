"""Covariances of poses; weakly determined ones as second moments along the profile of the likelihood.

Where a direction is known to a few degrees only, as of a tag seen from the front or of four points close together, the
pixels are not linear within its region: the valley of the error bends, and one side of it is flatter than the other.
The inverse normal matrix then says too little. There each of the two least known turns is followed to both sides with
the other five parameters at their best. Along that curve, the density is that of the pixels integrated over these five
by Laplace's method, and the second moment about the pose takes the place of the inverse normal matrix, to which it is
equal where the pixels are linear. Source: Tierney & Kadane, JASA 1986 (marginal densities).
"""

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.problem import PoseProblems
from camcal.geometry import rotation as so3
from camcal.solve.independent import Minima, Models

SINGULAR = 1e-10  # smallest eigenvalue of the scaled normal matrix of a pose that the points fix
_HELD = 1e-14  # keeps the normal matrices of other minima from having no inverse
_LINEAR, _OPEN = 0.02, 1.0  # rad: turns known better are linear, and those known less are not known at all
_MAX_CHI2_DIFFERENCE = 30.0  # χ² over the lowest, from where minima are not worth the time
_TURNS = 2  # the least known ones; the third is about the line of sight, and linear
_NODES = np.arange(-6.0, 7.0)  # standard deviations; the trapezoidal rule is exact for a normal density
_CORRECTIONS = 2  # Newton steps of the five other parameters at a node
_RISE = 1.0  # of the log density behind a low: another minimum begins


def covariances(problems: PoseProblems, minima: Minima, centres: Array, sigma: float) -> Array:
    """Return the covariances (S, 6, 6) of steps of frame_T_object, from minima of frame_T_centre.

    centres: (P, 3) the places in the objects' frames that the points of the problems are counted from. sigma: standard
    deviation of a whitened coordinate.
    """
    offsets = -centres[minima.which]
    result = sigma**2 * inverses(minima.models.normal)
    spread = np.einsum("sii->s", result[:, 3:, 3:])
    bent = np.flatnonzero((spread > _LINEAR**2) & (spread < _OPEN**2))
    if bent.size:
        least = np.full(len(problems.view), np.inf)
        np.minimum.at(least, minima.which, minima.cost)
        worth = 2 * (minima.cost - least[minima.which])[bent] <= _MAX_CHI2_DIFFERENCE * sigma**2
        bent = bent[worth & (scaled_eigenvalues(minima.models.normal[bent])[:, 0] > SINGULAR)]
    if bent.size:
        result[bent] += _excess(problems, minima.take(bent), offsets[bent], result[bent], sigma)
    return _moved(result, minima.states, offsets)


def scaled_eigenvalues(normal: Array) -> Array:
    """Return the eigenvalues (S, P), ascending, of normal matrices (S, P, P) scaled to a unit diagonal."""
    # a parameter on which nothing depends has an eigenvalue of 0
    scale = 1 / np.sqrt(np.maximum(np.einsum("sii->si", normal), np.finfo(float).tiny))
    return np.linalg.eigvalsh(normal * scale[:, :, None] * scale[:, None, :])


def _moved(covariances: Array, states: Array, offsets: Array) -> Array:
    """Return the covariances (S, 6, 6) of a_T_c of those of states a_T_b, with the origin of c at offsets (S, 3)."""
    moves = se3.shift_jacobians(states, offsets)
    return np.asarray(moves @ covariances @ moves.transpose(0, 2, 1))


def inverses(normal: Array) -> Array:
    """Return the inverses of normal matrices (S, P, P); of singular ones, something large."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("sii->si", normal), np.finfo(float).tiny))
    both = scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.inv(normal * both + _HELD * np.eye(normal.shape[-1]))
    return np.asarray((inverse + inverse.transpose(0, 2, 1)) / 2 * both)


def _excess(problems: PoseProblems, minima: Minima, offsets: Array, linear: Array, sigma: float) -> Array:
    """Return what second moments about minima have more than their linear covariances (S, 6, 6)."""
    roots = np.linalg.cholesky(linear)
    inverse_roots = np.linalg.inv(roots)
    values, turns = np.linalg.eigh(linear[:, 3:, 3:])
    result = np.zeros_like(linear)
    for turn in range(2, 2 - _TURNS, -1):
        others = turns[:, :, [other for other in range(3) if other != turn]]
        along = np.einsum("sij,sj->si", linear[:, :, 3:], turns[:, :, turn]) / np.sqrt(values[:, turn, None])
        moments = _moments(problems, minima, offsets, along, others, sigma)
        # where the camera loses the object at once, nothing is known beyond the linear covariance
        moments = np.where(np.isfinite(moments).all(axis=(1, 2), keepdims=True), moments, linear)
        # what a curve says less than the linear covariance is an accident of its ends
        excess, axes = np.linalg.eigh(inverse_roots @ moments @ inverse_roots.transpose(0, 2, 1))
        axes = roots @ axes
        result += (axes * np.maximum(excess - 1, 0.0)[:, None, :]) @ axes.transpose(0, 2, 1)
    return result


def _moments(
    problems: PoseProblems, minima: Minima, offsets: Array, along: Array, others: Array, sigma: float
) -> Array:
    """Return the second moments (S, 6, 6) about minima of the curves that begin with the steps `along` (S, 6), of one
    standard deviation; others: (S, 3, 2) the axes of the turns that are free.

    The steps are those of poses with the origin at the offsets (S, 3), which bends them too, as steps of the minima.
    """
    count, nodes = len(along), len(_NODES)
    start, which = np.repeat(minima.states, nodes, axis=0), np.repeat(minima.which, nodes)
    free = np.zeros((count, 6, 5))
    free[:, :3, :3], free[:, 3:, 3:] = np.eye(3), others
    free = np.repeat(free, nodes, axis=0)
    states = se3.retract(start, (_NODES[:, None] * along[:, None]).reshape(-1, 6))
    for _ in range(_CORRECTIONS):
        models = problems.linearise(states, which)
        step, across, density = _across(models, free, sigma)
        states = se3.retract(states, step)
    offsets = np.repeat(offsets, nodes, axis=0)
    placed, about = se3.shifted(states, offsets), se3.shifted(start, offsets)
    away = np.concatenate([placed[:, :, 3] - about[:, :, 3], _turn(placed, about)], axis=1)
    second = away[:, :, None] * away[:, None, :] + _moved(sigma**2 * across, states, offsets)
    second = _moved(second, about, -offsets)
    weights = _weights(density.reshape(count, nodes))
    counted = np.where(weights[:, :, None, None] != 0, second.reshape(count, nodes, 6, 6), 0.0)
    return np.asarray(np.einsum("sk,skij->sij", weights, counted))


def _turn(states: Array, start: Array) -> Array:
    return so3.log(states[:, :, :3] @ start[:, :, :3].transpose(0, 2, 1))


def _across(models: Models, free: Array, sigma: float) -> tuple[Array, Array, Array]:
    """Return the steps (T, 6) to the best of the free parameters, their inverse normal matrices (T, 6, 6), and the
    logarithms (T,) of the density integrated over them; free: (T, 6, 5).
    """
    inside = np.isfinite(models.cost)
    normal = np.where(inside[:, None, None], models.normal, np.eye(6))
    gradient = np.where(inside[:, None], models.gradient, 0.0)
    own = free.transpose(0, 2, 1) @ normal @ free
    across = free @ inverses(own) @ free.transpose(0, 2, 1)
    step = -np.einsum("tij,tj->ti", across, gradient)
    cost = models.cost + 0.5 * np.einsum("ti,ti->t", gradient, step)
    density = -cost / sigma**2 - 0.5 * np.linalg.slogdet(own)[1]
    return step, across, np.where(inside, density, -np.inf)


def _weights(density: Array) -> Array:
    """Return the weights (S, K) of the nodes by the logarithms of their densities, zero beyond a low on either side.

    They are NaN where the density of the middle, the minimum itself, is zero.
    """
    middle = len(_NODES) // 2
    peak = density[:, middle, None]
    density = density - np.where(np.isfinite(peak), peak, np.nan)
    for side in (density[:, middle:], density[:, middle::-1]):
        beyond = np.maximum.accumulate(side > np.minimum.accumulate(side, axis=1) + _RISE, axis=1)
        side[beyond] = -np.inf
    weights = np.exp(np.minimum(density, 50.0))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
