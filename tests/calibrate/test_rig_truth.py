"""Rigs whose truth is known, from a generator that shares no code with camcal's: poses, covariances, mistakes by name.

Larger numbers of them, and rigs of real images beside OpenCV, are in benchmarks/rig_*.py.
"""

from dataclasses import replace

import numpy as np
import pytest
import rig_scenes as scenes
from rig_scenes import Errors, SimulatedRig, Transform
from scipy.stats import chi2

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import FIXED, PRIOR, Captures, RigOptions
from camcal.cameras.catalogue import model_named
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

BOARD = Board("chessboard", 8, 5, 0.04)
FLAT = ShapeOptions(smooth=False, offsets=False)


def two_cameras(board=BOARD, **how):
    """A rig of two cameras side by side."""
    rng = np.random.default_rng(1)
    lenses = tuple(scenes.narrow_lens(rng, (640, 480), focal) for focal in (600.0, 610.0))
    poses = (Transform.of([0, 0, 0], [0, 0, 0]), Transform.of([0.01, -0.03, 0.005], [-0.12, 0.002, 0.004]))
    return SimulatedRig(lenses, poses, board, **how)


def seen_by(rig, captures=8, seed=1, **errors):
    return scenes.observed(scenes.scene(rig, captures, seed), Errors(**errors), seed)


def solve(captures, rig, **how):
    models = {name: model_named(lens.model) for name, lens in zip(rig.cameras, rig.lenses, strict=True)}
    return calibrate_rig(captures, rig.board, RigOptions(models, **how))


def errors_of(result, rig):
    """Errors (6 (N − 1),) of the transforms, in the order of their covariance."""
    found = []
    for name, truth in list(zip(rig.cameras, rig.poses, strict=True))[1:]:
        pose = result.poses[name]
        found += [pose.translation - truth.translation, so3.log(pose.rotation @ truth.rotation.T)]
    return np.concatenate(found)


def covariance_of(result):
    return result.covariance_of(tuple(name for name in result.names if "_T_" in name))


def square_of(result, rig):
    """The squared error of all transforms, normalised by their covariance."""
    errors = errors_of(result, rig)
    return float(errors @ np.linalg.solve(covariance_of(result), errors))


def said_of(captures, rig):
    """The codes of what is said of captures, those of a refusal included, and all the words."""
    try:
        result = solve(captures, rig)
    except CamcalError as error:
        return {message.code for message in error.failures}, str(error)
    messages = (*result.warnings, *result.failures)
    return {message.code for message in messages}, " ".join(map(str, messages))


@pytest.fixture(scope="module")
def rig():
    return two_cameras()


@pytest.fixture(scope="module")
def captures(rig):
    return seen_by(rig)


@pytest.fixture(scope="module")
def result(rig, captures):
    return solve(captures, rig)


def test_poses_are_as_far_from_the_truth_as_their_covariance_says(rig, result):
    # once in ten thousand beyond
    assert square_of(result, rig) < chi2.ppf(0.9999, 6)
    stds = np.sqrt(np.diag(covariance_of(result)))
    assert (stds[:3] < 2e-3).all(), "the covariance says something"
    assert (stds[3:] < 5e-3).all()


def test_covariance_covers_lenses_and_transforms_with_their_correlations(result):
    covariance, stds = result.covariance, np.sqrt(np.diag(result.covariance))
    assert result.names[0] == "left.fx"
    assert result.names[-6:] == tuple(f"right_T_left.{axis}" for axis in ("tx", "ty", "tz", "rx", "ry", "rz"))
    np.testing.assert_allclose(covariance, covariance.T, atol=0, rtol=1e-9)
    assert np.linalg.eigvalsh(covariance / np.outer(stds, stds)).min() > 0
    for name, own in result.calibrations.items():
        parameters = tuple(f"{name}.{parameter}" for parameter in own.camera.model.parameter_names)
        np.testing.assert_allclose(result.covariance_of(parameters), own.camera.covariance, rtol=1e-9)
    # a principal point that is off turns the camera
    index = [result.names.index(name) for name in ("right.cx", "right_T_left.ry")]
    assert abs(covariance[tuple(index)]) > 0.3 * stds[index[0]] * stds[index[1]]


def test_a_lens_model_that_could_be_right_as_well_widens_the_interval_by_half_the_square(rig, captures, result):
    other = model_named("kannala_brandt4")
    wider = solve(captures, rig, others=dict.fromkeys(captures.cameras, other))
    instead = calibrate_rig(captures, rig.board, RigOptions(dict.fromkeys(captures.cameras, other)))
    for name in ("left", "right"):
        np.testing.assert_array_equal(wider.poses[name].translation, result.poses[name].translation)
    added = wider.covariance - result.covariance
    lens = [index for index, name in enumerate(result.names) if "_T_" not in name]
    assert not added[lens].any()
    ours, theirs = result.poses["right"], instead.poses["right"]
    moved = np.concatenate([theirs.translation - ours.translation, so3.log(theirs.rotation @ ours.rotation.T)])
    expected = 0.5 * np.outer(moved, moved)
    np.testing.assert_allclose(covariance_of(wider) - covariance_of(result), expected, atol=0.1 * expected.max())


def test_order_of_captures_does_not_matter(rig, captures, result):
    again = solve(captures.take([5, 2, 7, 0, 1, 6, 3, 4]), rig)
    np.testing.assert_allclose(errors_of(again, rig), errors_of(result, rig), atol=1e-9)
    np.testing.assert_allclose(covariance_of(again), covariance_of(result), rtol=1e-6)


def test_nothing_is_said_of_sound_captures(result):
    assert [message.code for message in (*result.warnings, *result.failures)] == []
    assert result.motion is None
    assert not result.unlinked


def test_images_that_are_one_capture_late_are_named(rig, captures):
    codes, words = said_of(scenes.slipped(captures, 1), rig)
    assert codes == {"shifted_captures"}
    assert "right" in words


@pytest.mark.slow
def test_held_lenses_stay_and_priors_are_updated(rig):
    first, second = seen_by(rig, 16, 1), seen_by(rig, 16, 2)
    given = {name: own.camera for name, own in solve(first, rig).calibrations.items()}
    joint, fixed, prior = (
        solve(second, rig, lenses=lenses, given=given) if lenses else solve(second, rig)
        for lenses in ("", FIXED, PRIOR)
    )
    for name, camera in given.items():
        assert fixed.calibrations[name].camera.parameters.tolist() == camera.parameters.tolist()
        alone, updated = (own.calibrations[name].camera.std("fx") for own in (joint, prior))
        assert updated < min(alone, camera.std("fx"))
    assert square_of(prior, rig) < chi2.ppf(0.9999, 6)


@pytest.mark.slow
@pytest.mark.parametrize("board", [Board("chessboard", 8, 6, 0.03), Board("chessboard", 7, 7, 0.03)])
def test_symmetric_boards_numbered_at_random_in_every_image_are_resolved(board):
    own = two_cameras(board)
    assert square_of(solve(seen_by(own, 12, turned=True), own), own) < chi2.ppf(0.9999, 6)


@pytest.mark.slow
def test_cameras_in_a_chain_are_linked_through_those_between():
    """Every capture is seen by two neighbouring cameras of four."""
    own = scenes.random_rig(2, 4)
    seen = seen_by(own, 45, 2)
    rows = [
        tuple(view if place in (index % 3, index % 3 + 1) else None for place, view in enumerate(row))
        for index, row in enumerate(seen.views)
    ]
    result = solve(replace(seen, views=tuple(rows)), own)
    assert tuple(result.poses) == own.cameras
    assert square_of(result, own) < chi2.ppf(0.9999, 18)


@pytest.mark.slow
def test_a_camera_without_common_captures_is_named_and_the_others_are_solved():
    own = scenes.random_rig(2, 3)
    seen = seen_by(own, 30, 2)
    rows = [(a, b, None) if index % 2 else (None, None, c) for index, (a, b, c) in enumerate(seen.views)]
    result = solve(replace(seen, views=tuple(rows)), own)
    assert tuple(result.poses) == ("left", "right")
    assert tuple(result.unlinked) == ("third",)


@pytest.mark.slow
def test_corners_moved_by_a_thousandth_of_a_pixel_move_the_rig_as_little(rig, captures, result):
    rng = np.random.default_rng(0)
    moved = [
        [view and replace(view, pixels=view.pixels + rng.normal(0, 1e-3, view.pixels.shape)) for view in row]
        for row in captures.views
    ]
    again = solve(replace(captures, views=tuple(map(tuple, moved))), rig)
    stds = np.sqrt(np.diag(covariance_of(result)))
    # noise of 0.1 px is one standard deviation; the rest is left to decisions that are not continuous
    assert np.abs((errors_of(again, rig) - errors_of(result, rig)) / stds).max() < 0.2


@pytest.mark.slow
def test_motion_between_the_exposures_is_found_and_counted():
    own = two_cameras()
    seen = seen_by(own, 20, 3, motion=5e-4)
    result, without = solve(seen, own), solve(seen, own, motion=False)
    # the board moves by 0.5 mm along a line for one standard deviation of the delay
    assert 1e-4 < result.motion.median < 2e-3
    assert square_of(result, own) < chi2.ppf(0.9999, 6)
    assert square_of(without, own) > square_of(result, own)


@pytest.mark.slow
def test_errors_that_differ_less_between_captures_than_within_them_are_not_taken_for_motion():
    own = two_cameras()
    result = solve(seen_by(own, 20, 3, motion=2e-5), own)  # 0.02 mm are 0.01 px, the noise is 0.1 px
    assert result.motion is None
    assert square_of(result, own) < chi2.ppf(0.9999, 6)


@pytest.mark.slow
def test_claimed_standard_deviations_are_those_of_repeated_measurements(rig):
    where = scenes.scene(rig, 10, 1)
    results = [solve(scenes.observed(where, Errors(0.1), seed), rig, shape=FLAT) for seed in range(30)]
    errors = np.stack([errors_of(each, rig) for each in results])
    claimed = np.sqrt(np.mean([np.diag(covariance_of(each)) for each in results], axis=0))
    # a standard deviation from 30 runs is known to 13 %, the mean of six correlated ones hardly better
    assert 0.65 < np.exp(np.mean(np.log(claimed / errors.std(axis=0, ddof=1)))) < 1.5
    squares = [square_of(each, rig) for each in results]
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * len(results))
    assert low < sum(squares) < high


MISTAKES = {
    "shifted_captures": lambda seen, rig: scenes.slipped(seen, 1, 7),
    "exchanged_images": lambda seen, rig: scenes.exchanged(seen, 1, 3, 9),
    "swapped_views": lambda seen, rig: scenes.sides_exchanged(seen, [5]),
    "left_right_swapped": lambda seen, rig: scenes.sides_exchanged(seen, range(len(seen))),
    "mirrored_images": lambda seen, rig: scenes.mirrored(seen, 1, rig.board),
}


@pytest.mark.slow
@pytest.mark.parametrize("code", MISTAKES)
def test_mistakes_are_named(code):
    own = two_cameras(Board("chessboard", 9, 6, 0.025))
    codes, _ = said_of(MISTAKES[code](seen_by(own, 16), own), own)
    assert code in codes


@pytest.mark.slow
@pytest.mark.parametrize(("only_right", "start"), [((0, 4, 10, 13), 7), ((0, 2, 4, 6, 10, 12, 14), 8)])
def test_an_image_that_was_not_written_is_named_where_most_captures_do_not_fit(only_right, start):
    own = two_cameras(Board("chessboard", 9, 6, 0.025))
    seen = seen_by(own, 16)
    rows = tuple((None if capture in only_right else a, b) for capture, (a, b) in enumerate(seen.views))
    codes, words = said_of(scenes.slipped(replace(seen, views=rows), 1, start), own)
    assert codes == {"shifted_captures"}
    assert f"from capture {start:04d} on" in words


@pytest.mark.slow
def test_a_camera_that_was_moved_is_named_with_the_capture():
    own = two_cameras()
    moved = (own.poses[0], Transform.of([0, 0.02, 0], [0.004, 0, 0]) @ own.poses[1])
    where = replace(scenes.scene(own, 16, 1), later=(8, moved))
    codes, words = said_of(scenes.observed(where, Errors(), 1), own)
    assert "rig_changed" in codes
    assert "0008" in words


def test_cameras_that_share_no_capture_are_refused(rig, captures):
    rows = [(a, None) if index % 2 else (None, b) for index, (a, b) in enumerate(captures.views)]
    with pytest.raises(CamcalError, match="left, right"):
        solve(replace(captures, views=tuple(rows)), rig)


def test_captures_of_one_camera_are_no_rig(rig, captures):
    alone = Captures(("left",), captures.names, tuple((a,) for a, _ in captures.views))
    with pytest.raises(CamcalError):
        solve(alone, rig)
