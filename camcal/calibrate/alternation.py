"""Passes of an alternating estimation: how many there are, and how far each of them goes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import Posterior
from camcal.calibrate.shape import AT_ALL_TOGETHER
from camcal.solve.steps import Factors

# Passes: at least, unless noise and scales are known; at most; of a brief estimate at most.
_LEAST, _MOST, _BRIEF = 2, 100, 10
# Of a standard deviation: so little more to come for any lens parameter that no other pass is needed; and its largest
# change by a pass with which the result may still be used where passes run out.
_SETTLED, CALM = 1e-2, 0.3
_SLOWEST = 0.95  # rate at which changes are taken to fall at least
# Of the change by the pass before, and of a standard deviation: in turn, single points and all else hardly get on.
_SLOW, _CREEP = 0.5, 0.05
_NEGLIGIBLE_DOF = 1.0  # degrees of freedom that single points take together: solved for in turn, they are as good
# Noise, weights and lens answer to each other, and full steps may overshoot: less of the way to new scales is gone from
# then on where a pass takes back what the one before did.
_LESS, _LEAST_SHARE, _BACK = 0.7, 0.3, 0.5


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

    fresh: whether noise and scales are yet to be learned. on_points: degrees of freedom spent on single points of the
    board. share: how much of the way to new noise and weights is gone. moved: the last change of lens parameters and
    camera poses, in standard deviations.
    """

    additional: AdditionalParameters
    fresh: bool
    on_points: float
    share: float
    moved: Array

    def begin(self, additional: AdditionalParameters, count: int, *, fresh: bool) -> None:
        """Begin; count: of the parameters whose changes are watched."""
        self.additional, self.fresh, self.on_points = additional, fresh, 0.0
        self.share, self.moved = 1.0, np.zeros(count)

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

    def alternate(self, *, brief: bool) -> tuple[int, tuple[Factors, Posterior, float]]:
        """Return the number of passes, and what the last one returned."""
        number, moved, settled = 0, np.inf, False
        apart = self.additional.points and not self.points_together() and self.point_count() <= AT_ALL_TOGETHER
        while number < (_BRIEF if brief else _MOST) and not settled:
            number, before = number + 1, moved
            result = self._pass(first=self.fresh and number == 1)
            moved = result[2]
            settled = _to_come(moved, before) < _SETTLED and not (self.fresh and number < _LEAST)
            slow = number > _LEAST and moved > max(_SLOW * before, _CREEP)
            if apart and self.on_points > _NEGLIGIBLE_DOF and (slow or (settled and not brief)):
                self.solve_points_together()
                apart, settled = False, False
        return number, result

    def note_change(self, moved: Array, *, first: bool) -> float:
        """Return the largest of the changes by a pass, in standard deviations; less of the way is gone from then on
        where they take back what the pass before did.
        """
        if moved @ self.moved < -_BACK * np.linalg.norm(moved) * np.linalg.norm(self.moved):
            self.share = max(_LESS * self.share, _LEAST_SHARE)
        if not first:  # the first pass has yet to learn how large everything is
            self.moved = moved
        return float(np.max(np.abs(moved), initial=0.0))


def _to_come(moved: float, before: float) -> float:
    """Return how far a series goes on after a change, of which the one before was `before`; at least the change."""
    rate = min(moved / before, _SLOWEST) if before > 0 else 0.0
    return moved * max(rate / (1 - rate), 1.0)
