"""What an estimate keeps of one camera, and the passes of an alternating estimation.

Of a camera: where it is, and the noise and the weights of its corners. Of passes: how many there are, and how far each
of them goes.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import Posterior, columns_at
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
from camcal.calibrate.shape import AT_ALL_TOGETHER, TOGETHER, Scale, first_scales, with_priors
from camcal.dataclass import dataclass, replace
from camcal.solve.steps import Factors

_FINER = 0.4  # of the standard deviation that the images claim of a typical corner: the least that is accepted
_LEAST_DOF = 0.05  # of the coordinates, however many parameters were paid for

# Passes: at least, unless noise and scales are known; at most; of a brief estimate at most.
_LEAST, _MOST, _BRIEF = 2, 100, 10
# Of a standard deviation: so little more to come for any lens parameter that no other pass is needed; and its largest
# change by a pass with which the result may still be used where passes run out.
_SETTLED, CALM = 1e-2, 0.3
_SLOWEST = 0.95  # rate at which changes are taken to fall at least
# Of the change by the pass before, and of a standard deviation: in turn, single points and all else hardly get on.
_SLOW, _CREEP = 0.5, 0.01
_NEGLIGIBLE_DOF = 1.0  # degrees of freedom that single points take together: solved for in turn, they are as good
# Noise, weights and lens answer to each other, and full steps may overshoot: less of the way to new scales is gone from
# then on where a pass takes back what the one before did. Where passes go on in the same direction (cosine), each by a
# part of the one before, the next one goes to where their series ends, or so many times as far.
_LESS, _LEAST_SHARE, _BACK = 0.7, 0.3, 0.5
_ONWARD, _FARTHEST = 0.9, 4.0


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


@dataclass(frozen=True)
class AdditionalParameters:
    """What is estimated besides lens and poses: the board's smooth shape, its single points, effects within views (the
    names of EFFECTS).
    """

    smooth: bool = True
    points: bool = True
    effects: tuple[str, ...] = ()


class Alternation(ABC):
    """Passes until hardly anything is left to come.

    fresh: whether noise and scales are yet to be learned. brief: whether few passes do, with single points of the
    board solved for in turn. on_points: degrees of freedom spent on these. share: how much of the way to new noise,
    weights and scales is gone; damped: at most, but where a series of passes is summed up. moved: the last change of
    lens parameters and camera poses, in standard deviations. plain: how many passes ago the last leap was. leap_from:
    the largest change after which there is another one, as leaps out of an orbit would go on for ever.
    """

    additional: AdditionalParameters
    fresh: bool
    brief: bool
    on_points: float
    share: float
    damped: float
    moved: Array
    plain: int
    leap_from: float

    def begin(self, additional: AdditionalParameters, *, fresh: bool, brief: bool) -> None:
        """Begin to alternate."""
        self.additional, self.fresh, self.brief, self.on_points = additional, fresh, brief, 0.0
        self.share, self.damped, self.plain, self.leap_from = 1.0, 1.0, 0, CALM

    @abstractmethod
    def _pass(self, *, first: bool) -> tuple[Factors, Posterior, float]:
        """Return the factors of a pass, what they leave open, and the largest change, in standard deviations."""

    @abstractmethod
    def point_count(self) -> int:
        """Return the number of the board's points."""

    @abstractmethod
    def points_together(self) -> bool:
        """Return whether single points are solved for together with everything else."""

    @abstractmethod
    def solve_points_together(self) -> None:
        """Solve for single points together with everything else from now on."""

    def alternate(self) -> tuple[int, tuple[Factors, Posterior, float]]:
        """Return the number of passes, and what the last one returned."""
        number, moved, settled = 0, np.inf, False
        apart = self.additional.points and not self.points_together() and self.point_count() <= AT_ALL_TOGETHER
        while number < (_BRIEF if self.brief else _MOST) and not settled:
            number, before = number + 1, moved
            result = self._pass(first=self.fresh and number == 1)
            moved = result[2]
            settled = _to_come(moved, before) < _SETTLED and not (self.fresh and number < _LEAST)
            slow = number > _LEAST and moved > max(_SLOW * before, _CREEP)
            if apart and not self.brief and self.on_points > _NEGLIGIBLE_DOF and (slow or settled):
                self.solve_points_together()
                apart, settled = False, False
        if apart and self.brief and self.on_points > _NEGLIGIBLE_DOF and self.point_count() <= TOGETHER:
            self.solve_points_together()  # what points leave open counts, above all where views are few
            number, result = number + 1, self._pass(first=False)
        return number, result

    def note_change(self, moved: Array, *, first: bool) -> float:
        """Return the largest of the changes by a pass, in standard deviations; where they take back what the pass
        before did less of the way is gone from then on, and where they go on in its direction more of it once.
        """
        largest = float(np.max(np.abs(moved), initial=0.0))
        leapt = self.share > self.damped
        # the first pass has yet to learn how large everything is, and a leap moves what was at rest already
        self.share, self.plain = self.damped, -1 if leapt else 0 if first else self.plain + 1
        if self.plain > 1:
            before = self.moved
            product, lengths = float(moved @ before), float(np.linalg.norm(moved) * np.linalg.norm(before))
            if product < -_BACK * lengths:
                self.share = self.damped = max(_LESS * self.damped, _LEAST_SHARE)
            elif product > _ONWARD * lengths and largest < self.leap_from:
                self.leap_from = _LESS * largest
                rate = product / float(before @ before)
                self.share = self.damped / max(1 - rate, 1 / _FARTHEST)
        self.moved = moved
        return largest


def _to_come(moved: float, before: float) -> float:
    """Return how far a series goes on after a change, of which the one before was `before`; at least the change."""
    rate = min(moved / before, _SLOWEST) if before > 0 else 0.0
    return moved * max(rate / (1 - rate), 1.0)
