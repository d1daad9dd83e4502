"""The layout of a rig: derivatives by differences, equations by parts, what is left open by dense matrices."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from observed import PARAMETERS

from camcal.calibrate.effects import EffectColumns, motion_columns
from camcal.calibrate.problem import POSE, BoardProblem
from camcal.calibrate.rigs.effects import (
    KINDS,
    MOTION_DOF,
    SHIFT,
    TURN,
    CaptureEffects,
    moved_poses,
    moved_views,
    with_motion,
)
from camcal.calibrate.rigs.estimator import part_posteriors
from camcal.calibrate.rigs.fit import with_shares
from camcal.calibrate.rigs.measured import BoardPoses, KnownDistance, KnownRelation, Measured
from camcal.calibrate.rigs.problem import LensPrior, RigProblem, RigState
from camcal.cameras.catalogue import model_named
from camcal.cameras.observations import Observations
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import assemble, linearise
from camcal.solve.steps import Step, factorise
from camcal.targets.board import SCALE, Board, terms_of
from camcal.targets.board_set import board_set

BOARD = Board("chessboard", 4, 3, 0.05)
SEEN = (np.array([0, 1, 2, 3]), np.array([0, 2, 3]), np.array([1, 2]))  # captures of three cameras


def made(seed=0, *, offsets=True, terms=("xy", "P2(x)")):
    """A rig problem with noise in its pixels, and a state near its minimum."""
    rng = np.random.default_rng(seed)
    cameras = so3.exp(np.array([[0, 0, 0], [0.02, 0.2, 0.01], [-0.1, 0.05, 0.3]]))
    places = np.array([[0, 0, 0], [-0.12, 0.01, 0.02], [0.05, 0.1, 0.0]], float)
    rotations = so3.exp(0.3 * rng.normal(size=(4, 3)))
    translations = np.array([-0.08, -0.05, 0.8]) + 0.05 * rng.normal(size=(4, 3))
    model, lens = model_named("opencv5"), np.array(PARAMETERS["opencv5"])
    state = RigState(
        (lens, lens * 1.02, lens * 0.99),
        cameras,
        places,
        rotations=rotations,
        translations=translations,
        shape=1e-4 * rng.normal(size=len(terms)),
        offsets=1e-4 * rng.normal(size=(BOARD.count, 3)) if offsets else np.zeros((BOARD.count, 3)),
    )
    free = (np.arange(9), np.array([0, 1, 4]), np.arange(4))
    parts = []
    for camera, captures in enumerate(SEEN):
        empty = Observations(
            np.tile(np.arange(BOARD.count), (len(captures), 1)),
            np.zeros((2, len(captures), BOARD.count)),
            rng.uniform(0.5, 1, (len(captures), BOARD.count)),
            present=np.ones((len(captures), BOARD.count), bool),
        )
        part = BoardProblem(
            model,
            BOARD,
            empty,
            free[camera],
            terms,
            offsets,
            sigma=0.3,
            term_std=np.full(len(terms), 1e-3),
            offset_std=np.full(3, 1e-3),
            noise=rng.uniform(0.5, 2, len(captures)),
        )
        parts.append(part)
    problem = RigProblem(tuple(parts), SEEN, 4, {1: LensPrior(state.lenses[1][free[1]] + 0.5, 0.1 * np.eye(3))})
    parts = [
        replace(
            part,
            observations=replace(
                part.observations,
                pixels=(found := part.residuals(problem.of_camera(state, camera))) + 0.3 * rng.normal(size=found.shape),
            ),
        )
        for camera, part in enumerate(problem.parts)
    ]
    return problem.with_parts(parts), state


def on_two_boards(seed=0):
    """A rig problem of two boards on one body, which cameras see both in some captures; a distance is known."""
    rng = np.random.default_rng([seed, 1])
    problem, state = made(seed)
    together = board_set({"a": BOARD, "b": Board("chessboard", 5, 2, 0.05)})
    terms = terms_of(together, ("xy", SCALE))
    on_body = Pose.from_vector(np.array([0.1, -0.2, 0.3]), np.array([0.02, 0.2, 0.03]))
    state = replace(
        state,
        shape=1e-4 * rng.normal(size=len(terms)),
        offsets=1e-4 * rng.normal(size=(together.count, 3)),
        boards=BoardPoses(np.stack([np.eye(3), on_body.rotation]), np.stack([np.zeros(3), on_body.translation])),
    )
    parts, captures, bodies = [], [], []
    for part, own in zip(problem.parts, SEEN, strict=True):
        of_views = np.concatenate([own, own[1:]])  # all but the first capture show both
        boards = np.repeat([0, 1], [len(own), len(own) - 1])
        ids = np.array([np.arange(12), np.r_[12:22, 0, 0]])[boards]
        present = np.array([np.ones(12, bool), np.arange(12) < 10])[boards]
        observations = Observations(
            ids, np.zeros((2, *ids.shape)), np.where(present, rng.uniform(0.5, 1, ids.shape), 0.0), present=present
        )
        noise, stds = rng.uniform(0.5, 2, len(ids)), np.full(len(terms), 1e-3)
        parts.append(replace(part, board=together, observations=observations, terms=terms, term_std=stds, noise=noise))
        captures.append(of_views)
        bodies.append(boards)
    measured = Measured(
        (KnownRelation(0, 1, on_body, 1e-4 * np.eye(6)),), (KnownDistance((3, 15), (0, 1), 0.25, 1e-3),)
    )
    problem = RigProblem(
        tuple(parts),
        tuple(captures),
        4,
        problem.priors_of_lenses,
        bodies=tuple(bodies),
        attached=(1,),
        measured=measured,
    )
    parts = [
        replace(
            part,
            observations=replace(
                part.observations,
                pixels=(found := part.residuals(problem.of_camera(state, camera))) + 0.3 * rng.normal(size=found.shape),
            ),
        )
        for camera, part in enumerate(problem.parts)
    ]
    return problem.with_parts(parts), state


def cost_at(problem, state, shared, groups):
    blocks = problem.blocks(problem.retract(state, Step(shared, groups)))
    return sum(block.weighed()[0] for block in blocks)


@pytest.mark.parametrize("scene", [partial(made, offsets=False), made, on_two_boards])
def test_gradient_is_that_of_the_cost(scene):
    problem, state = scene()
    equations = linearise(problem, state)
    zero, none = np.zeros(problem.shared), np.zeros((4, POSE))
    for index in range(problem.shared):
        scale = 1e-4 if index < problem.lens_starts[-1] and equations.shared_shared[index, index] < 1e4 else 1e-7
        step = scale * np.eye(problem.shared)[index]
        slope = (cost_at(problem, state, step, none) - cost_at(problem, state, -step, none)) / (2 * scale)
        root = np.sqrt(equations.shared_shared[index, index])
        assert slope == pytest.approx(equations.gradient.shared[index], abs=1e-4 * root)
    for capture in range(4):
        for axis in range(POSE):
            step = none.copy()
            step[capture, axis] = 1e-7
            slope = (cost_at(problem, state, zero, step) - cost_at(problem, state, zero, -step)) / 2e-7
            root = np.sqrt(equations.group_group[capture, axis, axis])
            assert slope == pytest.approx(equations.gradient.groups[capture, axis], abs=1e-4 * root)


def separate(problem, state, columns=None):
    """The blocks and the equations of each camera alone."""
    found = []
    for camera, part in enumerate(problem.parts):
        own = problem.of_camera(state, camera)
        effects = None if columns is None else columns[camera].values
        found.append(problem.equations_of(state, camera, own, part.derivatives(own), effects))
    return [block for block, _ in found], [equations for _, equations in found]


@pytest.mark.parametrize("scene", [partial(made, offsets=False), made, on_two_boards])
def test_equations_of_single_cameras_join_to_those_of_the_rig(scene):
    problem, state = scene()
    whole = linearise(problem, state)
    found = problem.joined(
        separate(problem, state)[1], [np.zeros((len(own), 0), np.intp) for own in problem.captures], POSE
    )
    priors = assemble(problem.priors(state), problem.shared, 0, POSE)
    np.testing.assert_allclose(found.group_group, whole.group_group, rtol=1e-9)
    np.testing.assert_allclose(found.group_shared, whole.group_shared, atol=1e-9 * np.abs(whole.group_shared).max())
    shared = found.shared_shared + priors.shared_shared
    np.testing.assert_allclose(shared, whole.shared_shared, atol=1e-12 * np.abs(shared).max())
    np.testing.assert_allclose(found.gradient.shared + priors.gradient.shared, whole.gradient.shared, rtol=1e-7)
    assert found.cost + priors.cost == pytest.approx(whole.cost, rel=1e-12)
    np.testing.assert_allclose(problem.prior_precision(state), priors.shared_shared[: problem.dense, : problem.dense])


def dense(equations):
    """The normal matrix, groups first."""
    groups, size, shared = equations.group_shared.shape
    matrix = np.zeros((groups * size + shared,) * 2)
    for group in range(groups):
        own = slice(group * size, (group + 1) * size)
        matrix[own, own] = equations.group_group[group]
        matrix[own, groups * size :] = equations.group_shared[group]
        matrix[groups * size :, own] = equations.group_shared[group].T
    matrix[groups * size :, groups * size :] = equations.shared_shared
    return matrix


@pytest.mark.parametrize("scene", [partial(made, offsets=False), made])
def test_degrees_of_freedom_and_pose_covariances_are_those_of_the_whole_matrix(scene):
    problem, state = scene()
    blocks, equations = separate(problem, state)
    whole, empty = linearise(problem, state), [np.zeros((len(own), 0), np.intp) for own in problem.captures]
    found = part_posteriors(problem, state, factorise(whole), blocks, equations, empty, np.zeros((4, 0)))
    covariance, poses = np.linalg.inv(dense(whole)), 4 * POSE
    for camera, (own, left) in enumerate(zip(equations, found, strict=True)):
        columns = problem.columns(camera)
        for row, capture in enumerate(SEEN[camera]):
            only = np.arange(row, row + 1)
            part = problem.with_parts(
                [
                    replace(each, observations=each.observations.take(only), noise=each.noise[only])
                    if place == camera
                    else each
                    for place, each in enumerate(problem.parts)
                ]
            )
            part = replace(part, captures=tuple(SEEN[c][only] if c == camera else SEEN[c] for c in range(3)))
            state_of = part.of_camera(state, camera)
            single = part.equations_of(state, camera, state_of, part.parts[camera].derivatives(state_of), None)[1]
            places = np.concatenate([capture * POSE + np.arange(POSE), poses + columns])
            mine = covariance[np.ix_(places, places)]
            assert left.spent[row] + left.on_offsets[row] == pytest.approx(np.trace(mine @ dense(single)), rel=1e-6)
            np.testing.assert_allclose(
                left.poses[row],
                by_differences(problem, state, camera, row, mine, len(own.gradient.shared)),
                rtol=1e-4,
                atol=1e-6 * np.abs(left.poses[row]).max(),
            )


def by_differences(problem, state, camera, row, covariance, count):
    """The covariance of camera_T_board of one view by central differences of retracted states."""
    capture, columns = SEEN[camera][row], problem.columns(camera)
    before = problem.of_camera(state, camera)
    slopes = np.zeros((POSE, POSE + count))
    for index in range(POSE + count):
        ends = []
        for sign in (1e-6, -1e-6):
            step = Step(np.zeros(problem.shared), np.zeros((4, POSE)))
            if index < POSE:
                step.groups[capture, index] = sign
            else:
                step.shared[columns[index - POSE]] = sign
            after = problem.of_camera(problem.retract(state, step), camera)
            turn = so3.log(after.rotations[row] @ before.rotations[row].T)
            ends.append(np.concatenate([after.translations[row] - before.translations[row], turn]))
        slopes[:, index] = (ends[0] - ends[1]) / 2e-6
    return slopes @ covariance @ slopes.T


def test_values_and_names_are_of_lenses_and_poses():
    problem, state = made()
    names = problem.names(("a", "b", "c"))
    assert len(names) == problem.board_start == 9 + 3 + 4 + 12
    assert names[9:12] == ("b.fx", "b.fy", "b.k1")
    assert names[-12::6] == ("b_T_a.tx", "c_T_a.tx")
    moved = problem.retract(state, Step(np.arange(problem.shared) * 1e-6, np.zeros((4, POSE))))
    np.testing.assert_allclose(problem.change(state, moved), 1e-6 * np.arange(problem.board_start), atol=1e-12)
    values = problem.shared_values(moved) - problem.shared_values(state)
    np.testing.assert_allclose(values[:16], 1e-6 * np.arange(16), atol=1e-9)


def test_held_cameras_move_captures_only():
    problem, state = made()
    held, bare = problem.captures_only(state)
    assert held.shared == 0
    moved = held.retract(bare, Step(np.zeros(0), np.full((4, POSE), 1e-3)))
    np.testing.assert_array_equal(moved.camera_translations, state.camera_translations)
    assert np.abs(moved.translations - state.translations).min() == pytest.approx(1e-3)
    equations = linearise(held, bare)
    np.testing.assert_allclose(equations.group_group, linearise(problem, state).group_group, rtol=1e-9)


# Effects


def test_motion_columns_are_the_derivatives_by_shift_and_turn_about_the_centre():
    problem, state = made(offsets=False, terms=())
    assert [views.tolist() for views in moved_views(problem)] == [
        [False] * 4,
        [True] * 3,
        [True] * 2,
    ]
    own, part = problem.of_camera(state, 1), problem.parts[1]
    showing = part.observations.present & np.array([[True], [False], [True]])
    columns = motion_columns(BOARD, own.rotations, part.derivatives(own), showing)
    assert not columns[:, :, 1].any()
    for index in range(POSE):
        coefficients = np.zeros((3, POSE))
        ends = []
        for sign in (1e-6, -1e-6):
            coefficients[:, index] = sign
            ends.append(part.residuals(moved_poses(BOARD, own, coefficients)))
        slope = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(columns[:, index, ::2], slope[:, ::2], rtol=1e-5, atol=1e-4)


def test_coefficients_of_a_bending_board_are_those_of_the_capture():
    from camcal.calibrate.effects import EFFECTS

    effect = np.repeat(np.arange(len(EFFECTS)), [each.columns for each in EFFECTS])
    own = EffectColumns(np.zeros((2, len(effect), 1, 1)), effect)
    one = RigProblem((), (np.zeros(1, np.intp),) * 2, 1)
    layout = CaptureEffects.of([own, with_motion(own, np.zeros((2, POSE, 1, 1)))], one)
    shared = set(layout.slots[0].ravel()) & set(layout.slots[1].ravel())
    assert len(shared) == EFFECTS[2].columns
    assert {layout.kinds[layout.effect[slot]][0] for slot in shared} == {None}
    assert len(layout.effect) == 2 * len(effect) - len(shared) + POSE
    assert layout.of_kinds(SHIFT, TURN).sum() == POSE
    places = np.concatenate([slots[0] for slots in layout.slots])
    assert sorted(places.tolist()) == sorted([*range(len(layout.effect)), *shared])


def test_shift_and_turn_have_one_share_and_every_other_effect_has_its_own():
    from camcal.calibrate.effects import EFFECTS, SHARE_DOF

    effect = np.repeat(np.arange(len(EFFECTS)), [each.columns for each in EFFECTS])
    own = EffectColumns(np.zeros((2, len(effect), 1, 1)), effect)
    one = RigProblem((), (np.zeros(1, np.intp),) * 2, 1)
    layout = CaptureEffects.of([own, with_motion(own, np.zeros((2, POSE, 1, 1)))], one)
    scales = layout.start(4, (0.1, 0.2), 0.3)
    moving = [KINDS[kind] in (SHIFT, TURN) for _, kind in layout.kinds]
    assert sum(moving) == 2
    assert len(set(scales.share_of[moving])) == 1
    others = scales.share_of[np.logical_not(moving)]
    assert len(set(others)) == len(others) == 2 * 2 + 1
    assert not set(others) & set(scales.share_of[moving])
    np.testing.assert_array_equal(scales.share_dof[scales.share_of], np.where(moving, MOTION_DOF, SHARE_DOF))
    assert scales.shares.shape == (4, 6)


@pytest.mark.parametrize("motion", [False, True])
def test_what_a_capture_changes_is_larger_where_the_shares_of_the_others_follow(motion):
    left_out = np.random.default_rng(1).normal(size=(9, 2 * 4 + 6 + 3))
    problem = SimpleNamespace(lens_starts=(0, 4, 8), board_start=14)
    found = with_shares(left_out, SimpleNamespace(motion=motion, problem=problem))
    # (1 + 6 + 2) / (1 + 6) for six coordinates of a Student distribution of one degree of freedom
    factors = np.where((np.arange(17) >= 8) & (np.arange(17) < 14), 9 / 7 if motion else 1.0, 1.0)
    np.testing.assert_allclose(found, left_out * factors, rtol=1e-12)
