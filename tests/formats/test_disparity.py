"""Disparity maps as people have them: textbook 8-bit images, KITTI's 16-bit, PFM, float TIFF, NumPy arrays."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from camcal.errors import FileError, InvalidInput
from camcal.formats import disparity, disparity_sidecar
from camcal.formats.disparity_sidecar import Sidecar

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
    cv2.imwrite(str(tmp_path / "colour.png"), np.arange(12, dtype=np.uint8).reshape(2, 2, 3))
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


FLOATING = [".pfm", ".tiff", ".tif", ".npy", ".npz", ".exr"]
ANY_FLOAT = st.floats(width=32, allow_nan=True, allow_infinity=True)
SHAPES = st.tuples(st.integers(1, 6), st.integers(1, 6))


@pytest.mark.parametrize("suffix", FLOATING)
@settings(max_examples=15)
@given(values=arrays.arrays(np.float32, SHAPES, elements=ANY_FLOAT))
def test_floating_point_formats_hold_every_number_and_one_code_of_no_match(tmp_path_factory, suffix, values):
    path = tmp_path_factory.mktemp("map") / f"map{suffix}"
    written = disparity.write(path, values)
    assert written == disparity.Written(1.0, "inf" if suffix == ".pfm" else "nan")
    known = np.isfinite(values)
    found = disparity.read(path)
    np.testing.assert_array_equal(found.values[known], values[known])
    assert set(map(str, found.values[~known])) <= {written.invalid}
    np.testing.assert_array_equal(
        disparity.read(path, invalid=written.invalid).matched(), np.where(known, values, np.nan)
    )


@settings(max_examples=15)
@given(values=arrays.arrays(np.float32, SHAPES, elements=st.floats(0, 65535, width=32) | st.just(np.nan)))
def test_a_png_holds_half_a_count_and_keeps_every_match(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("map") / "map.png"
    written = disparity.write(path, values)
    found = disparity.read(path, written.scale).matched()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(values))
    counted = values >= 0.5 / written.scale  # what is smaller is coded 1, since 0 would say that there is no match
    error = np.abs(found - values)
    assert np.all(error[counted] <= 0.5 / written.scale * (1 + 1e-5))  # float32 of 65535 / 1
    assert np.all(error[~counted & ~np.isnan(values)] <= 1 / written.scale)


def test_a_png_has_the_resolution_that_kitti_promises(tmp_path):
    values = np.linspace(0.01, 255.99, 5000, dtype=np.float32).reshape(50, 100)
    assert disparity.write(tmp_path / "map.png", values) == disparity.Written(256.0, "0")
    np.testing.assert_allclose(disparity.read(tmp_path / "map.png").values, values, atol=1 / 512 + 1e-5)  # float32


@pytest.mark.parametrize(("largest", "scale"), [(255.998, 256), (256.0, 128), (600.0, 64), (65535.0, 1)])
def test_disparities_too_large_for_kitti_are_written_coarser_and_it_is_said(tmp_path, largest, scale):
    written = disparity.write(tmp_path / "map.png", np.array([[1, largest]], np.float32))
    assert written.scale == scale
    assert [dict(warning.values)["scale"] for warning in written.warnings] == [scale] * (scale != 256)
    np.testing.assert_allclose(disparity.read(tmp_path / "map.png", written.scale).values[0, 1], largest, rtol=1e-5)


@pytest.mark.parametrize(
    ("values", "scale", "message"),
    [
        ([[-0.5]], None, "cannot store -0.50 px"),
        ([[70000.0]], None, "cannot store 70000"),
        ([[300.0]], 256.0, "300.00 px"),
    ],
)
def test_what_a_png_cannot_hold_is_refused(tmp_path, values, scale, message):
    with pytest.raises(InvalidInput, match=message):
        disparity.write(tmp_path / "map.png", np.array(values, np.float32), scale=scale)
    assert not (tmp_path / "map.png").exists()


def test_a_map_without_a_match_is_readable(tmp_path):
    for suffix in disparity.SUFFIXES:
        disparity.write(tmp_path / f"map{suffix}", np.full((2, 3), np.nan, np.float32))
        assert np.isnan(disparity.read(tmp_path / f"map{suffix}").matched()).all()


@pytest.mark.parametrize("name", ["map.jpg", "map"])
def test_a_format_that_cannot_hold_disparities_is_refused(tmp_path, name):
    with pytest.raises(InvalidInput, match=r"disparity maps are \.pfm"):
        disparity.write(tmp_path / name, VALUES)


def test_a_scale_is_refused_where_pixels_are_written_as_they_are(tmp_path):
    with pytest.raises(InvalidInput, match=r"is for \.png"):
        disparity.write(tmp_path / "map.pfm", VALUES, scale=16.0)


@pytest.mark.parametrize("suffix", [".npy", ".tiff"])
def test_what_opencv_matchers_give_is_in_sixteenths_and_negative_without_a_match(tmp_path, suffix):
    path = tmp_path / f"sgbm{suffix}"
    counts = np.array([[-16, 160, 8]], np.int16)
    np.save(path, counts) if suffix == ".npy" else cv2.imwrite(str(path), counts)
    found = disparity.read(path)
    assert found.scale == 16
    np.testing.assert_array_equal(found.matched(), [[np.nan, 10, 0.5]])


def test_a_gray_map_saved_in_colour_is_read(tmp_path):
    cv2.imwrite(str(tmp_path / "venus.png"), np.repeat(np.uint8([[0, 8, 16]])[..., None], 3, axis=2))
    np.testing.assert_array_equal(disparity.read(tmp_path / "venus.png", 8.0).matched(), [[np.nan, 1, 2]])


def test_a_sidecar_tells_scale_and_code_unless_they_are_given(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, np.array([[-8, 0, 8, np.nan]], np.float32))
    disparity_sidecar.write(path, Sidecar(scale=4.0, invalid="nan"))
    np.testing.assert_array_equal(disparity.read(path).matched(), [[-2, 0, 2, np.nan]])
    np.testing.assert_array_equal(disparity.read(path, 8.0).matched(), [[-1, 0, 1, np.nan]])
    np.testing.assert_array_equal(disparity.read(path, invalid="0").matched(), [[np.nan, np.nan, 2, np.nan]])


def test_without_a_sidecar_what_is_not_positive_is_no_match(tmp_path):
    np.save(tmp_path / "map.npy", np.array([[-1, 0, np.nan, np.inf, 0.25]], np.float32))
    np.testing.assert_array_equal(disparity.read(tmp_path / "map.npy").matched(), [[np.nan] * 4 + [0.25]])


def test_an_unknown_code_is_refused(tmp_path):
    np.save(tmp_path / "map.npy", VALUES)
    with pytest.raises(InvalidInput, match="'-1'"):
        disparity.read(tmp_path / "map.npy", invalid="-1")


@pytest.mark.parametrize("names", [["arr_0"], ["depth", "disparity"]])
def test_an_archive_gives_its_only_array_or_the_one_named_disparity(tmp_path, names):
    np.savez(tmp_path / "map.npz", **{name: np.ones(3) if name == "depth" else VALUES for name in names})
    np.testing.assert_array_equal(disparity.read(tmp_path / "map.npz").values, VALUES)


def test_an_archive_of_other_arrays_is_refused_with_their_names(tmp_path):
    np.savez(tmp_path / "map.npz", left=VALUES, right=VALUES)
    with pytest.raises(InvalidInput, match="left, right"):
        disparity.read(tmp_path / "map.npz")


@pytest.mark.parametrize("suffix", [".npz", ".tiff", ".npy", ".exr", ".png"])
def test_files_cut_off_are_file_errors(tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    disparity.write(path, np.ones((20, 30), np.float32))
    content = path.read_bytes()
    for length in range(1, len(content) * 9 // 10, len(content) // 7):  # the end of a TIFF can be spared
        path.write_bytes(content[:length])
        with pytest.raises(FileError, match=r"map\."):
            disparity.read(path)


@pytest.mark.parametrize("suffix", disparity.SUFFIXES)
def test_the_same_map_gives_the_same_bytes(tmp_path, suffix):
    contents = set()
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        disparity.write(tmp_path / name / f"map{suffix}", np.abs(np.where(np.isfinite(VALUES), VALUES, np.nan)))
        contents.add((tmp_path / name / f"map{suffix}").read_bytes())
    assert len(contents) == 1


@pytest.mark.parametrize(
    ("invalid", "searched", "signed"), [("nan", (-4, 8), True), ("nan", (0, 8), False), ("0", (-4, 8), False)]
)
def test_a_map_is_signed_if_less_than_zero_was_looked_for_and_is_no_code(invalid, searched, signed):
    sidecar = disparity_sidecar.Sidecar(searched=searched)
    assert disparity.DisparityMap(np.ones((1, 1)), 1.0, invalid, sidecar).signed == signed
    assert not disparity.DisparityMap(np.ones((1, 1)), 1.0, invalid).signed
