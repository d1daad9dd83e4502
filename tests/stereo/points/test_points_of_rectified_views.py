"""Distances, points and normals of pairs rectified to a plane, a cylinder or to angles, beside or above each other."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.stereo.cloud import normals
from camcal.stereo.depth import BackProjection, Frame, StereoImage
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import AXES, CYLINDRICAL, LATLON, PINHOLE, PROJECTIONS

SHAPE = (60, 80)
ROWS = slice(0, 60)
FOCAL = {PINHOLE: 40.0, CYLINDRICAL: 30.0, LATLON: 25.0}  # so that the angular views see more than a right angle


def geometry_of(projection, axis, doffs=2.5):
    focal = FOCAL[projection]
    return StereoGeometry(focal, focal, 36.0, 31.0, 0.2, doffs, projection, axis)


def project(points, geometry, right=False):
    """Return the pixels (2, ...) of points (3, ...), by the formulas of the views and not by rays."""
    x, y, z = points
    along, across = (y, x) if geometry.axis == "y" else (x, y)
    centres = (geometry.cy, geometry.cx) if geometry.axis == "y" else (geometry.cx, geometry.cy)
    if right:
        along = along - geometry.baseline
        centres = centres[0] + geometry.doffs, centres[1]
    distance = np.hypot(across, z)
    if geometry.projection == PINHOLE:
        pair = along / z, across / z
    elif geometry.projection == CYLINDRICAL:
        pair = along / distance, np.arctan2(across, z)
    else:
        pair = np.arctan2(along, distance), np.arctan2(across, z)
    first, second = (geometry.fx * each + centre for each, centre in zip(pair, centres, strict=True))
    return np.stack([second, first] if geometry.axis == "y" else [first, second])


def scene(geometry):
    """Return the points (3, H, W) in which the pixels of the left picture see a plane, its normal, and disparities."""
    normal, distance = np.array([0.28, -0.36, 0.89]), 3.0
    normal /= np.linalg.norm(normal)
    columns, rows = geometry.rays(SHAPE)
    rays = columns[:, None, :] + rows[:, :, None]
    cosine = np.tensordot(normal, rays, axes=1)
    points = rays * (distance / np.where(cosine > 0.1, cosine, np.nan))
    shift = project(points, geometry) - project(points, geometry, right=True)
    return points, normal, shift[1 if geometry.axis == "y" else 0].astype(np.float32)


every_view = pytest.mark.parametrize("axis", AXES)
every_projection = pytest.mark.parametrize("projection", PROJECTIONS)


@every_view
@every_projection
def test_a_pixel_and_its_disparity_are_the_point_that_both_pictures_show_there(projection, axis):
    geometry = geometry_of(projection, axis)
    points, _, disparity = scene(geometry)
    image = StereoImage(disparity, geometry, signed=True)
    found = BackProjection(geometry, SHAPE, Frame()).points(ROWS, image.depth(ROWS))
    seen = np.isfinite(points[2])
    assert seen.mean() > 0.7
    error = np.linalg.norm(found - np.moveaxis(points, 0, -1), axis=-1) / np.linalg.norm(points, axis=0)
    assert error[seen].max() < 1e-4  # float32 of disparities of some pixels


@every_view
@every_projection
def test_normals_of_a_plane_are_its_own(projection, axis):
    geometry = geometry_of(projection, axis)
    points, normal, disparity = scene(geometry)
    found = normals(StereoImage(disparity, geometry, signed=True), slice(8, 52))
    inside = found[:, :, 8:-8]
    near = np.linalg.norm(points, axis=0)[8:52, 8:-8] < 6
    angle = np.degrees(np.arccos(np.clip(-np.tensordot(normal, inside, axes=1), -1, 1)))
    # within 9 pixels of an angular view a plane is curved, most near the ends of the baseline
    assert np.nanquantile(angle[near], 0.8) < {PINHOLE: 0.03, CYLINDRICAL: 0.1, LATLON: 1.0}[projection]
    assert np.isfinite(angle[near]).mean() > 0.95


@every_view
@every_projection
def test_sigma_is_how_far_the_depth_moves_with_the_disparity(projection, axis):
    geometry = geometry_of(projection, axis)
    _, _, disparity = scene(geometry)
    image = StereoImage(disparity, geometry, signed=True, sigma=0.01)
    depths = [StereoImage(disparity + step, geometry, signed=True).depth(ROWS) for step in (-0.01, 0.01)]
    moved = np.abs(depths[1] - depths[0]) / 2 / image.depth(ROWS)
    known = disparity + geometry.doffs > 1  # below, a hundredth of a pixel is no small step
    assert image.relative_sigma(ROWS)[known] == pytest.approx(moved[known], rel=5e-3)


def test_a_right_ray_beyond_the_end_of_the_baseline_is_no_match():
    geometry = StereoGeometry(50.0, 50.0, 0.0, 0.0, 0.1, projection=LATLON)
    image = StereoImage(np.full((1, 2), 79.0, np.float32), geometry)  # to the left of -90 degrees by 0.5 pixel
    assert not image.matched(slice(0, 1))[0, 0]
    assert np.isnan(image.depth(slice(0, 1))[0, 0])


@pytest.mark.parametrize(("name", "value"), [("projection", "mercator"), ("axis", "z")])
def test_a_view_that_is_none_is_refused_with_those_that_are(name, value):
    with pytest.raises(InvalidInput, match=f"{name} '{value}' is unknown; use one of"):
        StereoGeometry(1.0, 1.0, 0.0, 0.0, 1.0, **{name: value})
