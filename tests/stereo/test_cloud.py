"""Disparity to points: the formula against a projected scene, and what never becomes a point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.stereo.cloud import PointCloud, depth_map, make_cloud
from camcal.stereo.geometry import StereoGeometry

GEOMETRY = StereoGeometry(fx=700.0, fy=690.0, cx=3.5, cy=1.25, baseline=0.12)


def plane_disparity(geometry, shape=(5, 9), slope=(0.2, -0.1), distance=2.0):
    """Return the exact disparity (H, W) and points (H, W, 3) of the plane z = distance + slope · (X, Y)."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    x, y = (u - geometry.cx) / geometry.fx, (v - geometry.cy) / geometry.fy
    z = distance / (1 - slope[0] * x - slope[1] * y)
    return geometry.fx * geometry.baseline / z - geometry.doffs, np.stack([x * z, y * z, z], axis=-1)


@pytest.mark.parametrize("doffs", [0.0, 3.25, -7.5])
def test_the_points_of_a_slanted_plane_lie_where_they_were(doffs):
    geometry = StereoGeometry(700.0, 690.0, 3.5, 1.25, 0.12, doffs)
    disparity, points = plane_disparity(geometry)
    cloud = make_cloud(disparity, geometry)
    np.testing.assert_allclose(cloud.points, points.reshape(-1, 3), rtol=0, atol=2e-6)  # float32 at 2 m


def test_a_rectified_pair_sees_each_point_at_its_pixel_and_shifted_by_its_disparity():
    disparity = np.array([[0.5, 8.0, 42.0]])
    x, y, z = make_cloud(disparity, GEOMETRY).points.astype(float).T
    left = GEOMETRY.fx * x / z + GEOMETRY.cx
    right = GEOMETRY.fx * (x - GEOMETRY.baseline) / z + GEOMETRY.cx
    np.testing.assert_allclose(left, [0, 1, 2], atol=1e-5)  # float32 of a few pixels
    np.testing.assert_allclose(left - right, disparity[0], rtol=1e-6)
    np.testing.assert_allclose(GEOMETRY.fy * y / z + GEOMETRY.cy, 0, atol=1e-5)


@pytest.mark.parametrize("bad", [0.0, -0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("doffs", [0.0, 5.0])
def test_what_is_no_match_never_becomes_a_point(bad, doffs):
    geometry = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs)
    disparity = np.array([[bad, 10.0], [10.0, bad]], np.float32)
    assert np.isnan(depth_map(disparity, geometry)).tolist() == [[True, False], [False, True]]
    assert len(make_cloud(disparity, geometry).points) == 2


def test_a_depth_beyond_any_number_never_becomes_a_point():
    assert np.isnan(depth_map(np.array([[1e-45]], np.float32), GEOMETRY)).all()


def test_a_match_behind_the_cameras_never_becomes_a_point():
    geometry = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs=-10.0)
    assert len(make_cloud(np.array([[9.0, 10.0, 11.0]]), geometry).points) == 1


def test_whole_numbers_are_disparities_too():
    assert make_cloud(np.array([[0, 84]], np.uint8), GEOMETRY).points[0, 2] == pytest.approx(1.0)  # 700 · 0.12 / 84


def test_a_map_without_any_match_gives_an_empty_cloud():
    cloud = make_cloud(np.full((3, 4), np.nan), GEOMETRY, np.zeros((3, 4), np.uint8))
    assert (cloud.points.shape, cloud.colours.shape, cloud.intensity.shape) == ((0, 3), (0, 3), (0,))


@pytest.mark.parametrize("rows", [1, 31, 32, 33, 65])
def test_points_come_in_the_order_of_the_pixels_for_any_number_of_rows(rows):
    disparity = np.random.default_rng(rows).uniform(-1, 9, (rows, 3)).astype(np.float32)
    image = np.arange(rows * 3, dtype=np.uint16).reshape(rows, 3)
    cloud = make_cloud(disparity, GEOMETRY, image)
    np.testing.assert_array_equal(np.rint(cloud.intensity * 65535), image[disparity > 0])
    np.testing.assert_allclose(cloud.points[:, 2], 84 / disparity[disparity > 0], rtol=1e-6)  # float32


def test_depth_range_keeps_both_its_ends():
    disparity = np.array([[84.0, 42.0, 28.0, 21.0]])  # 1, 2, 3 and 4 m
    cloud = make_cloud(disparity, GEOMETRY, depth_range=(2.0, 3.0))
    np.testing.assert_allclose(cloud.points[:, 2], [2, 3])


def test_an_empty_depth_range_is_refused():
    with pytest.raises(InvalidInput, match="3 … 2 m"):
        make_cloud(np.ones((2, 2)), GEOMETRY, depth_range=(3.0, 2.0))


def test_colours_are_red_green_blue_of_the_pixel():
    image = np.array([[[1, 2, 3], [4, 5, 6]]], np.uint8)
    cloud = make_cloud(np.array([[np.nan, 5.0]]), GEOMETRY, image)
    np.testing.assert_array_equal(cloud.colours, [[6, 5, 4]])
    assert cloud.intensity is None


def test_alpha_is_left_out_of_the_colour():
    image = np.array([[[1, 2, 3, 200]]], np.uint8)
    np.testing.assert_array_equal(make_cloud(np.ones((1, 1)), GEOMETRY, image).colours, [[3, 2, 1]])


@pytest.mark.parametrize(("dtype", "peak"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1)])
def test_gray_is_a_colour_and_an_intensity(dtype, peak):
    image = (np.array([[0.0, 0.4, 1.0]]) * peak).astype(dtype)
    cloud = make_cloud(np.ones((1, 3)), GEOMETRY, image)
    np.testing.assert_array_equal(cloud.colours, [[0] * 3, [102] * 3, [255] * 3])
    np.testing.assert_allclose(cloud.intensity, [0, 0.4, 1], atol=1e-7)  # float32


def test_an_image_of_another_size_is_refused_with_both_sizes():
    with pytest.raises(InvalidInput, match="4 × 3, the disparity map 3 × 4"):
        make_cloud(np.ones((4, 3)), GEOMETRY, np.zeros((3, 4), np.uint8))


@pytest.mark.parametrize("name", ["fx", "fy", "baseline"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_geometry_that_cannot_be_is_refused(name, value):
    numbers = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "baseline": 1.0, name: value}
    with pytest.raises(InvalidInput, match=name):
        StereoGeometry(**numbers)


def test_the_arrays_of_a_cloud_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        PointCloud(np.zeros((2, 3))).points[0] = 1


@given(st.floats(1e-3, 1e4), st.floats(1.0, 1e5), st.floats(1e-3, 1e2), st.integers(0, 30), st.integers(0, 20))
def test_every_point_projects_back_to_its_pixel(disparity, focal, baseline, u, v):
    geometry = StereoGeometry(focal, 0.9 * focal, 12.5, 7.25, baseline)
    values = np.zeros((21, 31), np.float32)
    values[v, u] = disparity
    ((x, y, z),) = make_cloud(values, geometry).points.astype(float)
    pixel = (focal * x / z + 12.5, 0.9 * focal * y / z + 7.25)
    assert pixel == pytest.approx((u, v), abs=1e-5)  # float32: 3e-7 of at most 18 pixels
