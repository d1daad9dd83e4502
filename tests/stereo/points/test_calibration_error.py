"""The variance of depths that the covariance of a calibration causes, against calibrations drawn from it."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.stereo.depth import StereoImage
from camcal.stereo.depth_error import CalibratedPair, CalibrationError, calibration_error
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import CYLINDRICAL, LATLON, PINHOLE

LENSES = {
    PINHOLE: ("opencv5", [620.0, 622.0, 318.0, 243.0, -0.21, 0.09, 1e-3, -5e-4, 0.01]),
    CYLINDRICAL: ("kannala_brandt4", [250.0, 251.0, 321.0, 239.0, 0.01, -0.004, 0.001, 0.0]),
    LATLON: ("kannala_brandt4", [210.0, 211.0, 321.0, 239.0, 0.01, -0.004, 0.001, 0.0]),
}
SIZE = (640, 480)
DRAWS = 1500


def axes_of(right_T_left):
    """Return the rectified axes in the left camera's and in the right camera's, as rows: x along the baseline."""
    centre = right_T_left.inverse().translation
    x = centre / np.linalg.norm(centre)
    ahead = np.array([0.0, 0.0, 1.0]) + right_T_left.rotation.T[:, 2]
    z = ahead - (ahead @ x) * x
    z /= np.linalg.norm(z)
    left = np.stack([x, np.cross(z, x), z])
    return left, left @ right_T_left.rotation.T


def rig_of(projection, upright):
    """Return a rectified pair, its geometry and a covariance of all its parameters with correlations."""
    name, values = LENSES[projection]
    left, right = (Camera(model_named(name), SIZE, np.array(values) * scale) for scale in (1.0, 1.002))
    turn = so3.exp(np.array([0.0, 0.0, -np.pi / 2])) if upright else np.eye(3)
    pose = Pose.from_vector(np.array([0.01, -0.03, 0.005]), np.array([-0.12, 0.002, 0.004]))
    rng = np.random.default_rng(5)
    count = 2 * len(values) + 6
    std = np.concatenate([np.abs(values) * 5e-4, np.abs(values) * 5e-4, [1e-4] * 3, [2e-4, 4e-4, 2e-4]])
    factor = (rng.normal(size=(count, count)) / np.sqrt(2 * count) + np.eye(count) / np.sqrt(2)) * std[:, None]
    axes = [turn.T @ each for each in axes_of(pose)]
    focal = float(values[0])
    baseline = float(np.linalg.norm(pose.translation))
    geometry = StereoGeometry(focal, focal, 319.5, 239.5, baseline, 0.0, projection, "y" if upright else "x")
    return CalibratedPair(left, right, pose, factor @ factor.T, *axes), geometry


def points_of(pair, geometry, pixels, upright):
    """Return the points (N, 3) in the left camera that pixels (N, 2) of each camera are rectified and matched to."""
    axes = axes_of(pair.right_T_left)
    left, right = (
        camera.unproject(seen).directions @ turn.T
        for turn, camera, seen in zip(axes, (pair.left, pair.right), pixels, strict=True)
    )
    radii = [
        rays[:, 2] if geometry.projection == PINHOLE else np.hypot(rays[:, 1], rays[:, 2]) for rays in (left, right)
    ]
    columns = [rays[:, 0] / radius for rays, radius in zip((left, right), radii, strict=True)]
    depth = np.linalg.norm(pair.right_T_left.translation) / (columns[0] - columns[1])
    return (left / radii[0][:, None] * depth[:, None]) @ axes[0]


def drawn(pair, rng):
    """Yield pairs whose parameters are drawn from the covariance of a pair."""
    first, second = len(pair.left.parameters), len(pair.right.parameters)
    axes = pair.rect_R_left, pair.rect_R_right
    for step in rng.multivariate_normal(np.zeros(len(pair.covariance)), pair.covariance, DRAWS):
        cameras = [
            Camera(camera.model, SIZE, camera.parameters + part)
            for camera, part in zip((pair.left, pair.right), (step[:first], step[first : first + second]), strict=True)
        ]
        yield CalibratedPair(*cameras, pair.right_T_left.retract(step[first + second :]), pair.covariance, *axes)


@pytest.mark.slow
@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("projection", list(LENSES))
def test_drawn_calibrations_scatter_the_depth_as_predicted(projection, upright):
    pair, geometry = rig_of(projection, upright)
    predicted = calibration_error(pair, geometry, SIZE)
    places, distances = np.array([(80, 120), (320, 240), (560, 400)]), np.array([1.0, 3.0, 4.0])
    columns, rows = geometry.rays(SIZE[::-1])
    rays = columns[:, places[:, 0]].T + rows[:, places[:, 1]].T
    points = rays * distances[:, None] @ pair.rect_R_left
    pixels = [pair.left.project(points).pixels, pair.right.project(pair.right_T_left.apply(points)).pixels]
    found = np.array([points_of(own, geometry, pixels, upright) for own in drawn(pair, np.random.default_rng(1))])
    for index, (pixel, distance, ray) in enumerate(zip(places, distances, rays, strict=True)):
        outwards = ray * (0, 0, 1) if projection == PINHOLE else ray * ((1, 0, 1) if upright else (0, 1, 1))
        depths = found[:, index] @ pair.rect_R_left.T @ outwards
        parallax = geometry.scale / distance
        tangent = ray[1 if upright else 0] - parallax / geometry.focal
        effective = parallax / (1 + tangent**2) if projection == LATLON else parallax
        at = np.full(SIZE[::-1], effective, np.float32)
        std = np.sqrt(predicted.variance_of(at, slice(0, SIZE[1]))[pixel[1], pixel[0]]) / effective
        centre = np.median(depths)
        scatter = np.diff(np.quantile(depths, [0.1587, 0.8413]))[0] / 2 / centre  # of 1500: known to 3 %
        assert centre == pytest.approx(distance, rel=0.05)
        assert std == pytest.approx(scatter, rel=0.1)


def test_the_error_of_baseline_and_focal_length_alone_is_a_share_of_the_depth():
    camera = Camera(model_named("pinhole"), SIZE, np.array([500.0, 500.0, 319.5, 239.5]))
    pose = Pose(np.eye(3), np.array([-0.1, 0.0, 0.0]))
    covariance = np.zeros((14, 14))
    covariance[8, 8] = (0.1 * 0.02) ** 2
    covariance[0, 0] = covariance[4, 4] = covariance[0, 4] = covariance[4, 0] = (500 * 0.01) ** 2  # of one lens, twice
    geometry = StereoGeometry(500.0, 500.0, 319.5, 239.5, 0.1)
    found = calibration_error(CalibratedPair(camera, camera, pose, covariance, np.eye(3), np.eye(3)), geometry, SIZE)
    image = StereoImage(np.full(SIZE[::-1], 20.0, np.float32), geometry, sigma=0.0, calibration=found)
    assert image.relative_sigma(slice(0, 480)) == pytest.approx(np.hypot(0.02, 0.01), rel=1e-4)


def test_vergence_is_an_error_of_the_disparity_itself():
    camera = Camera(model_named("pinhole"), SIZE, np.array([500.0, 500.0, 319.5, 239.5]))
    pose = Pose(np.eye(3), np.array([-0.1, 0.0, 0.0]))
    covariance = np.zeros((14, 14))
    covariance[12, 12] = 1e-3**2  # ry
    geometry = StereoGeometry(500.0, 500.0, 319.5, 239.5, 0.1)
    found = calibration_error(CalibratedPair(camera, camera, pose, covariance, np.eye(3), np.eye(3)), geometry, SIZE)
    variance = found.variance_of(np.zeros(SIZE[::-1], np.float32), slice(0, 480))
    assert np.sqrt(variance[239, 319]) == pytest.approx(0.5, rel=1e-3)  # f dθ, of what is infinitely far
    assert np.sqrt(variance[239, 0]) == pytest.approx(0.5 * (1 + (319.5 / 500) ** 2), rel=1e-3)


def test_a_share_is_the_same_at_every_pixel_and_distance():
    parallax = np.array([[1.0, 10.0], [30.0, np.nan]], np.float32)
    variance = CalibrationError.of_share(0.03).variance_of(parallax, slice(0, 2))
    assert np.sqrt(variance)[:1] == pytest.approx(0.03 * parallax[:1])
