"""Poses by several cameras at once: rig_T_object, its covariance and what one camera alone cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera, Rig
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pnp import estimate_poses, estimate_rig_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.geometry.pose import Pose

PINHOLE = Camera(model_named("pinhole"), (1280, 960), [800.0, 805.0, 640.0, 480.0])
FISHEYE = Camera(model_named("kannala_brandt4"), (1400, 1400), [500.0, 500.0, 700.0, 700.0, 0.01, -0.004, 1e-3, -1e-4])
RIG = Rig(
    {"left": PINHOLE, "right": FISHEYE},
    {
        "left": Pose.from_vector(np.array([0.0, 0.05, 0.0]), np.array([-0.25, 0.0, 0.0])),
        "right": Pose.from_vector(np.array([0.02, -0.1, 0.01]), np.array([0.25, 0.01, 0.02])),
    },
)
TAG = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.05
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.1


def seen(rig_T_object, points, rng, noise_px, shown=None):
    """Return what each camera of the rig sees of the points, or of some of them."""
    views = []
    for name, camera in RIG.cameras.items():
        chosen = points if shown is None else points[shown[name]]
        pixels = camera.project(RIG.rig_T_camera[name].inverse().apply(rig_T_object.apply(chosen))).pixels
        views.append(Correspondences("a", chosen, pixels + noise_px * rng.standard_normal(pixels.shape), camera=name))
    return views


def error_of(found, truth):
    return np.concatenate([found.translation - truth.translation, (found @ truth.inverse()).vector()])


def some_pose(rng, distance):
    return Pose.from_vector(rng.normal(0, 0.4, 3), np.array([0, 0, distance]) + rng.normal(0, 0.03, 3))


def test_exact_pixels_give_the_pose_in_the_rig():
    rng = np.random.default_rng(1)
    truth = some_pose(rng, 1.0)
    for shown in (None, {"left": [0, 1, 2, 5], "right": [7]}, {"left": [0, 1, 2], "right": [3, 4, 6]}):
        found = estimate_rig_poses(RIG, [seen(truth, CUBE, rng, 0.0, shown)])[0].value
        np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-9)
        assert found.frames == "rig_T_object"
        assert found.used == (16 if shown is None else sum(map(len, shown.values())))


def test_one_camera_of_a_rig_gives_what_it_gives_alone():
    rng = np.random.default_rng(2)
    views = seen(some_pose(rng, 1.0), CUBE, rng, 0.2)
    options = PoseOptions(noise_px=0.2)
    in_rig = estimate_rig_poses(RIG, [views[:1]], options)[0].value
    alone = estimate_poses(PINHOLE, views[:1], options)[0].value
    expected = RIG.rig_T_camera["left"] @ alone.transform
    np.testing.assert_allclose(error_of(in_rig.transform, expected), 0, atol=1e-7)  # where the solver stops
    np.testing.assert_allclose(in_rig.residuals, alone.residuals, atol=1e-4)
    assert in_rig.tilt_rad == alone.tilt_rad
    assert in_rig.least_depth == pytest.approx(alone.least_depth)


def test_errors_are_as_large_as_the_covariance_says():
    rng = np.random.default_rng(3)
    truths = [some_pose(rng, 1.5) for _ in range(80)]
    outcomes = estimate_rig_poses(RIG, [seen(truth, TAG, rng, 0.3) for truth in truths], PoseOptions(noise_px=0.3))
    errors = [error_of(outcome.value.transform, truth) for outcome, truth in zip(outcomes, truths, strict=True)]
    total = sum(e @ np.linalg.solve(o.value.covariance, e) for e, o in zip(errors, outcomes, strict=True))
    low, high = stats.chi2.interval(0.99, 6 * len(truths))
    assert low < total < high


def moved_rig(step):
    """Return the rig with its lenses and camera_T_rig moved by a step, as its covariance counts them."""
    cameras, poses = {}, {}
    for name, camera in RIG.cameras.items():
        own = step[RIG.rows(name)]
        cameras[name] = replace(camera, parameters=camera.parameters + own[:-6])
        poses[name] = RIG.rig_T_camera[name].inverse().retract(own[-6:]).inverse()
    return Rig(cameras, poses)


def without_cross_terms(covariance):
    """Return a rig's covariance with those of each lens and of each pose alone."""
    blocks = np.zeros_like(covariance)
    for name in RIG.cameras:
        rows = RIG.rows(name)
        for block in (slice(rows.start, rows.stop - 6), slice(rows.stop - 6, rows.stop)):
            blocks[block, block] = covariance[block, block]
    return blocks


def test_the_covariance_of_a_rig_with_its_cross_terms_reaches_that_of_the_poses():
    rng = np.random.default_rng(8)
    count = RIG.rows("right").stop
    scales = np.concatenate([[0.8, 0.8, 1, 1], [1e-3] * 6, [0.8, 0.8, 1, 1], [1e-3] * 4, [1e-3] * 6])
    shared = rng.standard_normal((count, 2))  # two causes in common: cross-terms between lenses and poses
    factor = scales[:, None] * np.column_stack([shared, 0.2 * np.eye(count)])
    covariance, options = factor @ factor.T, PoseOptions(noise_px=0.05, outliers="none")
    truths, views = [some_pose(rng, 1.2) for _ in range(150)], []
    for truth in truths:
        real = moved_rig(factor @ rng.standard_normal(factor.shape[1]))
        poses = {name: rig_T_camera.inverse() @ truth for name, rig_T_camera in real.rig_T_camera.items()}
        pixels = {name: camera.project(poses[name].apply(CUBE)).pixels for name, camera in real.cameras.items()}
        views.append([Correspondences("a", CUBE, own, camera=name) for name, own in pixels.items()])

    def total(known):
        found = [each.value for each in estimate_rig_poses(replace(RIG, covariance=known), views, options)]
        errors = [error_of(own.transform, truth) for own, truth in zip(found, truths, strict=True)]
        pairs = zip(errors, found, strict=True)  # the pixels themselves are exact
        return sum(error @ np.linalg.solve(own.covariance - own.noise_covariance, error) for error, own in pairs)

    low, high = stats.chi2.interval(0.99, 6 * len(views))
    assert low < total(covariance) < high
    assert not low < total(without_cross_terms(covariance)) < high


def test_a_resized_rig_has_the_covariance_of_its_resized_lenses():
    rng = np.random.default_rng(9)
    factor = rng.standard_normal((RIG.rows("right").stop,) * 2)
    rig = replace(RIG, covariance=factor @ factor.T)
    half = rig.resized({"left": (640, 480)})
    np.testing.assert_allclose(half.cameras["left"].parameters, [400.0, 402.5, 319.75, 239.75])
    np.testing.assert_allclose(half.covariance[:4, :4], rig.covariance[:4, :4] / 4)
    np.testing.assert_allclose(half.covariance[:4, 4:], rig.covariance[:4, 4:] / 2)
    np.testing.assert_allclose(half.covariance[4:, 4:], rig.covariance[4:, 4:], rtol=1e-12)


def test_two_cameras_settle_which_of_two_poses_a_tag_has():
    rng = np.random.default_rng(4)
    truths = [some_pose(rng, 2.0) for _ in range(40)]
    instants = [seen(truth, TAG, rng, 0.3) for truth in truths]
    options = PoseOptions(noise_px=0.3)
    together = estimate_rig_poses(RIG, instants, options)
    alone = estimate_poses(PINHOLE, [views[0] for views in instants], options)
    of_left = RIG.rig_T_camera["left"]
    pairs = list(zip(together, alone, truths, strict=True))
    flipped = [np.linalg.norm(error_of(both.value.transform, truth)[3:]) > 0.3 for both, _, truth in pairs]
    lonely = [np.linalg.norm(error_of(of_left @ one.value.transform, truth)[3:]) > 0.3 for _, one, truth in pairs]
    assert sum(lonely) >= 3
    assert not any(flipped)


def test_wrong_points_of_one_camera_are_left_out_and_told_in_the_order_given():
    rng = np.random.default_rng(5)
    truth = some_pose(rng, 1.2)
    views = seen(truth, CUBE, rng, 0.2)
    pixels = views[0].pixels.copy()
    pixels[2] += 40
    spoilt = Correspondences("a", CUBE, pixels, camera="left")
    for outliers in ("few", "many"):
        options = PoseOptions(noise_px=0.2, outliers=outliers)
        found = estimate_rig_poses(RIG, [[views[1], spoilt]], options)[0].value
        assert np.flatnonzero(~found.inliers).tolist() == [8 + 2]
        assert np.linalg.norm(found.residuals[10]) > 20
        np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=5e-3)


def test_what_is_no_view_of_the_rig_is_refused():
    rng = np.random.default_rng(6)
    views = seen(some_pose(rng, 1.0), CUBE, rng, 0.2)
    with pytest.raises(InvalidInput, match="camera 'top' is not in the rig of left, right"):
        estimate_rig_poses(RIG, [[Correspondences("a", CUBE, views[0].pixels, camera="top")]])
    with pytest.raises(InvalidInput, match="'left' occurs twice"):
        estimate_rig_poses(RIG, [[views[0], views[0]]])
    few = [view.take(np.arange(1)) for view in views]
    error = estimate_rig_poses(RIG, [few])[0].error
    assert isinstance(error, InsufficientData)
    assert "4 different points or more, found 1" in str(error)
