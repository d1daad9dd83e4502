"""The offsets of a large board's points, each solved for with everything else held.

Solving for all offsets together takes memory and time that grow with the square and the cube of their number. Offsets
act on each other only through lens, poses and the board's smooth shape; of a large board each point has a small part in
these, so that solving in turn for the points and for everything else soon leads to the same minimum.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, Derivatives, State
from camcal.calibrate.scales import Scale, scale_of
from camcal.targets.surface import CORNER_CLASSES, IN_PLANE, OUT_OF_PLANE

# Points at most that are solved for together with everything else: in every pass, and in a last one.
TOGETHER, AT_ALL_TOGETHER = 60, 400


@dataclass(frozen=True, eq=False)
class PointEquations:
    """What the data say of every point: information (C, 3, 3) and vector (C, 3), of its offset in the board's unit.

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
