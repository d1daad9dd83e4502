"""Times by the motion of a board: derivatives by differences, chains by dense matrices, estimates by simulated truth.

The truth is no spline (see timed_scenes); its noise is that of corners alone. What detectors do to blurred or sheared
boards is not shown here.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from timed_scenes import BOARD, LENS, Clocked, Swing, by_hand, rotations

from camcal.calibrate.intrinsics import Options, compare_models
from camcal.calibrate.problem import POSE
from camcal.calibrate.timing import estimator
from camcal.calibrate.timing.calibrate import TimedCamera, _Source, _warnings, time_cameras
from camcal.calibrate.timing.estimator import _refine
from camcal.calibrate.timing.problem import READOUT, TimedCorners, TimeProblem, TimeState
from camcal.calibrate.timing.spline import Knots, Motion, motion_through
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.chains import WIDTH, ChainEquations, ChainFactors
from camcal.solve.least_squares import assemble
from camcal.solve.steps import NormalEquations, Step

READOUT_S = 0.02


@cache
def views_of(seed, *, frames=150, noise_px=0.1, dropped=0.0, **camera):
    rng = np.random.default_rng(seed)
    return Clocked(**{"readout": READOUT_S} | camera).views(by_hand(rng), frames, rng, noise_px, dropped)


LENSES = {}


def lens_of(views):
    """Return a brief calibration of rows as if they had been taken at once; that of the same corners is made once."""
    corners = tuple((view.image, view.pixels.tobytes()) for view in views)
    if corners not in LENSES:
        [found] = compare_models(views, BOARD, Options(LENS.model), [LENS.model])
        LENSES[corners] = found.calibration
    return LENSES[corners]


@cache
def timed(seed, *, frames=150, noise_px=0.1, **camera):
    views = views_of(seed, frames=frames, noise_px=noise_px, **camera)
    own = TimedCamera(lens_of(views), views, as_designed=True)
    return time_cameras({"": own}, offsets=False, shutter=True), views


def small(seed=0):
    """Return a problem of two cameras with all times free, and a state near its minimum."""
    rng = np.random.default_rng(seed)
    knots = Knots.over(0.0, 1.0, 0.25)
    turns, moved = 0.2 * rng.normal(size=(knots.nodes, 3)), 0.03 * rng.normal(size=(knots.nodes, 3))
    motion = Motion(knots, so3.to_quaternion(so3.exp(turns)), moved + np.array([-0.1, -0.06, 0.6]))
    cameras = []
    for _ in range(2):
        ids = rng.integers(0, BOARD.count, 60)
        own = rng.uniform(0.1, 0.9, 60), rng.uniform(0, 1, 60), rng.uniform(0.5, 1, 60)
        cameras.append(TimedCorners(LENS.model, np.array([0, 2, 4]), np.zeros((2, 60)), ids, *own, sigma=0.2))
    basis = 1e-3 * rng.normal(size=(BOARD.count, 3, 2))
    free = np.array([[False, True], [False, True], [True, True]])
    problem = TimeProblem(tuple(cameras), BOARD.points(), basis, np.array([0.5, 2.0]), free, knots.spans)
    lens = LENS.parameters
    poses = so3.exp(np.array([[0, 0, 0], [0.05, -0.1, 0.02]])), np.array([[0, 0, 0], [0.1, 0.01, 0.02]], float)
    times = np.array([[0, 0.01], [0, 1e-3], [0.02, 0.015]])
    state = TimeState((lens, 1.01 * lens), *poses, times, np.array([0.3, -0.2]), motion)
    seen = [
        replace(own, pixels=problem.residuals(state, place) + rng.normal(0, 0.3, (2, 60)))
        for place, own in enumerate(problem.cameras)
    ]
    return replace(problem, cameras=tuple(seen)), state


def test_derivatives_are_those_of_differences():
    problem, state = small()
    spans = assemble(problem.blocks(state), problem.shared, *problem.groups)
    found = ChainEquations.of(spans)
    nodes = state.motion.knots.nodes

    def cost(shared, groups):
        moved = problem.retract(state, Step(shared, groups.reshape(nodes, POSE)))
        return assemble(problem.blocks(moved), problem.shared, *problem.groups).cost

    width, step = problem.shared + POSE * nodes, 1e-6
    gradient = np.zeros(width)
    for column in range(width):
        moved = np.zeros(width)
        moved[column] = step
        ahead = cost(moved[: problem.shared], moved[problem.shared :])
        gradient[column] = (ahead - cost(-moved[: problem.shared], -moved[problem.shared :])) / (2 * step)
    scale = np.abs(gradient).max()
    # differences of step 1e-6 are good to 1e-9 of the largest; columns are scaled apart by 1e4
    np.testing.assert_allclose(gradient[: problem.shared], found.shared_gradient, atol=1e-6 * scale, rtol=1e-5)
    np.testing.assert_allclose(gradient[problem.shared :], found.node_gradient, atol=1e-6 * scale, rtol=1e-5)


def test_a_chain_is_solved_as_its_dense_matrix_would_be():
    rng = np.random.default_rng(3)
    spans, size, shared = 5, 2, 3
    width = WIDTH * size
    nodes = (spans + WIDTH - 1) * size
    dense, gradient = np.zeros((nodes + shared,) * 2), np.zeros(nodes + shared)
    groups, by_shared, right = (
        np.zeros((spans, width, width)),
        np.zeros((spans, width, shared)),
        np.zeros((spans, width)),
    )
    own, own_right = np.eye(shared), np.zeros(shared)
    dense[nodes:, nodes:] += np.eye(shared)
    for span in range(spans):
        rows = rng.normal(size=(20, width + shared))
        residuals = rng.normal(size=20)
        square, pulled = rows.T @ rows, rows.T @ residuals
        groups[span], by_shared[span], right[span] = square[:width, :width], square[:width, width:], pulled[:width]
        own, own_right = own + square[width:, width:], own_right + pulled[width:]
        places = np.r_[span * size : span * size + width, nodes : nodes + shared]
        dense[np.ix_(places, places)] += square
        gradient[places] += pulled
    equations = NormalEquations(1.0, Step(own_right, right), groups, by_shared, own, np.zeros(0), np.zeros(0))
    factors = ChainFactors.of(ChainEquations.of(equations))
    expected = np.linalg.solve(dense, -gradient)
    step = factors.solve()
    np.testing.assert_allclose(np.r_[step.groups.ravel(), step.shared], expected, rtol=1e-4, atol=1e-6)  # held by 1e-6
    covariance = np.linalg.inv(dense)[nodes:, nodes:]
    np.testing.assert_allclose(factors.shared_covariance, covariance, rtol=1e-4)


def test_a_refined_spline_is_the_same_motion():
    _, state = small()
    times = np.linspace(0, 1, 50)
    coarse, fine = state.motion.at(times), state.motion.refined().at(times)
    np.testing.assert_allclose(fine.translations, coarse.translations, atol=1e-12)
    np.testing.assert_allclose(fine.velocities, coarse.velocities, atol=1e-12)
    # quaternions of nodes are unit again, by which turns change a little
    assert np.abs(fine.quaternions - coarse.quaternions).max() < 1e-3


def test_a_spline_goes_through_poses_but_for_a_few_that_are_wrong():
    motion = by_hand(np.random.default_rng(2))
    times = np.arange(120) / 30
    turned, moved = motion.at(times)
    wrong = turned.copy()
    wrong[[20, 70]] = turned[[20, 70]] @ rotations(np.array([[0.0, 0, np.pi]]))
    found = motion_through(Knots.over(0, times[-1], 2 / 30), times, wrong, moved).at(times)
    assert np.abs(found.translations.T - moved).max() < 5e-4
    apart = so3.log(turned.transpose(0, 2, 1) @ so3.from_quaternion(found.quaternions.T))
    assert np.abs(apart).max() < 0.02


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_readout_time_is_within_its_interval(seed):
    times, _ = timed(seed)
    own = times.cameras[""]
    assert 5e-5 < own.readout_std < 2e-4  # 0.25 to 1 % of it
    assert abs(own.readout - READOUT_S) < 3 * own.readout_std
    assert own.offset == own.offset_std == 0
    assert not times.warnings


@cache
def shaken(hertz, seed=0):
    """Return the times of a camera before a board that is moved by hand and shakes at so many hertz."""
    rng = np.random.default_rng(seed)
    hand = by_hand(rng)
    size = np.array([[0.003], [0.003], [0.003], [0.03], [0.03], [0.03]]) * rng.normal(size=(6, 3))
    rates, phases = 2 * np.pi * hertz * rng.uniform(0.9, 1, (6, 3)), rng.uniform(0, 6, (6, 3))
    both = zip((hand.amplitudes, hand.rates, hand.phases), (size, rates, phases), strict=True)
    views = Clocked(readout=READOUT_S).views(Swing(*map(np.hstack, both)), 150, rng)
    return time_cameras({"": TimedCamera(lens_of(views), views, as_designed=True)}, offsets=False, shutter=True)


@pytest.mark.parametrize("hertz", [6, 8, 10])
def test_a_motion_that_is_fast_for_the_frames_widens_the_interval_of_the_readout_time(hertz):
    times = shaken(hertz)
    own = times.cameras[""]
    assert abs(own.readout - READOUT_S) < 3 * own.readout_std
    assert ["motion_too_fast"] * (hertz > 6) == [each.code for each in times.warnings]


@pytest.mark.parametrize(("times", "beyond"), [(0.7, False), (1.4, True)])
def test_what_frames_do_not_show_of_a_motion_is_said_where_it_is_most_of_the_uncertainty(times, beyond):
    found, _ = timed(0)
    source = _Source.of("", TimedCamera(lens_of(views_of(0)), views_of(0), as_designed=True))
    left = times * found.cameras[""].readout_std / np.sqrt(2)
    estimate = replace(found.estimate, unresolved=np.full((3, 1), left))
    said = _warnings(replace(found, estimate=estimate), [source])
    assert [each.code for each in said] == ["motion_too_fast"] * beyond


def test_a_fifteenth_of_what_the_last_step_of_knots_has_moved_is_left(monkeypatch):
    steps = []

    def refine(*given):
        solution, problem, stiff, change = _refine(*given)
        steps.append(np.full_like(change, 15e-3))
        return solution, problem, stiff, steps[-1]

    without = timed(0)[0].cameras[""].readout_std
    monkeypatch.setattr(estimator, "_refine", refine)
    views = views_of(0)
    found = time_cameras({"": TimedCamera(lens_of(views), views, as_designed=True)}, offsets=False, shutter=True)
    assert found.estimate.unresolved[READOUT, 0] == pytest.approx(1e-3)
    assert found.cameras[""].readout_std == pytest.approx(np.hypot(without, 1e-3), rel=1e-2)


def test_without_noise_the_readout_time_is_exact():
    times, _ = timed(5, noise_px=1e-4)
    assert times.cameras[""].readout == pytest.approx(READOUT_S, rel=1e-3)  # a spline is not the motion


def test_rows_that_are_taken_at_once_have_no_readout_time():
    times, _ = timed(4, readout=0.0)
    assert abs(times.cameras[""].readout) < 3 * times.cameras[""].readout_std


def test_rows_from_below_have_a_negative_readout_time():
    own = timed(4, readout=-0.015)[0].cameras[""]
    assert abs(own.readout + 0.015) < 3 * own.readout_std


def test_views_are_as_of_one_moment():
    times, views = timed(0)
    middles = [times.timed("", view).time for view in views]
    found = times.at("", views, middles)
    motion = by_hand(np.random.default_rng(0))
    exact = Clocked().project(motion, np.array(middles))
    left = np.stack([view.pixels for view in found]) - exact
    before = np.stack([view.pixels for view in views]) - exact
    assert np.sqrt(np.mean(before**2)) > 0.3  # px
    assert np.sqrt(np.mean(left**2)) < 0.11  # the noise is 0.1


def test_a_view_without_a_time_stays_as_it_is():
    times, views = timed(0)
    strange = replace(views[3], image="another.png")
    assert times.at("", [strange, views[4]], [0.1, None]) == [strange, views[4]]


def test_a_board_that_hardly_moves_does_not_tell_the_readout_time():
    rng = np.random.default_rng(7)
    views = Clocked(readout=READOUT_S).views(by_hand(rng, 0.5, 0.002), 150, rng)
    own = TimedCamera(lens_of(views), views, as_designed=True)
    times = time_cameras({"": own}, offsets=False, shutter=True)
    [warning] = times.warnings
    assert warning.code == "undetermined_readout_time"
    assert "move it faster" in warning.text
    assert abs(times.cameras[""].readout - READOUT_S) < 3 * times.cameras[""].readout_std


def test_too_few_images_are_refused():
    views = views_of(0)[:15]
    with pytest.raises(InsufficientData) as caught:
        time_cameras({"": TimedCamera(lens_of(views), views, as_designed=True)}, offsets=False, shutter=True)
    assert caught.value.failures[0].code == "too_few_timed_views"


def test_images_without_times_are_invalid_input():
    views = [replace(view, time=None) for view in views_of(0)]
    lens = lens_of(views)
    with pytest.raises(InvalidInput, match="set --timestamps or --fps"):
        time_cameras({"": TimedCamera(lens, views)}, offsets=False, shutter=True)


def test_two_images_of_one_time_are_invalid_input():
    views = list(views_of(0))
    lens = lens_of(views)
    views[7] = replace(views[7], time=views[6].time)
    with pytest.raises(InvalidInput, match="has the time of another image"):
        time_cameras({"": TimedCamera(lens, views)}, offsets=False, shutter=True)


RIGHT = {"turn": (0.02, -0.2, 0.01), "place": (0.02, 0.01, 0.05)}


def two_cameras(motion, frames, *, seed=0, dropped=0.05, **right):
    """Return a left and a right camera before one motion, each with a brief calibration of its own."""
    rng = np.random.default_rng(seed)
    cameras = {"left": Clocked(), "right": Clocked(**RIGHT | right)}
    views = {name: own.views(motion, frames, rng, 0.1, dropped, name) for name, own in cameras.items()}
    return {name: TimedCamera(lens_of(own), own, as_designed=True) for name, own in views.items()}


@pytest.mark.parametrize("frames_apart", [-30.4, 0.3, 29.7])
def test_an_offset_of_many_frames_is_found_with_dropped_frames(frames_apart):
    offset = frames_apart / 30
    cameras = two_cameras(by_hand(np.random.default_rng(1)), 110, offset=offset)
    times = time_cameras(cameras, offsets=True, shutter=False)
    own = times.cameras["right"]
    assert abs(own.offset - offset) < 4 * own.offset_std
    assert own.offset_std < 1e-3 / 30
    assert times.cameras["left"].offset_std == 0
    assert own.middle_offset is None
    assert not times.warnings


def test_the_offset_between_middle_rows_is_known_better_than_that_of_first_rows():
    cameras = {"left": Clocked(readout=READOUT_S), "right": Clocked(**RIGHT, offset=0.2, readout=0.8 * READOUT_S)}
    rng = np.random.default_rng(8)
    motion = by_hand(rng)
    views = {name: own.views(motion, 110, rng, name=name) for name, own in cameras.items()}
    timed = {name: TimedCamera(lens_of(own), own, as_designed=True) for name, own in views.items()}
    times = time_cameras(timed, offsets=True, shutter=True)
    own = times.cameras["right"]
    assert abs(own.middle_offset - (0.2 - 0.1 * READOUT_S)) < 4 * own.middle_offset_std
    assert own.middle_offset_std < 0.4 * own.offset_std
    assert own.middle_offset_std < 1e-3 / 30
    assert times.cameras["left"].middle_offset is None


def test_several_offsets_fit_a_motion_that_repeats_itself():
    rng = np.random.default_rng(4)
    rates = np.full((6, 1), 2 * np.pi)  # one a second
    motion = Swing(np.full((6, 1), 0.05) * np.array([[1], [1], [1], [6], [6], [6]]), rates, rng.uniform(0, 6, (6, 1)))
    with pytest.raises(InsufficientData) as caught:
        time_cameras(two_cameras(motion, 150, offset=0.2), offsets=True, shutter=False)
    assert caught.value.failures[0].code == "several_time_offsets"


def test_cameras_that_see_other_motions_have_none_in_common():
    one = two_cameras(by_hand(np.random.default_rng(1)), 90)
    far = [replace(view, time=view.time + 1000) for view in one["right"].views]
    with pytest.raises(InsufficientData) as caught:
        time_cameras({"left": one["left"], "right": replace(one["right"], views=far)}, offsets=False, shutter=True)
    assert caught.value.failures[0].code == "no_common_motion"


def test_an_even_motion_in_one_direction_does_not_tell_the_offset():
    """Its poses are the true ones: of such views alone no lens would be accepted."""
    rng = np.random.default_rng(6)
    even = by_hand(rng, 0.02, 1e-5, sweep=0)
    even.amplitudes[:3], even.amplitudes[0, 0] = 0, 40.0
    even.rates[0, 0], even.phases[0, 0] = 1e-3, -2.5e-3  # 40 mm/s along x
    centre, cameras = BOARD.points().mean(axis=0), {}
    for name, own in {"left": Clocked(), "right": Clocked(**RIGHT)}.items():
        views = own.views(even, 150, rng, name=name)
        lens = lens_of(own.views(by_hand(rng), 40, rng))
        turned, moved = even.at(np.array([view.time for view in views]))
        [turn] = rotations(np.array([own.turn], float))
        poses = [Pose(turn @ r, turn @ (t - r @ centre) + own.place) for r, t in zip(turned, moved, strict=True)]
        records = [
            replace(lens.views[0], image=view.image, camera_T_board=pose)
            for view, pose in zip(views, poses, strict=True)
        ]
        cameras[name] = TimedCamera(replace(lens, views=tuple(records)), views, as_designed=True)
    times = time_cameras(cameras, offsets=True, shutter=False)
    assert {warning.code for warning in times.warnings} == {"undetermined_time_offset"}
    assert "to and fro" in times.warnings[0].text
