"""Passes of an alternating estimation: how many there are, and how far each of them goes."""

from abc import ABC, abstractmethod

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import Posterior
from camcal.calibrate.shape import AT_ALL_TOGETHER, TOGETHER
from camcal.dataclass import dataclass
from camcal.solve.steps import Factors

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
