"""Photographs by cameras: levels, facts of the capture, and files that are damaged."""

import shutil

import numpy as np
import pytest

from camcal.errors import FileError
from camcal.raw.demosaic import demosaic_with_libraw
from camcal.raw.dng import write_dng
from camcal.raw.frame_facts import channel_facts
from camcal.raw.mosaic import sites
from camcal.raw.reading import read_camera_raw

BLACK_LEVEL = b"\x1a\xc6\x04\0\x01\0\0\0"  # the entry of one long number, little endian


@pytest.fixture
def chart(real_data):
    return real_data / "raw" / "tinydng-colorchart" / "colorchart.dng"


@pytest.fixture
def kodak(real_data):
    return next((real_data / "raw" / "rawpy-kodak-dc50").glob("*.KDC"))


def test_the_matrix_of_a_dng_is_the_one_in_its_tag(chart):
    stated = np.array([[6461, -1164, -857], [-3825, 11597, 2534], [-416, 1540, 6039]]) / 10000  # ColorMatrix1
    # LibRaw gives the inverse in float32, by way of a matrix known to 6 digits
    np.testing.assert_allclose(read_camera_raw(chart).camera_M_xyz, stated, atol=1e-4)


def test_masked_columns_give_the_black_level_that_the_maker_states(chart, tmp_path):
    content = bytearray(chart.read_bytes())
    place = content.index(BLACK_LEVEL)
    content[place : place + 2] = b"\x60\xc6"  # a tag that nobody reads
    (tmp_path / "chart.dng").write_bytes(content)
    black = read_camera_raw(tmp_path / "chart.dng").black
    np.testing.assert_allclose(black, 2056, atol=10)  # the read noise is 17 counts; the maker's level is the sensor's


def test_the_capture_of_a_photograph_is_read(kodak, chart):
    capture = read_camera_raw(kodak).capture
    assert (capture.make, capture.iso, capture.f_number, capture.focal_mm) == ("Eastman Kodak Company", 84, 6.2, 37)
    assert capture.exposure_s == pytest.approx(0.00435)
    silent = read_camera_raw(chart).capture
    assert (silent.model, silent.exposure_s, silent.iso) == ("Canon EOS Kiss X4", None, None)


def test_counts_of_eight_bits_behind_a_curve_are_made_linear_with_a_white_level_that_fits(kodak):
    frame = read_camera_raw(kodak)
    assert frame.white == frame.values.max() == 16383
    assert all(facts.at_white < 1e-4 for facts in channel_facts(frame))


def test_a_photograph_survives_the_way_through_our_own_dng(chart, tmp_path):
    frame = read_camera_raw(chart)
    write_dng(tmp_path / "copy.dng", frame)
    copy = read_camera_raw(tmp_path / "copy.dng")
    np.testing.assert_array_equal(copy.values, frame.values)
    np.testing.assert_array_equal(copy.black, frame.black)
    assert (copy.pattern, copy.white, copy.capture.model) == (frame.pattern, frame.white, frame.capture.model)
    gains = frame.camera_gains / frame.camera_gains.min()
    np.testing.assert_allclose(copy.camera_gains / copy.camera_gains.min(), gains, rtol=1e-5)  # rationals of 1e-6
    np.testing.assert_allclose(copy.camera_M_xyz, frame.camera_M_xyz, atol=1e-4)


def test_a_photograph_keeps_its_samples_in_libraws_filters(chart):
    values = read_camera_raw(chart).values[:301, :401]
    image = demosaic_with_libraw(values, "RGGB", "AHD")
    for channel, colour in enumerate("BGR"):
        for site in sites("RGGB", colour):
            np.testing.assert_array_equal(image[..., channel][site], values[site])


@pytest.mark.parametrize("share", [0.00001, 0.0001, 0.001, 0.2, 0.5, 0.99, 0.9999])
@pytest.mark.parametrize("name", ["chart", "kodak"])
def test_a_photograph_that_is_cut_off_is_a_file_error(request, tmp_path, capfd, name, share):
    source = request.getfixturevalue(name)
    path = tmp_path / f"short{source.suffix}"
    shutil.copyfile(source, path)
    with path.open("r+b") as stream:
        stream.truncate(max(4, int(share * source.stat().st_size)))
    with pytest.raises(FileError, match="truncated: refers to data beyond its"):
        read_camera_raw(path)
    assert capfd.readouterr() == ("", "")
