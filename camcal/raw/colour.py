"""White balance, tone curve and bit depth.

The gains that make gray things gray are found on the mosaic, before any colour is made.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.mosaic import by_place, cell_side, full_scale, sites
from camcal.raw.options import CAMERA, DEPTHS, GRAY_WORLD, LINEAR, NO_BALANCE, PATCH, SRGB, Balance, Gains, gamma_of
from camcal.raw.planes import rounded

DTYPES: Mapping[str, np.dtype[Any]] = MappingProxyType(
    dict(zip(DEPTHS, map(np.dtype, (np.uint8, np.uint16, np.float32)), strict=True))
)

_CEILING = 0.9  # of saturation: a clipped sample says nothing about the colour of the light
_ENOUGH = 1 << 20  # samples that a mean is taken from


def find_gains(balance: Balance, light: Array, pattern: str, camera_gains: Array | None) -> Gains | None:
    """Return the gains of red, green and blue for linear light (H, W), 1 at saturation; None for no balance.

    Raises InvalidInput if the camera's are asked for and unknown, or the patch is not within the frame;
    InsufficientData if there is no unclipped light to go by.
    """
    if balance.text == NO_BALANCE:
        return None
    if balance.text == CAMERA:
        if camera_gains is None:
            raise InvalidInput("has no camera white balance; use gray-world, a patch, or R,G,B")
        return _normalise(balance, camera_gains)
    if balance.text == GRAY_WORLD:
        return _normalise(balance, 1 / mean_light(light, pattern))
    if balance.text.startswith(PATCH):
        return _normalise(balance, 1 / mean_light(*_inside_patch(balance, light, pattern)))
    return balance.gains()


def _inside_patch(balance: Balance, light: Array, pattern: str) -> tuple[Array, str]:
    """Return the whole cells of the patch and the pattern they begin with, which is that of the frame."""
    x, y, width, height = balance.patch()
    side = cell_side(pattern)
    left, top = -(-x // side) * side, -(-y // side) * side
    inside = light[top : y + height, left : x + width]
    if x + width > light.shape[1] or y + height > light.shape[0] or min(inside.shape) < side:
        size = f"{light.shape[1]}x{light.shape[0]}"
        raise InvalidInput(f"the patch {x},{y},{width},{height} is not inside the {size} frame, or holds no cell")
    return inside, pattern


def _normalise(balance: Balance, gains: Array) -> Gains:
    red, green, blue = (float(gain) for gain in gains / (gains[1] if balance.normalise == "green" else gains.min()))
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
        raise InsufficientData("no unclipped pixels for the white balance; give three gains R,G,B")
    return np.array(means)


def balance_in_place(light: Array, pattern: str, gains: Gains) -> None:
    """Multiply every sample of a mosaic (H, W) by the gain of its colour."""
    for colour, gain in zip("RGB", gains, strict=True):
        for site in sites(pattern, colour):
            light[site] *= np.float32(gain)


def encode(light: Array, tone: str) -> Array:
    """Return the light, clipped to 0 … 1, behind a tone curve; linear light stays as it is.

    Source: IEC 61966-2-1 (srgb), Rec. ITU-R BT.709-6 item 1.2 (bt709); power:γ is v^(1/γ).
    """
    if tone == LINEAR:
        return light
    light = np.clip(light, 0, 1)
    if tone == SRGB:
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)
    if tone == "bt709":
        return np.where(light < 0.018, 4.5 * light, 1.099 * light ** np.float32(0.45) - 0.099)
    return np.asarray(light ** np.float32(1 / gamma_of(tone)))


def quantise(values: Array, depth: np.dtype[Any]) -> Array:
    """Return values in another type: floating point as they are, 0 … 1 rounded on the full scale of integers."""
    if np.issubdtype(depth, np.floating):
        return values
    return rounded(values, full_scale(depth), depth)
