"""Hand and eye with the robot's own noise: truth is simulated."""

from functools import cache

import numpy as np
import pytest

from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, estimate_known, prior_of, wide_prior_of
from camcal.calibrate.robot.estimator import estimate_robot
from camcal.calibrate.robot.problem import Poses, RobotPoses, RobotProblem, RobotState, closed_form
from camcal.calibrate.robot.reading import (
    Reading,
    duplicates,
    fits_better,
    moved_from,
    read_robot,
    shift_of,
    undetermined_axis,
)
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.formats.pose_text import form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.solve.steps import Step
from camcal.targets.board import Board, Surface

BOARD = Board("chessboard", 9, 6, 0.025)
LENS = Camera(model_named("opencv4"), (1280, 960), [1100.0, 1101, 640, 478, -0.2, 0.08, 5e-4, -3e-4])
STD = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 2e-3, 1e-4, 1e-4])
CARRIER = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.05, -0.02, 0.08]))
WORLD = Pose.from_vector(np.array([0.02, 3.1, 0.03]), np.array([0.6, 0.1, 0.02]))


def stacked(poses):
    return Poses(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


def robot_of(camera_T_board, in_hand=True, shift=0.0, turn=0.0, rng=None):
    """What a robot says, with noise of its position (m) and rotation (rad), of poses of the board."""
    exact = [WORLD @ pose.inverse() @ CARRIER.inverse() for pose in camera_T_board]
    exact = exact if in_hand else [pose.inverse() for pose in exact]
    if rng is None:
        return exact
    return [
        Pose(pose.rotation @ so3.exp(rng.normal(0, turn, 3)), pose.translation + rng.normal(0, shift, 3))
        for pose in exact
    ]


def scene(seed, count=20, noise_px=0.1):
    rng = np.random.default_rng(seed)
    poses = views(LENS, BOARD, count, rng=rng)
    return poses, observe(LENS, BOARD, poses, noise_px=noise_px, rng=rng)[0].views, rng


def seen_by(detections, lens=LENS.parameters, *, free=False):
    """What the images alone say."""
    camera = Camera(LENS.model, LENS.image_size, lens, np.diag(STD**2))
    known = KnownCamera(camera, 0.05, Observations.of(detections), np.arange(len(detections)))
    prior = wide_prior_of(known) if free else prior_of(known)
    rig, _ = estimate_known([known], [Pose.identity()], KnownBoard(Surface.flat(BOARD)), {0: prior})
    return rig


def solve(detections, robot, in_hand=True, lens=LENS.parameters, *, free=False):
    return solve_seen(seen_by(detections, lens, free=free), robot, in_hand)


def solve_seen(rig, robot, in_hand=True):
    poses = RobotPoses(stacked(robot), np.arange(len(robot)), in_hand, (1.0, 1.0), np.ones(len(robot)))
    seen = Poses(rig.state.rotations, rig.state.translations)
    return rig, poses, estimate_robot(rig.problem, rig.state, poses, closed_form(poses.world_T_carrier, seen))


@cache
def repetition(seed):
    """Poses of the board, what the images of a wrong lens say of them, and the draws that go on from there."""
    poses, detections, rng = scene(seed)
    return poses, seen_by(detections, LENS.parameters + STD * rng.normal(size=8)), rng.bit_generator.state


def errors(found):
    pairs = ((found.carrier_T_rig, CARRIER), (found.world_T_board, WORLD))
    return np.concatenate(
        [
            part
            for own, true in pairs
            for part in (own.translation - true.translation, so3.log(own.rotation @ true.rotation.T))
        ]
    )


@pytest.mark.parametrize("in_hand", [True, False])
def test_an_exact_robot_gives_hand_and_eye_to_a_tenth_of_a_millimetre(in_hand):
    poses, detections, _ = scene(1)
    _, _, found = solve(detections, robot_of(poses, in_hand), in_hand)
    assert found.converged
    error = errors(found)
    assert np.abs(error[[0, 1, 2, 6, 7, 8]]).max() < 1.5e-4
    assert np.abs(error[[3, 4, 5, 9, 10, 11]]).max() < np.radians(0.02)
    assert found.sigmas[0] < 3e-5


@pytest.mark.slow
@pytest.mark.parametrize("in_hand", [True, False])
@pytest.mark.parametrize(("shift", "turn_deg"), [(1e-4, 0.02), (1e-3, 0.1)])
def test_noise_of_the_robot_and_intervals_are_right(in_hand, shift, turn_deg):
    turn, scores, sigmas = np.radians(turn_deg), [], []
    for seed in range(16):
        poses, rig, drawn = repetition(seed)
        rng = np.random.default_rng()
        rng.bit_generator.state = drawn
        _, _, found = solve_seen(rig, robot_of(poses, in_hand, shift, turn, rng), in_hand)
        scores.append(errors(found) / np.sqrt(np.diag(found.covariance)))
        sigmas.append(found.sigmas)
    ratio = np.sqrt(np.mean(np.square(sigmas), axis=0)) / [shift, turn]
    assert ratio == pytest.approx(1, abs=0.12)
    assert 0.85 < np.sqrt(np.mean(np.square(scores))) < 1.2
    assert np.mean(np.abs(scores) < 1.96) > 0.90


def test_a_pose_of_the_robot_that_is_off_hardly_counts():
    poses, detections, rng = scene(2)
    robot = robot_of(poses, True, 3e-4, 5e-4, rng)
    robot[4] = Pose(robot[4].rotation, robot[4].translation + np.array([0.02, 0.0, 0.0]))
    _, _, found = solve(detections, robot)
    assert found.weights[4] < 0.1 < found.weights[[0, 1, 2, 3, 5, 6]].min()
    assert found.sigmas[0] < 8e-4
    assert np.abs(errors(found)[:3]).max() < 1e-3


def test_a_free_lens_is_estimated_from_the_images():
    poses, detections, rng = scene(3)
    wrong = LENS.parameters * np.array([1.01, 1.01, 1, 1, 1, 1, 1, 1])
    robot = robot_of(poses, True, 1e-4, 1e-4, rng)
    held, free = solve(detections, robot, lens=wrong)[2], solve(detections, robot, lens=wrong, free=True)[2]
    assert np.abs(errors(free)[:3]).max() < 3e-4
    assert free.state.rig.lenses[0][0] == pytest.approx(1100, abs=1.5)
    assert np.linalg.norm(errors(held)[:3]) > 3 * np.linalg.norm(errors(free)[:3])


@pytest.mark.parametrize("in_hand", [True, False])
def test_derivatives_are_those_of_differences(in_hand):
    poses, detections, rng = scene(4, 6)
    rig, robot, _ = solve(detections, robot_of(poses, in_hand, 5e-3, 0.02, rng), in_hand)
    fixed = stacked([CARRIER, WORLD])
    problem, state = RobotProblem(rig.problem, robot), RobotState(rig.state, fixed)
    _, by_fixed, by_group = problem.robot_rows(state)
    step = 1e-6
    for column in range(12):
        moved = []
        for sign in (1, -1):
            shared = np.zeros(problem.shared)
            shared[rig.problem.shared + column] = sign * step
            moved.append(problem.robot_rows(problem.retract(state, Step(shared, np.zeros((6, 6)))))[0])
        np.testing.assert_allclose(by_fixed[..., column], (moved[0] - moved[1]) / (2 * step), atol=1e-7)
    for column in range(6):
        groups = np.zeros((6, 6))
        groups[:, column] = step
        ends = [
            problem.robot_rows(problem.retract(state, Step(np.zeros(problem.shared), own)))[0]
            for own in (groups, -groups)
        ]
        np.testing.assert_allclose(by_group[..., column], (ends[0] - ends[1]) / (2 * step), atol=1e-7)


FORMS = ["ros", "quat:wxyz", "colmap", "euler:ZYX:deg", "euler:XYZ:rad", "rvec", "matrix"]


def candidates(forms, numbers):
    return [
        (form, stacked([form_named(form).parse(row).pose() for row in numbers]))
        for form in forms
        if len(form_named(form).numbers(CARRIER)) == numbers.shape[1]
    ]


@pytest.mark.parametrize("in_hand", [True, False])
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("form", [form for form in FORMS if form not in ("quat:wxyz", "colmap")])
def test_form_direction_and_unit_are_told_by_the_images(form, inverted, in_hand):
    rng = np.random.default_rng(5)
    seen = views(LENS, BOARD, 12, rng=rng)
    robot = robot_of(seen, in_hand, 1e-3, 1e-3, rng)
    given = [pose.inverse() if inverted else pose for pose in robot]
    numbers = np.array([form_named(form).numbers(Pose(pose.rotation, 1000 * pose.translation)) for pose in given])
    found = read_robot(candidates(FORMS[:1] + FORMS[3:], numbers), stacked(seen), (1.0, 1e-3), (False, True), in_hand)[
        0
    ]
    assert (found.words, found.inverted, found.scale) == (form, inverted, 1e-3)
    np.testing.assert_allclose(found.poses.translations, stacked(robot).translations, atol=1e-9)
    wrong = read_robot([(form, candidates([form], numbers)[0][1])], stacked(seen), (1e-3,), (not inverted,), in_hand)[0]
    assert fits_better(wrong.fit, found.fit)
    assert not fits_better(found.fit, wrong.fit)


def reading(robot, seen, in_hand=True):
    poses = stacked(robot)
    return Reading("", False, 1.0, poses, closed_form(poses if in_hand else poses.inverse(), stacked(seen)))


@pytest.mark.parametrize("shift", [1, -1, 2])
def test_a_list_that_is_shifted_is_told_from_one_that_is_not(shift):
    rng = np.random.default_rng(6)
    seen = views(LENS, BOARD, 14, rng=rng)
    robot = robot_of(seen, True, 1e-3, 2e-3, rng)
    assert shift_of([("", stacked(robot))], stacked(seen)) == 0
    moved = robot[-shift:] + robot[:-shift]
    assert shift_of([("", stacked(moved))], stacked(seen)) == shift


@pytest.mark.parametrize("in_hand", [True, False])
def test_a_board_that_has_moved_is_told_with_the_first_pose_after(in_hand):
    rng = np.random.default_rng(7)
    seen = views(LENS, BOARD, 16, rng=rng)
    robot = robot_of(seen, in_hand, 5e-4, 5e-4, rng)
    assert moved_from(reading(robot, seen, in_hand).fit) is None
    away = Pose.from_vector(np.array([0.0, 0.0, 0.02]), np.array([0.03, 0.0, 0.0]))
    moved = [away @ pose if in_hand else pose @ away.inverse() for pose in robot[10:]]
    assert moved_from(reading(robot[:10] + moved, seen, in_hand).fit) == 10


def test_a_hand_that_turned_about_one_axis_leaves_the_place_open():
    axis = np.array([0.6, 0.0, 0.8])
    turned = [Pose.from_vector(angle * axis, np.array([0.1 * angle, 0.2, 0.0])) for angle in np.linspace(-1, 1, 9)]
    found = undetermined_axis(stacked(turned))
    assert abs(found @ axis) == pytest.approx(1, abs=1e-6)
    still = [Pose.from_vector(0.001 * k * axis, np.zeros(3)) for k in range(6)]
    assert not undetermined_axis(stacked(still)).any()
    both = [*turned, Pose.from_vector(np.array([0.5, 0.5, 0.0]), np.zeros(3))]
    assert undetermined_axis(stacked(both)) is None


def test_repeated_poses_are_counted():
    poses = robot_of(views(LENS, BOARD, 6, rng=np.random.default_rng(8)))
    assert duplicates(stacked(poses)) == 0
    assert duplicates(stacked([*poses, poses[0], poses[3]])) == 2
