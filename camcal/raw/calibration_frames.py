"""Dark frames and flat fields, for subtraction and division, and bad pixels, to be replaced.

Dark frames, many exposures of no light, become the one that is subtracted, and the noise of every pixel. They are added
up as they come, so memory does not grow with their number. Of three and more, every pixel leaves out its highest and
its lowest frame: a cosmic ray or one flash of an unstable pixel then changes nothing. A median would do the same, but
needs all frames at once and has more noise: 20 % over the plain mean of 16 frames, this has 1.5 %.

Flat fields, what every pixel makes of even light, become the divisor that undoes it. Without smoothing it corrects
everything that multiplies light: the lens's fall-off, dust, and the response of single pixels. It then brings in the
noise of the flat frame, which is worth it while that is below the 0.5 … 1 % by which pixels differ: 16 frames at half
saturation of a sensor that holds 10 000 electrons have 0.35 %, one has 1.4 %. Smoothing gives up dust and pixels and is
for few or noisy frames.

Bad pixels are detected in dark frames, stored in a map, and replaced in the mosaic before other filters.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array, readonly, require_shape
from camcal.errors import InsufficientData, InvalidInput
from camcal.images.files import load, save
from camcal.images.image import read_npy, write_npy
from camcal.raw import MONO
from camcal.raw.mosaic import cell_side, is_x_trans, phases

MASK_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm"})
TEXT_SUFFIXES = frozenset({"", ".txt", ".badpixels"})  # dcraw searches for a file that is named .badpixels

_ENTRY = re.compile(r"(-?\d{1,9})\s+(-?\d{1,9})(\s+-?\d+)?", re.ASCII)

_OUTLIER = 8.0  # robust standard deviations: of 12 million normal values the furthest is 5.5 away
_SIGMA_PER_MAD = 1.4826
_ROUNDING = 12**-0.5  # counts: with less noise than that most dark pixels read the same, and the MAD is 0
_MOST_BAD = 0.1  # of the pixels
_LEAST_FOR_NOISE = 6  # frames: one good pixel of 12 million then seems unsteady by chance, with four frames 70
_BLOCK = 32  # pixels: 16 × 16 samples of one place of the cell, 5 × 5 with X-Trans
_SAMPLES = 1 << 18  # that a median over a whole frame is taken from

_FURTHEST_RING = 8
_AROUND = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])

_LEAST_TRIMMED = 3
_BRIGHTEST = 0.5  # of saturation
_FLOOR = 1e-3
_SATURATED = 0.95  # of saturation: photon noise clips from about here on, and the mean comes out too low
_MOST_SATURATED = 1e-3  # of the samples: hot pixels are fewer
_DARKEST = 0.02  # mean light of one colour: 80 of 4095 counts, 10 % noise and the error of the black level


def stack(frames: Iterable[Array]) -> tuple[int, Array, Array]:
    """Return how many frames (H, W) of one size, counts or linear light, there are, their mean and their deviation.

    Mean: (H, W) float32, of every pixel, without the highest and the lowest frame when there are three or more.
    Deviation: (H, W) float32, standard deviation of the frames that went into the mean, NaN for a single one. Without
    its extremes it is less than the noise, by the same factor for all pixels.
    Raises InsufficientData without a frame, InvalidInput if a frame has another size or is not finite.
    """
    count, sums, extremes = 0, np.zeros((2, 0, 0)), np.zeros((2, 0, 0))
    for count, frame in enumerate(frames, start=1):
        if count == 1:
            sums = np.zeros((2, *require_shape(frame, (None, None), "frame 1").shape))
            extremes = np.stack([frame, frame])
        exact = _require_frame(frame, sums.shape[1:], count)
        sums[0] += exact
        sums[1] += np.square(exact, out=exact)
        np.minimum(frame, extremes[0], out=extremes[0])
        np.maximum(frame, extremes[1], out=extremes[1])
    if count == 0:
        raise InsufficientData("no frames to average; give one or more")
    kept = count
    if count >= _LEAST_TRIMMED:
        kept -= 2
        for extreme in extremes.astype(np.float64):
            sums[0] -= extreme
            sums[1] -= extreme * extreme
    mean, deviation = sums[0] / kept, np.full(sums[0].shape, np.nan, np.float32)
    if kept > 1:
        variance = (sums[1] - sums[0] * sums[0] / kept) / (kept - 1)
        deviation = np.asarray(np.sqrt(np.maximum(variance, 0)), np.float32)
    return count, mean.astype(np.float32), deviation


def dark_average(frames: Iterable[Array], white: float) -> Array:
    """Return the dark frame (H, W), float32 in counts, of one or more exposures without light.

    white: counts at saturation. Raises InsufficientData without a frame, InvalidInput if frames differ in size, are
    not finite, or are too bright to be dark.
    """
    dark = stack(frames)[1]
    level = float(np.median(dark))
    if level > _BRIGHTEST * white:
        share = f"{level:.0f} of {white:.0f} counts"
        raise InvalidInput(
            f"half of the pixels have {share} or more; check that this is a dark frame with the lens covered"
        )
    return dark


def _require_frame(frame: Array, shape: tuple[int, ...], number: int) -> Array:
    if frame.shape != shape:
        found = " × ".join(map(str, frame.shape[::-1]))
        raise InvalidInput(f"frame {number} has {found} pixels, the first one {shape[1]} × {shape[0]}")
    exact = frame.astype(np.float64)
    if frame.dtype.kind == "f" and not np.isfinite(exact).all():
        raise InvalidInput(f"frame {number}: {np.count_nonzero(~np.isfinite(exact))} pixels are not finite")
    return exact


def flat_gain(flat: Array, pattern: str, smoothing: float = 0.0) -> Array:
    """Return the divisor (H, W), float32: the flat over the mean of each place of the pattern's cell, at least 1e-3.

    flat: (H, W) linear light, dark frame subtracted, 1 at saturation; best the mean of 16 or more frames.
    smoothing: standard deviation in pixels of a Gaussian over the samples of each place; 0 is none.
    Linear light is divided by it before white balance. The mean of a place is kept, and so is the colour of light.
    Raises InvalidInput if the flat is saturated, almost dark, or not finite.
    """
    flat = require_shape(flat, (None, None), "flat frame", np.float32)
    if not np.isfinite(flat).all():
        raise InvalidInput(f"{np.count_nonzero(~np.isfinite(flat))} pixels of the flat frame are not finite")
    if not 0 <= smoothing < np.inf:
        raise InvalidInput(f"the smoothing of the flat frame is 0 or more pixels, found {smoothing:g}")
    side = cell_side(pattern)
    gain = np.empty_like(flat)
    for place, site in enumerate(phases(pattern)):
        mean = _require_exposed(flat[site], f"row {place // side}, column {place % side} of the {pattern} cell")
        gain[site] = _smooth(flat[site], smoothing / side) / np.float32(mean)
    return np.maximum(gain, _FLOOR, out=gain)


def _require_exposed(samples: Array, place: str) -> float:
    """Return the mean of the samples of one place; raises InvalidInput if they tell no relative light."""
    saturated = np.count_nonzero(samples >= _SATURATED) / samples.size
    if saturated > _MOST_SATURATED:
        where = f"at {place} above {_SATURATED:.0%} of saturation"
        raise InvalidInput(f"flat frame saturated: {saturated:.1%} of the samples {where}; reduce the exposure")
    mean = float(samples.mean(dtype=np.float64))
    if mean < _DARKEST:
        where = f"of saturation at {place}, {_DARKEST:.0%} are needed"
        raise InvalidInput(f"flat frame too dark: mean {mean:.2%} {where}; increase the exposure")
    return mean


def _smooth(samples: Array, sigma: float) -> Array:
    if sigma == 0:
        return samples
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(samples, sigma, mode="reflect"))


def read_map(path: Path, size: tuple[int, int]) -> Array:
    """Return the mask (H, W) of bad pixels, true where bad, of a map for frames of `size` (width, height); read-only.

    An image (PNG, TIFF, PGM) or a NumPy array (H, W) is bad where it is not 0; a NumPy array (N, 2) of integers lists
    x and y. Any other file is text as dcraw reads it: "x y" or "x y time" on every line, # begins a comment; a pixel
    counts as bad whatever the time. x and y are the column and the row, (0, 0) at the top left of the visible frame.
    Raises FileError if the file cannot be read, InvalidInput with the line if it does not fit the frame.
    """
    suffix = path.suffix.lower()
    if suffix in MASK_SUFFIXES:
        mask = _fitting(load(path).pixels, size, path)
    elif suffix == ".npy":
        values = read_npy(path, kinds="bui")
        if values.ndim == 2 and values.shape[1] == 2 and size[0] != 2:
            points = ((x, y, f"{path}: entry {n}") for n, (x, y) in enumerate(values.tolist()))
            mask = _mask_of_points(points, size)
        else:
            mask = _fitting(values, size, path)
    else:
        mask = _mask_of_points(_parse(path), size)
    return readonly(mask, (None, None), "bad pixel map", bool)


def write_map(path: Path, mask: Array) -> None:
    """Write a mask (H, W) of bad pixels in one step: as text for dcraw, an image (255 is bad) or a NumPy array.

    Raises InvalidInput for a suffix that says neither, FileError if the file cannot be written.
    """
    mask = require_shape(mask, (None, None), "bad pixel map", bool)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        write_npy(path, mask)
    elif suffix in MASK_SUFFIXES:
        save(path, mask.astype(np.uint8) * np.uint8(255))
    elif suffix in TEXT_SUFFIXES:
        lines = [f"{x} {y} 0\n" for y, x in np.argwhere(mask).tolist()]
        files.write_text(path, f"# bad pixels of a {mask.shape[1]} x {mask.shape[0]} frame: x y time\n{''.join(lines)}")
    else:
        suffixes = ", ".join(sorted({".txt", ".npy"} | MASK_SUFFIXES))
        raise InvalidInput(f"{suffix} is not a suffix of a bad pixel map; use one of {suffixes}", where=str(path))


def make_map(darks: Iterable[Array], pattern: str) -> Array:
    """Return the mask (H, W) of bad pixels, true where dark frames (H, W) in counts show one; read-only.

    A pixel is bad when its mean is more than 8 robust standard deviations off the other pixels of its place in the
    pattern's cell, or, with six frames and more, its noise is. The glow of warm electronics is not: medians over
    blocks of 32 × 32 pixels, linear between their centres, are taken off first; a cluster of bad pixels that fills
    less than half a block hardly moves them. With three frames and more no single cosmic ray counts.
    Raises InsufficientData without a frame or if a tenth of the pixels is bad, InvalidInput if frames differ in size.
    """
    side = cell_side(pattern)
    count, mean, deviation = stack(darks)
    if min(mean.shape) < side:
        raise InvalidInput(f"a dark frame needs at least {side} × {side} pixels, found {mean.shape[::-1]}")
    mask = np.zeros(mean.shape, bool)
    for site in phases(pattern):
        mask[site] = _outliers(mean[site], _BLOCK // side)
        if count >= _LEAST_FOR_NOISE:
            mask[site] |= _outliers(deviation[site], _BLOCK // side)
    if (share := float(mask.mean())) > _MOST_BAD:
        raise InsufficientData(f"{share:.0%} of the pixels are outliers: check that these are dark frames")
    return readonly(mask, (None, None), "bad pixel map", bool)


def repair(values: Array, mask: Array, pattern: str) -> Array:
    """Return a copy of a mosaic with every bad pixel the median of the good ones of its eight nearest neighbours.

    values: (H, W) uint8, uint16 or float32. mask: (H, W), true where bad. The neighbours stand at the same place of
    the next cells, two pixels away (one with MONO); with X-Trans they are those of the same colour up to two pixels
    away. Those outside the frame do not count. Where none is good, the next ring is taken, up to the eighth.
    Raises InvalidInput if the sizes differ, InsufficientData if a pixel is further than that from a good one.
    """
    mask = require_shape(mask, (None, None), "bad pixel map", bool)
    if values.shape != mask.shape:
        found, wanted = (" × ".join(map(str, array.shape[::-1])) for array in (mask, values))
        raise InvalidInput(f"the bad pixel map is for {found} pixels, the frame has {wanted}")
    result = values.copy()
    left = np.argwhere(mask)
    for ring in range(1, _FURTHEST_RING + 1):
        if left.size:
            groups = [_fill(result, mask, pixels, offsets) for pixels, offsets in _neighbours(left, pattern, ring)]
            left = np.concatenate(groups)
    if left.size:
        row, column = left[0]
        near = _FURTHEST_RING * _reach(pattern)
        count = f"{len(left)} bad pixels without valid neighbour of their colour within {near} pixels"
        raise InsufficientData(f"{count}, such as column {column}, row {row}; the area is too large to be corrected")
    return result


def _parse(path: Path) -> Iterator[tuple[int, int, str]]:
    """Yield x, y and the place in the file of every entry of a text."""
    for number, line in enumerate(files.read_text(path).splitlines(), start=1):
        if not (entry := line.partition("#")[0].strip()):
            continue
        where = f"{path}:{number}"
        if not (match := _ENTRY.fullmatch(entry)):
            raise InvalidInput(f"expected 'x y' or 'x y time', found {entry[:40]!r}", where=where)
        yield int(match[1]), int(match[2]), where


def _mask_of_points(points: Iterable[tuple[int, int, str]], size: tuple[int, int]) -> Array:
    width, height = size
    mask = np.zeros((height, width), bool)
    for x, y, where in points:
        if not (0 <= x < width and 0 <= y < height):
            raise InvalidInput(f"column {x}, row {y} is outside the frame of {width} × {height} pixels", where=where)
        mask[y, x] = True
    return mask


def _fitting(values: Array, size: tuple[int, int], path: Path) -> Array:
    if values.shape != size[::-1]:
        found = " × ".join(map(str, (values.shape[1::-1] + values.shape[2:])))
        raise InvalidInput(f"the bad pixel map is {found}, the frame {size[0]} × {size[1]} pixels", where=str(path))
    return np.asarray(values != 0)


def _outliers(values: Array, block: int) -> Array:
    """Return which values (h, w) in counts, of one place of the cell, are far off the others.

    Medians over blocks are taken off first, interpolated and continued straight beyond the last centres.
    """
    (height, rows), (width, columns) = ((length, max(1, length // block)) for length in values.shape)
    tall, wide = height // rows, width // columns
    blocks = values[: rows * tall, : columns * wide].reshape(rows, tall, columns, wide)
    medians = np.median(blocks.swapaxes(1, 2).reshape(rows, columns, -1), axis=2)
    background = _interpolation(height, rows) @ medians @ _interpolation(width, columns).T
    residual = values - np.asarray(background, np.float32)
    step = max(1, residual.size // _SAMPLES)
    residual -= np.median(residual.ravel()[::step])
    distance = np.abs(residual, out=residual)
    sigma = max(_SIGMA_PER_MAD * float(np.median(distance.ravel()[::step])), _ROUNDING)
    return np.asarray(distance > _OUTLIER * sigma)


def _interpolation(length: int, blocks: int) -> Array:
    """Return the weights (length, blocks) that the centres of equal blocks have at every position."""
    if blocks == 1:
        return np.ones((length, 1), np.float32)
    at = (np.arange(length) + 0.5) / (length // blocks) - 0.5
    before = np.clip(np.floor(at), 0, blocks - 2).astype(int)
    weights = np.zeros((length, blocks), np.float32)
    weights[np.arange(length), before] = 1 - (at - before)
    weights[np.arange(length), before + 1] = at - before
    return weights


def _neighbours(pixels: Array, pattern: str, ring: int) -> Iterator[tuple[Array, Array]]:
    """Yield pixels (M, 2), row and column, with the offsets (K, 2) of their neighbours in a ring."""
    if not is_x_trans(pattern):
        yield pixels, _AROUND * (ring * _reach(pattern))
        return
    letters = np.array(list(pattern)).reshape(6, 6)
    far = ring * _reach(pattern)
    offsets = np.argwhere(np.ones((2 * far + 1, 2 * far + 1), bool)) - far
    offsets = offsets[np.abs(offsets).max(axis=1) > far - _reach(pattern)]
    for place in np.ndindex(6, 6):
        same = letters[tuple(((offsets + place) % 6).T)] == letters[place]
        yield pixels[(pixels % 6 == place).all(axis=1)], offsets[same]


def _reach(pattern: str) -> int:
    return 1 if pattern == MONO else 2


def _fill(result: Array, mask: Array, pixels: Array, offsets: Array) -> Array:
    """Set pixels (M, 2) to the median of their good neighbours; return those that have none."""
    places = pixels[:, None, :] + offsets
    limits = np.array(mask.shape) - 1
    inside = ((places >= 0) & (places <= limits)).all(axis=2)
    rows, columns = np.moveaxis(np.clip(places, 0, limits), 2, 0)
    good = inside & ~mask[rows, columns]
    fillable = good.any(axis=1)
    samples = np.where(good, result[rows, columns].astype(np.float32), np.float32(np.nan))
    medians = np.nanmedian(samples[fillable], axis=1)
    result[tuple(pixels[fillable].T)] = np.rint(medians) if result.dtype.kind == "u" else medians
    return np.asarray(pixels[~fillable])
