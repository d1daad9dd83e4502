"""White balance: the gains that make gray things gray, found on the mosaic before any colour is made."""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.parsing import parse_integer, parse_numbers
from camcal.raw.mosaic import by_place, cell_side, sites

NO_BALANCE = "none"
CAMERA = "camera"
GRAY_WORLD = "gray-world"
PATCH = "patch:"
NORMALISATIONS = ("min", "green")

Gains = tuple[float, float, float]

_CEILING = 0.9  # of saturation: a clipped sample says nothing about the colour of the light
_ENOUGH = 1 << 20  # samples that a mean is taken from


@dataclass(frozen=True)
class Balance:
    """How the gains are found: none, camera, gray-world, patch:X,Y,W,H (a gray area), or three gains R,G,B.

    normalise: gains that are found are scaled so that the smallest is 1 ("min": what is saturated turns white) or
    that of green ("green": green keeps its level). Three gains are taken as they are.
    """

    text: str = NO_BALANCE
    normalise: str = "min"

    def __post_init__(self) -> None:
        if self.normalise not in NORMALISATIONS:
            raise InvalidInput(f"gains are normalised by {' or '.join(NORMALISATIONS)}, not {self.normalise!r}")
        if self.text.startswith(PATCH):
            self.patch()
        elif self.text not in (NO_BALANCE, CAMERA, GRAY_WORLD):
            self.gains()

    def patch(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height of the gray area; raises InvalidInput unless it is four such numbers."""
        parts = self.text.removeprefix(PATCH).split(",")
        if len(parts) != 4 or not all(part.strip().isdecimal() for part in parts):
            raise InvalidInput(f"white balance {self.text!r}: a gray area is patch:X,Y,WIDTH,HEIGHT in pixels")
        x, y, width, height = (parse_integer(part) for part in parts)
        return x, y, width, height

    def gains(self) -> Gains:
        """Return the three gains that were given; raises InvalidInput unless they are positive numbers."""
        try:
            red, green, blue = parse_numbers(self.text.split(","))
        except ValueError:
            known = f"{NO_BALANCE}, {CAMERA}, {GRAY_WORLD}, {PATCH}X,Y,W,H or three gains R,G,B"
            raise InvalidInput(f"white balance {self.text!r} is unknown; use {known}") from None
        if not all(isfinite(gain) and gain > 0 for gain in (red, green, blue)):
            raise InvalidInput(f"white balance {self.text!r}: gains must be positive numbers")
        return red, green, blue

    def find(self, light: Array, pattern: str, camera_gains: Array | None) -> Gains | None:
        """Return the gains of red, green and blue for linear light (H, W), 1 at saturation; None for no balance.

        Raises InvalidInput if the camera's are asked for and unknown, or the patch is not within the frame;
        InsufficientData if there is no unclipped light to go by.
        """
        if self.text == NO_BALANCE:
            return None
        if self.text == CAMERA:
            if camera_gains is None:
                raise InvalidInput("carries no white balance of the camera; use gray-world, a patch, or R,G,B")
            return self._normalised(camera_gains)
        if self.text == GRAY_WORLD:
            return self._normalised(1 / mean_light(light, pattern))
        if self.text.startswith(PATCH):
            return self._normalised(1 / mean_light(*self._inside_patch(light, pattern)))
        return self.gains()

    def _inside_patch(self, light: Array, pattern: str) -> tuple[Array, str]:
        """Return the whole cells of the patch and the pattern they begin with, which is that of the frame."""
        x, y, width, height = self.patch()
        side = cell_side(pattern)
        left, top = -(-x // side) * side, -(-y // side) * side
        inside = light[top : y + height, left : x + width]
        if x + width > light.shape[1] or y + height > light.shape[0] or min(inside.shape) < side:
            size = f"{light.shape[1]}x{light.shape[0]}"
            raise InvalidInput(f"the patch {x},{y},{width},{height} is not inside the {size} frame, or holds no cell")
        return inside, pattern

    def _normalised(self, gains: Array) -> Gains:
        red, green, blue = (float(gain) for gain in gains / (gains[1] if self.normalise == "green" else gains.min()))
        return red, green, blue


def mean_light(light: Array, pattern: str) -> Array:
    """Return the mean light (3,) of red, green and blue over the cells of (H, W) without a clipped sample.

    Raises InsufficientData if no light is left.
    """
    stride = max(1, round(light.size / _ENOUGH))
    samples = [plane[::stride] for plane in by_place(light, pattern)]
    usable = np.max(samples, axis=0) < _CEILING
    means = [0.0]
    if usable.any():
        of_places = [values.mean(where=usable, dtype=np.float64) for values in samples]
        means = [np.mean([m for m, letter in zip(of_places, pattern, strict=True) if letter == c]) for c in "RGB"]
    if not min(means) > 0:
        raise InsufficientData("no unclipped light to balance white by; give three gains R,G,B")
    return np.array(means)


def balance_in_place(light: Array, pattern: str, gains: Gains) -> None:
    """Multiply every sample of a mosaic (H, W) by the gain of its colour."""
    for colour, gain in zip("RGB", gains, strict=True):
        for site in sites(pattern, colour):
            light[site] *= np.float32(gain)
