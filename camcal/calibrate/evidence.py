"""Evidence for and size of errors within views beyond noise."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import (
    EFFECTS,
    FLEX,
    FLEX_TERMS,
    ROLLING,
    Effect,
    EffectScales,
    columns_at,
    likelihood_gain,
)
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.problem import POSE
from camcal.dataclass import dataclass, replace
from camcal.targets.board import basis

_VIEWS = 40  # effects that so many views do not show need not be modelled
# Gains of the restricted log likelihood. Of noise alone few are beyond the first, with up to forty views; beyond the
# second, effects are certain.
_NOTHING, _CERTAIN = 3.0, 10.0
# That of an effect over the others, beyond which it is named. Cameras that expose all rows at once reach 10 by chance
# resemblance, those that do not 16 to 140.
NAMED = 20.0
_NAMES = tuple(effect.name for effect in EFFECTS)


@dataclass(frozen=True)
class Evidence:
    """share: 0…1, the weight of the effects. rolling, flex: the gains of the log likelihood that these two
    bring beside the others.
    """

    share: float = 0.0
    rolling: float = 0.0
    flex: float = 0.0


@dataclass(frozen=True)
class WithinViews:
    """What the errors within views are.

    share: 0…1, the evidence that they are more than noise. rolling_px: by how far the rows of an image are apart
    over its height, where a rolling shutter is seen, flex: RMS height in the board's unit by which the board bends,
    where that is seen: each of a typical view (median) and at most.
    """

    share: float = 0.0
    rolling_px: tuple[float, float] | None = None
    flex: tuple[float, float] | None = None


def evidence_of_effects(plain: Estimate) -> Evidence:
    """Return the evidence for effects by the gain of the restricted likelihood that they bring.

    plain: the estimate that takes errors within views for noise.
    """
    table = plain.problem.observations
    count = len(table.ids)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _VIEWS)).astype(np.intp))
    some = replace(
        plain.problem,
        observations=table.take(chosen),
        noise=plain.noise.views[chosen],
        offsets=False,
    )
    state = plain.state.take(chosen)
    derivatives = some.derivatives(state)
    start = EffectScales.start(len(chosen), plain.noise.sigma, max(some.board.extent))

    def gain(names: Sequence[str]) -> float:
        columns = columns_at(some, state, derivatives, names)
        return likelihood_gain(some.equations(state, derivatives, columns.values), columns.effect, start)

    everything = gain(_NAMES)
    share = float(np.clip((everything - _NOTHING) / (_CERTAIN - _NOTHING), 0, 1))
    if everything < NAMED:  # no part of it can have more
        return Evidence(share)
    rolling, flex = (everything - gain([name for name in _NAMES if name != own.name]) for own in (ROLLING, FLEX))
    return Evidence(share, rolling, flex)


def within_views(evidence: Evidence, everything: Estimate, height: int) -> WithinViews:
    """Return what the errors within views are, by the estimate that models all effects; height: of the image, px."""
    problem, state = everything.problem, everything.state
    present = problem.observations.present
    columns = columns_at(problem, state, problem.derivatives(state), everything.additional.effects)
    rolling_px = flex = None
    if evidence.rolling >= NAMED:
        moved = columns.of([EFFECTS.index(ROLLING)]).values
        products = _products(everything, columns.effect, ROLLING)
        squares = np.einsum("imvp,vmn,invp->vp", moved, products, moved, optimize=True)
        rows = problem.observations.pixels[1] - np.mean(problem.observations.pixels[1][present])
        # the effect grows with the distance from the middle row: by how much over the height of the image
        apart = np.sum(squares, axis=1) / np.sum(rows**2 * present, axis=1)
        rolling_px = _typical_and_most(height * np.sqrt(apart))
    if evidence.flex >= NAMED:
        terms = basis(problem.board, FLEX_TERMS)[:, 2]
        squares = np.einsum("cm,vmn,cn->vc", terms, _products(everything, columns.effect, FLEX), terms)
        flex = _typical_and_most(np.sqrt(np.mean(squares, axis=1)))
    return WithinViews(evidence.share, rolling_px, flex)


def _products(estimate: Estimate, effect: Array, wanted: Effect) -> Array:
    """Return the expected products (V, m, m) of the coefficients of one effect given the data: what these leave open
    counts, as estimates alone are drawn towards zero. effect: which effect each coefficient belongs to.
    """
    assert estimate.effect_scales is not None
    std = estimate.effect_scales.std(effect)
    left = estimate.factors.group_covariances()[:, POSE:, POSE:] * std[:, :, None] * std[:, None]
    values, chosen = estimate.coefficients, effect == EFFECTS.index(wanted)
    return np.asarray((values[:, :, None] * values[:, None] + left)[:, chosen][:, :, chosen])


def _typical_and_most(values: Array) -> tuple[float, float]:
    return float(np.median(values)), float(np.max(values))
