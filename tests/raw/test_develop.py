"""Levels, white balance, tone and depth, each by numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InsufficientData, InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.raw.develop import Corrections, develop, encode, find_gains, linearise, negative, quantise
from camcal.raw.mosaic import Mosaic, sites
from camcal.raw.options import Balance, Development


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


def gains_of(mosaic, balance, normalise="min"):
    return find_gains(Balance(balance, normalise), linearise(mosaic), mosaic.pattern, mosaic.camera_gains)


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
    picture = develop(mosaic, Development(balance=Balance("4,1,2"), depth="float"))
    # counts of a 10-bit frame are rounded: half a count times the gain of 4
    np.testing.assert_allclose(picture.pixels, 0.4, rtol=0, atol=4 * 0.5 / 959)
    assert picture.gains == (4.0, 1.0, 2.0)


def test_gray_world_makes_a_tinted_gray_card_gray():
    picture = develop(frame(coloured_light(0.2, 0.5, 0.25)), Development(balance=Balance("gray-world"), depth="float"))
    assert np.ptp(picture.pixels) < 1e-6  # float32
    assert picture.gains == pytest.approx((2.5, 1.0, 2.0), rel=0.005)  # counts of 10 bit are rounded


def test_gray_world_leaves_out_clipped_cells():
    light = coloured_light(0.2, 0.4, 0.2, shape=(20, 20))
    light[:10] = 1.0
    assert gains_of(frame(light), "gray-world") == pytest.approx((2.0, 1.0, 2.0), rel=0.005)


def test_a_gray_patch_gives_the_gains_whatever_is_around_it():
    light = coloured_light(0.4, 0.1, 0.4, shape=(20, 24))
    light[4:10, 6:14] = coloured_light(0.2, 0.4, 0.1, shape=(6, 8))
    assert gains_of(frame(light), "patch:5,3,10,8") == pytest.approx(gains_of(frame(light), "patch:6,4,8,6"), rel=0.5)
    assert gains_of(frame(light), "patch:6,4,8,6") == pytest.approx((2.0, 1.0, 4.0), rel=0.005)


@pytest.mark.parametrize("patch", ["20,0,5,4", "0,18,4,3", "3,3,2,2"])
def test_a_patch_that_is_not_inside_or_holds_no_cell_is_refused(patch):
    with pytest.raises(InvalidInput, match="24x20 frame"):
        gains_of(frame(coloured_light(0.4, 0.1, 0.4, shape=(20, 24))), f"patch:{patch}")


def test_found_gains_leave_green_alone_when_that_is_asked_for():
    mosaic = frame(coloured_light(0.5, 0.2, 0.4))
    assert gains_of(mosaic, "gray-world", "green") == pytest.approx((0.4, 1.0, 0.5), rel=0.005)


def test_gray_world_without_unclipped_light_says_so():
    with pytest.raises(InsufficientData, match="unclipped"):
        gains_of(frame(np.ones((4, 4))), "gray-world")


def test_gray_world_of_an_odd_size_uses_its_whole_cells():
    light = coloured_light(0.2, 0.4, 0.2, shape=(8, 10))
    mosaic = frame(light)
    cropped = Mosaic(mosaic.values[:7, :9], "RGGB", mosaic.black, mosaic.white)
    assert gains_of(cropped, "gray-world") == pytest.approx((2.0, 1.0, 2.0), rel=0.005)


def test_camera_gains_are_scaled_so_that_saturation_is_white():
    mosaic = frame(np.ones((4, 4)), camera_gains=np.array([1.0, 0.4, 0.8]))
    picture = develop(mosaic, Development(balance=Balance("camera"), depth="8"))
    assert picture.gains == pytest.approx((2.5, 1.0, 2.0))
    assert (picture.pixels == 255).all()


def test_camera_balance_of_a_frame_that_has_none_is_refused():
    with pytest.raises(InvalidInput, match="gray-world"):
        gains_of(frame(np.ones((4, 4))), "camera")


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


@pytest.mark.parametrize("tone", ["power:2.2", "power:.45", "srgb", "bt709"])
def test_tone_curves_rise_from_zero_to_one(tone):
    curve = encode(np.linspace(-0.5, 1.5, 4001, dtype=np.float32), tone)
    assert curve[0] == 0
    assert curve[-1] == pytest.approx(1, abs=1e-6)
    assert (np.diff(curve) >= -1e-4).all()  # BT.709 as printed steps down by 0.00007 where its branches meet
    assert curve.dtype == np.float32


@given(st.integers(0, 65535))
def test_sixteen_bit_counts_survive_the_way_through_light(count):
    light = np.array([count], np.float32) / np.float32(65535)
    assert quantise(light, np.dtype(np.uint16)) == count


@pytest.mark.parametrize(("depth", "dtype", "peak"), [("8", "u1", 255), ("16", "u2", 65535), ("float", "f4", 1.0)])
def test_white_is_the_full_scale_of_every_depth(depth, dtype, peak):
    pixels = develop(frame(np.ones((4, 4))), Development(depth=depth)).pixels
    assert pixels.dtype == np.dtype(dtype)
    np.testing.assert_allclose(pixels, peak, rtol=1e-6)  # float32


def test_the_depth_of_the_frame_is_kept_when_none_is_asked_for():
    assert develop(frame(np.ones((4, 4))), Development()).pixels.dtype == np.uint16


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "menon"}, "ri, malvar"),
        ({"algorithm": "libraw:AMAZE"}, "AHD"),
        ({"encoding": "log"}, "linear, gamma"),
        ({"exposure": float("nan")}, "--ev"),
        ({"tone": "gamma"}, "power:GAMMA"),
        ({"tone": "power:0"}, "unknown"),
        ({"tone": "power:-2"}, "unknown"),
        ({"depth": "12"}, "8, 16, float"),
    ],
)
def test_a_setting_that_does_not_exist_is_refused_with_those_that_do(change, message):
    with pytest.raises(InvalidInput, match=message):
        Development(**change)


@pytest.mark.parametrize(
    ("balance", "message"),
    [("auto", "gray-world"), ("1,2", "unknown"), ("1,0,2", "positive"), ("1,nan,2", "positive"), ("patch:1,2", "X,Y")],
)
def test_a_balance_that_does_not_exist_is_refused_with_those_that_do(balance, message):
    with pytest.raises(InvalidInput, match=message):
        Balance(balance)


def test_gains_are_normalised_by_the_smallest_or_by_green_only():
    with pytest.raises(InvalidInput, match="min, green"):
        Balance("camera", "max")


def test_a_stop_of_exposure_doubles_the_light():
    mosaic = frame(coloured_light(0.1, 0.2, 0.3))
    light = develop(mosaic, Development(depth="float")).pixels
    np.testing.assert_allclose(develop(mosaic, Development(exposure=1, depth="float")).pixels, 2 * light, rtol=1e-5)


def test_a_dark_frame_takes_the_place_of_the_black_level():
    rng = np.random.default_rng(2)
    dark = 64 + rng.uniform(0, 20, (8, 10)).astype(np.float32)
    light = np.full((8, 10), 0.5)
    values = (dark + light * (1023 - 74)).astype(np.float32)
    mosaic = Mosaic(values, "RGGB", np.zeros((2, 2)), 1023.0)
    picture = develop(mosaic, Development("none", depth="float"), Corrections(dark=dark))
    np.testing.assert_allclose(picture.pixels, 0.5, atol=0.006)  # the level of each place is a median of 20 pixels


def test_a_flat_field_undoes_the_fall_off_of_a_lens():
    fall_off = np.linspace(1, 0.4, 10)[None, :] * np.ones((8, 1))
    mosaic = frame(0.8 * fall_off)
    picture = develop(mosaic, Development("none", depth="float"), Corrections(flat=fall_off.astype(np.float32)))
    np.testing.assert_allclose(picture.pixels, 0.8, atol=0.002)  # counts of 10 bit


def test_a_bad_pixel_is_replaced_before_its_neighbours_see_it():
    light = coloured_light(0.2, 0.4, 0.1, shape=(12, 12))
    whole = develop(frame(light), Development()).pixels
    bad = np.zeros(light.shape, bool)
    bad[5, 6] = True
    light[5, 6] = 1.0
    np.testing.assert_array_equal(develop(frame(light), Development(), Corrections(bad=bad)).pixels, whole)


@pytest.mark.parametrize("name", ["dark", "bad", "flat"])
def test_a_correction_of_another_size_is_refused_with_both_sizes(name):
    with pytest.raises(InvalidInput, match="9x8, the frame 10x8"):
        develop(frame(np.ones((8, 10))), Development(), Corrections(**{name: np.ones((8, 9))}))


def test_the_balanced_mosaic_of_a_tinted_board_is_gray():
    mosaic = frame(coloured_light(0.2, 0.5, 0.25))
    picture = develop(mosaic, Development("gray", depth="float"))
    assert picture.pixels.shape == mosaic.values.shape
    assert np.ptp(picture.pixels) < 0.003  # counts of 10 bit


def test_a_monochrome_frame_stays_one_channel_and_needs_no_balance():
    mosaic = Mosaic(np.full((6, 6), 100, np.uint8), MONO, np.zeros((2, 2)), 255.0)
    picture = develop(mosaic, Development(balance=Balance("gray-world"), exposure=1))
    assert (picture.pixels == 200).all()
    assert picture.gains is None


def test_srgb_leaves_gray_gray_and_moves_colours():
    matrix = np.array([[0.9, 0.1, 0.0], [-0.3, 1.2, 0.1], [0.0, 0.2, 0.7]])
    gray = frame(coloured_light(0.3, 0.3, 0.3))
    gray = Mosaic(gray.values, "RGGB", gray.black, gray.white, camera_M_xyz=matrix)
    np.testing.assert_allclose(develop(gray, Development(colour="srgb", depth="float")).pixels, 0.3, atol=0.001)
    with pytest.raises(InvalidInput, match="nine numbers"):
        develop(frame(coloured_light(0.3, 0.3, 0.3)), Development(colour="srgb"))


def test_a_colour_matrix_of_a_file_is_red_green_blue_by_rows(tmp_path):
    (tmp_path / "matrix.txt").write_text("# swaps red and green\n0 1 0\n1 0 0\n0 0 1\n")
    mosaic = frame(coloured_light(0.1, 0.3, 0.2))
    pixels = develop(mosaic, Development(colour=str(tmp_path / "matrix.txt"), depth="float")).pixels
    np.testing.assert_allclose(pixels[4, 4], [0.2, 0.1, 0.3], atol=0.001)  # counts of 10 bit


@pytest.mark.parametrize("text", ["1 2 3", "a b c", "1 0 0 1 0 0 0 0 1", "1 0 0 0 1 0 0 0 nan"])
def test_what_is_no_colour_matrix_is_refused(tmp_path, text):
    (tmp_path / "matrix.txt").write_text(text)
    with pytest.raises(InvalidInput, match=r"matrix\.txt: .*nine numbers"):
        develop(frame(np.ones((4, 4))), Development(colour=str(tmp_path / "matrix.txt")))


def test_clipped_samples_are_counted_by_place():
    light = np.full((4, 4), 0.5)
    light[0, 0] = 1.0
    assert develop(frame(light), Development()).clipped == (0.25, 0.0, 0.0, 0.0)


def test_the_negative_keeps_counts_and_levels_unless_light_is_changed():
    mosaic = frame(coloured_light(0.1, 0.3, 0.2))
    kept = negative(mosaic, Development())
    np.testing.assert_array_equal(kept.values, mosaic.values)
    assert kept.white == mosaic.white
    brighter = negative(mosaic, Development(exposure=1))
    assert (brighter.white, brighter.black.max()) == (65535.0, 0.0)
    np.testing.assert_allclose(brighter.values / 65535, 2 * linearise(mosaic), atol=1e-4)
    with pytest.raises(InvalidInput, match="mosaic"):
        negative(mosaic, Development(tone="srgb"))
