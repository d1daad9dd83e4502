"""What decides how a robot's poses are read and judged: each limit between 0.7 and 1.4 times its value."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from robot_scenes import board_at, hand_of, noisy, stacked

from camcal.calibrate.robot import estimator
from camcal.calibrate.robot.estimator import estimate_robot
from camcal.calibrate.robot.problem import Poses, RobotPoses, SeenPoses, _rotation, _weights, closed_form, pairs_of
from camcal.calibrate.robot.reading import (
    Motion,
    duplicates,
    fits_better,
    moved_from,
    read_robot,
    seen_form,
    shift_of,
    undetermined_axis,
)
from camcal.errors import InsufficientData
from camcal.formats.pose_text import form_named
from camcal.formats.robot_poses import RobotRows
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.report.handeye import report_of, systematic_messages
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.handeye_poses import by_time, candidates_of, require_enough, time_of

BELOW, ABOVE = 0.7, 1.4  # times a limit
SIDES = pytest.mark.parametrize(("times", "beyond"), [(BELOW, False), (ABOVE, True)])


def poses_of(vectors, places=None):
    vectors = np.asarray(vectors, float)
    return Poses(so3.exp(vectors), np.zeros_like(vectors) if places is None else np.asarray(places, float))


def test_five_poses_are_enough():
    with pytest.raises(InsufficientData, match="4 images with the board and a pose of the robot; 5 or more"):
        require_enough(4)
    require_enough(5)


@SIDES
def test_another_reading_is_named_where_it_fits_three_times_better(times, beyond):
    assert fits_better(SimpleNamespace(score=3 * times), SimpleNamespace(score=1.0)) == beyond
    assert fits_better(SimpleNamespace(score=1e-7 * times), SimpleNamespace(score=0.0)) == beyond


def turned_about_two(largest, ratio):
    """Poses that turned by so much (rad) about x, and by a share of it about y."""
    return poses_of([[largest * a, largest * ratio * b, 0] for a in (-0.5, 0, 0.5) for b in (-0.5, 0, 0.5)])


@SIDES
def test_turns_about_a_second_axis_count_from_a_seventh_of_the_first_on(times, beyond):
    assert (undetermined_axis(turned_about_two(0.2, 0.15 * times)) is None) == beyond


@SIDES
def test_a_hand_has_turned_from_five_degrees_on(times, beyond):
    turned = np.radians(5) * times / np.sqrt(2)
    found = undetermined_axis(turned_about_two(turned, 1.0))
    assert (found is None) == beyond
    assert beyond or not found.any()


def boards(before, after, apart):
    """Where poses say that the board is, with a spread of 1 about two places."""
    count = before + after
    sign = np.where(np.arange(count) % 2, 1.0, -1.0)
    places = np.repeat(sign[:, None] * np.sqrt((count - 2) / count), 3, axis=1)
    places[before:, 0] += apart
    return SimpleNamespace(boards=places)


@SIDES
def test_a_board_has_moved_from_an_f_of_25_on(times, beyond):
    # 6 poses before and after: F is the square of the distance, which is well above 4 standard deviations
    assert moved_from(boards(6, 6, np.sqrt(25 * times))) == (6 if beyond else None)


@SIDES
def test_a_board_has_moved_from_four_standard_deviations_on(times, beyond):
    # of 60 poses each F is far above 25
    assert moved_from(boards(60, 60, 4 * times)) == (60 if beyond else None)


@pytest.mark.parametrize(("after", "told"), [(2, False), (3, True), (4, True)])
def test_a_board_has_moved_where_three_poses_or_more_say_so(after, told):
    assert (moved_from(boards(20, after, 500.0)) == 20) == told


@SIDES
def test_poses_are_the_same_within_a_hundredth_of_a_millimetre_and_a_two_hundredth_of_a_degree(times, beyond):
    places, turns = np.zeros((2, 3)), np.zeros((2, 3))
    places[1, 0] = 1e-5 * times
    assert duplicates(poses_of(turns, places)) == (not beyond)
    turns[1, 1] = 9e-5 * times
    assert duplicates(poses_of(turns)) == (not beyond)


@SIDES
def test_a_shift_of_a_list_is_told_beyond_the_rounding_of_angles(times, beyond):
    vectors = np.random.default_rng(3).normal(0, 1, (12, 3))

    def lists(size):
        robot = poses_of(size * vectors)
        return robot, robot.take(np.roll(np.arange(12), 1)).inverse()

    robot, camera = lists(1e-3)
    pairs = pairs_of(12)
    angles = [
        np.linalg.norm(so3.log(np.swapaxes(each[pairs[0]], 1, 2) @ each[pairs[1]]), axis=1)
        for each in (robot.rotations, camera.inverse().rotations)
    ]
    size = 1e-3 * 1.7e-4 * times / np.median(np.abs(angles[0] - angles[1]))
    robot, camera = lists(size)
    assert (shift_of([("", robot)], camera) != 0) == beyond


@SIDES
def test_boards_farther_off_than_20_are_in_mm(times, beyond):
    camera = poses_of(np.zeros((6, 3)), np.tile([0.0, 0.0, 20 * times], (6, 1)))
    said, found = seen_form([("", camera)], [("matrix", camera)], (1.0,), True)
    assert said == ("matrix, mm" if beyond else "matrix")
    assert found.translations[0, 2] == pytest.approx(20 * times * (1e-3 if beyond else 1))


def test_turns_below_three_degrees_say_nothing_of_axes():
    rng, right, wrong = np.random.default_rng(5), so3.exp(np.array([0.3, -0.2, 0.5])), so3.exp(np.array([0.0, 1.0, 0]))
    axes = rng.normal(size=(25, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    eye = axes * np.radians(3) * np.r_[np.full(20, BELOW), np.full(5, ABOVE)][:, None]
    hand = np.concatenate([eye[:20] @ wrong.T, eye[20:] @ right.T])
    np.testing.assert_allclose(_rotation(hand, eye), right, atol=1e-9)


def test_weights_fall_to_a_half_at_two_standard_deviations():
    assert _weights(np.array([1.0, 1.0, 1.0, 2 * 1.4826]))[3] == pytest.approx(0.5)


def test_no_more_than_about_4000_pairs_of_poses_are_looked_at():
    assert [len(pairs_of(count)[0]) for count in (90, 128)] == [4005, 4064]


def clock(late, length, step=0.01, count=12):
    """The delay that is found of poses that are late by so many s, over a length in s."""
    stamps = np.arange(0, length, step)
    times = np.linspace(0.3, 0.7, count) * length
    motion = Motion(stamps + late, stacked(hand_of(map(board_at, stamps))))
    return motion.delay(times, stacked([board_at(time) for time in times]))


def test_clocks_differ_by_two_seconds_at_most():
    assert clock(2 * BELOW, 24.0) == pytest.approx(2 * BELOW, abs=6e-3)
    assert abs(clock(2 * ABOVE, 24.0)) <= 2


def test_clocks_differ_by_a_quarter_of_what_the_poses_take_at_most():
    assert clock(BELOW, 4.0) == pytest.approx(BELOW, abs=6e-3)
    assert abs(clock(ABOVE, 4.0)) <= 1


def test_two_thousand_delays_are_tried():
    # 0.002 s apart: poses are each 0.001 s
    assert clock(0.0054, 9.0, step=0.001, count=6) == pytest.approx(0.006, abs=1e-6)


@pytest.fixture(scope="module")
def found():
    """Hand and eye of poses of the board, one of the robot's 0.2 m off."""
    rng = np.random.default_rng(7)
    seen = [board_at(time) for time in np.linspace(0, 20, 30)]
    robot = noisy(hand_of(seen), 5e-4, 5e-4, rng)
    robot[12] = Pose(robot[12].rotation, robot[12].translation + np.array([0.2, 0.0, 0.0]))
    measured = stacked(noisy(seen, 1e-5, 1e-5, rng))
    poses = RobotPoses(stacked(robot), np.arange(30), True, (1.0, 1.0), np.ones(30))
    problem = SeenPoses(measured, np.tile(np.eye(6) * 1e-10, (30, 1, 1)))
    return estimate_robot(problem, measured, poses, closed_form(poses.world_T_carrier, measured))


def test_weights_of_poses_are_those_of_a_student_distribution_of_four_degrees_of_freedom(found):
    distance = np.sum((found.residuals[12].reshape(2, 3) / np.array(found.sigmas)[:, None]) ** 2)
    assert found.weights[12] * distance == pytest.approx(4 + 6, rel=0.1)
    assert 2.0 < found.weights.max() < (4 + 6) / 4


def report(found, **changed):
    return report_of(replace(found, **changed), {}, 0.0, tuple(map(str, range(30))), "", ())


@SIDES
def test_what_is_systematic_is_said_beyond_four_standard_deviations(times, beyond):
    for name in ("scale", "delay"):
        assert bool(systematic_messages({name: (4e-3 * times, 1e-3)}, ())) == beyond


@SIDES
def test_lengths_of_a_robot_that_are_wrong_by_more_than_half_are_poses_of_other_images(times, beyond):
    assert bool(systematic_messages({"scale": (0.5 * times, 1e-3)}, ())) != beyond


@SIDES
def test_a_pose_is_doubtful_below_a_weight_of_0_2(found, times, beyond):
    weights = np.ones(30)
    weights[4] = 0.2 * times
    assert report(found, weights=weights).doubtful == (() if beyond else ("4",))


@SIDES
@pytest.mark.parametrize("sigmas", [(5e-3, 0.0), (0.0, 8.7e-3)])
def test_noise_of_no_robot_is_said(found, sigmas, times, beyond):
    own = report(found, sigmas=tuple(sigma * times + 1e-6 for sigma in sigmas))
    assert ("large_robot_noise" in [each.code for each in own.warnings]) == beyond


def with_linear_errors(found, count, share):
    """What is said of some of the poses whose position errors are linear in position to a share of their variance."""
    robot = found.problem.robot
    places = robot.base_T_hand.translations[:count]
    terms = np.column_stack([np.ones(count), places - places.mean(axis=0)])
    noise = np.random.default_rng(9).normal(size=(count, 3))
    noise -= terms @ np.linalg.lstsq(terms, noise, rcond=None)[0]
    linear = terms[:, 1:].copy()
    # of n poses, 4 terms spent: 1 - (N / (n - 4)) / ((N + L) / (n - 1)) is the share
    ratio = ((count - 1) / (count - 4)) / (1 - share) - 1
    linear *= np.sqrt(ratio * np.sum(noise**2) / np.sum(linear**2))
    residuals = np.zeros((30, 6))
    residuals[:count, :3] = (noise + linear) * 1e-4
    weights = np.r_[np.ones(count), np.zeros(30 - count)]  # what is doubtful is left out
    return report(found, residuals=residuals, weights=weights)


@SIDES
def test_errors_are_systematic_from_a_share_of_0_3_on(found, times, beyond):
    own = with_linear_errors(found, 30, 0.3 * times)
    assert own.linear == pytest.approx(0.3 * times, abs=1e-6)
    assert ("systematic_robot" in [each.code for each in own.warnings]) == beyond


@SIDES
def test_errors_of_few_poses_are_systematic_where_noise_is_so_in_one_of_1000_lists(found, times, beyond):
    from scipy.special import fdtri

    # of 9 poses, 9 terms' coordinates and 15 that are left; the share that F is of
    ratio = 9 / 15 * fdtri(9, 15, 1 - 1e-3 / times)
    share = 1 - (8 / 5) / (1 + ratio)
    own = with_linear_errors(found, 9, share)
    assert own.linear == pytest.approx(share, abs=1e-6)
    assert ("systematic_robot" in [each.code for each in own.warnings]) == beyond


@pytest.mark.parametrize(("name", "time"), [("70000000000", 7e10), ("140000000000", 140.0)])
def test_names_that_are_large_numbers_are_nanoseconds(name, time):
    view = BoardDetection(f"{name}.png", (10, 10), np.zeros(1, int), np.zeros((1, 2)))
    assert time_of(view) == pytest.approx(time)


@pytest.mark.parametrize(("share", "timed"), [(0.35, False), (0.7, True)])
def test_poses_go_by_time_where_half_of_the_images_are_of_their_hours(share, timed):
    rows = RobotRows(np.column_stack([np.arange(10.0), np.ones((10, 7))]))
    inside = round(20 * share)
    assert by_time(rows, [5.0] * inside + [50.0] * (20 - inside)) == timed


def test_squares_of_few_degrees_of_freedom_weigh_as_what_is_as_likely_of_six():
    from scipy.stats import chi2

    share = np.array([0.5, 0.9, 0.99, 0.9999])
    for dof in (1.0, 3.0, 6.0):
        found = estimator._student_weights(chi2.ppf(share, dof), np.full(4, dof))
        np.testing.assert_allclose(10 / found - 4, chi2.ppf(share, 6), rtol=0.06)


def test_of_many_forms_that_fit_as_badly_a_few_are_looked_at():
    rng = np.random.default_rng(4)
    camera = poses_of(rng.normal(0, 0.3, (9, 3)), rng.normal(0, 0.1, (9, 3)))
    candidates = [(str(place), poses_of(rng.normal(0, 0.3, (9, 3)))) for place in range(30)]
    assert len(read_robot(candidates, camera, (1.0,), (False,), True)) == 12


@pytest.mark.parametrize("order", ["XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ"])
def test_of_orders_of_euler_angles_that_turn_by_the_same_the_right_one_is_told(order):
    """All twelve do where the first axis is the last one too."""
    seen = [board_at(time) for time in np.random.default_rng(1).uniform(0, 30, 12)]
    for words in (f"euler:{order}:intrinsic:deg", f"euler:{order.lower()}:extrinsic:deg"):
        numbers = np.array([form_named(words).numbers(hand) for hand in hand_of(seen)])
        candidates = candidates_of(RobotRows(numbers).forms(), numbers)
        assert read_robot(candidates, stacked(seen), (1.0,), (False,), True)[0].words == words


@pytest.mark.parametrize("dof", [1.0, 3.0, 6.0])
def test_the_student_distribution_counts_gaussian_errors_as_the_noise_says(dof):
    from scipy.integrate import quad
    from scipy.stats import chi2

    def weighed(square):
        return (
            float(estimator._student_weights(np.array([square]), np.array([dof]))[0]) * square * chi2.pdf(square, dof)
        )

    mean = (quad(weighed, 0, 5 * dof)[0] + quad(weighed, 5 * dof, 200)[0]) / dof
    assert estimator._consistency(np.array([dof])) == pytest.approx(mean, rel=5e-3)


def test_intervals_are_wider_by_those_of_student_of_three_degrees_of_freedom_or_more():
    # 3.182, 2.228 and 1.960 of tables
    found = estimator._widening(np.array([1.0, 3.0, 10.0, 1e9]))
    np.testing.assert_allclose(found, np.array([3.182, 3.182, 2.228, 1.960]) / 1.960, rtol=3e-4)
