"""Normals from planes in disparity: exact on planes, unknown where a plane is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.stereo.cloud import normals
from camcal.stereo.depth import StereoImage
from camcal.stereo.disparity import StereoGeometry

GEOMETRY = StereoGeometry(fx=800.0, fy=780.0, cx=31.0, cy=18.5, baseline=0.2, doffs=4.0)
SHAPE = (40, 60)


def seen(normal, distance=3.0, shape=SHAPE, geometry=GEOMETRY):
    """Return the disparity (H, W) of the plane normal · P = -distance, as the left camera sees it."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    rays = np.stack([(u - geometry.cx) / geometry.fx, (v - geometry.cy) / geometry.fy, np.ones(shape)], axis=-1)
    z = -distance / (rays @ normal)
    return geometry.fx * geometry.baseline / z - geometry.doffs


def angle_deg(found, normal):
    return np.degrees(np.arccos(np.clip(np.tensordot(normal, found.astype(float), axes=1), -1, 1)))


@given(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8))
def test_the_normal_of_a_plane_is_exact_up_to_its_edges_and_looks_at_the_camera(x, y):
    normal = np.array([x, y, -1.0]) / np.sqrt(x * x + y * y + 1)
    found = normals(StereoImage(seen(normal), GEOMETRY), slice(0, SHAPE[0]))
    assert angle_deg(found, normal).max() < 0.05  # sums of float32; at the edges windows are half as wide
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1, atol=1e-6)


def test_holes_do_not_turn_a_normal():
    normal = np.array([0.6, 0.0, -0.8])
    disparity = seen(normal)
    disparity[np.random.default_rng(2).random(SHAPE) < 0.4] = np.nan
    found = normals(StereoImage(disparity, GEOMETRY), slice(0, SHAPE[0]))
    assert angle_deg(found, normal).max() < 0.1


def test_a_twentieth_of_a_pixel_of_noise_turns_normals_by_few_degrees():
    geometry = StereoGeometry(1000.0, 1000.0, 30.0, 20.0, 0.2)
    normal = np.array([0.0, 0.0, -1.0])
    disparity = seen(normal, distance=2.0, geometry=geometry)  # 100 px
    noisy = disparity + np.random.default_rng(4).normal(0, 0.05, SHAPE)
    found = normals(StereoImage(noisy, geometry), slice(0, SHAPE[0]))[:, 4:-4, 4:-4]
    # a slope is known to 0.05 / sqrt(81 · 20 / 3) px per px, and 1000 / 100 of it are radians: 1.2° along each axis
    assert np.sqrt(np.mean(angle_deg(found, normal) ** 2)) == pytest.approx(1.74, rel=0.1)


def test_a_block_of_rows_has_the_normals_of_the_whole():
    disparity = np.random.default_rng(5).uniform(10, 11, SHAPE)
    image = StereoImage(disparity, GEOMETRY)
    whole = normals(image, slice(0, SHAPE[0]))
    parts = [normals(image, slice(start, start + 7)) for start in range(0, 35, 7)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole[:, :35])


@pytest.mark.parametrize("place", [np.s_[20, :], np.s_[:, 30], np.s_[18:20, 30:32], (range(20), range(20))])
def test_too_few_matches_or_some_in_a_line_have_no_normal(place):
    disparity = np.full(SHAPE, np.nan)
    disparity[place] = 10.0
    assert np.isnan(normals(StereoImage(disparity, GEOMETRY), slice(0, SHAPE[0]))).all()
