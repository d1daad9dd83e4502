"""Whether a lens has one centre: the entrance pupil of a wide lens moves along the axis with the angle of incidence.

With the pupil of a ray at the angle θ moved by e (θ/Θ)² towards the scene, Θ the largest angle of a corner, its pixel
moves by -e (θ/Θ)² ∂u/∂Z: as much less as the board is farther away, which no lens with one centre has. e is estimated
beside the lens, all else following, in one step from a solution; its variance is that of the scatter from view to view.
Source: Gennery, Generalized camera calibration including fish-eye lenses, IJCV 68, 2006 (the moving entrance pupil).
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import posterior
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.influence import influence
from camcal.calibrate.noise import REJECTED
from camcal.calibrate.problem import BoardProblem
from camcal.records import Brief
from camcal.solve.least_squares import assemble
from camcal.solve.losses import student_bound
from camcal.solve.steps import SingularError, Step, factorise

_OUTER = 0.9  # of the largest angle
_CLEARLY = 1.5  # times the bound that 95 % of what is none are within
_STEPS = 2  # the second stands where the scatter is that of a lens with this shift
_WIDE = np.radians(40)  # of the outermost corner: of narrower lenses nothing is asked


@dataclass(frozen=True)
class EntrancePupil(Brief):
    """The shift, towards the scene, of the entrance pupil for rays at an angle (rad) against that on the axis.

    shift, std: in the board's unit. moved_px: RMS by which that moves the outermost corners, against ones far away.
    views: that show it.
    """

    shift: float
    std: float
    angle: float
    moved_px: float
    views: int

    @property
    def seen(self) -> bool:
        """Whether it is not chance."""
        return abs(self.shift) > _CLEARLY * student_bound(max(self.views - 1, 1)) * self.std


def entrance_pupil(estimate: Estimate) -> EntrancePupil | None:
    """Return the shift that a solution leaves to be seen, None for a lens that is not wide or not free, and where all
    boards are equally far away.
    """
    central, state = replace(estimate.problem, offsets=False), estimate.state
    points = central.camera_points(state)
    angles = np.arctan2(np.hypot(points[0], points[1]), points[2])
    kept = central.observations.weights >= REJECTED
    largest = float(np.max(angles, where=kept, initial=0.0))
    if largest < _WIDE or not central.model.is_central or not len(central.free):
        return None
    # one more parameter of the lens, without a prior
    count = len(state.parameters)
    mean = central.model.prior_mean if central.lens_mean is None else central.lens_mean
    spread = np.full(count, np.inf) if central.lens_spread is None else central.lens_spread
    problem = replace(
        central,
        free=np.append(central.free, count),
        lens_mean=np.append(mean, 0.0),
        lens_spread=np.append(spread, np.inf),
    )
    try:
        return _estimated(estimate, central, problem, angles, largest)
    except (SingularError, np.linalg.LinAlgError):
        return None


def _estimated(
    estimate: Estimate, central: BoardProblem, problem: BoardProblem, angles: Array, largest: float
) -> EntrancePupil:
    """Return the shift; problem: that of a lens with one centre, `central`, with one more parameter."""
    state, place, shift = estimate.state, len(central.free), 0.0
    kept = central.observations.weights >= REJECTED
    for number in range(_STEPS):
        derivatives = central.derivatives(state)
        column = -derivatives.by_point[:, 2] * (angles.ravel() / largest) ** 2
        by_lens = np.concatenate([derivatives.by_lens, column[:, None]], axis=1)
        moved = replace(derivatives, residuals=derivatives.residuals + shift * column, by_lens=by_lens)
        wider = replace(state, parameters=np.append(state.parameters, shift))
        blocks, last = [problem.data(wider, moved), *problem.priors(wider)], number == _STEPS - 1
        factors = factorise(assemble(blocks, problem.shared, *problem.groups, products=last))
        step = factors.solve()
        shift += float(step.shared[place])
        state = central.retract(state, Step(np.delete(step.shared, place), step.groups))
    own = replace(
        estimate, problem=problem, state=wider, linearised=wider, factors=factors, posterior=posterior(factors)
    )
    scatter: Array = influence(own)[:, place]
    std = np.sqrt(max(float(scatter @ scatter), own.posterior.shared[place, place]))
    outer = (kept & (angles > _OUTER * largest)).ravel()
    moved_px = abs(shift) * float(np.sqrt(np.mean(np.sum(column[:, outer] ** 2, axis=0))))
    return EntrancePupil(shift, float(std), largest, moved_px, len(scatter))
