"""What is read of JPEG and PNG files without decoding them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.images import exif
from camcal.images.exif import insert_exif, read_jpeg, read_png_exif

PICTURE = np.random.default_rng(1).integers(0, 255, (30, 40, 3), dtype=np.uint8)
BLOCK = exif.with_orientation(b"", 6)


def encoded(suffix, picture=PICTURE, parameters=()):
    return cv2.imencode(suffix, picture, list(parameters))[1].tobytes()


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize(("picture", "channels"), [(PICTURE, 3), (PICTURE[:, :, 0], 1)])
def test_size_and_channels_of_a_jpeg_are_read(progressive, picture, channels):
    header = read_jpeg(encoded(".jpg", picture, (cv2.IMWRITE_JPEG_PROGRESSIVE, progressive)))
    assert (header.size, header.channels, header.exif, header.complete) == ((40, 30), channels, b"", True)


def test_a_jpeg_is_cut_off_although_its_thumbnail_is_whole():
    thumbnail = encoded(".jpg", PICTURE[:8, :8])
    content = insert_exif(encoded(".jpg"), BLOCK + thumbnail)
    assert read_jpeg(content).complete
    assert thumbnail in read_jpeg(content).exif
    for length in (len(content) - 1, len(content) * 2 // 3, len(thumbnail) + 60, 20, 3):
        assert not read_jpeg(content[:length]).complete


def test_bytes_behind_the_end_of_a_jpeg_do_not_matter():
    assert read_jpeg(encoded(".jpg") + b"\0" * 1000).complete


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_an_exif_block_is_found_again_and_pixels_stay(suffix):
    content = insert_exif(encoded(suffix), BLOCK)
    found = read_jpeg(content).exif if suffix == ".jpg" else read_png_exif(content)
    assert found == BLOCK
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    before, after = (cv2.imdecode(np.frombuffer(file, np.uint8), flags) for file in (encoded(suffix), content))
    np.testing.assert_array_equal(after, before)


def test_a_png_without_exif_has_none():
    assert read_png_exif(encoded(".png")) == b""


@given(st.binary(max_size=300), st.integers(0, 700))
def test_no_bytes_whatever_are_a_traceback(noise, length):
    for whole in (encoded(".jpg"), insert_exif(encoded(".jpg"), BLOCK)):
        read_jpeg(whole[:length] + noise)
    assert isinstance(read_png_exif(encoded(".png")[:length] + noise), bytes)
