"""`ri` against the same filter written plainly: whole arrays of float64, one number for every pixel, no tiles.

The plain form follows the docstrings of the modules; what it does not prove is that the recipe is a good one.
"""

import numpy as np
import pytest
from bayer import PEAK, by_threads, random_mosaic, sampled, scene

from camcal.raw import PATTERNS, ri_green
from camcal.raw.demosaic import demosaic
from camcal.raw.residual import RED_BLUE_REACH, noise_of_green, residual_interpolation
from camcal.raw.tiles import detail_balance, one_by_one

MARGIN = 64  # pixels; more than the filter reaches, and whole windows
DIAGONALS = [[(1, 1), (-1, -1)], [(1, -1), (-1, 1)]]
LINES = [[(0, 1), (0, -1)], [(1, 0), (-1, 0)]]
CROSS = ((0, 2), (0, -2), (2, 0), (-2, 0))


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


def slope(of, on, tap, flat, steepest, expected=1, noise=0):
    power = in_windows(on * on, tap) + flat
    found = np.clip((in_windows(of * on, tap) + expected * flat) / power, -steepest, steepest)
    return everywhere(found * np.maximum(1 - noise / power, 0))


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


def spread(mosaic, green, noise):
    """Return red and blue at every pixel."""
    curves = [sum(seen(image, *step) for step in CROSS) - 4 * image for image in (mosaic, green)]
    gain = slope(*curves, 0.2, 20, 1.1, noise=12 * noise)
    residual_curve = curves[0] - gain * curves[1]
    beside = mean_of(residual_curve, [*DIAGONALS[0], *DIAGONALS[1]])
    share = of_the_cell(slope(residual_curve, beside, 0.2, 1000, 1, expected=0))
    of_cell = of_the_cell(gain)
    changes = [in_nine(residual_change(mosaic, green, of_cell, steps)) for steps in DIAGONALS]
    opposite = directed(mosaic, green, of_cell, DIAGONALS, changes) - share * residual_curve / 4
    corners = [at_phase(mosaic.shape, phase) for phase in ((0, 0), (1, 1))]
    beside_green = [of_the_other_in_the_cell(gain, axis) for axis in (0, 1)]
    colours = [np.where(corner, mosaic, opposite) for corner in corners]
    gains = [np.where(np.roll(corner, 1, 0), *beside_green) for corner in corners]
    both = list(zip(colours, gains, strict=True))
    changes = [in_nine(sum(residual_change(colour, green, own, steps) for colour, own in both)) for steps in LINES]
    return [
        np.where(is_green(mosaic.shape), directed(colour, green, own, LINES, changes), colour) for colour, own in both
    ]


def at_phase(shape, phase):
    result = np.zeros(shape, bool)
    result[phase[0] :: 2, phase[1] :: 2] = True
    return result


def of_the_cell(image):
    """Return for every pixel the number of the one diagonally across in its cell."""
    return of_the_other_in_the_cell(of_the_other_in_the_cell(image, 0), 1)


def residual_change(colour, green, gain, steps):
    """Return how much what green leaves of a colour changes from one side of every pixel to the other."""
    return np.abs(
        seen(colour, *steps[0]) - seen(colour, *steps[1]) - gain * (seen(green, *steps[0]) - seen(green, *steps[1]))
    )


def in_nine(change):
    """Return the cube of the sum over 3 × 3 pixels of a phase."""
    return (40 + sum(seen(change, 2 * row, 2 * column) for row in (-1, 0, 1) for column in (-1, 0, 1))) ** 3


def directed(colour, green, gain, directions, changes):
    """Return a colour in the middle of neighbours in two directions, each weighted by the changes of the other."""
    share = changes[1] / (changes[0] + changes[1])
    between, level = (
        share * mean_of(image, directions[0]) + (1 - share) * mean_of(image, directions[1]) for image in (colour, green)
    )
    return between + gain * (green - level)


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
    inner = [slice(MARGIN + 2, -(-end // 4) * 4 - 2) for end in (height + before[0], width + before[1])]
    cells = mosaic[tuple(inner)]
    red, blue = spread(mosaic, green, noise_of_green((cells[::2, 1::2], cells[1::2, ::2])))
    colour = np.stack([blue, green, red], -1)
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
    gains = detail_balance(light, "GRBG")
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
    assert 2 < np.abs(difference).max() <= 2 * (ri_green.REACH + ri_green.SMOOTHING_REACH + RED_BLUE_REACH)


def stripes(first, second, degrees, size=72):
    """Return an image (H, W, 3), 0 … 255, of stripes of two colours 15 pixels wide, their edges of one pixel's blur."""
    rows, columns = np.indices((size, size))
    across = columns * np.cos(np.deg2rad(degrees)) + rows * np.sin(np.deg2rad(degrees)) + 0.3
    share = np.clip(0.5 + 7.5 - np.abs(across % 30 - 15), 0, 1)[..., None]
    return np.rint(255 * (share * np.array(first) + (1 - share) * np.array(second)))


BLUE, GREEN, RED, CYAN, MAGENTA, BLACK = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 0, 0)], float
)


@pytest.mark.parametrize("degrees", [20, 45, 65])
@pytest.mark.parametrize(("first", "second"), [(RED, CYAN), (BLUE, RED), (GREEN, MAGENTA), (BLACK, MAGENTA)])
def test_an_edge_of_saturated_colours_has_fewer_dots_than_by_gradients(degrees, first, second):
    truth = stripes(first, second, degrees)
    mosaic = sampled(truth.astype(np.uint8), "RGGB")

    def dots(algorithm):
        error = demosaic(mosaic, "RGGB", algorithm) - truth
        smooth = (error + seen(error, 1, 0) + seen(error, 0, 1) + seen(error, 1, 1)) / 4
        return float(np.sqrt(np.mean((error - smooth)[8:-8, 8:-8] ** 2)))

    # 0.24 … 0.97 of them; gains that end at 0 and directions of one colour alone leave 0.9 … 1.65
    assert dots("ri") < dots("vng")


def test_noise_is_not_carried_from_green_to_red_and_blue():
    truth = np.repeat(np.repeat(255 * scene((20, 25)) * 0.4 + 60, 8, 0), 8, 1)
    noise = np.random.default_rng(2).normal(0, 20, truth.shape[:2])
    mosaic = np.clip(np.rint(sampled(truth, "RGGB") + noise), 0, 255).astype(np.uint8)
    error = (demosaic(mosaic, "RGGB") - truth)[8:-8, 8:-8]
    red_at_green = error[0::2, 1::2, 2]
    assert red_at_green.std() < 0.85 * 20  # two samples and two estimates are the mean of; green's noise would make 1.0
