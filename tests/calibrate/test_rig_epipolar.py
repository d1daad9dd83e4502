"""Epipolar errors of corners, by captures, between captures, and by what the other captures say."""

from dataclasses import replace

import numpy as np
import pytest
from test_rig_problem import made

from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.epipolar import between_captures, epipolar_by_capture, left_out_errors
from camcal.solve.steps import Step


def exact(problem, state):
    """The problem whose corners are where the state, without a shape of the board, has them."""
    bare = replace(state, shape=0 * state.shape, offsets=0 * state.offsets)
    parts = [
        replace(part, observations=replace(part.observations, pixels=0 * part.observations.pixels))
        for part in problem.parts
    ]
    zero = problem.with_parts(parts)
    pixels = [part.residuals(zero.of_camera(bare, camera)) for camera, part in enumerate(zero.parts)]
    return problem.with_parts(
        [
            replace(part, observations=replace(part.observations, pixels=own))
            for part, own in zip(problem.parts, pixels, strict=True)
        ]
    ), bare


def test_corners_of_the_state_have_no_error_in_the_captures_that_two_cameras_saw():
    problem, state = exact(*made())
    squares, counts = epipolar_by_capture(problem, state)
    np.testing.assert_array_equal(counts, problem.board.count * np.array([1, 1, 3, 1]))
    np.testing.assert_allclose(squares, 0, atol=1e-12)


def test_errors_between_captures_are_told_from_those_within_them():
    problem, state = made()
    rng = np.random.default_rng(3)

    def moved(between, within):
        parts = []
        for part in exact(problem, state)[0].parts:
            shape = part.observations.pixels.shape
            shift = between * rng.choice([-1.0, 1.0], (2, shape[1], 1)) + within * rng.normal(size=shape)
            parts.append(
                replace(part, observations=replace(part.observations, pixels=part.observations.pixels + shift))
            )
        return between_captures(problem.with_parts(parts), exact(problem, state)[1])

    assert moved(0.0, 0.3) < 0.8
    assert moved(1.0, 0.1) > 3.0


def test_a_capture_is_predicted_by_the_lenses_and_poses_without_it():
    problem, state = made()
    rng = np.random.default_rng(4)
    changes = rng.normal(size=(problem.count, problem.dense)) * 1e-4
    captures, errors = left_out_errors(problem, state, changes)
    for capture, change in enumerate(changes):
        step = Step(np.append(change, np.zeros(problem.shared - len(change))), np.zeros((problem.count, POSE)))
        squares, counts = epipolar_by_capture(problem, problem.retract(state, step))
        assert np.sum(captures == capture) == counts[capture]
        assert np.sum(errors[captures == capture] ** 2) == pytest.approx(squares[capture], rel=1e-9)
    same, unchanged = left_out_errors(problem, state, 0 * changes)
    assert np.sum(unchanged[same == 2] ** 2) == pytest.approx(epipolar_by_capture(problem, state)[0][2], rel=1e-12)
    assert np.abs(unchanged - errors).max() > 1e-3
