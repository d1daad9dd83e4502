"""Writing images: what is written is read again, the orientation is there once, nothing is left half."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from camcal.errors import FileError, InvalidInput
from camcal.images.exif import read_jpeg
from camcal.images.files import KINDS, load, save
from camcal.images.image import Image

ORIENTATION = 0x0112


def picture(dtype, channels):
    shape = (30, 40) if channels == 1 else (30, 40, channels)
    rng = np.random.default_rng(3)
    return rng.random(shape, np.float32) if dtype == "float32" else rng.integers(0, 255, shape).astype(dtype)


CASES = [(suffix, dtype, n) for suffix, kind in KINDS.items() for dtype in kind.dtypes for n in kind.channels]


@pytest.mark.parametrize(("suffix", "dtype", "channels"), CASES)
def test_what_is_written_is_read_again(tmp_path, suffix, dtype, channels):
    pixels = picture(dtype, channels)
    save(tmp_path / f"image{suffix}", pixels)
    found = load(tmp_path / f"image{suffix}").pixels
    assert (found.dtype, found.shape) == (pixels.dtype, pixels.shape)
    if suffix not in (".jpg", ".jpeg"):
        np.testing.assert_array_equal(found, pixels)


@pytest.mark.parametrize("suffix", [suffix for suffix, kind in KINDS.items() if kind.oriented])
@pytest.mark.parametrize("orientation", [1, 6, 8])
def test_the_orientation_is_kept(tmp_path, suffix, orientation):
    path = tmp_path / f"image{suffix}"
    save(path, Image(picture("uint8", 3), orientation))
    assert load(path).orientation == orientation
    found = Pillow.open(io.BytesIO(path.read_bytes()))
    assert found.getexif().get(ORIENTATION, 1) == orientation
    assert sorted(found.size) == [30, 40]  # Pillow turns the size of a TIFF


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_the_exif_block_goes_along_with_the_orientation_in_it_once(tmp_path, suffix):
    stream, tags = io.BytesIO(), Pillow.Exif()
    tags[ORIENTATION], tags[0x010F] = 6, "Maker"
    Pillow.new("RGB", (40, 30)).save(stream, "JPEG", exif=tags)
    (tmp_path / "source.jpg").write_bytes(stream.getvalue())
    source = load(tmp_path / "source.jpg")
    path = tmp_path / f"copy{suffix}"
    save(path, source)
    found = Pillow.open(io.BytesIO(path.read_bytes())).getexif()
    assert (found[ORIENTATION], found[0x010F]) == (6, "Maker")
    assert path.read_bytes().count(b"Exif\0\0" if suffix == ".jpg" else b"eXIf") == 1
    assert load(path).exif.count(b"\x01\x12\x00\x03") == 1  # the entry: tag 0x0112, type 3


def test_an_exif_block_too_long_for_jpeg_leaves_the_orientation(tmp_path):
    tags = Pillow.Exif()
    tags[0x010F] = "x" * 70000
    save(tmp_path / "image.jpg", Image(picture("uint8", 3), 6, tags.tobytes()[6:]))
    assert load(tmp_path / "image.jpg").orientation == 6
    assert len(read_jpeg((tmp_path / "image.jpg").read_bytes()).exif) < 100


def test_jpeg_is_written_with_the_quality_of_opencv_unless_told(tmp_path):
    pixels = picture("uint8", 3)
    save(tmp_path / "ours.jpg", pixels)
    cv2.imwrite(str(tmp_path / "theirs.jpg"), pixels)
    assert (tmp_path / "ours.jpg").read_bytes() == (tmp_path / "theirs.jpg").read_bytes()
    save(tmp_path / "small.jpg", pixels, quality=20)
    assert (tmp_path / "small.jpg").stat().st_size < (tmp_path / "ours.jpg").stat().st_size / 2


@pytest.mark.parametrize(
    ("name", "dtype", "channels", "advice"),
    [
        ("image.jpg", "float32", 3, "3 channels of float32; use one of .tif, .tiff, .npy"),
        ("image.jpg", "uint16", 1, "1 channel of uint16; use one of .png"),
        ("image.jpg", "uint8", 4, "4 channels of uint8; use one of .png"),
        ("image.xyz", "uint8", 3, ".xyz cannot hold"),
        ("image", "uint8", 3, "no suffix cannot hold"),
    ],
)
def test_a_type_that_cannot_hold_the_pixels_is_refused_with_those_that_can(tmp_path, name, dtype, channels, advice):
    with pytest.raises(InvalidInput) as refused:
        save(tmp_path / name, picture(dtype, channels))
    assert advice in str(refused.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("quality", [0, 101])
def test_a_quality_that_does_not_exist_is_refused(tmp_path, quality):
    with pytest.raises(InvalidInput, match="1 … 100"):
        save(tmp_path / "image.jpg", picture("uint8", 3), quality=quality)


def test_a_folder_that_cannot_be_written_is_a_file_error_and_the_old_image_stays(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(FileError):
        save(tmp_path / "file" / "image.png", picture("uint8", 3))
    save(tmp_path / "image.png", picture("uint8", 3))
    before = (tmp_path / "image.png").read_bytes()
    with pytest.raises(InvalidInput):
        save(tmp_path / "image.png", picture("float32", 3))
    assert (tmp_path / "image.png").read_bytes() == before
