"""Camera raw files that we write as DNG ourselves, read through LibRaw; photographs by cameras are in tests/real.

This does not prove that LibRaw reads any maker's format.
"""

import struct

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.raw.dng import dng_bytes
from camcal.raw.mosaic import Capture, Mosaic, is_x_trans
from camcal.raw.reading import pattern_of, read_camera_raw

X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"
ACTIVE_AREA, BLACK_LEVEL, PHOTOMETRIC, SAMPLES = 0xC68D, 0xC61A, 0x0106, 0x0115
LEFT = 40  # columns left of the image


def written(path, content):
    path.write_bytes(content)
    return path


def entry_of(content, tag):
    """Where the entry of a tag begins in the first directory."""
    (count,) = struct.unpack_from("<H", content, 8)
    places = range(10, 10 + 12 * count, 12)
    return next(place for place in places if struct.unpack_from("<H", content, place) == (tag,))


def with_active_area(frame, top, left, bottom, right):
    """The frame as a DNG file of which only a part is the image; the area takes the place of the make."""
    content = bytearray(dng_bytes(frame))
    place = entry_of(content, 0x010F)
    area = len(content)
    entries = bytes(content[10:place] + content[place + 12 :])
    (count,) = struct.unpack_from("<H", content, 8)
    rest = entries[: 12 * (count - 1)]
    new = struct.pack("<HHII", ACTIVE_AREA, 4, 4, area)
    ordered = sorted([*(rest[i : i + 12] for i in range(0, len(rest), 12)), new], key=lambda e: e[:2][::-1])
    content[10 : 10 + 12 * count] = b"".join(ordered)
    return bytes(content) + struct.pack("<4I", top, left, bottom, right)


def noise(shape, mean=500, seed=0):
    return np.random.default_rng(seed).normal(mean, 4, shape).astype(np.uint16)


def frame(pattern="RGGB", black=0.0, shape=(60, 100), **known):
    side = 6 if is_x_trans(pattern) else 2
    return Mosaic(noise(shape), pattern, np.full((side, side), black), 4095.0, **known)


def test_the_second_green_of_a_camera_file_is_green():
    assert pattern_of(np.array([[0, 1], [3, 2]]), b"RGBG") == "RGGB"
    assert pattern_of(np.array([[1, 0], [2, 3]]), b"RGBG") == "GRBG"


def test_an_x_trans_cell_becomes_thirty_six_letters():
    codes = np.reshape(["RGB".index(letter) for letter in X_TRANS], (6, 6))
    assert pattern_of(codes, b"RGBG") == X_TRANS


@pytest.mark.parametrize(
    ("codes", "letters", "words"),
    [
        (np.array([[0, 1], [3, 2]]), b"CYMG", "C, G, M, Y"),
        (np.array([[0, 1], [3, 2]]), b"RGBE", "B, E, G, R"),
        (np.array([[0, 1], [2, 2]]), b"RGBG", "RGBB"),
        (np.zeros((16, 16), int), b"RGBG", "16 × 16"),
        (None, b"RGBG", "no colour filter"),
    ],
)
def test_a_filter_of_other_colours_or_another_cell_is_refused(codes, letters, words):
    with pytest.raises(InvalidInput, match=words):
        pattern_of(codes, letters)


def test_an_x_trans_frame_is_read_with_a_level_for_each_place_of_its_cell(tmp_path):
    given = frame(X_TRANS, black=64)
    read = read_camera_raw(written(tmp_path / "x.dng", dng_bytes(given)))
    assert read.pattern == X_TRANS
    np.testing.assert_array_equal(read.black, given.black)
    np.testing.assert_array_equal(read.values, given.values)


@pytest.mark.parametrize(("top", "left"), [(0, 0), (2, 4), (4, 9), (7, 5)])
def test_the_pattern_of_x_trans_is_that_of_the_image_and_not_of_the_margins(tmp_path, top, left):
    given = frame(X_TRANS)
    content = with_active_area(given, top, left, 55, 95)
    read = read_camera_raw(written(tmp_path / "x.dng", content))
    np.testing.assert_array_equal(read.values, given.values[top:55, left:95])
    assert read.pattern == X_TRANS  # which DNG counts from the corner of the image, too


def test_a_sensor_without_filter_is_monochrome(tmp_path):
    given = frame("MONO", black=16)
    read = read_camera_raw(written(tmp_path / "mono.dng", dng_bytes(given)))
    assert (read.pattern, read.white, read.camera_gains, read.camera_M_xyz) == ("MONO", 4095, None, None)
    np.testing.assert_array_equal(read.black, given.black)
    np.testing.assert_array_equal(read.values, given.values)


def masked(light):
    """A frame whose left columns see no light; its counts without light differ from place to place of the cell."""
    values = noise((120, 200), mean=100)
    values[1::2] += 20
    values[:, LEFT:] += light.astype(np.uint16)
    return Mosaic(values, "GRBG", np.zeros((2, 2)), 16383.0)


def test_without_a_black_level_the_masked_columns_tell_it(tmp_path):
    light = np.random.default_rng(1).uniform(0, 9000, (120, 160))
    content = with_active_area(masked(light), 0, LEFT, 120, 200)
    read = read_camera_raw(written(tmp_path / "masked.dng", content))
    np.testing.assert_allclose(read.black, [[100, 100], [120, 120]], atol=1)  # medians of 1000 samples, σ 4


def test_columns_that_see_the_light_are_not_taken_for_masked_ones(tmp_path):
    values = noise((120, 200), mean=3000)
    content = with_active_area(Mosaic(values, "GRBG", np.zeros((2, 2)), 16383.0), 0, LEFT, 120, 200)
    read = read_camera_raw(written(tmp_path / "open.dng", content))
    np.testing.assert_array_equal(read.black, 0)


def test_a_black_level_in_the_file_comes_first(tmp_path):
    given = masked(np.full((120, 160), 5000))
    content = with_active_area(Mosaic(given.values, "GRBG", np.full((2, 2), 90.0), 16383.0), 0, LEFT, 120, 200)
    read = read_camera_raw(written(tmp_path / "stated.dng", content))
    np.testing.assert_array_equal(read.black, 90)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_is_noted_and_not_applied(tmp_path, orientation):
    read = read_camera_raw(written(tmp_path / "turned.dng", dng_bytes(frame(orientation=orientation))))
    assert (read.orientation, read.size) == (orientation, (100, 60))


def test_what_the_file_does_not_say_is_unknown(tmp_path):
    read = read_camera_raw(written(tmp_path / "bare.dng", dng_bytes(frame())))
    assert read.camera_gains is None
    assert vars(read.capture) == vars(Capture("camcal", "camcal"))  # the specification demands a make and a model


def test_full_colour_is_no_mosaic(tmp_path):
    content = bytearray(dng_bytes(frame("MONO", shape=(60, 99))))
    width, samples, bits = (entry_of(content, tag) for tag in (0x0100, SAMPLES, 0x0102))
    struct.pack_into("<I", content, width + 8, 33)
    struct.pack_into("<H", content, samples + 8, 3)
    assert struct.unpack_from("<H", content, bits + 8) == (16,)
    with pytest.raises(InvalidInput, match=r"full colour in every pixel.*: it is demosaiced already; export it"):
        read_camera_raw(written(tmp_path / "linear.dng", content))


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 0.5, 0.999])
def test_a_file_that_is_cut_off_is_a_file_error_and_nothing_else_is_printed(tmp_path, capfd, share):
    content = dng_bytes(frame())
    path = written(tmp_path / "short.dng", content[: int(share * len(content))])
    with pytest.raises(FileError, match=r"short\.dng: truncated: .*\d+ bytes"):
        read_camera_raw(path)
    assert capfd.readouterr() == ("", "")  # LibRaw complains on its own when it meets the end


@pytest.mark.parametrize("content", [b"not an image at all", b"II*", b"\x89PNG\r\n\x1a\n" + bytes(99)])
def test_a_file_of_another_kind_is_a_file_error(tmp_path, content):
    with pytest.raises(FileError, match="not a readable camera raw file"):
        read_camera_raw(written(tmp_path / "other.dng", content))
