"""Whether a lens has one centre: the entrance pupil of a wide lens moves along the axis with the angle of incidence.

With the pupil of a ray at the angle θ moved by e (θ/Θ)² towards the scene, Θ the largest angle of a corner, its pixel
moves by -e (θ/Θ)² ∂u/∂Z: as much less as the board is farther away, which no lens with one centre has. e is estimated
beside the lens, all else following, in one step from a solution; its variance is that of the scatter from view to view.
Source: Gennery, Generalized camera calibration including fish-eye lenses, IJCV 68, 2006 (the moving entrance pupil).
"""

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import posterior
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.influence import influence
from camcal.calibrate.noise import REJECTED
from camcal.calibrate.problem import BoardProblem
from camcal.cameras.observations import whitened
from camcal.dataclass import dataclass, replace
from camcal.records import Brief
from camcal.solve.least_squares import assemble
from camcal.solve.losses import student_bound
from camcal.solve.steps import Jacobian, SingularError, Step, factorise

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
    try:
        return _fit_shift(estimate, central, angles, largest)
    except (SingularError, np.linalg.LinAlgError):
        return None


def _fit_shift(estimate: Estimate, central: BoardProblem, angles: Array, largest: float) -> EntrancePupil:
    """Return the shift, the last one of the parameters that views share, without a prior."""
    state, place, shift, table = estimate.state, central.shared, 0.0, central.observations
    for number in range(_STEPS):
        derivatives = central.derivatives(state)
        column = -derivatives.by_point[:, 2] * (angles.ravel() / largest) ** 2
        block = central.data(state, replace(derivatives, residuals=derivatives.residuals + shift * column))
        root = None if table.whitening is None else table.whitening.reshape(2, 2, -1)
        own = Jacobian(whitened(root, column)[:, None].transpose(2, 0, 1), np.array([place]))
        blocks, last = [replace(block, shared=(*block.shared, own)), *central.priors(state)], number == _STEPS - 1
        factors = factorise(assemble(blocks, place + 1, *central.groups, products=last))
        step = factors.solve()
        shift += float(step.shared[place])
        state = central.retract(state, Step(step.shared[:place], step.groups))
    left = posterior(factors)
    scatter: Array = influence(replace(estimate, factors=factors, posterior=left))[:, place]
    std = np.sqrt(max(float(scatter @ scatter), left.shared[place, place]))
    outer = ((table.weights >= REJECTED) & (angles > _OUTER * largest)).ravel()
    moved_px = abs(shift) * float(np.sqrt(np.mean(np.sum(column[:, outer] ** 2, axis=0))))
    return EntrancePupil(shift, float(std), largest, moved_px, len(scatter))
