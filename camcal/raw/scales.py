"""The scale on which filters compare neighbours, 0 … 255, and the way there from counts and back."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from camcal.arrays import Array
from camcal.raw.mosaic import sites
from camcal.raw.planes import HERE, Plane

WHITE = 255.0  # of green on the scale of the filters
_TOE = np.float32(0.002)  # share of the white level below which the root turns linear: noise falls below 0
_ROOT_SCALE = float(WHITE / (np.sqrt(1 + _TOE) - np.sqrt(_TOE)))
_SAMPLED_ROWS = 256
_STRONGEST_BALANCE = 16.0


class Scale(Protocol):
    """How counts of a colour ("R", "G" or "B") become the filters' numbers, and back.

    `undo` leaves numbers, in place, that are counts after a multiplication with `factor`.
    """

    @property
    def white(self) -> float: ...
    def apply(self, values: Array, colour: str) -> None: ...
    def undo(self, plane: Plane, scratch: Plane) -> None: ...
    def factor(self, colour: str) -> float: ...


@dataclass(frozen=True)
class Proportional:
    """Numbers proportional to the counts: gamma-encoded images have the scale that filters were made for."""

    white: float

    def apply(self, values: Array, colour: str) -> None:  # noqa: ARG002
        values *= np.float32(WHITE / self.white)

    def undo(self, plane: Plane, scratch: Plane) -> None:
        pass

    def factor(self, colour: str) -> float:  # noqa: ARG002
        return self.white / WHITE


@dataclass(frozen=True)
class Counts:
    """The counts themselves, for linear filters."""

    white: float

    def apply(self, values: Array, colour: str) -> None:
        pass

    def undo(self, plane: Plane, scratch: Plane) -> None:
        pass

    def factor(self, colour: str) -> float:  # noqa: ARG002
        return 1.0


@dataclass(frozen=True)
class Root:
    """Square roots of linear light, the detail of the three colours made equally strong.

    There photon noise has the same strength everywhere, and what demosaicing assumes, that colours vary together and
    differ smoothly, is much more nearly true than in linear light. Every sample comes back as it was.
    """

    white: float
    gains: dict[str, float]

    def apply(self, values: Array, colour: str) -> None:
        values *= np.float32(self.gains[colour] / self.white)
        scratch = np.abs(values)
        scratch += _TOE
        np.sqrt(scratch, out=scratch)
        scratch += np.sqrt(_TOE)
        values *= np.float32(_ROOT_SCALE)
        values /= scratch  # x / (√(|x| + c) + √c) is √(x + c) - √c, for negative x with the other sign

    def undo(self, plane: Plane, scratch: Plane) -> None:
        values = plane[HERE]
        np.abs(values, out=scratch[HERE])
        np.add(scratch[HERE], np.float32(2 * np.sqrt(_TOE) * _ROOT_SCALE), out=scratch[HERE])
        np.multiply(scratch[HERE], values, out=values)

    def factor(self, colour: str) -> float:
        return self.white / self.gains[colour] / _ROOT_SCALE**2


def scale_of(values: Array, pattern: str, white: float, *, linear: bool) -> Scale:
    """Return the scale for a Bayer mosaic (H, W) of counts, linear in light or gamma-encoded."""
    return Root(white, _detail_balance(values, pattern)) if linear else Proportional(white)


def _detail_balance(values: Array, pattern: str) -> dict[str, float]:
    """Return gains that make the detail of red and blue as strong as that of green.

    Detail is the mean second difference along rows, of some hundred rows.
    """
    strength = {colour: float(np.mean([_detail(values[site]) for site in sites(pattern, colour)])) for colour in "RGB"}
    if min(strength.values()) <= 0:
        return dict.fromkeys("RGB", 1.0)
    gains = {colour: strength["G"] / strength[colour] for colour in "RGB"}
    return {colour: float(np.clip(gain, 1 / _STRONGEST_BALANCE, _STRONGEST_BALANCE)) for colour, gain in gains.items()}


def _detail(samples: Array) -> float:
    rows = samples[:: max(1, len(samples) // _SAMPLED_ROWS)].astype(np.float32)
    curves = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
    return float(curves.mean()) if curves.size else 0.0
