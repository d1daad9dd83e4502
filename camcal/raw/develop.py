"""Developing a raw frame: levels, white balance, demosaicing, tone and depth, in that order.

Every step is neutral unless asked for. Light is linear, 0 at black and 1 at saturation, until the tone curve; white
balance acts on the mosaic, because the filters compare neighbours of different colours.
"""

import re
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.demosaic import BILINEAR, demosaic, require_algorithm
from camcal.raw.mosaic import Mosaic, full_scale, sites

BALANCES = ("none", "camera", "gray-world")
TONES = ("linear", "srgb", "bt709")
DEPTHS: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}

_GRAY_WORLD_CEILING = 0.9  # of saturation: a clipped sample says nothing about the colour of the light
_POWER = re.compile(r"power:(\d+(?:\.\d*)?|\.\d+)$")


@dataclass(frozen=True)
class Development:
    """What is done to a raw frame.

    balance: none, camera, gray-world, or three gains "R,G,B". tone: linear, power:2.2 (v ↦ v^(1/2.2)), srgb or bt709.
    depth: 8, 16 or float; None keeps that of the raw frame.
    """

    algorithm: str = BILINEAR
    balance: str = "none"
    tone: str = "linear"
    depth: str | None = None

    def __post_init__(self) -> None:
        require_algorithm(self.algorithm)
        if self.balance not in BALANCES:
            _parse_gains(self.balance)
        if self.tone not in TONES:
            _parse_power(self.tone)
        if self.depth is not None and self.depth not in DEPTHS:
            raise InvalidInput(f"depth {self.depth!r} is unknown; use one of {', '.join(DEPTHS)}")


@dataclass(frozen=True, eq=False)
class Picture:
    """A developed frame: pixels (H, W, 3) blue, green, red, or (H, W) without demosaicing, and the gains it got.

    gains: red, green, blue factors on the linear light, None when there was no white balance.
    """

    pixels: Array
    gains: tuple[float, float, float] | None


def develop(frame: Mosaic, development: Development) -> Picture:
    """Return the developed frame; floating point is 0 … 1, integers use the full scale of their type.

    Raises InvalidInput if the camera's white balance is asked for and unknown, InsufficientData if gray-world has
    no unclipped light to go by.
    """
    depth = DEPTHS[development.depth] if development.depth else frame.values.dtype
    gains = white_balance(frame, development.balance)
    neutral = gains is None and not frame.black.any() and frame.white == full_scale(frame.values.dtype)
    values = frame.values if neutral else balanced(linearise(frame), frame.pattern, gains)
    pixels = demosaic(values, frame.pattern, development.algorithm)
    if development.tone == "linear" and pixels.dtype == depth and depth != np.float32:
        return Picture(pixels, gains)
    return Picture(quantise(encode(_light(pixels), development.tone), depth), gains)


def linearise(frame: Mosaic) -> Array:
    """Return the light (H, W), float32, 0 at black and 1 at saturation; noise may fall below 0."""
    result = np.empty(frame.values.shape, np.float32)
    for row, column in np.ndindex(2, 2):
        site = (slice(row, None, 2), slice(column, None, 2))
        black = frame.black[row, column]
        np.subtract(frame.values[site], np.float32(black), out=result[site])
        result[site] *= np.float32(1 / (frame.white - black))
    return result


def white_balance(frame: Mosaic, balance: str) -> tuple[float, float, float] | None:
    """Return the gains of red, green and blue, None for no balance.

    Gains from the camera and from the gray world have their smallest at 1, so that what is saturated turns white;
    gains given as numbers are taken as they are.
    """
    if balance == "none":
        return None
    if balance == "camera":
        return _normalised(_camera_gains(frame))
    if balance == "gray-world":
        return _normalised(_gray_world(frame))
    return _parse_gains(balance)


def balanced(light: Array, pattern: str, gains: tuple[float, float, float] | None) -> Array:
    """Return the mosaic (H, W) with every sample multiplied, in place, by the gain of its colour."""
    for colour, gain in zip("RGB", gains or (), strict=False):
        for site in sites(pattern, colour):
            light[site] *= np.float32(gain)
    return light


def encode(light: Array, tone: str) -> Array:
    """Return the light, clipped to 0 … 1, behind a tone curve.

    Source: IEC 61966-2-1 (srgb), Rec. ITU-R BT.709-6 item 1.2 (bt709); power:γ is v^(1/γ).
    """
    light = np.clip(light, 0, 1)
    if tone == "linear":
        return light
    if tone == "srgb":
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)
    if tone == "bt709":
        return np.where(light < 0.018, 4.5 * light, 1.099 * light ** np.float32(0.45) - 0.099)
    return np.asarray(light ** np.float32(1 / _parse_power(tone)))


def quantise(values: Array, depth: np.dtype[Any]) -> Array:
    """Return values 0 … 1 in another type: float32 as they are, integers rounded on the full scale."""
    if np.issubdtype(depth, np.floating):
        return values
    return np.rint(values * np.float32(full_scale(depth))).astype(depth)


def _light(pixels: Array) -> Array:
    return pixels.astype(np.float32) / np.float32(full_scale(pixels.dtype))


def _camera_gains(frame: Mosaic) -> Array:
    if frame.camera_gains is None:
        raise InvalidInput("carries no white balance of the camera; use gray-world or three gains R,G,B")
    return frame.camera_gains


def _gray_world(frame: Mosaic) -> Array:
    """Return gains that make the mean of every colour the same, over the cells without a clipped sample."""
    height, width = (length // 2 * 2 for length in frame.values.shape)
    light = linearise(frame)[:height, :width]
    usable = light.reshape(height // 2, 2, width // 2, 2).max(axis=(1, 3)) < _GRAY_WORLD_CEILING
    sums = [np.mean([light[site].sum(where=usable) for site in sites(frame.pattern, colour)]) for colour in "RGB"]
    if min(sums) <= 0:
        raise InsufficientData("no unclipped light for the gray-world balance; use three gains R,G,B")
    return 1 / np.array(sums)


def _normalised(gains: Array) -> tuple[float, float, float]:
    red, green, blue = (float(gain) for gain in gains / gains.min())
    return red, green, blue


def _parse_gains(text: str) -> tuple[float, float, float]:
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            f"white balance {text!r} is unknown; use {', '.join(BALANCES)} or three gains R,G,B"
        ) from None
    if not all(isfinite(gain) and gain > 0 for gain in (red, green, blue)):
        raise InvalidInput(f"white balance {text!r}: gains must be positive numbers")
    return red, green, blue


def _parse_power(tone: str) -> float:
    match = _POWER.match(tone)
    if match is None or not float(match[1]) > 0:
        raise InvalidInput(f"tone {tone!r} is unknown; use {', '.join(TONES)} or power:GAMMA")
    return float(match[1])
