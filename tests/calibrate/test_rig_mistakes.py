"""Where the limits are beyond which captures of a rig are mistakes, and which camera or capture is named.

Boards stand parallel to the images of parallel cameras at 1 m, so that a pixel is as far for all of their points.
"""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.rigs import mistakes as module
from camcal.calibrate.rigs.calibrate import Captures, RigOptions, calibrate_rig
from camcal.calibrate.rigs.links import CameraPoses, link
from camcal.calibrate.rigs.mistakes import RigCamera, mistakes
from camcal.calibrate.rigs.series import largest_step
from camcal.cameras.catalogue import model_named
from camcal.cameras.observations import Observations
from camcal.errors import CamcalError, InsufficientData
from camcal.geometry import rotation as so3
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

BOARD = Board("chessboard", 9, 6, 0.03)
FOCAL, COUNT = 600.0, 16
LENS = np.array([FOCAL, FOCAL, 320.0, 240.0])
PLACES = ((0.0, 0.0, 0.0), (-0.12, 0.0, 0.0), (-0.24, 0.0, 0.0))  # of the first camera in each
NAMES = ("left", "right", "third")


def boards(seed=1):
    """Places (COUNT, 3) of the board, two of them, of captures 5 and 9, 100 px apart along x."""
    places = np.random.default_rng(seed).uniform([-0.25, -0.2, 1.0], [0.05, 0.0, 1.0], (COUNT, 3))
    places[9] = places[5] + [100 / FOCAL, 0, 0]
    return places


def camera(name, translations, rotations=None):
    """A camera with the poses of its views, and the corners that it saw."""
    rotations = np.tile(np.eye(3), (len(translations), 1, 1)) if rotations is None else rotations
    placed = BOARD.points() @ rotations.transpose(0, 2, 1) + translations[:, None]
    pixels = FOCAL * placed[..., :2] / placed[..., 2:] + LENS[2:]
    seen = Observations(
        np.tile(np.arange(BOARD.count), (len(pixels), 1)), pixels.transpose(2, 0, 1), np.ones(pixels.shape[:2])
    )
    problem = BoardProblem(model_named("pinhole"), BOARD, seen, np.arange(4))
    return RigCamera(name, CameraPoses(np.arange(len(pixels)), rotations, translations), problem, LENS)


def seen_by(*beside, names=NAMES, places=PLACES):
    """Cameras, each of which saw the boards so many pixels (COUNT, 2) beside where they are."""
    shifts = [np.pad(np.asarray(each, float), ((0, 0), (0, 1))) / FOCAL for each in beside]
    own = zip(names, places[: len(shifts)], shifts, strict=False)
    return [camera(name, boards() + place + shift) for name, place, shift in own]


def found_in(cameras):
    pairs = [(a, b) for b in range(len(cameras)) for a in range(b)]
    links = {(a, b): link(cameras[a].poses, cameras[b].poses, BOARD) for a, b in pairs}
    return mistakes(cameras, links, BOARD, [f"{index:04d}" for index in range(COUNT)])


def said_of(cameras):
    """The codes of what is said of cameras, and all the words."""
    try:
        found = found_in(cameras)
    except CamcalError as error:
        return {message.code for message in error.failures}, str(error)
    messages = (*found.warnings, *found.failures)
    return {message.code for message in messages}, " ".join(message.text for message in messages)


def still():
    return np.zeros((COUNT, 2))


def noise(px):
    """Errors (COUNT, 2) of so many pixels, as a standard deviation of a coordinate."""
    return px * np.random.default_rng(8).normal(size=(COUNT, 2))


def one_beside(captures, px):
    """Errors of so many pixels in some captures, none in the others."""
    shifts = still()
    shifts[captures, 1] = px
    return shifts


def test_of_a_bad_capture_only_the_camera_that_fits_no_other_is_left_out():
    assert found_in(seen_by(still(), still(), one_beside(5, 40.0))).excluded == {(5, 2)}
    assert found_in(seen_by(one_beside(5, 40.0), still())).excluded == {(5, 0), (5, 1)}


def test_a_last_capture_that_does_not_fit_is_no_change_of_the_rig():
    assert said_of(seen_by(still(), one_beside(COUNT - 1, 40.0)))[0] == {"inconsistent_captures"}
    codes, words = said_of(seen_by(still(), one_beside(range(COUNT - 3, COUNT), 40.0)))
    assert codes == {"rig_changed"}
    assert "from capture 0013 on" in words


@pytest.mark.parametrize(
    ("typical", "beside", "wrong"), [(0.0, 1.5, False), (0.0, 3.0, True), (1.0, 4.5, False), (1.0, 9.0, True)]
)
def test_a_capture_is_wrong_beyond_6_times_the_typical_error_and_2_px(typical, beside, wrong):
    shifts = noise(0.85 * typical)
    shifts[5] = [0.0, beside]
    assert (len(found_in(seen_by(still(), shifts)).excluded) > 0) == wrong


@pytest.mark.parametrize(("left", "named"), [(20.0, True), (45.0, False)])
def test_images_are_exchanged_if_that_leaves_less_than_3_tenths_of_the_error(left, named):
    shifts = still()
    shifts[5], shifts[9] = [100.0, left], [-100.0, left]
    codes, words = said_of(seen_by(still(), shifts))
    assert codes == {"exchanged_images" if named else "inconsistent_captures"}
    assert ("between captures 0005 and 0009" in words) == named


@pytest.mark.parametrize(
    ("sigma", "step", "changed"), [(0.0, 0.3, False), (0.0, 0.6, True), (1.0, 3.0, False), (1.0, 6.0, True)]
)
def test_a_relative_pose_changed_if_6_standard_deviations_and_4_tenths_of_a_pixel_tell(sigma, step, changed):
    shifts = noise(sigma)
    shifts[8:, 1] += step
    assert ("rig_changed" in said_of(seen_by(still(), shifts))[0]) == changed


@pytest.mark.parametrize(("late", "early"), [("right", "left"), ("left", "right")])
def test_the_camera_whose_images_are_late_is_named_before_the_other(late, early):
    cameras = seen_by(still(), still())
    index = NAMES.index(late)
    rows = np.arange(-1, COUNT - 1)  # its first image shows what was there before the first capture
    moved = cameras[index].poses.translations[rows]
    cameras[index] = camera(late, moved)
    codes, words = said_of(cameras)
    assert codes == {"shifted_captures"}
    assert f"images of {late} are 1 capture late against those of {early}" in words


def of_two_sizes(ratio):
    """Two cameras, the second of which saw a board so many times as large as the given one."""
    rotations = so3.exp(np.random.default_rng(2).normal(size=(COUNT, 3)) * 0.3)
    places = boards() + np.random.default_rng(3).uniform(0, 0.5, (COUNT, 3)) * [0, 0, 1]
    return camera("left", places, rotations), camera("right", (places + PLACES[1]) / ratio, rotations)


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (1.042, "the board of right is 1.04 times as large as that of left"),
        (1 / 1.042, "the board of left is 1.04 times as large as that of right"),
    ],
)
def test_the_larger_one_of_two_boards_is_named(ratio, words):
    codes, said = said_of(of_two_sizes(ratio))
    assert codes == {"boards_of_two_sizes"}
    assert words in said


def test_boards_whose_sizes_differ_by_2_percent_are_one():
    assert "boards_of_two_sizes" not in said_of(of_two_sizes(1.02))[0]


@pytest.mark.parametrize(
    ("names", "place", "said"),
    [
        (("left", "right"), PLACES[1], ""),
        (("right", "left"), PLACES[1], "right is left of left"),
        (("left", "right"), (0.12, 0.0, 0.0), "right is left of left"),
        (("left", "right"), (0.02, -0.12, 0.0), ""),  # one above the other
    ],
)
def test_cameras_beside_each_other_with_exchanged_names_are_said(names, place, said):
    codes, words = said_of(seen_by(still(), still(), names=names, places=(PLACES[0], place)))
    assert codes == ({"left_right_swapped"} if said else set())
    assert said in words


def test_two_cameras_with_the_same_images_in_most_captures_are_no_rig():
    ids = np.arange(BOARD.count)
    pixels = camera("left", boards()).problem.observations.pixels.transpose(1, 2, 0)[:4]
    views = [BoardDetection(f"{index}.png", (640, 480), ids, own) for index, own in enumerate(pixels)]
    rows = [(view, view) for view in views[:3]] + [(views[3], replace(views[3], pixels=views[3].pixels + 1.0))]
    models = dict.fromkeys(NAMES[:2], model_named("pinhole"))
    with pytest.raises(InsufficientData, match="left and right have the same images"):
        calibrate_rig(Captures(NAMES[:2], tuple("abcd"), tuple(rows)), BOARD, RigOptions(models))


def test_five_of_the_captures_that_do_not_fit_are_named():
    shifts = still()
    shifts[[1, 3, 4, 7, 10, 12, 14], 1] = [40, -55, 70, -35, 90, -60, 45]
    _, words = said_of(seen_by(still(), shifts))
    assert "7 captures inconsistent with the others" in words
    assert ": 0001, 0003, 0004, 0007, 0010 and 2 more; not used" in words


def test_captures_that_are_off_by_more_than_4_hundredths_of_a_radian_do_not_fit_however_large_all_errors_are():
    cameras = seen_by(still(), still())
    known = link(cameras[0].poses, cameras[1].poses, BOARD)
    pair = module._Pair(*cameras, BOARD, known)  # 24 px; six times the errors of the fifth that fits best are 30
    fitting = pair._fitting(np.array([5.0] * 5 + [18.0] * 6 + [27.0] * 5))
    assert fitting.tolist() == [True] * 11 + [False] * 5


@pytest.mark.parametrize(("left", "late"), [(0.075, True), (0.12, False)])
def test_images_are_late_if_that_leaves_less_than_a_tenth_of_a_pixel_however_small_the_error_is(left, late):
    """The board hardly moves: by 0.2 px from capture to capture, which all of the second camera's images show late."""
    angles = np.random.default_rng(5).uniform(0, 2 * np.pi, (2, COUNT))
    moves, rest = (np.column_stack([np.cos(own), np.sin(own)]) for own in angles)
    places = np.tile([-0.1, -0.1, 1.0], (COUNT, 1))

    def seen(name, shifts, place):
        return camera(name, places + place + np.pad(shifts, ((0, 0), (0, 1))) / FOCAL)

    first, second = 0.14 * moves, 0.14 * moves[np.arange(-1, COUNT - 1)] + left * rest
    codes, _ = said_of([seen("left", first, PLACES[0]), seen("right", second, PLACES[1])])
    assert ("shifted_captures" in codes) == late


def test_the_noise_beside_a_step_of_three_captures_is_taken_for_twice_what_it_looks():
    values = np.array([-1.0, 0.0, 1.0, 99.0, 100.0, 101.0, 100.0, 98.0, 102.0])[:, None]
    place, size, clear = largest_step(values)
    assert (place, size) == (3, 100.0)
    noise = 1.0 / 0.6745  # the median of what is left is 1
    assert clear == pytest.approx(100 / (2 * noise * np.sqrt(np.pi / 2 * (1 / 3 + 1 / 6))), rel=1e-9)
