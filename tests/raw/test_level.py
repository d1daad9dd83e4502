"""Statistics of the frames of one level: against drawn frames of known noise, and against NumPy's own variance."""

import numpy as np
import pytest

from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.level import measure_level, phase_names
from camcal.raw.mosaic import Mosaic


def frames(count=2, shape=(120, 160), noise=3.0, pattern=0.0, mean=400.0, drift=0.0, seed=0, cfa="RGGB"):
    rng = np.random.default_rng(seed)
    fixed = mean + pattern * rng.standard_normal(shape)
    for index in range(count):
        values = np.rint(fixed + index * drift + noise * rng.standard_normal(shape)).astype(np.uint16)
        yield Mosaic(values, cfa, np.zeros((2, 2)), 4095.0)


@pytest.mark.parametrize("count", [2, 5])
def test_variance_is_the_pooled_variance_about_each_pixel(count):
    level = measure_level(frames(count))
    stack = np.array([frame.values[::2, ::2] for frame in frames(count)], float)
    centred = stack - stack.mean(axis=(1, 2), keepdims=True)
    expected = centred.var(axis=0, ddof=1).sum() / (centred[0].size - 1)
    assert level.temporal[0] == pytest.approx(expected, rel=1e-10)  # rounding of sums alone
    assert level.mean_dn[0] == pytest.approx(stack.mean())
    assert (level.frames, level.samples, level.size) == (count, 60 * 80, (160, 120))


def test_light_that_changes_between_frames_does_not_count_as_noise():
    still, drifting = (measure_level(frames(drift=drift)) for drift in (0, 40))
    assert drifting.temporal == pytest.approx(still.temporal, rel=1e-10)
    assert np.ptp(drifting.frame_means, axis=0) == pytest.approx([40] * 4, abs=0.3)  # 3 counts / sqrt(4800) × 5


def test_the_pattern_of_the_pixels_is_told_from_noise_and_from_shading():
    level = measure_level(frames(count=4, shape=(400, 600), noise=6.0, pattern=2.0))
    assert np.sqrt(level.spatial) == pytest.approx([2.0] * 4, rel=0.05)  # 6²/4 + 2² from 60 000 samples: 0.6 % × 3
    shading = np.linspace(300, 500, 600) * np.ones((400, 1))
    shaded = [Mosaic(np.float32(frame.values + shading), "RGGB", np.zeros((2, 2)), 1e4) for frame in frames(
        count=4, shape=(400, 600), noise=6.0, pattern=2.0
    )]  # fmt: skip
    assert measure_level(shaded).spatial == pytest.approx(level.spatial, abs=0.02)


def test_samples_at_the_ends_of_the_counts_are_counted():
    values = np.full((40, 40), 500, np.uint16)
    values[0, 0], values[1, 1], values[3, 1] = 0, 1000, 1100
    level = measure_level([Mosaic(values, "RGGB", np.zeros((2, 2)), 1000.0)] * 2)
    assert level.clipped == pytest.approx([1 / 400, 0, 0, 2 / 400])
    assert (level.peak, level.white) == (1100, 1000)


def test_greens_are_named_by_their_rows():
    assert phase_names("RGGB") == ("R", "Gr", "Gb", "B")
    assert phase_names("GBRG") == ("Gb", "B", "R", "Gr")
    assert phase_names("MONO") == ("mono",)


def test_a_sensor_without_filters_is_one_phase():
    level = measure_level(frames(cfa="MONO", shape=(61, 81)))
    assert level.names == ("mono",)
    assert level.samples == 61 * 81


def test_an_odd_border_is_left_out_so_that_all_phases_are_alike():
    assert measure_level(frames(shape=(61, 81))).samples == 30 * 40


def test_what_cannot_be_compared_is_refused():
    one, other = next(frames()), next(frames(shape=(80, 80)))
    with pytest.raises(InsufficientData, match="single frame"):
        measure_level([one])
    with pytest.raises(InvalidInput, match="160 × 120 RGGB and 80 × 80 RGGB"):
        measure_level([one, other])
    with pytest.raises(InsufficientData, match="too small"):
        measure_level(frames(shape=(20, 20)))
    with pytest.raises(InvalidInput, match="Bayer"):
        phase_names("GGRGGB" * 6)
