"""Batch estimation of the motion from the pixels of all frames, with covariances and evidence.

Frames of one chain are linked by free motion; chains stand one after another in one block-tridiagonal system, and the
solver's rules of damping hold chain by chain, so that many variants of a stretch of a track are solved in one go. Where
a carrier vibrates, the pose of a frame is that of the smooth motion and a shake of its own: pixels see the shaken pose.
Source: Barfoot, State Estimation for Robotics, 2017, sections 4.3 and 5.3; MacKay, Bayesian interpolation, 1992 (noise
from the evidence).
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData
from camcal.estimate.tracking.frames import FrameCosts
from camcal.estimate.tracking.motion import POSE, FreeMotion, MotionState, difference
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.steps import TridiagonalFactor, factorise_tridiagonal

_STOPPING = Stopping(iterations=60, damping=1e-6, rise=30.0, by_gain=False, most=1e3)
_SETTLED = 1e-3  # decrease of a chain's cost that is below which no step is made
_LOOSENED = (1e-9, 1e-6, 1e-3, 1.0)  # damping against rounding
_TEMPERATURES = (1e4, 1e3, 100.0, 30.0, 10.0, 3.0, 1.0)  # a shake of a board may be a hundred deviations of its pose
_IDENTITY = np.eye(6)


@dataclass(frozen=True, eq=False)
class Chains:
    """M frames of one or more chains, one after another.

    frames: what they say of their poses. used: (M) whether they count. steps: (M - 1) s between frames. chains: (M)
    numbers from 0, in order. begun: (M - 1) links over which the motion began again. unknown: (S,) variances of what is
    not known of it. anchors: (M, S) information about states where they are now: little at a start, much at one held.
    jitter_std: (M, 6, 6) covariance of shakes, None if nothing shakes. groups: (M) numbers from 0, in order, of
    chains that are judged together; None for each on its own.
    """

    frames: FrameCosts
    used: Array
    steps: Array
    chains: Array
    begun: Array
    unknown: Array
    anchors: Array
    jitter_std: Array | None
    groups: Array | None = None

    @property
    def linked(self) -> Array:
        """The mask (M - 1) of frames that the next one of the same chain follows."""
        return np.asarray(self.chains[1:] == self.chains[:-1])

    @property
    def judged(self) -> Array:
        """The numbers (M) by which frames are judged together."""
        return self.chains if self.groups is None else self.groups

    def sums(self, values: Array) -> Array:
        """Return the sums of values (M) by group."""
        return np.bincount(self.judged, values, minlength=int(self.judged[-1]) + 1)


class _Terms(NamedTuple):
    """What a linearisation gives: costs by chain, gradient (M, S), blocks of the curvature, and the shaken poses'."""

    costs: Array
    gradient: Array
    blocks: Array
    beside: Array
    pixel_gradient: Array
    pixel_curvature: Array


@dataclass(frozen=True, eq=False)
class BatchTrack:
    """The likeliest states of chains and what is known of them.

    states: of M frames. pulls: (M, 6) of the pixels on the smooth poses: shakes are Σ times them. costs: by group, 2 x
    the negative logarithm. factor: of the curvature. curvatures: (M, 6, 6) what pixels say of the frames' poses.
    evidence: by group, -2 ln, up to what does not depend on states, noise and shakes.
    """

    chains: Chains
    motion: FreeMotion
    states: MotionState
    pulls: Array
    costs: Array
    evidence: Array
    factor: TridiagonalFactor
    curvatures: Array

    @property
    def poses(self) -> tuple[Array, Array]:
        """The rotations (M, 3, 3) and translations (M, 3) of the frames, with their shakes."""
        return _shaken(self.chains, self.states, self.pulls)


def _shaken(chains: Chains, states: MotionState, pulls: Array) -> tuple[Array, Array]:
    """Return the poses of the frames: the smooth ones with their shakes."""
    if chains.jitter_std is None:
        return states.rotations, states.translations
    shakes = (chains.jitter_std @ pulls[..., None])[..., 0]
    return so3.exp(shakes[:, 3:]) @ states.rotations, states.translations + shakes[:, :3]


class _Links(NamedTuple):
    """Information (M - 1, S, S) of the steps between frames, zero between chains, and ln |Q| (M - 1)."""

    information: Array
    log_volume: Array


def _links(chains: Chains, motion: FreeMotion) -> _Links:
    linked = chains.linked
    steps = np.where(linked, chains.steps, 1.0)
    unique, inverse = np.unique(steps, return_inverse=True)
    information = motion.information(unique)[inverse]
    volume = np.linalg.slogdet(motion.covariance(unique))[1][inverse]
    anew = np.flatnonzero(chains.begun & linked)
    if len(anew):
        spread = motion.covariance(steps[anew]) + np.diag(chains.unknown)
        information[anew] = np.linalg.inv(spread)
        volume[anew] = np.linalg.slogdet(spread)[1]
    return _Links(np.where(linked[:, None, None], information, 0.0), np.where(linked, volume, 0.0))


def solve(
    chains: Chains,
    motion: FreeMotion,
    start: MotionState,
    iterations: int = _STOPPING.iterations,
    pulls: Array | None = None,
) -> BatchTrack:
    """Return the likeliest states from a start and pulls (M, 6) there, None to find them out first.

    iterations: 0 judges the start as it is.
    """
    links = _links(chains, motion)
    states = start
    if pulls is None:
        pulls = _first_pulls(chains, states)
    terms = _linearised(chains, motion, links, states, pulls, start)
    damping = np.full(len(terms.costs), _STOPPING.damping)
    going = np.ones(len(terms.costs), dtype=bool)
    for _ in range(iterations):
        step = -_factor(terms, damping[chains.judged]).solve(terms.gradient)
        step = np.where(going[chains.judged][:, None], step, 0.0)
        moved = states.moved(step)
        pulled = _pulled(chains, pulls, step, terms)
        tried = _linearised(chains, motion, links, moved, pulled, start)
        gained = terms.costs - tried.costs
        better = going & (gained > 0)
        row = better[chains.judged]
        states = MotionState(
            *(
                np.where(row.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
                for new, old in zip(moved, states, strict=True)
            )
        )
        pulls = np.where(row[:, None], pulled, pulls)
        terms = _mixed(terms, tried, better, chains)
        damping = np.where(
            better, _STOPPING.eased(damping, 0.0, gained), np.where(going, _STOPPING.raised(damping, 1.0), damping)
        )
        going &= np.where(better, gained > _SETTLED, damping < _STOPPING.most)
        if not going.any():
            break
    return _judged(chains, motion, links, states, pulls, terms)


def _first_pulls(chains: Chains, states: MotionState) -> Array:
    """Return the pulls (M, 6) at given states: a shake may be so large that all pixels would be taken for wrong."""
    pulls = np.zeros((len(chains.used), 6))
    if chains.jitter_std is None:
        return pulls
    nothing, best = pulls, chains.frames.linearised(*_shaken(chains, states, pulls))[0]
    for temper in _TEMPERATURES:
        _, gradient, curvature = chains.frames.linearised(*_shaken(chains, states, pulls), temper)
        shakes = (chains.jitter_std @ pulls[..., None])[..., 0]
        right = gradient[..., None] - curvature @ shakes[..., None]
        pulls = -np.linalg.solve(_IDENTITY + curvature @ chains.jitter_std, right)[..., 0]
    cost = chains.frames.linearised(*_shaken(chains, states, pulls))[0]
    cost = cost + ((chains.jitter_std @ pulls[..., None])[..., 0] * pulls).sum(axis=1)
    return np.where((chains.used & (cost < best))[:, None], pulls, nothing)


def _mixed(old: _Terms, new: _Terms, better: Array, chains: Chains) -> _Terms:
    """Return the terms of the chains that are better and those of the others as they were."""
    if better.all():
        return new
    row = better[chains.judged]
    parts = [np.where(better, new.costs, old.costs)]
    for one, other in zip(new[1:], old[1:], strict=True):
        chosen = row[: len(one)]
        parts.append(np.where(chosen.reshape(-1, *(1,) * (one.ndim - 1)), one, other))
    return _Terms(*parts)


def _linearised(
    chains: Chains, motion: FreeMotion, links: _Links, states: MotionState, pulls: Array, anchor: MotionState
) -> _Terms:
    cost, gradient, curvature = chains.frames.linearised(*_shaken(chains, states, pulls))
    used = chains.used
    cost, gradient = np.where(used, cost, 0.0), np.where(used[:, None], gradient, 0.0)
    curvature = np.where(used[:, None, None], curvature, 0.0)
    count, size = len(used), motion.size
    total = np.zeros((count, size))
    blocks = np.zeros((count, size, size))
    if chains.jitter_std is None:
        total[:, POSE], blocks[:, POSE, POSE] = gradient, curvature
    else:
        # Shakes integrated out: H' = (I + H Σ)⁻¹ H, g' = (I + H Σ)⁻¹ (g - H j).
        shakes = (chains.jitter_std @ pulls[..., None])[..., 0]
        cost = cost + (shakes * pulls).sum(axis=1)
        loosened = np.linalg.inv(_IDENTITY + curvature @ chains.jitter_std)
        blocks[:, POSE, POSE] = loosened @ curvature
        total[:, POSE] = (loosened @ (gradient[..., None] - curvature @ shakes[..., None]))[..., 0]
    forecast, growth = motion.forecast(states.at(slice(None, -1)), chains.steps)
    off = difference(states.at(slice(1, None)), forecast)
    skew = so3.hat(off[:, 3:6]) / 2
    ahead = np.tile(np.eye(size), (count - 1, 1, 1))
    ahead[:, 3:6, 3:6] -= skew
    growth[:, 3:6] += skew @ growth[:, 3:6]
    weighted = (links.information @ off[..., None])[..., 0]
    cost[1:] += (off * weighted).sum(axis=1)
    left, right = growth.swapaxes(-1, -2), ahead.swapaxes(-1, -2)
    total[:-1] -= (left @ weighted[..., None])[..., 0]
    total[1:] += (right @ weighted[..., None])[..., 0]
    blocks[:-1] += left @ links.information @ growth
    blocks[1:] += right @ links.information @ ahead
    beside = -right @ links.information @ growth
    held_off = difference(states, anchor)
    cost += (chains.anchors * held_off**2).sum(axis=1)
    total += chains.anchors * held_off
    every = np.arange(size)
    blocks[:, every, every] += chains.anchors
    return _Terms(chains.sums(cost), total, blocks, beside, gradient, curvature)


def _factor(terms: _Terms, damping: Array) -> TridiagonalFactor:
    """Return the factor of the damped curvature, damped more where rounding has left it indefinite.

    Raises InsufficientData if nothing helps.
    """
    from scipy.linalg import LinAlgError

    every = np.arange(terms.blocks.shape[1])
    for least in (0.0, *_LOOSENED):
        blocks = terms.blocks.copy()
        blocks[:, every, every] *= 1 + np.maximum(damping, least)[:, None]
        try:
            return factorise_tridiagonal(blocks, terms.beside)
        except LinAlgError:
            continue
    raise InsufficientData("ill-conditioned motion (rounding errors): check units and time stamps")


def _pulled(chains: Chains, pulls: Array, step: Array, terms: _Terms) -> Array:
    """Return the pulls (M, 6) once the smooth poses have moved by steps."""
    if chains.jitter_std is None:
        return pulls
    curvature, shakes = terms.pixel_curvature, (chains.jitter_std @ pulls[..., None])[..., 0]
    right = terms.pixel_gradient[..., None] + curvature @ (step[:, POSE] - shakes)[..., None]
    return -np.linalg.solve(_IDENTITY + curvature @ chains.jitter_std, right)[..., 0]


def _judged(
    chains: Chains,
    motion: FreeMotion,
    links: _Links,
    states: MotionState,
    pulls: Array,
    terms: _Terms,
) -> BatchTrack:
    factor = _factor(terms, np.zeros(len(chains.used)))
    volume = factor.log_determinants()
    volume[1:] += links.log_volume
    volume -= np.where(chains.anchors > 0, np.log(np.maximum(chains.anchors, 1e-300)), 0.0).sum(axis=1)
    if chains.jitter_std is not None:
        volume += np.linalg.slogdet(_IDENTITY + terms.pixel_curvature @ chains.jitter_std)[1]
    return BatchTrack(
        chains,
        motion,
        states=states,
        pulls=pulls,
        costs=terms.costs,
        evidence=terms.costs + chains.sums(volume),
        factor=factor,
        curvatures=terms.pixel_curvature,
    )


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariances of a track: of states (M, S, S), with the next (M - 1, S, S), of the frames' poses (M, 6, 6).

    informed: (M, 6, 6) what shakes are known by, H' - H' C H'; zero where nothing shakes.
    """

    states: Array
    beside: Array
    poses: Array
    informed: Array


def spread_of(track: BatchTrack) -> Spread:
    """Return the covariances of a track."""
    states, beside = track.factor.covariances()
    poses = states[:, POSE, POSE]
    informed = np.zeros_like(poses)
    jitter_std, curvature = track.chains.jitter_std, track.curvatures
    if jitter_std is not None:
        # Given the smooth pose, that of the frame lies (I + Σ H)⁻¹ of the way from what the pixels say to it.
        loosened = np.linalg.inv(_IDENTITY + curvature @ jitter_std)
        own = loosened @ curvature
        informed = own - own @ poses @ own
        poses = jitter_std @ loosened + loosened.swapaxes(-1, -2) @ poses @ loosened
    return Spread(states, beside, (poses + poses.swapaxes(-1, -2)) / 2, informed)
