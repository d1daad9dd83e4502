"""How clear it is that errors within views are more than noise: the evidence for effects in a solution without them."""

from dataclasses import replace

import numpy as np

from camcal.calibrate.effects import EFFECTS, columns_at
from camcal.calibrate.estimator import Estimate, Views
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.variances import EffectScales, likelihood_gain
from camcal.solve.steps import assemble

_VIEWS = 40  # effects that so many views do not show need not be modelled
# Gains of the restricted log likelihood. Of noise alone few are beyond the first, with up to forty views; beyond the
# second, effects are certain.
_NOTHING, _CERTAIN = 3.0, 10.0


def share_of_effects(plain: Estimate, views: Views) -> float:
    """Return how far effects are to be believed in, 0…1, by the gain of the restricted likelihood that they bring.

    plain: the estimate that takes errors within views for noise.
    """
    count = len(views.present)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _VIEWS)).astype(np.intp))
    problem, state = _of_views(plain.problem, plain.noise.views, chosen), plain.state.take(chosen)
    derivatives = problem.derivatives(state)
    columns = columns_at(problem, state, derivatives, views.present[chosen], [effect.name for effect in EFFECTS])
    blocks = [problem.data(state, derivatives, columns.values), *problem.priors(state)]
    equations = assemble(blocks, problem.shared, len(chosen), 6 + len(columns.effect))
    start = EffectScales.start(len(chosen), plain.noise.sigma, max(problem.board.extent))
    gain = likelihood_gain(equations, columns, start)
    return float(np.clip((gain - _NOTHING) / (_CERTAIN - _NOTHING), 0, 1))


def _of_views(problem: BoardProblem, noise: np.ndarray, chosen: np.ndarray) -> BoardProblem:
    """Return the problem of some of the views, the offsets of single points held."""
    return replace(problem, observations=problem.observations.take(chosen), noise=noise[chosen], offsets=False)
