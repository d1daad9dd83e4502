"""What an estimate keeps of one camera: where it is, and the noise and the weights of its corners."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import columns_at
from camcal.calibrate.noise import (
    FINEST,
    PERIODS,
    CornerNoise,
    ViewNoise,
    clipped,
    corner_weights,
    count_of,
    estimate_noise,
    first_noise,
    period_shares,
    view_noise,
)
from camcal.calibrate.problem import POSE, BoardProblem, Derivatives, State
from camcal.calibrate.shape import Scale, first_scales, with_priors
from camcal.dataclass import dataclass, replace

_FINER = 0.4  # of the standard deviation that the images claim of a typical corner: the least that is accepted
_LEAST_DOF = 0.05  # of the coordinates, however many parameters were paid for


@dataclass(frozen=True, eq=False)
class Place:
    """A state, what was linearised there, and the coefficients (V, m) of effects."""

    state: State
    derivatives: Derivatives
    coefficients: Array


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """The noise of views and of corners (None without covariances), and the degrees of freedom (V,) that the corners of
    each view have spent.
    """

    views: ViewNoise
    corners: CornerNoise | None
    spent: Array


class CameraPart:
    """One camera in an alternation; its attributes are what a pass leaves for the next.

    share: how much of the way to new noise and weights is gone, more than 1 to go beyond. board: the scales of the
    classes of the board's shape.
    """

    def __init__(
        self, problem: BoardProblem, state: State, effects: Sequence[str], known: KnownNoise | None = None
    ) -> None:
        self.problem = problem
        self.present, self.claimed = problem.observations.present, problem.observations.covariance
        derivatives = problem.derivatives(state)
        self.columns = columns_at(problem, state, derivatives, effects)
        self.place = Place(state, derivatives, np.zeros((len(self.present), len(self.columns.effect))))
        self.shares = self._shares()
        self.noise = known.views if known else first_noise(problem.distances(self.residuals(self.place)), self.present)
        self.spent = known.spent if known else np.full(len(self.present), float(POSE))
        self.corners = known.corners if known else None
        self.board: dict[str, Scale] = first_scales()
        self.share = 1.0
        # offsets of the points may follow the corners of a view or two exactly, as if these had no noise at all
        finest = FINEST if self.claimed is None else _FINER * _typical_std(self.claimed[self.present])
        self.finest = max(finest, problem.finest)

    def residuals(self, place: Place) -> Array:
        """Return the residuals (2, V, P) that effects do not explain, NaN where the lens has no image.

        Beyond the domain of the lens of now they are those of its formula: a corner that had none could not pull the
        lens back.
        """
        residuals = np.where(place.derivatives.valid, place.derivatives.residuals, np.nan)
        return residuals.reshape(2, *self.present.shape) + self.field(place)

    def field(self, place: Place) -> Array:
        """Return what effects move the corners by, (2, V, P) px."""
        views = self.columns.values.transpose(0, 2, 3, 1)
        return np.asarray((views @ place.coefficients[:, :, None])[..., 0])

    def judge(self, *, first: bool) -> None:
        """Take noise and weights from the residuals."""
        residuals = self.residuals(self.place)
        if self.claimed is not None and not first:
            self.weigh(residuals)
        distances = self.problem.distances(residuals)
        if not first:
            weights = self.problem.observations.weights
            self.noise = view_noise(
                distances,
                self.present,
                weights=weights,
                spent=self.spent,
                noise=self.noise,
                share=self.share,
                finest=self.finest,
            )
        weights = corner_weights(distances, self.present, self.noise, self.spent)
        if not first:
            before = self.problem.observations.weights
            weights = np.where(weights > 0, np.clip(before + self.share * (weights - before), 0.0, 1.0), 0.0)
        observations = replace(self.problem.observations, weights=weights)
        problem = replace(self.problem, observations=observations, sigma=self.noise.sigma, noise=self.noise.views)
        self.problem = with_priors(problem, self.board)

    def weigh(self, residuals: Array) -> None:
        """Take the errors that corners have beyond their covariances from the residuals, and weigh them by both."""
        assert self.claimed is not None
        observations = self.problem.observations
        kept = self.present & np.isfinite(residuals).all(axis=0)
        # by their own median, not by the weights: these follow from the noise, and both would shrink each other
        even = clipped((residuals / np.sqrt(self.noise.views)[:, None])[:, kept].T)
        weights = np.ones(len(even))
        found = estimate_noise(even, self.claimed[kept], self.shares[kept], weights, self.unspent(), self.corners)
        self.corners = found if self.corners is None else self.corners.towards(found, self.share)
        total = self.corners.covariances(self.claimed.reshape(-1, 2, 2), self.shares.reshape(-1, 2, len(PERIODS)))
        self.problem = replace(self.problem, observations=observations.weighted(total.reshape(self.claimed.shape)))

    def _shares(self) -> Array:
        """Return the shares (V, P, 2, n) that errors of each period have in the corners, in u and in v."""
        board, shape = self.problem.board, self.present.shape
        if self.claimed is None or not board.has_saddle_corners:
            return np.zeros((*shape, 2, len(PERIODS)))
        side = board.spacing if board.checker else (board.marker or board.spacing)
        axes = side * self.place.derivatives.by_board(self.place.state.rotations)[..., :2]
        return period_shares(axes.reshape(-1, 2, 2)).reshape(*shape, 2, -1)

    def unspent(self) -> float:
        """Return the degrees of freedom per coordinate that parameters have left over."""
        left = 1 - float(np.sum(self.spent)) / float(np.sum(count_of(self.problem.observations.weights)))
        return max(left, _LEAST_DOF)

    def cost(self, place: Place) -> float:
        """Return the cost of the corners at a place; inf where corners that count have no image."""
        weights = self.problem.observations.weights / self.noise.views[:, None]
        squared = np.nan_to_num(self.problem.distances(self.residuals(place)), nan=np.inf) ** 2
        total = np.sum(weights * np.where(weights > 0, squared, 0.0)) / self.noise.sigma**2
        return 0.5 * float(total)

    @property
    def model_error_px(self) -> float | None:
        """What a typical corner is off by beyond its covariance, None without covariances."""
        return None if self.corners is None else self.corners.typical(self.shares[self.present])


def _typical_std(covariances: Array) -> float:
    """Return the standard deviation of a coordinate of a typical corner, of covariances (N, 2, 2)."""
    return float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2)) / 2))
