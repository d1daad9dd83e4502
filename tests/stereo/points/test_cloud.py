"""Disparity to vertices: the formula against a projected scene, what never becomes a point, and what a vertex holds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.stereo.cloud import CloudMaker, thinned
from camcal.stereo.depth import Frame, StereoImage
from camcal.stereo.depth_error import CalibrationError
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.selection import Selection, depth_figures, select

GEOMETRY = StereoGeometry(fx=700.0, fy=690.0, cx=3.5, cy=1.25, baseline=0.12)
ALL = Selection(outliers="none")


def vertices(image, selection=ALL, frame=None, **kwargs):
    frame = frame or Frame()
    stream = CloudMaker(image, select(image, selection, frame).kept, frame, **kwargs).stream()
    found = np.concatenate(list(stream.blocks))
    assert len(found) == stream.count
    assert found.dtype == stream.type
    return found


def xyz(found):
    return np.stack([found[name] for name in "xyz"], axis=-1).astype(float)


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
    found = vertices(StereoImage(disparity, geometry))
    np.testing.assert_allclose(xyz(found), points.reshape(-1, 3), rtol=0, atol=2e-6)  # float32 at 2 m


def test_a_rectified_pair_sees_each_point_at_its_pixel_and_shifted_by_its_disparity():
    disparity = np.array([[0.5, 8.0, 42.0]])
    x, y, z = xyz(vertices(StereoImage(disparity, GEOMETRY))).T
    left = GEOMETRY.fx * x / z + GEOMETRY.cx
    right = GEOMETRY.fx * (x - GEOMETRY.baseline) / z + GEOMETRY.cx
    np.testing.assert_allclose(left, [0, 1, 2], atol=1e-5)  # float32 of a few pixels
    np.testing.assert_allclose(left - right, disparity[0], rtol=1e-6)
    np.testing.assert_allclose(GEOMETRY.fy * y / z + GEOMETRY.cy, 0, atol=1e-5)


@given(st.floats(1e-3, 1e4), st.floats(1.0, 1e5), st.floats(1e-3, 1e2), st.integers(0, 30), st.integers(0, 20))
def test_every_point_projects_back_to_its_pixel(disparity, focal, baseline, u, v):
    geometry = StereoGeometry(focal, focal * 1.01, 15.2, 9.7, baseline)
    values = np.full((21, 31), np.nan)
    values[v, u] = disparity
    ((x, y, z),) = xyz(vertices(StereoImage(values, geometry)))
    # float32 of x and z at a distance of at most 16 px from the principal point
    assert geometry.fx * x / z + geometry.cx == pytest.approx(u, abs=1e-5)
    assert geometry.fy * y / z + geometry.cy == pytest.approx(v, abs=1e-5)
    assert focal * baseline / z == pytest.approx(disparity, rel=1e-6)


@pytest.mark.parametrize("bad", [0.0, -0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("doffs", [0.0, 5.0])
def test_what_is_no_match_never_becomes_a_point(bad, doffs):
    geometry = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs)
    image = StereoImage(np.array([[bad, 10.0], [10.0, bad]], np.float32), geometry)
    assert np.isnan(image.depth(slice(0, 2))).tolist() == [[True, False], [False, True]]
    assert len(vertices(image)) == 2


def test_where_the_search_went_below_zero_so_may_matches():
    toed_in = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs=5.0)
    disparity = np.array([[-6.0, -5.0, -4.0, 0.0, 2.0, np.nan, np.inf, -np.inf]])
    found = vertices(StereoImage(disparity, toed_in, signed=True))
    np.testing.assert_allclose(found["z"], [70 / 1, 70 / 5, 70 / 7], rtol=1e-6)  # float32
    assert len(vertices(StereoImage(disparity, toed_in))) == 1


def test_without_an_offset_a_match_below_zero_is_behind_the_cameras_all_the_same():
    disparity = np.array([[-4.0, 0.0, 2.0]])
    assert len(vertices(StereoImage(disparity, GEOMETRY, signed=True))) == 1


def test_a_depth_beyond_any_number_never_becomes_a_point():
    assert len(vertices(StereoImage(np.array([[1e-45, 1.0]], np.float32), GEOMETRY))) == 1


def test_a_match_behind_the_cameras_never_becomes_a_point():
    geometry = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs=-10.0)
    assert len(vertices(StereoImage(np.array([[9.0, 10.0, 11.0]]), geometry))) == 1


def test_whole_numbers_are_disparities_too():
    found = vertices(StereoImage(np.array([[0, 84]], np.uint8), GEOMETRY))
    assert found["z"].tolist() == [1.0]  # 700 · 0.12 / 84


def test_a_map_without_any_match_gives_an_empty_cloud():
    image = StereoImage(np.full((3, 4), np.nan), GEOMETRY, pixels=np.zeros((3, 4), np.uint8))
    assert len(vertices(image)) == 0
    assert depth_figures(image, np.zeros((3, 4), bool)) is None


@pytest.mark.parametrize("width", [1, 70_000, 200_000])
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_points_come_in_the_order_of_the_pixels_however_many_blocks_there_are(rows, width):
    disparity = np.random.default_rng(rows).uniform(-1, 9, (rows, width)).astype(np.float32)
    pixels = np.arange(rows * width, dtype=np.uint32).reshape(rows, width).astype(np.uint16)
    found = vertices(StereoImage(disparity, GEOMETRY, pixels=pixels))
    np.testing.assert_array_equal(np.rint(found["intensity"] * 65535), pixels[disparity > 0])
    np.testing.assert_allclose(found["z"], 84 / disparity[disparity > 0], rtol=1e-6)  # float32


def test_blocks_are_made_when_they_are_asked_for():
    image = StereoImage(np.ones((4, 200_000), np.float32), GEOMETRY)
    made = []

    def noting(work, items):
        for rows in items:
            made.append(rows.start)
            yield work(rows)

    blocks = iter(CloudMaker(image, np.ones(image.shape, bool)).stream(in_order=noting).blocks)
    assert made == []
    next(blocks)
    assert made == [0]
    assert len(list(blocks)) == 3


def test_a_coloured_vertex_takes_fifteen_bytes():
    found = vertices(StereoImage(np.ones((2, 2)), GEOMETRY, pixels=np.zeros((2, 2, 3), np.uint8)))
    assert found.itemsize == 15


def test_colours_are_red_green_blue_of_the_pixel():
    pixels = np.array([[[1, 2, 3], [4, 5, 6]]], np.uint8)
    found = vertices(StereoImage(np.array([[np.nan, 5.0]]), GEOMETRY, pixels=pixels))
    assert found[["red", "green", "blue"]].tolist() == [(6, 5, 4)]
    assert "intensity" not in found.dtype.names


@pytest.mark.parametrize("scale", [1, 257])
def test_alpha_is_left_out_of_the_colour(scale):
    pixels = (np.array([[[1, 2, 3, 200]]]) * scale).astype(np.uint8 if scale == 1 else np.uint16)
    found = vertices(StereoImage(np.ones((1, 1)), GEOMETRY, pixels=pixels))
    assert found[["red", "green", "blue"]].tolist() == [(3, 2, 1)]


@pytest.mark.parametrize(("dtype", "peak"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1)])
def test_gray_is_a_colour_and_an_intensity(dtype, peak):
    pixels = (np.array([[0.0, 0.4, 1.0]]) * peak).astype(dtype)
    found = vertices(StereoImage(np.ones((1, 3)), GEOMETRY, pixels=pixels))
    assert found[["red", "green", "blue"]].tolist() == [(0, 0, 0), (102, 102, 102), (255, 255, 255)]
    np.testing.assert_allclose(found["intensity"], [0, 0.4, 1], atol=1e-7)  # float32


@pytest.mark.parametrize("name", ["pixels", "sigma", "confidence"])
def test_a_picture_of_another_size_is_refused_with_both_sizes(name):
    with pytest.raises(InvalidInput, match="4 × 3, the disparity map 3 × 4"):
        StereoImage(np.ones((4, 3)), GEOMETRY, **{name: np.zeros((3, 4), np.float32)})


@pytest.mark.parametrize("name", ["fx", "fy", "baseline"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_geometry_that_cannot_be_is_refused(name, value):
    numbers = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "baseline": 1.0, name: value}
    with pytest.raises(InvalidInput, match=name):
        StereoGeometry(**numbers)


def test_sigma_of_the_depth_is_what_an_error_of_sigma_in_the_disparity_makes():
    disparity, wrong = np.array([[20.0, 40.0]]), 1e-3
    found = vertices(StereoImage(disparity, GEOMETRY, sigma=wrong), sigma=True)
    moved = vertices(StereoImage(disparity - wrong, GEOMETRY))
    # float32 of the difference of two depths; second order is 1e-3 / 20
    np.testing.assert_allclose(found["sigma"], moved["z"].astype(float) - found["z"], rtol=5e-3)


def test_sigma_takes_the_offset_the_calibration_and_the_unit_into_account():
    geometry = StereoGeometry(700.0, 700.0, 1.0, 1.0, 0.1, doffs=5.0)
    sigma = np.array([[0.3, np.nan]], np.float32)
    image = StereoImage(np.array([[5.0, 5.0]]), geometry, sigma=sigma, calibration=CalibrationError.of_share(0.04))
    found = vertices(image, frame=Frame(unit="mm"), sigma=True)
    np.testing.assert_allclose(found["z"], 7000, rtol=1e-6)
    np.testing.assert_allclose(found["sigma"], [7000 * 0.05, np.nan], rtol=1e-6)  # 0.03 and 0.04 in quadrature


def test_sigma_that_is_not_known_is_refused():
    with pytest.raises(InvalidInput, match="--sigma-disparity"):
        vertices(StereoImage(np.ones((1, 1)), GEOMETRY), sigma=True)


def test_points_and_normals_stand_in_the_frame_and_its_unit():
    disparity, points = plane_disparity(GEOMETRY, (20, 30))
    frame = Frame(Pose.from_vector(np.array([0.3, -1.2, 0.5]), np.array([5.0, -3.0, 0.7])), "tilted", "mm")
    image = StereoImage(disparity, GEOMETRY)
    found = vertices(image, frame=frame, normals=True)
    expected = frame.frame_T_left.apply(points.reshape(-1, 3)) * 1000
    np.testing.assert_allclose(xyz(found), expected, rtol=0, atol=2e-3)  # float32 at 8000 mm
    normal = frame.frame_T_left.rotation @ np.array([0.2, -0.1, -1]) / np.sqrt(1.05)
    inside = np.s_[15 * 30 + 15]
    np.testing.assert_allclose([found[name][inside] for name in ("nx", "ny", "nz")], normal, atol=1e-3)  # of window 9


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_an_organised_cloud_has_a_place_for_every_pixel_of_the_grid(stride):
    disparity = np.random.default_rng(1).uniform(-1, 9, (50, 4001)).astype(np.float32)
    image = StereoImage(disparity, GEOMETRY)
    selection = Selection(outliers="none", stride=stride)
    stream = CloudMaker(image, select(image, selection, Frame()).kept, organised=True, stride=stride).stream()
    z = np.concatenate(list(stream.blocks))["z"].reshape(stream.grid[::-1])
    assert stream.count == z.size
    wanted = disparity[::stride, ::stride]
    np.testing.assert_allclose(z, np.where(wanted > 0, 84 / wanted, np.nan), rtol=1e-6)  # float32


def test_a_cloud_is_thinned_by_voxels_and_then_by_drawing():
    image = StereoImage(np.full((40, 40), 84.0), GEOMETRY)
    stream = CloudMaker(image, np.ones(image.shape, bool)).stream({"fx": "700 px"})
    fewer = thinned(stream, voxel=0.005, max_points=50)
    (found,) = fewer.blocks
    assert len(found) == fewer.count == 50
    assert len(np.unique(np.floor(xyz(found) / 0.005), axis=0)) == 50
    assert fewer.notes == {"fx": "700 px"}


def test_an_organised_cloud_is_not_thinned():
    image = StereoImage(np.full((4, 4), 84.0), GEOMETRY)
    stream = CloudMaker(image, np.ones(image.shape, bool), organised=True).stream()
    with pytest.raises(InvalidInput, match="organised"):
        thinned(stream, voxel=0.1)


def test_the_depth_figures_are_those_of_the_points():
    disparity = np.array([[84.0, 42.0, 21.0, 0.0, 28.0]])
    image = StereoImage(disparity, GEOMETRY)
    assert depth_figures(image, disparity > 0) == pytest.approx((1.0, 2.5, 4.0))
