"""A variable number of gradients, against the paper's own sums, sample by sample.

The paper numbers the 25 samples around one in reading order, 1 … 25; 13 is the sample itself.
"""

import numpy as np
import pytest
from bayer import PEAK, by_threads, random_mosaic, sampled, scene

from camcal.raw import PATTERNS
from camcal.raw.filters import vng

# Gradients: pairs of full weight, pairs of half weight.
STRAIGHT = {
    "N": ("8-18 3-13", "7-17 9-19 2-12 4-14"),
    "E": ("14-12 15-13", "9-7 19-17 10-8 20-18"),
    "S": ("18-8 23-13", "19-9 17-7 24-14 22-12"),
    "W": ("12-14 11-13", "17-19 7-9 16-18 6-8"),
}
GRADIENTS_AT_COLOUR = STRAIGHT | {
    "NE": ("9-17 5-13", "8-12 14-18 4-8 10-14"),
    "SE": ("19-7 25-13", "14-8 18-12 20-14 24-18"),
    "NW": ("7-19 1-13", "12-18 8-14 6-12 2-8"),
    "SW": ("17-9 21-13", "18-14 12-8 22-18 16-12"),
}
GRADIENTS_AT_GREEN = STRAIGHT | {
    "NE": ("9-17 5-13 4-12 10-18", ""),
    "SE": ("19-7 25-13 20-8 24-12", ""),
    "NW": ("7-19 1-13 6-18 2-14", ""),
    "SW": ("17-9 21-13 22-14 16-8", ""),
}
# Means: the sample's own colour, then at red and blue samples green and the opposite colour ...
MEANS_AT_COLOUR = {
    "N": ("3 13", "8", "7 9"),
    "E": ("13 15", "14", "9 19"),
    "S": ("13 23", "18", "17 19"),
    "W": ("11 13", "12", "7 17"),
    "NE": ("5 13", "4 8 10 14", "9"),
    "SE": ("13 25", "14 18 20 24", "19"),
    "NW": ("1 13", "2 6 8 12", "7"),
    "SW": ("13 21", "12 16 18 22", "17"),
}
# ... at green samples the colour of their row and that of their column.
MEANS_AT_GREEN = {
    "N": ("3 13", "2 4 12 14", "8"),
    "E": ("13 15", "14", "8 10 18 20"),
    "S": ("13 23", "12 14 22 24", "18"),
    "W": ("11 13", "12", "6 8 16 18"),
    "NE": ("9", "4 14", "8 10"),
    "SE": ("19", "14 24", "18 20"),
    "NW": ("7", "2 12", "6 8"),
    "SW": ("17", "12 22", "16 18"),
}


def by_the_paper(mosaic, pattern, row, column):
    """Return red, green and blue of one sample, by their letters."""
    window = np.pad(mosaic.astype(float), 2, mode="reflect")[row : row + 5, column : column + 5].ravel()
    place = row % 2 * 2 + column % 2
    letter, beside, below = pattern[place], pattern[place ^ 1], pattern[place ^ 2]
    at_green = letter == "G"
    gradients = {
        direction: sum(
            weight * abs(window[int(one) - 1] - window[int(other) - 1])
            for weight, pairs in zip((1, 0.5), weighted, strict=True)
            for one, other in (pair.split("-") for pair in pairs.split())
        )
        for direction, weighted in (GRADIENTS_AT_GREEN if at_green else GRADIENTS_AT_COLOUR).items()
    }
    least, greatest = min(gradients.values()), max(gradients.values())
    smooth = [name for name, gradient in gradients.items() if gradient <= 1.5 * least + 0.5 * (greatest - least)]
    means = MEANS_AT_GREEN if at_green else MEANS_AT_COLOUR
    own, first, second = np.mean(
        [[window[np.array(numbers.split(), int) - 1].mean() for numbers in means[name]] for name in smooth], axis=0
    )
    here = window[12]
    names = (beside, below) if at_green else ("G", "RB".replace(letter, ""))
    return {letter: here, names[0]: here + first - own, names[1]: here + second - own}


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(6, 8), (7, 9)])
def test_every_colour_follows_the_published_sums(pattern, dtype, shape):
    mosaic = random_mosaic(shape, dtype)
    found = vng(mosaic, pattern, PEAK[dtype])
    expected = np.array(
        [
            [[by_the_paper(mosaic, pattern, row, column)[c] for c in "BGR"] for column in range(shape[1])]
            for row in range(shape[0])
        ]
    )
    if dtype == np.uint16:
        expected, tolerance = np.clip(expected, 0, 65535), 0.6  # rounded; sums of eight up to 65535 in float32
    else:
        expected, tolerance = np.minimum(expected, 1), 2e-6
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


def test_eight_bits_look_like_the_others():
    mosaic = sampled((scene((80, 90)) * 255).astype(np.uint8), "GRBG")
    eight, exact = vng(mosaic, "GRBG", 255), vng(mosaic.astype(np.float32), "GRBG", 255)
    # OpenCV halves whole numbers and so takes other directions now and then (0.76 off); a wrong phase is 39 off.
    assert np.abs(eight - exact).mean() < 1


@pytest.mark.parametrize("dtype", PEAK)
@pytest.mark.parametrize("tile", [(2, 4), (8, 6), (10, 20)])
def test_tiles_and_threads_change_no_bit(dtype, tile):
    mosaic = sampled((scene((23, 52)) * PEAK[dtype]).astype(dtype), "GBRG")
    whole = vng(mosaic, "GBRG", PEAK[dtype])
    np.testing.assert_array_equal(vng(mosaic, "GBRG", PEAK[dtype], tile=tile), whole)
    np.testing.assert_array_equal(vng(mosaic, "GBRG", PEAK[dtype], tile=tile, each=by_threads), whole)
