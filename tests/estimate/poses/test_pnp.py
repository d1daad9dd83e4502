"""Poses from points: synthetic truth for several lenses, the statistics of the covariance, the two planar minima.

Noise is Gaussian and the lens is exactly known here; what a wrong lens does to a pose is not shown.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.packed_correspondences import PackedCorrespondences
from camcal.estimate.poses.pose_quality import region_quantile
from camcal.estimate.poses.problem import Anchor, PoseProblems
from camcal.estimate.poses.records import AMBIGUOUS, Alternative, Correspondences, PoseOptions, PosePrior
from camcal.geometry.pose import Pose
from camcal.solve.differentiate import central_jacobian

PINHOLE = Camera(model_named("pinhole"), (1280, 960), [800.0, 805.0, 640.0, 480.0])
WIDE = Camera(model_named("opencv5"), (1280, 960), [700.0, 702.0, 630.0, 490.0, -0.25, 0.08, 1e-3, -5e-4, -0.01])
FISHEYE = Camera(model_named("kannala_brandt4"), (1400, 1400), [320.0, 320.0, 700.0, 700.0, 0.01, -0.004, 1e-3, -1e-4])
LENSES = {"pinhole": PINHOLE, "opencv5": WIDE, "kannala_brandt4": FISHEYE}

BOARD = np.array([[x, y, 0.0] for y in range(6) for x in range(9)]) * 0.03
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
TAG = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.05


def observed(camera, camera_T_object, points, rng, noise_px=0.0, image="view"):
    """Return the correspondences of points that must all be in the lens's domain."""
    projection = camera.project(camera_T_object.apply(points))
    assert projection.valid.all()
    return Correspondences(image, points, projection.pixels + noise_px * rng.standard_normal((len(points), 2)))


def estimate(camera, view, noise_px=None):
    outcome = estimate_poses(camera, [view], PoseOptions(noise_px=noise_px))[0]
    assert outcome.error is None, outcome.error
    return outcome.value


def problems_of(camera, *views, anchor=None):
    return PoseProblems.of((PackedCorrespondences.of(camera, views, Pose.identity()),), anchor)


def error_of(found, truth):
    """Return the step (6,) from the truth to the pose found."""
    return np.concatenate([found.translation - truth.translation, (found @ truth.inverse()).vector()])


def some_pose(rng, distance=(0.5, 1.0), turn=0.4):
    place = np.append(rng.normal(0, 0.03, 2), rng.uniform(*distance))
    return Pose.from_vector(rng.normal(0, turn, 3), place)


def bowl(rng, count):
    """Return points in all directions up to 110° from the axis, 1 m to 2 m away."""
    theta, phi = rng.uniform(0, np.radians(110), count), rng.uniform(0, 2 * np.pi, count)
    rays = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return rays * rng.uniform(1, 2, (count, 1))


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES.keys())
@pytest.mark.parametrize("count", [4, 5, 6, 30])
def test_exact_pixels_of_a_solid_object_give_its_pose(camera, count):
    rng = np.random.default_rng(count)
    truth = some_pose(rng)
    found = estimate(camera, observed(camera, truth, rng.uniform(-0.1, 0.1, (count, 3)), rng))
    # pixels at 1e3 with 16 digits, over a focal length of 800 px: 1e-15 rad, times the conditioning of few points
    np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-10)
    assert found.status == "ok"


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES.keys())
@pytest.mark.parametrize("points", [BOARD, TAG], ids=["board", "tag"])
def test_exact_pixels_of_a_plane_give_its_pose(camera, points):
    rng = np.random.default_rng(3)
    truth = some_pose(rng)
    found = estimate(camera, observed(camera, truth, points, rng))
    np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-10)  # as above
    assert found.p_wrong < 1e-12  # without noise every other minimum is infinitely unlikely


def test_a_plane_that_faces_the_camera_exactly_gives_its_pose():
    rng = np.random.default_rng(4)
    for vector in ([0.0, 0, 0], [np.pi, 0, 0]):  # z of the board away from the camera and towards it
        truth = Pose.from_vector(np.array(vector), np.array([0.0, 0, 0.6]))
        found = estimate(PINHOLE, observed(PINHOLE, truth, BOARD, rng))
        np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-9)  # the tilt is weakest here


def test_points_beyond_ninety_degrees_give_the_pose():
    rng = np.random.default_rng(5)
    truth = Pose.from_vector(np.array([0.4, -0.2, 1.0]), np.array([0.1, 0.2, -0.1]))
    points = truth.inverse().apply(bowl(rng, 30))
    assert np.any(truth.apply(points)[:, 2] < 0)
    found = estimate(FISHEYE, observed(FISHEYE, truth, points, rng))
    np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-10)


def test_a_board_at_the_side_partly_behind_the_camera_gives_the_pose():
    rng = np.random.default_rng(6)
    truth = Pose.from_vector(np.array([0.0, -1.5, 0.1]), np.array([0.4, -0.1, -0.1]))
    assert np.ptp(np.sign(truth.apply(BOARD)[:, 2])) == 2
    found = estimate(FISHEYE, observed(FISHEYE, truth, BOARD, rng))
    np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-10)


@pytest.mark.parametrize("count", [4, 5, 6])
def test_few_noisy_points_reach_the_minimum_next_to_the_truth(count):
    rng = np.random.default_rng(20 + count)
    truths = [some_pose(rng, (0.4, 1.0), 0.8) for _ in range(60)]
    views = [observed(PINHOLE, truth, rng.uniform(-0.1, 0.1, (count, 3)), rng, 0.5) for truth in truths]
    outcomes = estimate_poses(PINHOLE, views, PoseOptions(noise_px=0.5))
    reference = problems_of(PINHOLE, *views).minimise(se3.of_poses(truths), np.arange(60))
    for outcome, cost in zip(outcomes, reference.cost, strict=True):
        assert np.sum(outcome.value.residuals**2) / 2 <= cost + 1e-6  # both end within 1e-6 of the minimum's cost


def test_the_minimum_is_that_of_opencv_refinement():
    rng = np.random.default_rng(7)
    truth = some_pose(rng)
    view = observed(PINHOLE, truth, BOARD, rng, 0.3)
    found = estimate(PINHOLE, view)
    fx, fy, cx, cy = PINHOLE.parameters
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-15)
    vector, place = cv2.solvePnPRefineLM(
        view.points, view.pixels, matrix, None, truth.vector()[:, None], truth.translation[:, None].copy(), criteria
    )
    reference = Pose.from_vector(vector.ravel(), place.ravel())
    np.testing.assert_allclose(error_of(found.transform, reference), 0, atol=1e-6)  # rad and m


@pytest.mark.parametrize("points", [BOARD[::5], CUBE], ids=["plane", "cube"])
def test_errors_are_as_large_as_the_covariance_says(points):
    rng = np.random.default_rng(8)
    sigma, runs = 0.3, 100
    truths = [some_pose(rng, (0.4, 0.7)) for _ in range(runs)]
    views = [observed(PINHOLE, truth, points, rng, sigma) for truth in truths]
    # the noise is estimated from all views, to 3 % here, which the interval below is too wide to feel
    found = [outcome.value for outcome in estimate_poses(PINHOLE, views)]
    errors = [error_of(pose.transform, truth) for pose, truth in zip(found, truths, strict=True)]
    total = sum(error @ np.linalg.solve(pose.covariance, error) for error, pose in zip(errors, found, strict=True))
    low, high = stats.chi2.interval(0.99, 6 * runs)
    assert low < total < high
    assert found[0].degrees_of_freedom == runs * (2 * len(points) - 6)
    low, high = stats.chi2.interval(0.99, found[0].degrees_of_freedom)
    assert low < found[0].degrees_of_freedom * (found[0].sigma_px / sigma) ** 2 < high


def test_a_small_far_tag_reports_both_of_its_poses():
    rng = np.random.default_rng(9)
    truth = Pose.from_vector(np.array([0.5, 0, 0]), np.array([0.0, 0, 3.0]))  # 27 px wide, tilted by 29°
    views = [observed(PINHOLE, truth, TAG, rng, 0.3) for _ in range(20)]
    for outcome in estimate_poses(PINHOLE, views, PoseOptions(noise_px=0.3)):
        found = outcome.value
        tilts = [np.linalg.norm(error_of(pose, truth)[3:]) for pose in (found.transform, found.alternative.transform)]
        # one is the truth; the other has the normal reflected, so they are twice 29° apart
        assert min(tilts) < 0.5 < max(tilts)
        expected = 1 / (1 + np.exp(found.alternative.chi_square_difference / 2))
        assert found.p_wrong == pytest.approx(expected)
        assert found.status.startswith("ambiguous") == (found.p_wrong > AMBIGUOUS)


def test_the_probability_of_the_wrong_pose_is_how_often_it_wins():
    rng = np.random.default_rng(10)
    truths = [some_pose(rng, (2.0, 4.0), 0.3) for _ in range(100)]
    outcomes = estimate_poses(
        PINHOLE, [observed(PINHOLE, truth, TAG, rng, 0.3) for truth in truths], PoseOptions(noise_px=0.3)
    )
    pairs = [(outcome.value, truth) for outcome, truth in zip(outcomes, truths, strict=True)]
    decided = [(found, truth) for found, truth in pairs if found.alternative]
    wrong = [
        np.linalg.norm(error_of(found.transform, truth)) > np.linalg.norm(error_of(found.alternative.transform, truth))
        for found, truth in decided
    ]
    predicted = np.array([found.p_wrong for found, _ in decided])
    spread = np.sqrt(np.sum(predicted * (1 - predicted)))
    assert predicted.sum() > 10
    assert abs(sum(wrong) - predicted.sum()) < 2.58 * spread  # 99 % of a sum of independent draws


def test_a_noise_in_pixels_takes_the_place_of_covariances():
    rng = np.random.default_rng(11)
    view = observed(PINHOLE, some_pose(rng), BOARD, rng, 0.3)
    known = replace(view, covariance=1e-4 * np.eye(2) * rng.uniform(0.5, 2.0, (54, 1, 1)))
    plain, given = (estimate_poses(PINHOLE, [each], PoseOptions(noise_px=0.3))[0].value for each in (view, known))
    np.testing.assert_array_equal(given.covariance, plain.covariance)
    assert given.sigma_px == given.noise_scale == 0.3
    with pytest.raises(InvalidInput, match="give no scale"):
        PoseOptions(noise_px=0.3, noise_scale=1.0)


def test_covariances_of_pixels_count_up_to_a_common_factor():
    rng = np.random.default_rng(11)
    view = observed(PINHOLE, some_pose(rng), BOARD, rng, 0.3)
    covariance = np.eye(2) * rng.uniform(0.5, 2.0, (54, 1, 1)) + 0.2
    once, four = (estimate(PINHOLE, Correspondences("a", BOARD, view.pixels, f * covariance)) for f in (1, 4))
    np.testing.assert_allclose(error_of(once.transform, four.transform), 0, atol=1e-9)  # where the solver stops
    np.testing.assert_allclose(once.covariance, four.covariance, rtol=1e-4)
    assert once.noise_scale == pytest.approx(2 * four.noise_scale, rel=1e-6)
    assert once.sigma_px == pytest.approx(four.sigma_px, rel=1e-6)
    assert once.sigma_px == pytest.approx(0.3, rel=0.3)  # of 102 degrees of freedom
    assert np.linalg.norm(error_of(once.transform, estimate(PINHOLE, view).transform)) > 1e-6


def test_the_inverse_has_the_frames_exchanged_and_its_own_covariance():
    rng = np.random.default_rng(13)
    found = estimate(PINHOLE, observed(PINHOLE, some_pose(rng), TAG, rng, 0.3), 0.3)
    turned = found.inverse()
    assert (found.frames, turned.frames) == ("camera_T_object", "object_T_camera")
    np.testing.assert_allclose((found.transform @ turned.transform).matrix(), np.eye(4), atol=1e-14)
    np.testing.assert_allclose(turned.inverse().covariance, found.covariance, rtol=1e-9, atol=1e-18)
    assert turned.p_wrong == found.p_wrong


def test_pose_and_lens_jacobians_are_the_derivatives_of_the_whitened_residuals():
    rng = np.random.default_rng(14)
    pose = some_pose(rng)
    view = observed(WIDE, pose, BOARD[::7], rng, 1.0)
    spreads = rng.normal(size=(len(view.points), 2, 2))
    covariance = spreads @ spreads.transpose(0, 2, 1) + 0.1 * np.eye(2)
    frame = Pose.from_vector(np.array([0.1, 0.3, -0.2]), np.array([0.1, 0.0, 0.05]))
    packed = PackedCorrespondences.of(WIDE, [Correspondences("a", view.points, view.pixels, covariance)], frame)
    state, only = se3.of_poses([frame.inverse() @ pose]), np.zeros(1, int)
    rows, by_lens, inside = packed.rows(state, only, packed.present, lens=True)
    assert inside.all()

    def by_step(step):
        return packed.rows(se3.retract(state, step[None]), only, packed.present)[0][:, 6]

    def by_parameters(parameters):
        lens = replace(packed, camera=replace(WIDE, parameters=parameters))
        return lens.rows(state, only, packed.present)[0][:, 6]

    # slopes of up to 1e4 px; rounding of 1e3 px over steps of 1e-4: 1e-9
    numeric = central_jacobian(by_step, np.zeros(6), 1e-4)
    np.testing.assert_allclose(rows[:, :6], np.moveaxis(numeric, -1, 1), rtol=1e-7, atol=1e-5)
    numeric = central_jacobian(by_parameters, WIDE.parameters, 1e-4)
    np.testing.assert_allclose(by_lens, np.moveaxis(numeric, -1, 1), rtol=1e-7, atol=1e-5)


def test_a_prior_pulls_with_the_derivatives_of_its_cost():
    rng = np.random.default_rng(15)
    factors = rng.normal(size=(6, 6))
    anchor = Anchor(se3.of_poses([some_pose(rng)]), (factors @ factors.T)[None])
    state, only = se3.of_poses([some_pose(rng)]), np.zeros(1, int)
    numeric = central_jacobian(lambda d: anchor.models(se3.retract(state, d[None]), only).cost[0], np.zeros(6), 1e-3)
    np.testing.assert_allclose(anchor.models(state, only).gradient[0], numeric, rtol=1e-9, atol=1e-9)


def test_a_prior_takes_the_place_of_a_fourth_point():
    rng = np.random.default_rng(16)
    truth = some_pose(rng)
    view = observed(PINHOLE, truth, TAG[:3], rng, 0.1)
    prior = PosePrior(truth.retract(1e-3 * rng.standard_normal(6)), 1e-4 * np.eye(6))
    found = estimate_poses(PINHOLE, [view], PoseOptions(noise_px=0.1, prior=prior))[0].value
    assert np.linalg.norm(error_of(found.transform, truth)) < 0.02  # 0.1 px over 150 px, seen at a slant
    assert np.all(np.linalg.eigvalsh(prior.covariance - found.covariance) > 0)  # the pixels can only add
    assert len(found.alternatives) > 0  # three points have up to four poses
    tight = PosePrior(prior.pose, 1e-12 * np.eye(6))
    held = estimate_poses(PINHOLE, [view], PoseOptions(noise_px=0.1, prior=tight))[0].value
    np.testing.assert_allclose(error_of(held.transform, prior.pose), 0, atol=1e-5)
    with pytest.raises(InvalidInput, match="give the noise"):
        PoseOptions(prior=prior)


def test_the_uncertainty_of_the_lens_is_propagated_and_kept_apart():
    rng = np.random.default_rng(17)
    runs, sigma = 150, 0.05
    stds = np.array([0.5, 0.5, 0.7, 0.7])
    known = replace(PINHOLE, covariance=np.diag(stds**2))
    lenses = [replace(PINHOLE, parameters=PINHOLE.parameters + stds * rng.standard_normal(4)) for _ in range(runs)]
    truths = [some_pose(rng) for _ in lenses]
    views = [observed(lens, truth, BOARD, rng, sigma) for lens, truth in zip(lenses, truths, strict=True)]
    estimates = [outcome.value for outcome in estimate_poses(known, views, PoseOptions(noise_px=sigma))]
    total = noise_only = 0.0
    for found, truth in zip(estimates, truths, strict=True):
        error = error_of(found.transform, truth)
        total += error @ np.linalg.solve(found.covariance, error)
        noise_only += error @ np.linalg.solve(found.noise_covariance, error)
    low, high = stats.chi2.interval(0.99, 6 * runs)
    assert low < total < high
    assert noise_only > 5 * total
    ignored = estimate_poses(known, views, PoseOptions(noise_px=sigma, intrinsics=False))[-1].value
    np.testing.assert_array_equal(ignored.covariance, found.noise_covariance)


def test_regions_at_few_points_need_the_quantile_of_fisher():
    rng = np.random.default_rng(18)
    inside = []
    for _ in range(60):
        truth = some_pose(rng, (0.3, 0.4))
        found = estimate(PINHOLE, observed(PINHOLE, truth, CUBE[[0, 1, 2, 4, 7]], rng, 0.3))
        error = error_of(found.transform, truth)
        inside.append(
            error @ np.linalg.solve(found.covariance, error) < region_quantile(0.95, found.degrees_of_freedom)
        )
    assert found.degrees_of_freedom == 4
    assert np.mean(inside) > 0.87  # 2.6 standard deviations of a share of 60; χ² gives 0.7
    assert region_quantile(0.95, None) == pytest.approx(stats.chi2.ppf(0.95, 6))
    assert region_quantile(0.95, 10**7) == pytest.approx(region_quantile(0.95, None), rel=1e-5)


def test_views_together_have_the_poses_they_have_alone():
    rng = np.random.default_rng(19)
    shapes = [BOARD, TAG, CUBE, BOARD[:20], rng.uniform(-0.1, 0.1, (9, 3)), BOARD[3:40]]
    views = [observed(WIDE, some_pose(rng), points, rng, 0.2, str(i)) for i, points in enumerate(shapes)]
    options = PoseOptions(noise_px=0.2)
    for view, outcome in zip(views, estimate_poses(WIDE, views, options), strict=True):
        alone = estimate_poses(WIDE, [view], options)[0].value
        together = outcome.value
        # sums over arrays that are filled up may be taken in another order: rounding, times the conditioning
        np.testing.assert_allclose(error_of(together.transform, alone.transform), 0, atol=1e-9)
        np.testing.assert_allclose(together.covariance, alone.covariance, rtol=1e-6, atol=1e-18)
        assert len(together.alternatives) == len(alone.alternatives)
        assert together.inliers.all()


def test_an_object_far_from_the_origin_of_its_map_has_its_pose_and_its_covariance():
    rng = np.random.default_rng(23)
    far, sigma = np.array([4e3, 5.4e4, 300.0]), 0.3
    truths = [some_pose(rng) for _ in range(50)]
    views = [observed(PINHOLE, truth, CUBE, rng, sigma) for truth in truths]
    options = PoseOptions(noise_px=sigma)
    near = estimate_poses(PINHOLE, views, options)
    away = estimate_poses(PINHOLE, [replace(view, points=view.points + far) for view in views], options)
    for one, other in zip(near, away, strict=True):
        np.testing.assert_allclose(other.value.transform.rotation, one.value.transform.rotation, atol=1e-6)
        # where the points are, in the camera: coordinates of 5e4 m are told to 1e-11 m
        here, there = one.value.transform.apply(CUBE), other.value.transform.apply(CUBE + far)
        np.testing.assert_allclose(here, there, atol=1e-6)
        assert other.value.condition == pytest.approx(one.value.condition, rel=1e-3)
        # brought back to the object, the covariance is the same but for the digits that cancel: (5e4)² of 1e-16
        back = se3.shift_jacobians(se3.of_poses([other.value.transform]), far[None])[0]
        returned = back @ other.value.covariance @ back.T
        np.testing.assert_allclose(np.diag(returned), np.diag(one.value.covariance), rtol=0.01)


def test_a_prior_moves_with_the_frame_of_the_object():
    rng = np.random.default_rng(24)
    view = observed(PINHOLE, some_pose(rng), CUBE, rng, 0.3)
    known = PosePrior(some_pose(rng), np.diag([1e-4] * 3 + [1e-3] * 3))
    found = estimate_poses(PINHOLE, [view], PoseOptions(noise_px=0.3, prior=known))[0].value
    other_T_object = Pose(np.eye(3), np.array([0.5, -0.3, 0.2]))
    back = se3.shift_jacobians(se3.of_poses([known.pose]), -other_T_object.translation[None])[0]
    moved = PosePrior(known.pose @ other_T_object.inverse(), back @ known.covariance @ back.T)
    options = PoseOptions(noise_px=0.3, prior=moved)
    again = estimate_poses(PINHOLE, [replace(view, points=other_T_object.apply(CUBE))], options)[0].value
    expected = found.transform @ other_T_object.inverse()
    np.testing.assert_allclose(error_of(again.transform, expected), 0, atol=1e-4)  # the prior's pull is not linear


@settings(max_examples=15)
@given(
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-5, 5)] * 3),
    st.floats(0.01, 100),
    st.sampled_from(["board", "cube"]),
)
def test_another_frame_or_unit_of_the_object_changes_the_pose_by_just_that(vector, place, scale, shape):
    rng = np.random.default_rng(20)
    points = {"board": BOARD, "cube": CUBE}[shape]
    view = observed(PINHOLE, some_pose(rng), points, rng, 0.3)
    options = PoseOptions(noise_px=0.3)
    found = estimate_poses(PINHOLE, [view], options)[0].value
    other_T_object = Pose.from_vector(np.array(vector), np.array(place))
    moved = Correspondences("a", scale * other_T_object.apply(points), view.pixels)
    again = estimate_poses(PINHOLE, [moved], options)[0].value
    expected = found.transform @ other_T_object.inverse()
    size = scale * (1 + np.linalg.norm(place))
    error = error_of(again.transform, Pose(expected.rotation, scale * expected.translation))
    # the solver stops within 1e-3 standard deviations: 1e-4 rad and 1e-4 m at the most
    np.testing.assert_allclose(error / [*[size] * 3, 1, 1, 1], 0, atol=2e-6)
    assert again.p_wrong == pytest.approx(found.p_wrong, abs=1e-6)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (TAG[:3], "a pose needs 4 different points or more, found 3"),
        (np.vstack([TAG[:3], TAG[:2]]), "found 3"),
        (np.outer(np.arange(5), [0.01, 0.02, 0.0]), "all 5 points are collinear"),
    ],
    ids=["three", "repeated", "collinear"],
)
def test_points_that_cannot_fix_a_pose_are_refused(points, message):
    rng = np.random.default_rng(15)
    outcome = estimate_poses(PINHOLE, [observed(PINHOLE, some_pose(rng), points, rng)])[0]
    assert isinstance(outcome.error, InsufficientData)
    assert message in str(outcome.error)


def test_a_view_without_a_pose_does_not_touch_the_others():
    rng = np.random.default_rng(16)
    good = observed(PINHOLE, some_pose(rng), BOARD, rng, 0.3, "good")
    alone = estimate(PINHOLE, good)
    outcomes = estimate_poses(PINHOLE, [good.take(np.arange(3)), good])
    assert [outcome.error is None for outcome in outcomes] == [False, True]
    np.testing.assert_array_equal(outcomes[1].value.covariance, alone.covariance)


@pytest.mark.parametrize("outliers", ["none", "few", "many"])
def test_a_view_that_leaves_its_pose_open_is_told_among_the_others(outliers):
    rng = np.random.default_rng(25)
    views = [observed(PINHOLE, some_pose(rng), CUBE, rng, 0.3, str(i)) for i in range(3)]
    views.insert(1, Correspondences("point", CUBE, np.tile([300.0, 400.0], (8, 1))))
    options = PoseOptions(noise_px=0.3, outliers=outliers)
    outcomes = estimate_poses(PINHOLE, views, options)
    assert [outcome.error is None for outcome in outcomes] == [True, False, True, True]
    assert isinstance(outcomes[1].error, InsufficientData)
    assert str(outcomes[1].error).startswith("point: ")
    for view, outcome in zip(views, outcomes, strict=True):
        if outcome.value is not None:
            alone = estimate_poses(PINHOLE, [view], options)[0].value
            np.testing.assert_allclose(outcome.value.residuals, alone.residuals, atol=1e-6)  # where the solver stops
            np.testing.assert_allclose(outcome.value.covariance, alone.covariance, rtol=1e-5, atol=1e-15)


def test_pixels_outside_the_lens_domain_are_left_out_and_counted():
    rng = np.random.default_rng(17)
    truth = some_pose(rng)
    view = observed(FISHEYE, truth, BOARD, rng, 0.0)
    pixels = view.pixels.copy()
    pixels[0] = [1e5, 1e5]
    found = estimate(FISHEYE, Correspondences("a", BOARD, pixels))
    assert found.used == 53
    assert np.isnan(found.residuals[0]).all()
    np.testing.assert_allclose(error_of(found.transform, truth), 0, atol=1e-10)


def test_numbers_that_are_not_finite_are_refused():
    with pytest.raises(InvalidInput, match="not a finite number"):
        Correspondences("a", TAG, np.full((4, 2), np.nan))
    with pytest.raises(InvalidInput, match="not positive"):
        Correspondences("a", TAG, np.zeros((4, 2)), np.zeros((4, 2, 2)))
    for wrong in ({"noise_px": -1.0}, {"threshold_px": np.nan}):
        with pytest.raises(InvalidInput, match="not positive"):
            PoseOptions(**wrong)


@pytest.mark.parametrize(
    "pixels",
    [
        [(192.5, 0), (540.7, 23.5), (1175.5, 849.2), (314.1, 203), (80.2, 157.8), (0, 171.3), (959, 0), (959, 1)],
        [(499.3, 959), (0, 0), (279.3, 959), (1, 0), (289.4, 0)],
    ],
)
def test_pixels_that_no_pose_explains_end_without_a_warning(pixels):
    for flat in (False, True):
        points = np.random.default_rng(18).uniform(-0.1, 0.1, (len(pixels), 3)) * [1, 1, 0 if flat else 1]
        outcome = estimate_poses(PINHOLE, [Correspondences("a", points, np.array(pixels))])[0]
        assert outcome.error is not None or np.isfinite(outcome.value.covariance).all()


@settings(max_examples=15)  # each costs four refinements
@given(st.lists(st.tuples(st.floats(0, 1279), st.floats(0, 959)), min_size=4, max_size=8), st.booleans())
def test_any_pixels_give_a_pose_or_one_clear_error(pixels, flat):
    rng = np.random.default_rng(18)
    points = rng.uniform(-0.1, 0.1, (len(pixels), 3)) * [1, 1, 0 if flat else 1]
    outcome = estimate_poses(PINHOLE, [Correspondences("a", points, pixels)])[0]
    if outcome.error is None:
        assert np.isfinite(outcome.value.covariance).all()
        assert np.isfinite(outcome.value.residuals).all()
    else:
        assert isinstance(outcome.error, InsufficientData)


def test_squared_residuals_are_those_of_mahalanobis():
    camera = LENSES["pinhole"]
    rng = np.random.default_rng(31)
    points = rng.uniform(-0.2, 0.2, (20, 3))
    view, truth = observed(camera, some_pose(rng), points, rng, noise_px=1.0), some_pose(rng)
    shapes = rng.normal(size=(20, 2, 2))
    covariance = 0.1 * np.eye(2) + shapes @ shapes.swapaxes(1, 2)
    packed = PackedCorrespondences.of(camera, [replace(view, covariance=covariance)], Pose.identity())
    found = packed.squared(se3.of_poses([truth]), np.zeros(1, int))[0]
    residuals = camera.project(truth.apply(points)).pixels - view.pixels
    expected = np.einsum("ni,nij,nj->n", residuals, np.linalg.inv(covariance), residuals)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_allclose(packed.variances()[0], np.trace(covariance, axis1=1, axis2=2) / 2, rtol=1e-9)


def test_the_least_depth_is_that_of_the_nearest_inlier_in_front_of_the_camera():
    camera = Camera(model_named("pinhole"), (1280, 960), [800.0, 800.0, 640.0, 480.0])
    rng = np.random.default_rng(32)
    middle = np.array([5.0, -3.0, 7.0])  # far from the object's origin
    points = middle + rng.uniform(-0.2, 0.2, (12, 3))
    truth = Pose.from_vector(np.array([0.2, -0.4, 0.1]), np.zeros(3))
    truth = Pose(truth.rotation, np.array([0.05, 0.02, 1.5]) - truth.rotation @ middle)
    found = estimate(camera, observed(camera, truth, points, rng), noise_px=0.1)
    assert found.least_depth == pytest.approx(truth.apply(points)[:, 2].min(), rel=1e-6)


@pytest.mark.parametrize(
    ("probability", "misfit", "status"),
    [(0.009, 1.0, "ok"), (0.011, 1.0, "ambiguous"), (0.0, 2.9, "ok"), (0.0, 3.1, "weak")],
)
def test_a_pose_is_trusted_up_to_a_hundredth_for_another_one_and_three_times_the_noise(probability, misfit, status):
    camera = Camera(model_named("pinhole"), (1280, 960), [800.0, 800.0, 640.0, 480.0])
    rng = np.random.default_rng(33)
    found = estimate(camera, observed(camera, some_pose(rng), rng.uniform(-0.1, 0.1, (30, 3)), rng), noise_px=0.1)
    other = Alternative(found.transform, 0.0, probability)
    assert replace(found, alternatives=(other,), misfit=misfit).status.split(":")[0] == status


def test_the_misfit_is_how_many_times_the_stated_noise_the_residuals_are():
    rng = np.random.default_rng(36)
    view = observed(PINHOLE, some_pose(rng), rng.uniform(-0.1, 0.1, (300, 3)), rng, noise_px=2.0)
    assert estimate(PINHOLE, view, noise_px=1.0).misfit == pytest.approx(2, rel=0.12)  # 4σ of 594 degrees of freedom


@pytest.mark.parametrize(
    ("turn", "share", "near"), [(0.099, 0, True), (0.101, 0, False), (0, 0.099, True), (0, 0.101, False)]
)
def test_poses_are_near_up_to_an_angle_and_a_share_of_the_distance(turn, share, near):
    first = Pose.from_vector(np.array([0.3, -0.2, 0.5]), np.array([0.0, 0.0, 2.0]))
    axis = np.array([0.6, 0.0, 0.8])
    second = Pose(
        Pose.from_vector(turn * axis, np.zeros(3)).rotation @ first.rotation, first.translation + 2 * share * axis
    )
    assert se3.near(se3.of_poses([first]), se3.of_poses([second]), 0.1).tolist() == [near]
