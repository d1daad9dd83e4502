"""What a rig can measure: against the formula of the parallel pair, and against rigs drawn from a covariance."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera, Rig
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.quality.rig_geometry import baseline, pair_errors, pair_geometry, rotation_angle

PINHOLE = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 319.5, 239.5])
FISHEYE = Camera(model_named("kannala_brandt4"), (800, 800), [240.0, 240.0, 399.5, 399.5, 0.01, -0.004, 1e-3, -1e-4])
PARALLEL = Pose(np.eye(3), np.array([-0.12, 0.0, 0.0]))
TOED_IN = Pose.from_vector(np.array([0.02, -0.15, 0.01]), np.array([-0.2, 0.01, 0.02]))


def pair(right_T_left, right=PINHOLE, covariance=None):
    return Rig(
        {"left": PINHOLE, "right": right}, {"left": Pose.identity(), "right": right_T_left.inverse()}, covariance
    )


def test_a_parallel_pair_has_the_depth_error_of_the_textbook():
    found = pair_geometry(pair(PARALLEL), "left", "right", (10, 50), disparity_px=0.3)
    assert (found.baseline.value, found.baseline.std) == (pytest.approx(0.12), None)
    assert found.vergence == pytest.approx(0.0)
    assert found.epipolar_px is None
    for own, times in zip(found.depths, (10, 50), strict=True):
        assert own.distance == pytest.approx(0.12 * times)
        assert own.calibration is None
        # Z² σ_d / (f b) on the axis; at the corner of the image the same distance is 1.28 times less deep
        on_axis = own.distance**2 * 0.3 / (500 * 0.12)
        assert 0.75 * on_axis < own.matching < 1.05 * on_axis
    near, far = found.depths
    assert far.matching / near.matching == pytest.approx(25, rel=0.05)
    assert near.common == pytest.approx(1 - 500 * 0.12 / 1.2 / 640, abs=0.05)
    assert found.common == (1.0, 1.0)


def test_cameras_that_look_at_one_place_converge():
    right_T_left = Pose.from_vector(np.array([0, np.radians(-8), 0]), np.array([0.0, 0, 0]))
    turned_in = Pose(right_T_left.rotation, -right_T_left.rotation @ np.array([0.2, 0, 0]))
    found = pair_geometry(pair(turned_in), "left", "right")
    assert np.degrees(found.vergence) == pytest.approx(8)
    axis = turned_in.rotation[2]  # the right camera's, in the left one's frame
    assert found.converging == (axis[0] < 0)
    opposite = Pose(right_T_left.rotation.T, -right_T_left.rotation.T @ np.array([0.2, 0, 0]))
    assert pair_geometry(pair(opposite), "left", "right").converging != found.converging


def test_fields_that_do_not_overlap_have_nothing_in_common():
    behind = Pose.from_vector(np.array([0, np.pi, 0]), np.array([0.1, 0, 0]))
    found = pair_geometry(pair(behind), "left", "right", (5,))
    assert found.common == (0.0, 0.0)
    assert found.depths[0].matching is None


def test_the_spread_of_baseline_and_rotation_is_that_of_samples():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6)) * 1e-3
    steps = rng.standard_normal((2000, 6)) @ root.T
    poses = [TOED_IN.retract(step) for step in steps]
    lengths = [np.linalg.norm(pose.translation) for pose in poses]
    angles = [np.linalg.norm(pose.vector()) for pose in poses]
    # a standard deviation of 2000 samples is known to 1.6 %
    assert baseline(TOED_IN, root @ root.T).std == pytest.approx(np.std(lengths), rel=0.06)
    assert rotation_angle(TOED_IN, root @ root.T).std == pytest.approx(np.std(angles), rel=0.06)


@pytest.mark.slow
def test_errors_of_the_calibration_are_those_of_rigs_drawn_from_its_covariance():
    rng = np.random.default_rng(2)
    rig = pair(TOED_IN, FISHEYE)
    count = rig.rows("right").stop
    scales = np.concatenate([[0.5] * 4, [0] * 6, [0.5] * 4, [1e-4] * 4, [2e-4] * 6])
    root = scales[:, None] * rng.standard_normal((count, count)) / np.sqrt(count)
    found = pair_geometry(replace(rig, covariance=root @ root.T), "left", "right", (10,))
    point = np.array([0.05, -0.1, 1.0])
    point *= 10 * found.baseline.value / np.linalg.norm(point)
    true_pixels = PINHOLE.project(point[None]).pixels, FISHEYE.project(TOED_IN.apply(point[None])).pixels
    depths, misses = [], []
    for _ in range(300):
        step = root @ rng.standard_normal(count)
        left = replace(PINHOLE, parameters=PINHOLE.parameters + step[rig.rows("left")][:-6])
        right = replace(FISHEYE, parameters=FISHEYE.parameters + step[rig.rows("right")][:-6])
        right_T_left = TOED_IN.retract(step[-6:])
        one = left.unproject(true_pixels[0]).directions[0]
        two = right_T_left.rotation.T @ right.unproject(true_pixels[1]).directions[0]
        place = right_T_left.inverse().translation
        along = np.linalg.lstsq(np.column_stack([one, -two]), place, rcond=None)[0]
        depths.append(along[0])
        nearest = along[0] * one
        seen = right.project(right_T_left.apply(nearest[None])).pixels[0]
        line = right.project(right_T_left.apply((nearest * 1.01)[None])).pixels[0] - seen
        normal = np.array([-line[1], line[0]]) / np.linalg.norm(line)
        misses.append(normal @ (true_pixels[1][0] - seen))
    # one point stands for the median over the field, and 300 samples for the covariance
    assert found.depths[0].calibration == pytest.approx(np.std(depths), rel=0.35)
    assert found.epipolar_px == pytest.approx(np.std(misses), rel=0.35)


def test_with_an_uncertain_baseline_lengths_and_depths_are_off_by_its_share():
    covariance = np.zeros((20, 20))
    covariance[14, 14] = (0.01 * 0.12) ** 2  # of tx of the right camera: 1 % of the baseline
    found = pair_errors(pair(PARALLEL, covariance=covariance), "left", "right", 1.5, 0.2)
    assert found.depth.std == pytest.approx(0.01 * 1.5, rel=1e-3)
    assert found.length.std == pytest.approx(0.01 * 0.2, rel=1e-3)
    assert found.depth.matching == pytest.approx(1.5**2 * 0.25 / (500 * 0.12), rel=0.15)  # on the axis
    assert found.depth.bound == pytest.approx(1.96 * np.hypot(found.depth.std, found.depth.matching), rel=1e-3)


def test_errors_of_a_pair_need_a_covariance_and_something_in_both_images():
    with pytest.raises(InvalidInput, match="left and right: no covariance of where they stand"):
        pair_errors(pair(PARALLEL), "left", "right", 1.0)
    behind = Pose.from_vector(np.array([0, np.pi, 0]), np.array([0.1, 0, 0]))
    found = pair_errors(pair(behind, covariance=np.eye(20)), "left", "right", 1.0, 0.1)
    assert (found.depth, found.length) == (None, None)
