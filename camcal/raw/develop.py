"""Developing a raw frame: levels, bad pixels, flat field, balance, exposure, demosaicing, colour, tone, depth.

In that order, and every step is neutral unless asked for. Light is linear, 0 at black and 1 at saturation, until the
tone curve; white balance acts on the mosaic, because filters compare neighbours of different colours, and the gains
that make gray things gray are found there. A 3 × 3 matrix leads from the colours of the sensor to those of a standard.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.files import read_bytes
from camcal.parsing import parse_numbers
from camcal.raw import AUTO, GRAY, MONO, NONE, calibration_frames
from camcal.raw.demosaic import demosaic
from camcal.raw.mosaic import Mosaic, by_place, cell_side, full_scale, phases, sites
from camcal.raw.options import (
    CAMERA,
    DEPTHS,
    GRAY_WORLD,
    LINEAR,
    NO_BALANCE,
    NO_MATRIX,
    PATCH,
    SRGB,
    Balance,
    Development,
    Gains,
    gamma_of,
)
from camcal.raw.tiles import Each, one_by_one, rounded


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrections from other frames of the same sensor, each (H, W).

    dark: counts without light, float32. bad: true where a pixel is to be replaced. flat: what light is divided by.
    """

    dark: Float32Array | None = None
    bad: BoolArray | None = None
    flat: Float32Array | None = None

    @property
    def change_light(self) -> bool:
        return self.dark is not None or self.flat is not None

    def require_size(self, frame: Mosaic) -> None:
        """Raise InvalidInput unless all of them have the frame's size."""
        for name in ("dark", "bad", "flat"):
            array = getattr(self, name)
            if array is not None and array.shape != frame.values.shape:
                sizes = "{}x{}, the frame {}x{}".format(*array.shape[::-1], *frame.size)
                raise InvalidInput(f"the {_WORDS[name]} is {sizes}: sizes must be equal")


NO_CORRECTIONS = Corrections()
_WORDS = {"dark": "dark frame", "bad": "map of bad pixels", "flat": "flat field"}


@dataclass(frozen=True, eq=False)
class Picture:
    """A developed frame: pixels (H, W, 3) blue, green, red, or (H, W) of one channel, and how they were made.

    gains: red, green, blue factors on the linear light, None when there was no white balance. linear: whether the
    filter took the counts for linear light. clipped: share of the samples at or above white, by place of the cell.
    """

    pixels: PixelArray
    gains: Gains | None
    linear: bool
    clipped: tuple[float, ...]


def develop(
    frame: Mosaic,
    development: Development,
    corrections: Corrections = NO_CORRECTIONS,
    each: Each = one_by_one,
) -> Picture:
    """Return the developed frame; floating point is 1 at saturation, integers use the full scale of their type.

    each: runs the work on the tiles of the frame.
    Raises InvalidInput if a correction does not fit, or what is asked for is not known of the frame; InsufficientData
    if there is no light to balance white by.
    """
    corrections.require_size(frame)
    matrix = colour_matrix(frame, development.colour)
    gains: Gains | None = None
    on_full_scale = not frame.black.any() and frame.white == full_scale(frame.values.dtype)
    untouched = development.is_neutral and not corrections.change_light
    if on_full_scale and untouched and development.algorithm != GRAY:  # demosaiced as counts, in their own type
        linear = frame.values.dtype != np.uint8 if development.encoding is None else development.encoding == LINEAR
        values = _repair(frame.values, frame, corrections)
    else:
        linear = development.encoding != "gamma"
        values, gains = balanced_light(frame, development, corrections)
    pixels = demosaic(values, frame.pattern, development.algorithm, linear=linear, each=each)
    if matrix is not None:
        if pixels.ndim != 3:
            raise InvalidInput(f"a colour matrix needs colour, and {development.algorithm} gives one channel")
        swapped = np.asarray(matrix[::-1, ::-1], np.float32)  # colours of pixels are blue, green, red
        pixels = np.asarray(pixels.reshape(-1, 3) @ swapped.T).reshape(pixels.shape)
    depth = DTYPES[development.depth] if development.depth else frame.values.dtype
    if development.tone != LINEAR or pixels.dtype != depth:
        if pixels.dtype != np.float32:
            pixels = pixels.astype(np.float32) / np.float32(full_scale(pixels.dtype))
        pixels = quantise(encode(pixels, development.tone), depth)
    return Picture(pixels, gains, linear, clipped_shares(frame))


def negative(frame: Mosaic, development: Development, corrections: Corrections = NO_CORRECTIONS) -> Mosaic:
    """Return the raw frame as it is before demosaicing, for files that hold a mosaic.

    Its counts and levels stay as they are, bad pixels apart, unless light is changed: then it is 16 bits, black 0.
    Raises InvalidInput if more is asked for than a mosaic can hold.
    """
    if development.algorithm not in (AUTO, NONE) or development.tone != LINEAR or development.colour != NO_MATRIX:
        raise InvalidInput("a DNG file holds the mosaic: leave out --algorithm, --tone and --colour, or write TIFF")
    corrections.require_size(frame)
    untouched = development.is_neutral and not corrections.change_light
    if untouched and frame.values.dtype != np.float32:
        return replace(frame, values=_repair(frame.values, frame, corrections))
    light, gains = balanced_light(frame, development, corrections)
    counts = quantise(light, np.dtype(np.uint16))
    balance = frame.camera_gains if gains is None else None
    return replace(
        frame, values=counts, black=np.zeros_like(frame.black), white=full_scale(counts.dtype), camera_gains=balance
    )


def balanced_light(frame: Mosaic, development: Development, corrections: Corrections) -> tuple[Array, Gains | None]:
    """Return the linear light (H, W), float32, corrected, balanced and exposed, and the gains of the balance.

    The balanced mosaic as a gray image needs a balance; without one asked for it is that of a gray world.
    """
    light = _repair(linearise(frame, corrections.dark), frame, corrections)
    if corrections.flat is not None:
        light /= corrections.flat
    balance = development.balance
    if development.algorithm == GRAY and balance.text == NO_BALANCE:
        balance = Balance(GRAY_WORLD)
    gains = None if frame.pattern == MONO else find_gains(balance, light, frame.pattern, frame.camera_gains)
    if gains is not None:
        balance_in_place(light, frame.pattern, gains)
    if development.exposure:
        light *= np.float32(2**development.exposure)
    return light, gains


def linearise(frame: Mosaic, dark: Array | None = None) -> Array:
    """Return the light (H, W), float32, 0 at black and 1 at saturation; noise may fall below 0.

    dark: (H, W) counts without light, which take the place of the black level.
    """
    result = np.empty(frame.values.shape, np.float32)
    for site, black in zip(phases(frame.pattern), frame.black.ravel(), strict=True):
        level = black if dark is None else float(np.median(dark[site]))
        np.subtract(frame.values[site], np.float32(black) if dark is None else dark[site], out=result[site])
        result[site] *= np.float32(1 / (frame.white - level))
    return result


def clipped_shares(frame: Mosaic) -> tuple[float, ...]:
    """Return the share of the samples at or above white, for every place of the cell."""
    return tuple(
        float(np.count_nonzero(values >= frame.white) / values.size)
        for values in (frame.values[site] for site in phases(frame.pattern))
    )


def _repair(values: Array, frame: Mosaic, corrections: Corrections) -> Array:
    return values if corrections.bad is None else calibration_frames.repair(values, corrections.bad, frame.pattern)


# IEC 61966-2-1, table 1: linear sRGB to CIE XYZ, white D65.
XYZ_M_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def colour_matrix(frame: Mosaic, choice: str) -> Array | None:
    """Return the matrix (3, 3) from the balanced red, green, blue of a frame to those asked for; None for none.

    choice: none, srgb (by what the file says of its sensor; gray stays gray), or a text file of nine numbers.
    Raises InvalidInput if the frame says nothing of its sensor or the file is no such matrix, FileError if it is not
    there.
    """
    if choice == NO_MATRIX:
        return None
    if choice != SRGB:
        return read_matrix(Path(choice))
    if frame.camera_M_xyz is None:
        raise InvalidInput("has no colour matrix of the sensor: give a file of nine numbers instead of srgb")
    camera_M_srgb = frame.camera_M_xyz @ XYZ_M_SRGB
    camera_M_srgb /= camera_M_srgb.sum(axis=1, keepdims=True)
    return np.asarray(np.linalg.inv(camera_M_srgb))


def read_matrix(path: Path) -> Array:
    """Return the matrix (3, 3) in a text file: nine numbers, row by row, # begins a comment."""
    try:
        text = read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise FileError("not a text file; a colour matrix has nine numbers", where=str(path)) from error
    words = " ".join(line.partition("#")[0] for line in text.splitlines()).replace(",", " ").split()
    try:
        numbers = np.array(parse_numbers(words))
    except ValueError as error:
        raise InvalidInput(f"a colour matrix is nine numbers ({error})", where=str(path)) from error
    if numbers.size != 9 or not np.isfinite(numbers).all() or abs(np.linalg.det(numbers.reshape(3, 3))) < 1e-9:
        raise InvalidInput(f"a colour matrix is nine numbers that can be inverted, found {len(words)}", where=str(path))
    return numbers.reshape(3, 3)


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
