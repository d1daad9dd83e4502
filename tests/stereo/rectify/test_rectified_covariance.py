"""The covariance of a rectified pair, beside rectification of calibrations that are slightly off."""

import numpy as np
from rigs import NARROW, PLAIN, placed

from camcal.cameras.model import Camera
from camcal.stereo.rectify.plan import plan_rectification
from camcal.stereo.rectify.record import rectified_covariance


def planned(left, right, pose):
    return plan_rectification({"left": left, "right": right}, pose)


def test_a_view_that_is_its_source_has_its_covariance():
    pose = placed((0.1, 0, 0))
    spread = np.diag(np.arange(1.0, 15.0))
    found = rectified_covariance(planned(PLAIN, PLAIN, pose), PLAIN, PLAIN, spread)
    np.testing.assert_allclose(found, spread, atol=1e-4)  # the view's parameters are found to 1e-6


def test_a_distance_between_cameras_and_a_turn_are_carried_to_rectified_axes():
    pose = placed((0.1, 0.02, -0.01), (1, 4, 2))
    plan = planned(NARROW, NARROW, pose)
    spread = np.zeros((24, 24))
    spread[18:21, 18:21] = np.outer(pose.translation, pose.translation) * 1e-4  # 1 % of the baseline, along it
    found = rectified_covariance(plan, NARROW, NARROW, spread)
    np.testing.assert_allclose(found[8:11, 8:11], np.diag([1e-4 * plan.baseline**2, 0, 0]), atol=1e-15)
    assert np.abs(found[:8]).max() == 0


def test_a_lens_that_is_off_moves_points_as_the_rectified_camera_does():
    pose = placed((0.1, 0.0, 0.01), (0.5, 3, 1))
    plan = planned(NARROW, NARROW, pose)
    step = np.array([1.0, 1.2, 0.5, -0.4, 1e-4, 0, 0, 0, 0])
    spread = np.zeros((24, 24))
    spread[:9, :9] = np.outer(step, step)
    found = rectified_covariance(plan, NARROW, NARROW, spread)
    changed = np.sqrt(np.diag(found)[:4]) * np.sign(found[0, :4])  # of a matrix of rank one, up to sign
    off = Camera(NARROW.model, NARROW.image_size, NARROW.parameters + step)
    pixels = np.random.default_rng(1).uniform(0.1, 0.9, (50, 2)) * np.array(NARROW.image_size)
    truth = off.unproject(pixels).directions @ plan.rect_R_left.T
    drawn = plan.left_camera.project(NARROW.unproject(pixels).directions @ plan.rect_R_left.T).pixels
    before = plan.left_camera.project(truth).pixels - drawn
    nearer = Camera(plan.left_camera.model, plan.size, plan.left_camera.parameters + changed)
    after = nearer.project(truth).pixels - drawn
    # a shift of the distortion's centre is not one of a pinhole
    assert np.sqrt((after**2).mean()) < 0.12 * np.sqrt((before**2).mean())
