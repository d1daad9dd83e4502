"""What every view alone says of the lens, from one linearisation: squared residuals as a function of the lens, the pose
following.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import FINEST
from camcal.calibrate.outliers import RAYLEIGH_MEDIAN, row_medians
from camcal.calibrate.problem import BoardProblem, State
from camcal.solve.losses import Cauchy

_LOSS = Cauchy(3.0)
_ROUNDS = 20
_CHUNK = 64  # views


@dataclass(frozen=True, eq=False)
class ViewQuadratics:
    """Of every view the squared residuals, px², as a function of a change of the lens in standard deviations of its
    prior, the view's pose following: constant (V,), slopes (V, K), curvature (V, K, K); count: (V,) coordinates.
    weights: (V, P) those of the corners.
    """

    constant: Array
    slopes: Array
    curvature: Array
    count: Array
    weights: Array

    def costs(self, change: Array) -> Array:
        """Return the squared residuals (V,) under a change (K,), or one for each view (V, K)."""
        change = np.broadcast_to(change, self.slopes.shape)
        costs = self.constant + np.einsum(
            "vi,vi->v", 2 * self.slopes + np.einsum("vij,vj->vi", self.curvature, change), change
        )
        return np.asarray(np.maximum(costs, FINEST**2 * self.count))

    def best(self, members: Array) -> Array:
        """Return the change (K,) that suits some of the views (V,) best; each counts by its own noise."""
        change: Array = np.zeros(self.slopes.shape[1])
        for _ in range(_ROUNDS):
            weights = members * self.count / self.costs(change)
            before: Array = change
            change = np.asarray(-np.linalg.solve(self._normal(weights), weights @ self.slopes))
            if np.abs(change - before).max() < 1e-6:
                break
        return np.asarray(change)

    def left_out(self) -> Array:
        """Return the squared residuals (V,) of every view under the lens that the other views give."""
        change = self.best(np.ones(len(self.count)))
        weights = self.count / self.costs(change)
        normal = self._normal(weights) - weights[:, None, None] * self.curvature
        slopes = weights @ self.slopes - weights[:, None] * self.slopes
        return self.costs(-np.linalg.solve(normal, slopes[..., None])[..., 0])

    def scores(self) -> Array:
        """Return how every view pulls at the lens of all of them, (V, K), in units in which pulls are alike."""
        change = self.best(np.ones(len(self.count)))
        weights = self.count / self.costs(change)
        scores = weights[:, None] * (self.slopes + self.curvature @ change)
        return np.asarray(np.linalg.solve(np.linalg.cholesky(self._normal(weights)), scores.T).T)

    def gain(self, smaller: Array) -> float:
        """Return by how much two lenses are likelier than one, nat per coordinate of the smaller group (V,)."""
        two = np.where(smaller, self.costs(self.best(smaller)), self.costs(self.best(~smaller)))
        one = self.costs(self.best(np.ones(len(smaller))))
        return float(np.sum(0.5 * self.count * np.log(one / two)) / self.count[smaller].sum())

    def _normal(self, weights: Array) -> Array:
        return np.asarray(np.einsum("v,vij->ij", weights, self.curvature) + np.eye(self.slopes.shape[1]))


def view_quadratics(problem: BoardProblem, state: State) -> ViewQuadratics:
    """Return what every view says of the lens at a state; corners count little that are far off within their view."""
    derivatives, (views, points) = problem.derivatives(state), problem.observations.ids.shape
    shown = (problem.observations.weights > 0) & derivatives.valid.reshape(views, points)
    distances = np.where(shown, np.hypot(*derivatives.residuals).reshape(views, points), np.nan)
    typical = row_medians(distances, shown)
    relative = np.nan_to_num(distances) * RAYLEIGH_MEDIAN / np.maximum(typical, FINEST)[:, None]
    weights = shown * _LOSS.weight(relative**2)
    lens, spread = problem.free, problem.lens_spread
    scale = np.abs(state.parameters[lens]) if spread is None else spread[lens]
    scale = np.where(np.isfinite(scale) & (scale > 0), scale, np.maximum(np.abs(state.parameters[lens]), 1.0))
    parts = [
        np.concatenate([derivatives.residuals[:, None], derivatives.by_lens * scale[:, None]], axis=1),
        derivatives.by_pose(),
    ]
    products = []
    for first in range(0, views, _CHUNK):
        some = slice(first, first + _CHUNK)
        root = np.sqrt(weights[some])
        columns, pose = (
            (part.reshape(2, -1, views, points)[:, :, some] * root)
            .transpose(2, 0, 3, 1)
            .reshape(len(root), 2 * points, -1)
            for part in parts
        )
        basis = np.linalg.qr(pose)[0]
        left = columns - basis @ (basis.transpose(0, 2, 1) @ columns)
        products.append(left.transpose(0, 2, 1) @ left)
    gram = np.concatenate(products)
    return ViewQuadratics(gram[:, 0, 0], gram[:, 1:, 0], gram[:, 1:, 1:], 2.0 * shown.sum(axis=1), weights)
