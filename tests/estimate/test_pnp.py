"""Poses from points: synthetic truth for several lenses, the statistics of the covariance, the two planar minima.

Noise is Gaussian and the lens is exactly known here; what a wrong lens does to a pose is not shown.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pnp import AMBIGUOUS, Correspondences, estimate_poses
from camcal.estimate.pose_problem import PoseProblem
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy

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


def estimate(camera, view, noise_px=None, loss=None):
    outcome = estimate_poses(camera, [view], noise_px, loss)[0]
    assert outcome.error is None, outcome.error
    return outcome.value


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
    for _ in range(25):
        truth = some_pose(rng, (0.4, 1.0), 0.8)
        view = observed(PINHOLE, truth, rng.uniform(-0.1, 0.1, (count, 3)), rng, 0.5)
        found = estimate(PINHOLE, view, 0.5)
        reference = minimise(PoseProblem(PINHOLE, view.points, view.pixels), truth)
        assert np.sum(found.residuals**2) / 2 <= reference.cost + 1e-6  # both end within 1e-9 of the minimum's cost


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
    assert found[0].freedom == runs * (2 * len(points) - 6)
    low, high = stats.chi2.interval(0.99, found[0].freedom)
    assert low < found[0].freedom * (found[0].sigma_px / sigma) ** 2 < high


def test_a_small_far_tag_reports_both_of_its_poses():
    rng = np.random.default_rng(9)
    truth = Pose.from_vector(np.array([0.5, 0, 0]), np.array([0.0, 0, 3.0]))  # 27 px wide, tilted by 29°
    for _ in range(20):
        found = estimate(PINHOLE, observed(PINHOLE, truth, TAG, rng, 0.3), 0.3)
        tilts = [np.linalg.norm(error_of(pose, truth)[3:]) for pose in (found.transform, found.alternative.transform)]
        # one is the truth; the other has the normal reflected, so they are twice 29° apart
        assert min(tilts) < 0.5 < max(tilts)
        expected = 1 / (1 + np.exp(found.alternative.chi_square_difference / 2))
        assert found.p_wrong == pytest.approx(expected)
        assert found.status.startswith("ambiguous") == (found.p_wrong > AMBIGUOUS)


def test_the_probability_of_the_wrong_pose_is_how_often_it_wins():
    rng = np.random.default_rng(10)
    truths = [some_pose(rng, (2.0, 4.0), 0.3) for _ in range(100)]
    outcomes = estimate_poses(PINHOLE, [observed(PINHOLE, truth, TAG, rng, 0.3) for truth in truths], 0.3)
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


def test_covariances_of_pixels_count_up_to_a_common_factor():
    rng = np.random.default_rng(11)
    view = observed(PINHOLE, some_pose(rng), BOARD, rng, 0.3)
    covariance = np.eye(2) * rng.uniform(0.5, 2.0, (54, 1, 1)) + 0.2
    once, four = (estimate(PINHOLE, Correspondences("a", BOARD, view.pixels, f * covariance)) for f in (1, 4))
    np.testing.assert_allclose(error_of(once.transform, four.transform), 0, atol=1e-9)  # where the solver stops
    np.testing.assert_allclose(once.covariance, four.covariance, rtol=1e-4)
    assert once.sigma_px == pytest.approx(2 * four.sigma_px, rel=1e-6)
    assert np.linalg.norm(error_of(once.transform, estimate(PINHOLE, view).transform)) > 1e-6


def test_a_robust_loss_is_not_led_astray_by_an_outlier():
    rng = np.random.default_rng(12)
    truth = some_pose(rng)
    view = observed(PINHOLE, truth, BOARD, rng, 0.1)
    pixels = view.pixels.copy()
    pixels[7] += 20
    spoilt = Correspondences("a", BOARD, pixels)
    plain, robust = (error_of(estimate(PINHOLE, spoilt, 0.1, loss).transform, truth) for loss in (None, Cauchy(0.3)))
    assert np.linalg.norm(robust) < 0.2 * np.linalg.norm(plain)


def test_the_inverse_has_the_frames_exchanged_and_its_own_covariance():
    rng = np.random.default_rng(13)
    found = estimate(PINHOLE, observed(PINHOLE, some_pose(rng), TAG, rng, 0.3), 0.3)
    turned = found.inverse()
    assert (found.frames, turned.frames) == ("camera_T_object", "object_T_camera")
    np.testing.assert_allclose((found.transform @ turned.transform).matrix(), np.eye(4), atol=1e-14)
    np.testing.assert_allclose(turned.inverse().covariance, found.covariance, rtol=1e-9, atol=1e-18)
    assert turned.p_wrong == found.p_wrong


def test_pose_jacobian_is_the_derivative_of_the_whitened_residuals():
    rng = np.random.default_rng(14)
    pose = some_pose(rng)
    view = observed(WIDE, pose, BOARD[::7], rng, 1.0)
    problem = PoseProblem(WIDE, view.points, view.pixels, rng.normal(size=(len(view.points), 2, 2)))
    h = 1e-6
    sides = [[problem.blocks(pose.retract(s * h * axis))[0].residuals for s in (1, -1)] for axis in np.eye(6)]
    numeric = np.stack([(ahead - behind) / (2 * h) for ahead, behind in sides], axis=-1)
    values = problem.blocks(pose)[0].shared[0].values
    # central differences at h = 1e-6 of pixels near 1e3: 1e-13 of rounding over 1e-6, values up to 1e4
    np.testing.assert_allclose(values, numeric, atol=1e-3)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (TAG[:3], "a pose needs 4 different points or more, found 3"),
        (np.vstack([TAG[:3], TAG[:2]]), "found 3"),
        (np.outer(np.arange(5), [0.01, 0.02, 0.0]), "all 5 points lie on one line"),
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
    with pytest.raises(InvalidInput, match="not positive"):
        estimate_poses(PINHOLE, [], -1.0)


@settings(max_examples=25)  # each costs four refinements
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
