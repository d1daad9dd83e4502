"""Boards of circles in rendered photographs, whose true centres are known.

What this does not prove: how real lenses, printers and papers differ; tests/real/test_circles_real.py looks at some.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.targets.board import parse_board
from camcal.targets.circles import find_circles

SIZE, FOCAL = (640, 480), 600.0
NUMBERED = 0.05  # px: far from the next circle, and no less than smaller discs and steeper boards allow
MEASURED = 0.02  # px: four standard deviations; ellipses' centres are 0.1 px off at 45°
PLAIN = parse_board("circles:7x5:25mm:15mm")
STAGGERED = parse_board("asymmetric_circles:3x7:20mm:16mm")
EVEN = parse_board("asymmetric_circles:3x6:20mm:16mm")
SQUARE = parse_board("circles:5x5:25mm:15mm")


def camera(k1=0.0):
    return Camera(model_named("opencv5"), SIZE, [FOCAL, FOCAL, 320, 240, k1, 0, 0, 0, 0])


def held(board, tilt_deg, roll_deg=7.0, spacing_px=42):
    """Return the pose of a board tilted about an axis across the image and turned in its own plane."""
    turn = so3.exp(np.radians(tilt_deg) * np.array([0.6, -0.8, 0.0])) @ so3.exp(np.radians([0.0, 0.0, roll_deg]))
    middle = np.array([*board.extent, 0.0]) / 2
    return Pose(turn, np.array([2e-4, -3e-4, FOCAL * board.spacing / spacing_px]) - turn @ middle)


@cache
def view(board, tilt_deg=45, roll_deg=7.0, spacing_px=42, k1=0.0, exposure=Exposure()):  # noqa: B008 - frozen
    """Return a photograph and the true pixels of the centres."""
    lens, pose = camera(k1), held(board, tilt_deg, roll_deg, spacing_px)
    gray = render(lens, board, pose, rng=np.random.default_rng(1), exposure=exposure)
    gray.flags.writeable = False
    return gray, lens.project(pose.apply(board.points())).pixels


def errors(detection, truth):
    return detection.pixels - truth[detection.ids]


def normalised(detection, truth):
    away = errors(detection, truth)
    return np.einsum("ni,nij,nj->n", away, np.linalg.inv(detection.covariance), away).mean() / 2


@pytest.mark.parametrize("board", [PLAIN, STAGGERED], ids=["plain", "asymmetric"])
@pytest.mark.parametrize("k1", [0.0, -0.25], ids=["pinhole", "barrel"])
def test_centres_at_45_degrees_are_those_of_the_discs(board, k1):
    gray, truth = view(board, k1=k1, spacing_px=42 if board is PLAIN else 34)
    detection = find_circles(gray, board)
    assert len(detection.ids) == board.count
    assert np.abs(errors(detection, truth)).max() < MEASURED
    assert 0.5 < normalised(detection, truth) < 1.6  # chi² of 42 to 70 values over their number, to 3 σ


def test_a_diameter_that_is_not_told_is_found_in_the_image():
    gray, truth = view(PLAIN)
    detection = find_circles(gray, replace(PLAIN, diameter=None))
    assert np.abs(errors(detection, truth)).max() < MEASURED


def test_gamma_moves_no_centre():
    gray, truth = view(PLAIN, exposure=Exposure(gamma=2.2))
    assert np.abs(errors(find_circles(gray, PLAIN), truth)).max() < 0.025  # half the slope where it is dark


def test_dots_whose_blur_reaches_the_next_are_told_apart():
    """The rims are 5 px apart along the tilt, 3.3 standard deviations of the blur."""
    gray, truth = view(PLAIN, spacing_px=18, exposure=Exposure(blur_px=1.5))
    detection = find_circles(gray, PLAIN)
    assert np.sqrt((errors(detection, truth) ** 2).mean()) < MEASURED
    assert 0.5 < normalised(detection, truth) < 1.6  # of 70 values, as above


@pytest.mark.parametrize("roll_deg", [-170, -100, -35, 80, 160])
def test_an_asymmetric_board_of_an_odd_number_of_rows_has_the_same_ids_however_it_is_turned(roll_deg):
    gray, truth = view(STAGGERED, 30, roll_deg, 30)
    assert np.abs(errors(find_circles(gray, STAGGERED), truth)).max() < NUMBERED


@pytest.mark.parametrize("board", [PLAIN, EVEN], ids=["plain", "even"])
@pytest.mark.parametrize("roll_deg", [-70, 70])
def test_rows_run_to_the_right(board, roll_deg):
    gray, truth = view(board, 20, roll_deg, 30)
    assert np.abs(errors(find_circles(gray, board), truth)).max() < NUMBERED
    turned, other = view(board, 20, roll_deg + 180, 30)
    assert np.abs(errors(find_circles(turned, board), other[::-1])).max() < NUMBERED


def test_a_square_grid_is_numbered_from_its_top_left():
    gray, truth = view(SQUARE, 10, 30)
    assert np.abs(errors(find_circles(gray, SQUARE), truth)).max() < NUMBERED
    turned, other = view(SQUARE, 10, 75)
    quarter = np.rot90(np.arange(25).reshape(5, 5), -1).ravel()
    assert np.abs(find_circles(turned, SQUARE).pixels - other[quarter]).max() < NUMBERED


def test_columns_and_rows_exchanged_are_the_same_board():
    gray, truth = view(PLAIN)
    across = find_circles(gray, PLAIN.transposed())
    assert len(across.ids) == PLAIN.count
    nearest = np.linalg.norm(across.pixels[:, None] - truth, axis=2)
    assert nearest.min(axis=1).max() < NUMBERED
    first, second, below = nearest.argmin(axis=1)[[0, 1, 5]]
    assert abs(second - first) == 7  # along what were columns
    steps = truth[[second, below]] - truth[first]
    assert np.linalg.det(steps) > 0  # not mirrored


def test_white_dots_on_black_are_found():
    gray, truth = view(PLAIN)
    assert np.abs(errors(find_circles(255 - gray, PLAIN), truth)).max() < MEASURED


def test_covered_dots_are_left_out_and_the_others_stay():
    gray, truth = view(PLAIN)
    covered = gray.copy()
    for place in (9, 17):
        cv2.circle(covered, np.rint(truth[place]).astype(int).tolist(), 14, 120, -1)
    detection = find_circles(covered, PLAIN)
    assert set(range(35)) - set(detection.ids.tolist()) == {9, 17}
    assert np.abs(errors(detection, truth)).max() < MEASURED


def test_a_board_in_the_dark_is_found():
    gray, truth = view(PLAIN, exposure=Exposure(black=0.02, white=0.07, background=0.03, noise_dn=1))
    detection = find_circles(gray, PLAIN)
    assert len(detection.ids) == PLAIN.count
    assert np.abs(errors(detection, truth)).max() < 0.15  # a contrast of 13 gray levels, 1/14 of the usual


def test_a_board_at_75_degrees_is_found():
    gray, truth = view(PLAIN, 75, spacing_px=55)
    detection = find_circles(gray, PLAIN)
    assert len(detection.ids) == PLAIN.count
    assert np.abs(errors(detection, truth)).max() < NUMBERED


def test_another_grid_is_named():
    gray, _ = view(PLAIN)
    assert find_circles(gray, parse_board("circles:8x5:25mm")).reason == "a grid of 7 x 5 circles visible, not 8 x 5"
    assert not find_circles(gray, parse_board("circles:6x5:25mm")).found


@pytest.mark.parametrize("roll_deg", [7, 97, 200])
@pytest.mark.parametrize(
    ("drawn", "asked", "proposed", "reason"),
    [
        (
            "circles:7x5:25mm:15mm",
            "circles:8x5:20mm",
            "circles:7x5:20mm",
            "a grid of 7 x 5 circles visible, not 8 x 5",
        ),
        (
            "asymmetric_circles:3x7:20mm:16mm",
            "asymmetric_circles:4x11:20mm",
            "asymmetric_circles:3x7:20mm",
            "an asymmetric grid of 3 x 7 circles visible, not 4 x 11",
        ),
        (
            "asymmetric_circles:3x6:20mm:16mm",
            "asymmetric_circles:4x11",
            "asymmetric_circles:3x6",
            "an asymmetric grid of 3 x 6 circles visible, not 4 x 11",
        ),
        (
            "asymmetric_circles:3x7:20mm:16mm",
            "circles:7x5:25mm:15mm",
            "asymmetric_circles:3x7",
            "an asymmetric grid of 3 x 7 circles visible, not 7 x 5",
        ),
        (
            "circles:7x5:25mm:15mm",
            "asymmetric_circles:4x11:20mm",
            "circles:5x7",
            "a grid of 5 x 7 circles visible, not 4 x 11",
        ),
    ],
)
def test_another_grid_is_proposed_as_a_board(drawn, asked, proposed, reason, roll_deg):
    gray, _ = view(parse_board(drawn), 30, roll_deg, 30)
    detection = find_circles(gray, parse_board(asked))
    assert (detection.other, detection.reason) == (parse_board(proposed), reason)


def test_a_grid_that_leaves_the_image_is_not_proposed():
    gray, truth = view(PLAIN, 30, 7, 30)
    cut = gray[:, int(truth[:, 0].min()) + 70 :]
    detection = find_circles(np.ascontiguousarray(cut), parse_board("circles:8x6"))
    assert detection.other is None
    assert detection.reason.startswith("board partly outside the image (")


def test_a_grid_with_holes_is_not_proposed():
    gray, truth = view(PLAIN, 30, 7, 30)
    covered = gray.copy()
    for u, v in truth[[9, 10, 16, 24]].astype(int):
        covered[v - 9 : v + 10, u - 9 : u + 10] = 200
    detection = find_circles(covered, parse_board("circles:8x6"))
    assert detection.other is None
    assert detection.reason.startswith("part of a grid visible (")


def test_the_dark_squares_of_a_small_chessboard_are_no_grid_of_circles():
    """At 10 px a square they pass for dots, in the arrangement of an asymmetric grid."""
    row, column = np.mgrid[0:7, 0:10]
    squares = np.kron(np.where((row + column) % 2, 220, 30), np.ones((10, 10))).astype(np.uint8)
    image = cv2.copyMakeBorder(squares, 80, 80, 105, 105, cv2.BORDER_CONSTANT, value=220)
    image = cv2.GaussianBlur(image, (0, 0), 2.0)
    detection = find_circles(image, parse_board("asymmetric_circles:4x11"))
    assert (detection.other, detection.found) == (None, False)


def test_images_without_circles_have_a_reason():
    noise = np.random.default_rng(2).integers(0, 256, (240, 320)).astype(np.uint8)
    for gray in (np.full((240, 320), 128, np.uint8), noise):
        detection = find_circles(gray, PLAIN)
        assert not detection.found
        assert detection.reason


def test_half_a_board_is_not_numbered_by_guess():
    gray, truth = view(PLAIN)
    cut = gray.copy()
    cut[:, int(truth[3, 0]) :] = 200
    assert not find_circles(cut, PLAIN).found
