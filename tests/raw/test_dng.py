"""DNG files as LibRaw, which shares no code with us, reads them."""

from io import BytesIO

import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.raw import PATTERNS
from camcal.raw.dng import dng_bytes, write_dng
from camcal.raw.mosaic import Capture, Mosaic
from camcal.raw.reading import read_camera_raw

X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"
EOS_6D = np.array([[0.7034, -0.0804, -0.1014], [-0.4420, 1.2564, 0.2058], [-0.0851, 0.1994, 0.5758]])
LEVELS = np.array([[10.0, 20.0], [30.0, 40.0]])


def counts(shape, dtype=np.uint16, seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


def opened(frame):
    return rawpy.imread(BytesIO(dng_bytes(frame)))


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", [(40, 60), (41, 61), (22, 23)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_counts_pattern_and_levels_come_back(pattern, shape, dtype):
    frame = Mosaic(counts(shape, dtype), pattern, LEVELS, 250.0)
    with opened(frame) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, frame.values)
        assert "".join("RGBG"[code] for code in raw.raw_pattern.ravel()) == pattern
        np.testing.assert_array_equal(np.array(raw.black_level_per_channel)[raw.raw_pattern], LEVELS)
        assert raw.white_level == 250


@given(st.integers(22, 70), st.integers(22, 70), st.sampled_from([*PATTERNS, "MONO"]), st.integers(1, 65535))
@settings(max_examples=30, deadline=None)
def test_any_frame_survives_the_way_through_a_file(tmp_path_factory, height, width, pattern, white):
    frame = Mosaic(counts((height, width), seed=white), pattern, np.zeros((2, 2)), float(white))
    path = tmp_path_factory.mktemp("dng") / "frame.dng"
    write_dng(path, frame)
    read = read_camera_raw(path)
    np.testing.assert_array_equal(read.values, frame.values)
    assert (read.pattern, read.white, read.orientation) == (pattern, white, 1)


def test_x_trans_comes_back(tmp_path):
    frame = Mosaic(counts((61, 75)), X_TRANS, np.full((6, 6), 256.0), 60000.0)
    write_dng(tmp_path / "frame.dng", frame)
    read = read_camera_raw(tmp_path / "frame.dng")
    np.testing.assert_array_equal(read.values, frame.values)
    assert (read.pattern, read.white) == (X_TRANS, 60000)
    np.testing.assert_array_equal(read.black, 256)


def test_white_balance_colour_orientation_and_capture_come_back(tmp_path):
    capture = Capture("Acme", "Model 1", 1 / 8000, 12800, 2.8, 52.5)
    frame = Mosaic(counts((40, 60)), "GBRG", LEVELS, 60000.0, np.array([2.25, 1.0, 1.5]), EOS_6D, 6, capture)
    write_dng(tmp_path / "frame.dng", frame)
    read = read_camera_raw(tmp_path / "frame.dng")
    np.testing.assert_allclose(read.camera_gains, frame.camera_gains, rtol=1e-5)  # LibRaw keeps float32
    # LibRaw gives the inverse in float32, by way of a matrix known to 6 digits
    np.testing.assert_allclose(read.camera_M_xyz, EOS_6D, atol=1e-4)
    assert read.orientation == 6
    assert vars(read.capture) == vars(capture)


def test_libraw_finds_the_capture_where_other_programs_look_for_it():
    capture = Capture("Acme", "Model 1", 1 / 250, 400, 5.6, 50)
    with opened(Mosaic(counts((40, 60)), "RGGB", LEVELS, 60000.0, capture=capture)) as raw:
        found = raw.other
        assert found.iso_speed == 400
        assert (found.shutter_speed, found.aperture, found.focal_length) == pytest.approx((1 / 250, 5.6, 50), rel=1e-6)


@pytest.mark.parametrize("place", [0, 3])
def test_white_balance_is_kept_up_to_a_common_factor(tmp_path, place):
    gains = np.roll([0.5, 2.0, 0.125], place)
    write_dng(tmp_path / "frame.dng", Mosaic(counts((40, 60)), "RGGB", LEVELS, 60000.0, gains))
    read = read_camera_raw(tmp_path / "frame.dng").camera_gains
    np.testing.assert_allclose(read / read.min(), gains / gains.min(), rtol=1e-5)  # float32, rationals of 1e-6


def test_the_same_frame_gives_the_same_bytes():
    frame = Mosaic(counts((40, 60)), "RGGB", LEVELS, 60000.0)
    assert dng_bytes(frame) == dng_bytes(frame)


def test_a_model_beyond_ascii_is_written_with_question_marks(tmp_path):
    frame = Mosaic(counts((40, 60)), "RGGB", LEVELS, 60000.0, capture=Capture("Ümlaut", "日本"))
    write_dng(tmp_path / "frame.dng", frame)
    assert read_camera_raw(tmp_path / "frame.dng").capture.make == "?mlaut"


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (Mosaic(np.zeros((40, 60), np.float32), "RGGB", LEVELS, 60000.0), "floating point; give --depth 16"),
        (Mosaic(counts((40, 60)), "RGGB", LEVELS - 11, 60000.0), "black level below 0, found -1"),
    ],
)
def test_what_a_dng_cannot_hold_is_refused(frame, words):
    with pytest.raises(InvalidInput, match=words):
        dng_bytes(frame)


def test_a_file_that_cannot_be_written_is_a_file_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileError):
        write_dng(tmp_path / "file" / "frame.dng", Mosaic(counts((40, 60)), "RGGB", LEVELS, 60000.0))
