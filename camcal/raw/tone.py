"""From linear light to the numbers of an image: tone curve and depth."""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.mosaic import full_scale
from camcal.raw.options import DEPTHS, LINEAR
from camcal.raw.planes import rounded

TONES = (LINEAR, "srgb", "bt709")
DTYPES: Mapping[str, np.dtype[Any]] = MappingProxyType(
    dict(zip(DEPTHS, map(np.dtype, (np.uint8, np.uint16, np.float32)), strict=True))
)

_POWER = re.compile(r"power:([0-9]+(?:\.[0-9]*)?|\.[0-9]+)$")


def require_tone(tone: str) -> str:
    """Return the tone; raises InvalidInput unless it is one of TONES or power:GAMMA."""
    if tone not in TONES:
        _gamma(tone)
    return tone


def encode(light: Array, tone: str) -> Array:
    """Return the light, clipped to 0 … 1, behind a tone curve; linear light stays as it is.

    Source: IEC 61966-2-1 (srgb), Rec. ITU-R BT.709-6 item 1.2 (bt709); power:γ is v^(1/γ).
    """
    if tone == LINEAR:
        return light
    light = np.clip(light, 0, 1)
    if tone == "srgb":
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)
    if tone == "bt709":
        return np.where(light < 0.018, 4.5 * light, 1.099 * light ** np.float32(0.45) - 0.099)
    return np.asarray(light ** np.float32(1 / _gamma(tone)))


def quantise(values: Array, depth: np.dtype[Any]) -> Array:
    """Return values in another type: floating point as they are, 0 … 1 rounded on the full scale of integers."""
    if np.issubdtype(depth, np.floating):
        return values
    return rounded(values, full_scale(depth), depth)


def _gamma(tone: str) -> float:
    match = _POWER.match(tone)
    if match is None or not float(match[1]) > 0:
        raise InvalidInput(f"tone {tone!r} is unknown; use {', '.join(TONES)} or power:GAMMA")
    return float(match[1])
