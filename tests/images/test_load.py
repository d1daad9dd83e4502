"""Reading images: every type, every depth, and what is said of files that are none."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from camcal.errors import FileError, InvalidInput
from camcal.images import exif
from camcal.images.files import gray_8bit, load
from camcal.images.image import Image, Scratch


def pictures():
    rng = np.random.default_rng(2)
    return {
        "gray": rng.integers(0, 255, (30, 40), dtype=np.uint8),
        "colour": rng.integers(0, 255, (30, 40, 3), dtype=np.uint8),
        "alpha": rng.integers(0, 255, (30, 40, 4), dtype=np.uint8),
        "gray16": rng.integers(0, 65535, (30, 40), dtype=np.uint16),
        "colour16": rng.integers(0, 65535, (30, 40, 3), dtype=np.uint16),
        "alpha16": rng.integers(0, 65535, (30, 40, 4), dtype=np.uint16),
        "float": rng.normal(size=(30, 40)).astype(np.float32),
        "colour float": rng.normal(size=(30, 40, 3)).astype(np.float32),
    }


PICTURES = pictures()
GRAY, COLOUR = PICTURES["gray"], PICTURES["colour"]
HOLDS = {
    ".png": ["gray", "colour", "alpha", "gray16", "colour16", "alpha16"],
    ".tiff": list(PICTURES),
    ".npy": list(PICTURES),
    ".bmp": ["gray", "colour"],
    ".pgm": ["gray", "gray16"],
    ".ppm": ["colour", "colour16"],
    ".pfm": ["float", "colour float"],
}


def write(path, pixels):
    np.save(path, pixels) if path.suffix == ".npy" else cv2.imwrite(str(path), pixels)
    return path


def tiff(pixels, orientation):
    return exif.with_orientation(cv2.imencode(".tiff", pixels)[1].tobytes(), orientation)


def oriented(suffix, orientation, picture=COLOUR):
    """A file with an orientation tag, written by Pillow."""
    stream = io.BytesIO()
    tags = Pillow.Exif()
    tags[0x0112] = orientation
    kind = {".jpg": "JPEG", ".png": "PNG", ".tif": "TIFF"}[suffix]
    Pillow.fromarray(picture[..., ::-1]).save(stream, kind, exif=tags)
    return stream.getvalue()


@pytest.mark.parametrize(("suffix", "name"), [(suffix, name) for suffix, names in HOLDS.items() for name in names])
def test_pixels_come_as_the_file_holds_them(tmp_path, suffix, name):
    image = load(write(tmp_path / f"image{suffix}", PICTURES[name]))
    assert image.pixels.dtype == PICTURES[name].dtype
    np.testing.assert_array_equal(image.pixels, PICTURES[name])
    assert image.size == (40, 30)
    assert not image.pixels.flags.writeable


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_the_orientation_is_noted_and_not_applied(tmp_path, suffix, orientation):
    path = tmp_path / f"image{suffix}"
    path.write_bytes(oriented(suffix, 1))
    upright = load(path)
    path.write_bytes(oriented(suffix, orientation))
    image = load(path)
    assert (image.orientation, image.size) == (orientation, (40, 30))
    np.testing.assert_array_equal(image.pixels, upright.pixels)


@pytest.mark.parametrize("name", PICTURES)
def test_tiff_images_of_every_type_are_not_turned(tmp_path, name):
    path = tmp_path / "image.tiff"
    path.write_bytes(tiff(PICTURES[name], 6))
    np.testing.assert_array_equal(load(path).pixels, PICTURES[name])
    assert load(path).orientation == 6


@pytest.mark.parametrize("picture", [GRAY, COLOUR])
def test_scratch_memory_changes_no_pixel_and_is_used_again(tmp_path, picture):
    path, scratch = write(tmp_path / "image.jpg", picture), Scratch()
    image = load(path, scratch)
    np.testing.assert_array_equal(image.pixels, load(path).pixels)
    assert np.shares_memory(load(path, scratch).pixels, image.pixels)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff", ".bmp", ".pgm", ".webp", ".npy"])
@pytest.mark.parametrize("scratch", [None, Scratch()])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.98])
def test_a_file_that_is_cut_off_is_refused(tmp_path, suffix, scratch, share):
    path = write(tmp_path / f"image{suffix}", np.tile(GRAY, (5, 5)))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileError, match=f"image{suffix}: .*(truncated|readable|missing|exceed)"):
        load(path, scratch)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"", "is empty"),
        ("a.png", b"Dear diary, today", "unknown image format .begins with b'Dear dia'"),
        ("a.jpg", b"\xff\xd8\xff\xe0nonsense\xff\xd9", "damaged or truncated JPEG file: no frame header"),
        ("a.npy", b"\x93NUMPY", "not a readable NumPy array file"),
    ],
)
def test_what_is_no_image_is_refused_in_one_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match=words) as refused:
        load(tmp_path / name)
    assert "\n" not in str(refused.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        load(tmp_path / "none.png")
    with pytest.raises(FileError, match="is a folder"):
        load(tmp_path)


def test_a_camera_raw_file_is_sent_to_the_command_that_develops_it(tmp_path):
    with pytest.raises(InvalidInput, match=r"a\.DNG: .*camcal demosaic"):
        load(tmp_path / "a.DNG")


def test_an_array_that_is_no_image_is_refused(tmp_path):
    for pixels in (np.zeros((4, 5, 2), np.uint8), np.zeros(7, np.uint8), np.zeros((4, 5), np.int32)):
        with pytest.raises(FileError, match="an image is"):
            load(write(tmp_path / "image.npy", pixels))


def test_eight_bits_of_gray_stay_as_they_are(tmp_path):
    np.testing.assert_array_equal(gray_8bit(load(write(tmp_path / "image.png", GRAY)).pixels), GRAY)


@pytest.mark.parametrize("name", ["colour", "alpha"])
def test_colour_becomes_gray_by_the_weights_of_opencv(name):
    expected = PICTURES[name][..., :3] @ [0.114, 0.587, 0.299]
    np.testing.assert_allclose(gray_8bit(PICTURES[name]), expected, atol=0.51)  # rounded to whole levels


@pytest.mark.parametrize(("low", "high"), [(0, 4095), (100, 60000), (0.0, 1.0), (-1e-3, 1e-3)])
def test_sixteen_bits_and_floats_fill_the_eight_bits_whatever_their_range(low, high):
    dtype = np.uint16 if isinstance(high, int) else np.float32
    ramp = np.linspace(low, high, 40000).reshape(200, 200).astype(dtype)
    gray = gray_8bit(ramp)
    # 0.1 % are cut at either end, half a level is rounding
    np.testing.assert_allclose(gray, np.linspace(0, 255, 40000).reshape(200, 200), atol=0.9)


def test_a_few_hot_pixels_and_nan_do_not_darken_the_image():
    ramp = np.linspace(0, 1, 40000, dtype=np.float32).reshape(200, 200)
    ramp[3, :5] = 1e9, -1e9, np.nan, np.inf, -np.inf
    gray = gray_8bit(ramp)
    assert gray[3, :5].tolist() == [255, 0, 0, 255, 0]
    np.testing.assert_allclose(gray[10:], 255 * ramp[10:], atol=0.9)  # 0.1 % cut at either end, rounding


def test_a_flat_image_is_no_division_by_zero():
    assert gray_8bit(np.full((4, 5), 700, np.uint16)).max() == 0
    assert gray_8bit(np.full((4, 5), np.nan, np.float32)).max() == 0


def test_an_image_record_refuses_what_is_no_image():
    for pixels in (np.zeros((4, 5, 2), np.uint8), np.zeros((4, 5), bool), np.zeros((0, 5), np.uint8)):
        with pytest.raises(InvalidInput, match="an image is"):
            Image(pixels)
    with pytest.raises(InvalidInput, match="orientation"):
        Image(GRAY, 9)
    assert Image(GRAY[:, :, None]).pixels.shape == (30, 40)
