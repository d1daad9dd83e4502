"""Levels, white balance, tone and depth, each by numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.develop import Development, develop, encode, linearise, quantise, white_balance
from camcal.raw.mosaic import PATTERNS, Mosaic, sites


def frame(light, pattern="RGGB", black=(64.0, 64.0, 64.0, 64.0), white=1023.0, camera_gains=None):
    """Return a uint16 frame of linear light (H, W) between the given levels."""
    black = np.reshape(black, (2, 2))
    floor = np.tile(black, (light.shape[0] // 2, light.shape[1] // 2))
    values = np.rint(floor + light * (white - floor)).astype(np.uint16)
    return Mosaic(values, pattern, black, white, camera_gains)


def coloured_light(red, green, blue, pattern="RGGB", shape=(8, 10)):
    light = np.empty(shape)
    for colour, level in zip("RGB", (red, green, blue), strict=True):
        for site in sites(pattern, colour):
            light[site] = level
    return light


def test_black_becomes_zero_and_white_one_for_every_phase():
    black = (60.0, 64.0, 70.0, 58.0)
    dark, bright = frame(np.zeros((4, 6)), black=black), frame(np.ones((4, 6)), black=black)
    np.testing.assert_allclose(linearise(dark), 0, atol=1e-7)
    np.testing.assert_allclose(linearise(bright), 1, atol=1e-6)  # float32


def test_noise_below_black_stays_negative_until_the_end():
    values = np.full((4, 4), 60, np.uint16)
    mosaic = Mosaic(values, "RGGB", np.full((2, 2), 64.0), 164.0)
    np.testing.assert_allclose(linearise(mosaic), -0.04, atol=1e-7)  # float32
    assert (develop(mosaic, Development()).pixels == 0).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_neutral_frame_keeps_its_counts(dtype):
    values = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (6, 7)).astype(dtype)
    mosaic = Mosaic(values, "GRBG", np.zeros((2, 2)), float(np.iinfo(dtype).max))
    np.testing.assert_array_equal(develop(mosaic, Development(algorithm="none")).pixels, values)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_gains_reach_their_colours(pattern):
    mosaic = frame(coloured_light(0.1, 0.4, 0.2, pattern), pattern)
    picture = develop(mosaic, Development(balance="4,1,2", depth="float"))
    # counts of a 10-bit frame are rounded: half a count times the gain of 4
    np.testing.assert_allclose(picture.pixels, 0.4, rtol=0, atol=4 * 0.5 / 959)
    assert picture.gains == (4.0, 1.0, 2.0)


def test_gray_world_makes_a_tinted_gray_card_gray():
    picture = develop(frame(coloured_light(0.2, 0.5, 0.25)), Development(balance="gray-world", depth="float"))
    assert np.ptp(picture.pixels) < 1e-6  # float32
    assert picture.gains == pytest.approx((2.5, 1.0, 2.0), rel=0.005)  # counts of 10 bit are rounded


def test_gray_world_leaves_out_clipped_cells():
    light = coloured_light(0.2, 0.4, 0.2, shape=(20, 20))
    light[:10] = 1.0
    assert white_balance(frame(light), "gray-world") == pytest.approx((2.0, 1.0, 2.0), rel=0.005)


def test_gray_world_without_unclipped_light_says_so():
    with pytest.raises(InsufficientData, match="unclipped"):
        white_balance(frame(np.ones((4, 4))), "gray-world")


def test_gray_world_of_an_odd_size_uses_its_whole_cells():
    light = coloured_light(0.2, 0.4, 0.2, shape=(8, 10))
    mosaic = frame(light)
    cropped = Mosaic(mosaic.values[:7, :9], "RGGB", mosaic.black, mosaic.white)
    assert white_balance(cropped, "gray-world") == pytest.approx((2.0, 1.0, 2.0), rel=0.005)


def test_camera_gains_are_scaled_so_that_saturation_is_white():
    mosaic = frame(np.ones((4, 4)), camera_gains=np.array([1.0, 0.4, 0.8]))
    picture = develop(mosaic, Development(balance="camera", depth="8"))
    assert picture.gains == pytest.approx((2.5, 1.0, 2.0))
    assert (picture.pixels == 255).all()


def test_camera_balance_of_a_frame_that_has_none_is_refused():
    with pytest.raises(InvalidInput, match="gray-world"):
        white_balance(frame(np.ones((4, 4))), "camera")


@pytest.mark.parametrize(
    ("tone", "light", "expected"),
    [
        ("linear", 0.18, 0.18),
        ("power:2.2", 0.18, 0.18 ** (1 / 2.2)),
        ("srgb", 0.001, 0.01292),
        ("srgb", 0.18, 0.461356),  # mid gray: 118 of 255
        ("bt709", 0.01, 0.045),
        ("bt709", 0.18, 0.409008),
    ],
)
def test_tone_curves_have_the_values_of_their_standards(tone, light, expected):
    assert encode(np.full((1, 1), light, np.float32), tone)[0, 0] == pytest.approx(expected, abs=1e-6)  # float32


@pytest.mark.parametrize("tone", ["linear", "power:2.2", "power:.45", "srgb", "bt709"])
def test_tone_curves_rise_from_zero_to_one(tone):
    curve = encode(np.linspace(-0.5, 1.5, 4001, dtype=np.float32), tone)
    assert curve[0] == 0
    assert curve[-1] == pytest.approx(1, abs=1e-6)
    assert (np.diff(curve) >= -1e-4).all()  # BT.709 as printed steps down by 0.00007 where its branches meet
    assert curve.dtype == np.float32


@given(st.integers(0, 65535))
def test_sixteen_bit_counts_survive_the_way_through_light(count):
    light = np.float32(count) / np.float32(65535)
    assert quantise(light, np.dtype(np.uint16)) == count


@pytest.mark.parametrize(("depth", "dtype", "peak"), [("8", "u1", 255), ("16", "u2", 65535), ("float", "f4", 1.0)])
def test_white_is_the_full_scale_of_every_depth(depth, dtype, peak):
    pixels = develop(frame(np.ones((4, 4))), Development(depth=depth)).pixels
    assert pixels.dtype == np.dtype(dtype)
    assert (pixels == peak).all()


def test_the_depth_of_the_frame_is_kept_when_none_is_asked_for():
    assert develop(frame(np.ones((4, 4))), Development()).pixels.dtype == np.uint16


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "ri"}, "bilinear, none"),
        ({"balance": "auto"}, "gray-world"),
        ({"balance": "1,2"}, "unknown"),
        ({"balance": "1,0,2"}, "positive"),
        ({"balance": "1,nan,2"}, "positive"),
        ({"tone": "gamma"}, "power:GAMMA"),
        ({"tone": "power:0"}, "unknown"),
        ({"tone": "power:-2"}, "unknown"),
        ({"depth": "12"}, "8, 16, float"),
    ],
)
def test_a_setting_that_does_not_exist_is_refused_with_those_that_do(change, message):
    with pytest.raises(InvalidInput, match=message):
        Development(**change)
