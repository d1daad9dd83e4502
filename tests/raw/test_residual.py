"""`ri` against the same filter written plainly: whole arrays of float64, one number for every pixel, no tiles.

The plain form follows the docstrings of the modules; what it does not prove is that the recipe is a good one.
"""

import numpy as np
import pytest
from bayer import PEAK, by_threads, random_mosaic, sampled, scene

from camcal.raw import ri_green, ri_red_blue
from camcal.raw.demosaic import demosaic
from camcal.raw.mosaic import PATTERNS
from camcal.raw.planes import one_by_one
from camcal.raw.residual import residual_interpolation
from camcal.raw.scales import scale_of

MARGIN = 64  # pixels; more than the filter reaches, and whole windows
PHASES = [(row, column) for row in (0, 1) for column in (0, 1)]  # red, green beside it, green below it, blue


def seen(image, down, right):
    """Return what every pixel sees that far away; beyond the border the other side, which the margin keeps out."""
    return np.roll(image, (-down, -right), (0, 1))


def in_windows(image, tap):
    """Return every phase's means (2, 2, H / 4, W / 4): of blocks of 4 × 4 pixels, the next ones weighted by the tap."""
    height, width = image.shape
    means = image.reshape(height // 4, 2, 2, width // 4, 2, 2).mean((1, 4)).transpose(1, 3, 0, 2)
    for axis in (2, 3):
        means = (tap * np.roll(means, 1, axis) + means + tap * np.roll(means, -1, axis)) / (1 + 2 * tap)
    return means


def everywhere(means):
    """Return for every pixel what is known for the windows of its phase, linearly between the middles of blocks."""
    for axis in (2, 3):
        halves = [0.75 * means + 0.25 * np.roll(means, way, axis) for way in (1, -1)]
        means = np.stack(halves, axis + 1).reshape(*(size * (1 + (i == axis)) for i, size in enumerate(means.shape)))
    rows, columns = means.shape[2:]
    return means.transpose(2, 0, 3, 1).reshape(2 * rows, 2 * columns)


def slope(of, on, tap, flat, highest):
    return everywhere(np.clip((in_windows(of * on, tap) + flat) / (in_windows(on * on, tap) + flat), 0, highest))


def of_the_other_in_the_cell(image, axis):
    """Return for every pixel the number of the other pixel of its cell along an axis."""
    swapped = np.empty_like(image)
    first, second = (slice(None),) * axis + (slice(0, None, 2),), (slice(None),) * axis + (slice(1, None, 2),)
    swapped[first], swapped[second] = image[second], image[first]
    return swapped


def differences_along(mosaic, axis):
    """Return green minus red or blue at every pixel, by its neighbours along an axis."""
    step = np.eye(2, dtype=int)[axis]
    before, after = seen(mosaic, *-step), seen(mosaic, *step)
    curve = seen(mosaic, *-2 * step) + seen(mosaic, *2 * step) - 2 * mosaic
    beside = (seen(curve, *-step) + seen(curve, *step)) / 2
    gain = of_the_other_in_the_cell(slope(curve, beside, 0.8, 10, 1), axis)
    other = (before + after) / 2 - gain * curve / 4
    return np.where(is_green(mosaic.shape), mosaic - other, other - mosaic)


def is_green(shape):
    return np.add(*np.indices(shape)) % 2 == 1


def fused_differences(mosaic):
    """Return green minus red or blue at the samples of red and blue."""
    total = weight = 0
    for axis in (0, 1):
        step = np.eye(2, dtype=int)[axis]
        difference = differences_along(mosaic, axis)
        gradient = np.abs(seen(difference, *step) - seen(difference, *-step))
        for side in (step, -step):
            smoothness = 0.25 + sum(
                seen(gradient, *(along * side + across * step[::-1])) for along in range(5) for across in range(-2, 3)
            )
            there = 0.55 * difference + 0.35 * seen(difference, *side) + 0.10 * seen(difference, *2 * side)
            total = total + there / smoothness**3
            weight = weight + 1 / smoothness**3
    return total / weight


def calmed(difference):
    """Return the differences, drawn to their local means where they vary more than these do."""
    mean = difference
    for step in ((2, 0), (0, 2)):
        mean = 0.522 * mean + 0.239 * (seen(mean, *step) + seen(mean, -step[0], -step[1]))
    noise = in_windows((difference - mean) ** 2, 0.8)
    detail = in_windows(mean**2, 0.8) - in_windows(mean, 0.8) ** 2 + 0.1
    return mean + everywhere(detail / (detail + 0.4 * noise)) * (difference - mean)


def spread(mosaic, green, phase):
    """Return the colour of a phase at every pixel."""
    laplacians = [
        sum(seen(image, *step) for step in ((0, 2), (0, -2), (2, 0), (-2, 0))) - 4 * image for image in (mosaic, green)
    ]
    gain = slope(*laplacians, 0.2, 20, 1.1)
    here = np.zeros(mosaic.shape, bool)
    here[phase[0] :: 2, phase[1] :: 2] = True
    result = np.where(here, mosaic, 0.0)
    for axis in (0, 1):
        step = np.eye(2, dtype=int)[axis]
        of_cell = of_the_other_in_the_cell(gain, axis)
        between = mean_of(mosaic, [step, -step]) + of_cell * (green - mean_of(green, [step, -step]))
        result = np.where(np.roll(here, 1, axis), between, result)
    of_cell = of_the_other_in_the_cell(of_the_other_in_the_cell(gain, 0), 1)
    diagonals = [[(1, 1), (-1, -1)], [(1, -1), (-1, 1)]]
    changes = [seen_change(mosaic, steps, of_cell, green) ** 2 for steps in diagonals]
    share = changes[1] / (changes[0] + changes[1])
    colour, level = (
        share * mean_of(image, diagonals[0]) + (1 - share) * mean_of(image, diagonals[1]) for image in (mosaic, green)
    )
    return np.where(np.roll(here, (1, 1), (0, 1)), colour + of_cell * (green - level), result)


def seen_change(mosaic, steps, gain, green):
    """Return how much what green leaves of a colour changes along a diagonal, summed over 3 × 3 pixels of a phase."""
    change = np.abs(
        seen(mosaic, *steps[0]) - seen(mosaic, *steps[1]) - gain * (seen(green, *steps[0]) - seen(green, *steps[1]))
    )
    return 9 + sum(seen(change, 2 * row, 2 * column) for row in (-1, 0, 1) for column in (-1, 0, 1))


def mean_of(image, steps):
    return np.mean([seen(image, *step) for step in steps], axis=0)


def plain(numbers, pattern):
    """Return colour (H, W, 3) blue, green, red of a mosaic of numbers 0 … 255, not cut off at white."""
    place = pattern.index("R")
    height, width = numbers.shape
    before = MARGIN + place // 2, MARGIN + place % 2
    after = (MARGIN + -(height + before[0]) % 4, MARGIN + -(width + before[1]) % 4)
    mosaic = np.pad(numbers.astype(float), list(zip(before, after, strict=True)), mode="reflect")
    green = np.where(is_green(mosaic.shape), mosaic, mosaic + calmed(fused_differences(mosaic)))
    colour = np.stack([spread(mosaic, green, (1, 1)), green, spread(mosaic, green, (0, 0))], -1)
    return colour[before[0] : before[0] + height, before[1] : before[1] + width]


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", [(66, 70), (67, 81)])
def test_it_is_the_plain_filter(pattern, shape):
    numbers = sampled(255 * scene(shape), pattern).astype(np.float32)
    found = residual_interpolation(numbers, pattern, 255, linear=False)
    # float32 in a few hundred steps on numbers up to 255; 4e-5 was found
    np.testing.assert_allclose(found, np.minimum(plain(numbers, pattern), 255), rtol=0, atol=1e-3)


def test_linear_light_is_filtered_as_square_roots():
    light = sampled(scene((66, 70)) ** 2.2 * np.array([0.6, 1.0, 0.4]) - 0.01, "GRBG").astype(np.float32)
    gains = scale_of(light, "GRBG", 1, linear=True).gains
    factors = sampled(np.broadcast_to([gains[colour] for colour in "BGR"], (*light.shape, 3)), "GRBG")
    toe, top = np.sqrt(0.002), np.sqrt(1.002) - np.sqrt(0.002)
    roots = np.sign(light) * (np.sqrt(np.abs(light * factors) + toe**2) - toe) / top
    numbers = plain(255 * roots, "GRBG") / 255 * top
    expected = np.abs(numbers) * (np.abs(numbers) + 2 * toe) * np.sign(numbers) / [gains[colour] for colour in "BGR"]
    found = residual_interpolation(light, "GRBG", 1)
    assert found.min() < 0
    np.testing.assert_allclose(found, np.minimum(expected, 1), rtol=0, atol=4e-6)  # as above, on a scale of 1


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("dtype", PEAK)
@pytest.mark.parametrize("tile", [(4, 18), (10, 8)])
def test_tiles_and_threads_change_no_bit(dtype, tile, linear):
    mosaic = sampled((scene((23, 52)) * PEAK[dtype]).astype(dtype), "GBRG")
    whole = residual_interpolation(mosaic, "GBRG", PEAK[dtype], linear=linear)
    for each in (one_by_one, by_threads):
        tiled = residual_interpolation(mosaic, "GBRG", PEAK[dtype], linear=linear, tile=tile, each=each)
        np.testing.assert_array_equal(tiled, whole)


def test_a_frame_larger_than_a_tile_has_no_seams():
    mosaic = random_mosaic((300, 1100), np.uint16)
    found = residual_interpolation(mosaic, "RGGB", 65535)
    again = residual_interpolation(mosaic, "RGGB", 65535, tile=(1000, 1000))
    np.testing.assert_array_equal(found, again)


def test_colours_far_from_a_change_stay_as_they_are():
    mosaic = sampled((scene((130, 140)) * 255).astype(np.uint8), "RGGB")
    changed = mosaic.copy()
    changed[64:66, 70:72] ^= 255
    difference = np.argwhere((demosaic(mosaic, "RGGB") != demosaic(changed, "RGGB")).any(-1)) - (64, 70)
    assert 2 < np.abs(difference).max() <= 2 * (ri_green.REACH + ri_green.CALMING_REACH + ri_red_blue.REACH)
