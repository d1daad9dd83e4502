"""What is known of the parameters of a lens model before any image of the lens is seen."""

import math
from dataclasses import dataclass

LAST = 3


@dataclass(frozen=True)
class Parameter:
    """One parameter of a lens model and what is known of it beforehand.

    role: the part that a coefficient plays in the distortion, one of the fields of distortion.Roles.
    growth: of a coefficient: the power of the radius by which its term grows relative to the radius, from which the
    standard deviation of its weak prior follows; spread: that standard deviation where there is no growth, inf for no
    prior. mean: of the prior, and where an estimate starts. typical: the value in an ordinary lens, to simulate one.
    limits: the values that a camera file may have.
    stage: when a calibration's start frees it, in 1, in 2, or with all others in LAST: the stiffest parameters first.
    colour_stage: likewise when it may differ between the colours of one lens, what differs in most lenses first.
    """

    name: str
    role: str = ""
    growth: int | None = None
    spread: float = math.inf
    mean: float = 0.0
    typical: float = 0.0
    limits: tuple[float, float] = (-math.inf, math.inf)
    stage: int = LAST
    colour_stage: int = LAST

    def prior_std(self, radius: float) -> float:
        """Return the standard deviation of the weak prior; radius: of the image's corner, in the model's plane."""
        return self.spread if self.growth is None else float(radius**-self.growth)


def staged(stages: dict[str, int]) -> tuple[tuple[str, ...], ...]:
    """Return the names of all parameters freed by each stage before LAST, given every parameter's stage."""
    return tuple(tuple(name for name, own in stages.items() if own <= stage) for stage in range(1, LAST))
