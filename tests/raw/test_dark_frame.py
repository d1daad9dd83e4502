"""Averages of dark frames against frames with known noise."""

import numpy as np
import pytest

from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.calibration_frames import dark_average, stack

HEIGHT, WIDTH = 60, 80
WHITE = 4095.0


def dark_frames(count, seed=1, level=64.0, noise=3.0):
    rng = np.random.default_rng(seed)
    return [np.rint(rng.normal(level, noise, (HEIGHT, WIDTH))).astype(np.uint16) for _ in range(count)]


def test_one_or_two_frames_are_averaged_as_they_are():
    frames = dark_frames(2)
    np.testing.assert_array_equal(dark_average(frames[:1], WHITE), frames[0])
    np.testing.assert_array_equal(dark_average(frames, WHITE), np.mean(frames, axis=0))
    assert dark_average(frames, WHITE).dtype == np.float32


@pytest.mark.parametrize("count", [3, 4, 9])
def test_of_three_frames_and_more_the_highest_and_lowest_of_every_pixel_are_left_out(count):
    frames = dark_frames(count)
    kept = np.sort(frames, axis=0)[1:-1].astype(float)
    stacked, mean, deviation = stack(iter(frames))
    assert stacked == count
    # sums of integers are exact; the results are float32
    np.testing.assert_allclose(mean, kept.mean(axis=0), rtol=1e-7)
    if count > 3:
        np.testing.assert_allclose(deviation, kept.std(axis=0, ddof=1), rtol=1e-7)
    else:
        assert np.isnan(deviation).all()


def test_a_cosmic_ray_in_any_of_the_frames_leaves_no_trace():
    for hit in range(4):
        frames = dark_frames(4)
        frames[hit][7, 9] = 65535
        _, mean, deviation = stack(frames)
        assert mean[7, 9] == pytest.approx(64, abs=15)  # 5 times the noise of a single frame
        assert deviation[7, 9] < 15


def test_many_frames_average_to_less_noise():
    found = dark_average(dark_frames(16), WHITE)
    # 3 / √16 = 0.75 counts, 1.5 % more for the frames left out; 4800 pixels know a deviation to 1 %
    assert found.std() == pytest.approx(0.75 * 1.015, rel=0.04)
    assert found.mean() == pytest.approx(64, abs=0.05)


def test_frames_are_not_written_to_and_may_be_floating_point():
    frames = [frame.astype(np.float32) / 4 for frame in dark_frames(3)]
    copies = [frame.copy() for frame in frames]
    np.testing.assert_array_equal(dark_average(frames, WHITE), np.median(frames, axis=0))
    np.testing.assert_array_equal(frames, copies)


def test_no_frames_are_too_few():
    with pytest.raises(InsufficientData, match="no frames"):
        dark_average([], WHITE)


def test_a_frame_of_another_size_is_refused_by_its_number():
    frames = [*dark_frames(2), np.zeros((HEIGHT, WIDTH - 2), np.uint16)]
    with pytest.raises(InvalidInput, match=r"frame 3 has 78 × 60 pixels, the first one 80 × 60"):
        dark_average(frames, WHITE)


def test_a_frame_in_colour_is_refused():
    with pytest.raises(InvalidInput, match=r"frame 1 has shape \(4, 4, 3\)"):
        dark_average([np.zeros((4, 4, 3), np.uint8)], WHITE)


def test_a_frame_that_is_not_finite_is_refused():
    frame = np.zeros((4, 4), np.float32)
    frame[1, 2] = np.nan
    with pytest.raises(InvalidInput, match="frame 1: 1 pixel"):
        dark_average([frame], WHITE)


def test_a_bright_frame_is_not_dark():
    with pytest.raises(InvalidInput, match=r"3000 of 4095 counts .* check that this is a dark frame"):
        dark_average(dark_frames(3, level=3000, noise=0), WHITE)
