"""Statistics of raw frames whose counts are known."""

import numpy as np
import pytest

from camcal.raw.frame_facts import BINS, channel_facts
from camcal.raw.mosaic import Mosaic

X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"
CELL = np.array([[100, 200], [300, 400]])


def frame(values, pattern="RGGB", black=0.0, white=1000.0):
    side = 6 if len(pattern) == 36 else 2
    return Mosaic(np.asarray(values), pattern, np.full((side, side), black), white)


@pytest.mark.parametrize(
    ("pattern", "means"),
    [
        ("RGGB", {"R": 100, "Gr": 200, "Gb": 300, "B": 400}),
        ("GRBG", {"R": 200, "Gr": 100, "Gb": 400, "B": 300}),
        ("GBRG", {"R": 300, "Gr": 400, "Gb": 100, "B": 200}),
        ("BGGR", {"R": 400, "Gr": 300, "Gb": 200, "B": 100}),
        ("MONO", {"gray": 250}),
    ],
)
def test_every_channel_has_its_own_mean(pattern, means):
    found = channel_facts(frame(np.tile(CELL, (3, 4)).astype(np.uint16), pattern))
    assert {facts.name: facts.mean for facts in found} == means
    assert [facts.name for facts in found] == list(means)


def test_x_trans_has_three_channels_and_every_sample_counts_once():
    values = np.arange(61 * 75, dtype=np.uint16).reshape(61, 75)
    found = channel_facts(frame(values, X_TRANS, white=60000.0))
    assert [facts.name for facts in found] == ["R", "G", "B"]
    assert sum(facts.samples for facts in found) == values.size
    assert sum(facts.mean * facts.samples for facts in found) == pytest.approx(values.sum(), rel=1e-12)  # float64


def test_clipping_counts_what_is_at_or_beyond_the_levels():
    values = np.full((20, 20), 500, np.uint16)
    values[0:10:2, 0] = [1000, 1001, 65535, 999, 998]  # three at white or above
    values[1, 1:9:2] = [64, 63, 0, 65]  # three at black or below
    red, _, _, blue = channel_facts(frame(values, black=64.0))
    assert (red.at_white, red.at_black) == (3 / 100, 0)
    assert (blue.at_white, blue.at_black) == (0, 3 / 100)
    assert (red.least, red.most, blue.least, blue.most) == (500, 65535, 0, 500)


def test_each_place_of_the_cell_has_its_own_black():
    black = np.array([[10.0, 20.0], [30.0, 40.0]])
    found = channel_facts(Mosaic(np.full((4, 4), 25, np.uint8), "RGGB", black, 255.0))
    assert [facts.at_black for facts in found] == [0, 0, 1, 1]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_histogram_counts_every_sample_between_zero_and_white(dtype):
    values = np.random.default_rng(0).integers(0, 255, (40, 50)).astype(dtype)
    for facts, place in zip(channel_facts(frame(values, white=200.0)), np.ndindex(2, 2), strict=True):
        samples = np.clip(values[place[0] :: 2, place[1] :: 2], 0, 199)
        expected, _ = np.histogram(samples, bins=BINS, range=(0, 200))
        np.testing.assert_array_equal(facts.histogram, expected)


def test_light_below_zero_is_in_the_first_bin():
    values = np.array([[-0.5, 0.2], [2.0, -1.0]], np.float32)
    found = channel_facts(frame(values, "MONO", white=1.0))[0]
    assert (found.histogram[0], found.histogram[-1], found.histogram.sum()) == (2, 1, 4)
    assert (found.at_black, found.at_white) == (0.5, 0.25)
