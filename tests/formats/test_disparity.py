"""Disparity maps as people have them: textbook 8-bit images, KITTI's 16-bit, PFM, float TIFF, NumPy arrays."""

import cv2
import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import disparity

VALUES = np.array([[0.5, 17.25, np.inf], [64.0, np.nan, -1.0]], np.float32)


def write_pfm(path, values, header=b"Pf\n3 2\n-1.0\n", order="<f4"):
    path.write_bytes(header + values[::-1].astype(order).tobytes())


@pytest.mark.parametrize(("dtype", "scale"), [(np.uint8, 1.0), (np.uint16, 256.0)])
@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_the_scale_follows_from_the_depth_and_is_told(tmp_path, dtype, scale, suffix):
    path = tmp_path / f"disparity{suffix}"
    counts = np.array([[0, 7, 200]], dtype)
    np.save(path, counts) if suffix == ".npy" else cv2.imwrite(str(path), counts)
    found = disparity.read(path)
    assert found.scale == scale
    np.testing.assert_array_equal(found.values, counts / np.float32(scale))
    assert found.values.dtype == np.float32


def test_a_given_scale_wins(tmp_path):
    cv2.imwrite(str(tmp_path / "disparity.png"), np.array([[160, 8]], np.uint16))
    np.testing.assert_array_equal(disparity.read(tmp_path / "disparity.png", 16.0).values, [[10, 0.5]])


@pytest.mark.parametrize("suffix", [".tiff", ".npy"])
def test_floating_point_comes_back_with_its_invalid_codes(tmp_path, suffix):
    path = tmp_path / f"disparity{suffix}"
    np.save(path, VALUES) if suffix == ".npy" else cv2.imwrite(str(path), VALUES)
    np.testing.assert_array_equal(disparity.read(path).values, VALUES)


@pytest.mark.parametrize(
    ("header", "order"),
    [
        (b"Pf\n3 2\n-1.0\n", "<f4"),
        (b"Pf\n3 2\n1.0\n", ">f4"),
        (b"Pf 3 2 -0.003922\n", "<f4"),
        (b"Pf\n3 2\n-1e0\n", "<f4"),
    ],
)
def test_pfm_is_read_from_the_bottom_up_and_its_number_only_tells_the_byte_order(tmp_path, header, order):
    write_pfm(tmp_path / "disparity.pfm", VALUES, header, order)
    np.testing.assert_array_equal(disparity.read(tmp_path / "disparity.pfm").values, VALUES)


@pytest.mark.parametrize("header", [b"PF\n3 2\n-1.0\n", b"Pf\n3 2\n", b"P5\n3 2\n255\n"])
def test_what_is_no_gray_pfm_is_a_file_error(tmp_path, header):
    write_pfm(tmp_path / "disparity.pfm", VALUES, header)
    with pytest.raises(FileError, match=r"disparity\.pfm"):
        disparity.read(tmp_path / "disparity.pfm")


def test_a_truncated_pfm_says_how_much_is_missing(tmp_path):
    write_pfm(tmp_path / "disparity.pfm", VALUES, b"Pf\n3 3\n-1.0\n")
    with pytest.raises(FileError, match="take 36 bytes, found 24"):
        disparity.read(tmp_path / "disparity.pfm")


def test_a_colour_image_is_not_a_disparity_map(tmp_path):
    cv2.imwrite(str(tmp_path / "colour.png"), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(InvalidInput, match=r"\(2, 2, 3\)"):
        disparity.read(tmp_path / "colour.png")


def test_an_empty_array_is_not_a_disparity_map(tmp_path):
    np.save(tmp_path / "empty.npy", np.zeros((0, 4)))
    with pytest.raises(InvalidInput, match=r"\(0, 4\)"):
        disparity.read(tmp_path / "empty.npy")


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan])
def test_a_scale_that_cannot_be_is_refused(tmp_path, scale):
    np.save(tmp_path / "disparity.npy", VALUES)
    with pytest.raises(InvalidInput, match="scale"):
        disparity.read(tmp_path / "disparity.npy", scale)
