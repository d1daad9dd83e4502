"""Counts of fewer bits than their file says: found by the counts that are used."""

import numpy as np
import pytest

from camcal.raw.frame_facts import Widened, likely_white, used_counts, widened
from camcal.raw.mosaic import Mosaic


def used(counts, white=65535):
    return used_counts(Mosaic(counts.astype(np.uint16), "RGGB", np.zeros((2, 2)), white))


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_shifted_and_scaled_counts_are_told_from_counts_of_sixteen_bits(bits):
    counts = np.random.default_rng(bits).integers(20, 2**bits, (40, 50))
    shifted, scaled = 2.0 ** (16 - bits), 65535 / (2.0**bits - 1)
    assert widened([used(counts * shifted)]) == Widened(bits, shifted)
    assert widened([used(np.rint(counts * scaled))]) == Widened(bits, scaled)
    assert widened([used(counts)]) is None
    assert widened([used(np.random.default_rng(0).integers(0, 65536, (40, 50)))]) is None
    assert Widened(bits, shifted).white == 2**bits - 1


def test_low_bits_filled_with_the_high_ones_are_recognised():
    counts = np.random.default_rng(1).integers(0, 4096, (40, 50))
    assert widened([used(counts << 4 | counts >> 8)]).bits == 12


def test_all_frames_together_tell_and_few_counts_do_not():
    coarse, fine = (np.random.default_rng(2).integers(0, 4096, (40, 50)) * step for step in (16, 1))
    assert widened([used(coarse), used(fine)]) is None
    assert widened([used(np.full((20, 20), 4096))]) is None
    assert widened([used(coarse, white=15000)]) is None  # a camera file, whose counts are the sensor's


@pytest.mark.parametrize(
    ("peak", "white", "expected"),
    [(1023, 4095, 1023), (900, 4095, 1023), (1023, 65535, 1023), (3540, 65535, 4095), (40, 1023, 255),
     (1024, 4095, None), (0, 4095, None), (1023, 15000, None), (0.1, 1.0, None), (60, 255, None)],
)  # fmt: skip
def test_a_white_level_of_two_bits_too_many_is_noticed(peak, white, expected):
    assert likely_white(peak, white) == expected
