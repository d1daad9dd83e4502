"""How large squares are in views, and how far corners are from a smooth map: against maps that are known."""

import numpy as np
import pytest

from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.refusals import Misfit, misfit, require_fit, roughness
from camcal.cameras.catalogue import model_named
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.040)
PLACES = BOARD.points()[:, :2] / 0.040  # in squares


def seen(count, pixels=None, present=None):
    """Problem and state of a board that is seen askew from near by, in views one as the other, all of it or in part."""
    turn = so3.exp(np.array([0.3, 0.9, 0.1]))
    state = State(
        np.array([1000.0, 1000.0, 800.0, 600.0]),
        np.tile(turn, (count, 1, 1)),
        np.tile([-0.1, -0.1, 0.4], (count, 1)),
        np.zeros(0),
        np.zeros((BOARD.count, 3)),
    )
    pixels = np.zeros((2, count, BOARD.count)) if pixels is None else pixels
    present = np.ones((count, BOARD.count), bool) if present is None else present
    ids = np.tile(np.arange(BOARD.count), (count, 1))
    table = Observations(ids, pixels, np.ones((count, BOARD.count)), present=present)
    return BoardProblem(model_named("pinhole"), BOARD, table, np.arange(4)), state


def test_the_side_of_a_square_is_the_root_of_the_median_area_in_the_view():
    present = np.ones((1, BOARD.count), bool)
    present[0, ::5] = False
    problem, state = seen(1, present=present)
    turn, shift = state.rotations[0], state.translations[0]

    def image(points):
        places = points @ turn.T + shift
        return 1000 * places[:, :2] / places[:, 2:]

    drawn, length = BOARD.points(), 1e-6
    ways = [(image(drawn + way) - image(drawn - way)) / (2 * length) * 0.040 for way in length * np.eye(3)[:2]]
    areas = np.abs(ways[0][:, 0] * ways[1][:, 1] - ways[0][:, 1] * ways[1][:, 0])
    found = misfit(problem, state, np.zeros((2, *present.shape)))
    assert found.sides[0] == pytest.approx(np.sqrt(np.median(areas[present[0]])), rel=1e-6)
    assert np.ptp(np.sqrt(areas)) > 0.3 * found.sides[0]


def test_the_limit_of_the_median_is_that_of_the_square_of_the_median_corner():
    present = np.ones((3, 10), bool)
    present[0, 1:] = present[1, 8:] = False
    found = Misfit(np.zeros((3, 10)), np.array([900.0, 100.0, 60.0]), present)
    assert found.median_limit_px == pytest.approx(1.2)  # of 1, 8 and 10 corners the median is in the third view


def test_the_median_of_every_view_is_that_of_its_own_corners():
    distances = np.array([[1.0, 2.0, 9.0, 100.0], [3.0, 4.0, 5.0, 90.0]])
    present = np.array([[True, True, True, False], [True] * 4])
    np.testing.assert_allclose(Misfit(distances, np.ones(2), present).medians, [2.0, 4.5])


def rough(pixels, present=None):
    """The roughness of views (V, P, 2) of the board."""
    problem, _ = seen(len(pixels), np.moveaxis(pixels, 2, 0), present)
    return roughness(problem)


def powers(degree):
    x, y = PLACES.T
    return np.column_stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def mapped(rng, degree=3):
    """Pixels of a random polynomial map of which every power moves corners by up to some 50 px."""
    terms = powers(degree)
    return (terms / terms.max(axis=0)) @ rng.normal(size=(terms.shape[1], 2)) * 50


def test_polynomials_of_the_third_degree_are_smooth_and_no_others():
    rng = np.random.default_rng(1)
    affine = PLACES @ np.array([[60.0, 5.0], [-8.0, 70.0]]) + 300
    assert rough((affine + mapped(rng))[None]) < 1e-9
    for power in ((4, 0), (0, 4), (2, 2), (3, 1)):
        bent = affine + 20 * (PLACES[:, :1] / 8) ** power[0] * (PLACES[:, 1:] / 5) ** power[1]
        assert rough(bent[None]) > 1e-4


def test_roughness_is_the_median_of_what_is_left_in_squares_of_the_median_view():
    rng = np.random.default_rng(2)
    axes = np.array([[40.0, 10.0], [-30.0, 50.0]])  # squares of 2300 px²
    sizes, lengths = np.array([3.0, 1.0, 9.0]), []
    views = PLACES @ axes + 200 + sizes[:, None, None] * rng.normal(size=(3, BOARD.count, 2))
    for view in views:
        left = view - powers(3) @ np.linalg.lstsq(powers(3), view, rcond=None)[0]
        plane = np.linalg.lstsq(powers(1), view, rcond=None)[0]  # of 1, y and x
        lengths.append(np.median(np.hypot(*left.T)) / np.sqrt(abs(np.linalg.det(plane[1:]))))
    assert rough(views) == pytest.approx(lengths[0], rel=1e-9)
    assert rough(views * [1.0, -1.0]) == pytest.approx(lengths[0], rel=1e-9)  # a board whose y is upwards
    assert lengths[0] == pytest.approx(3 * np.sqrt(2 * np.log(2)) * np.sqrt(44 / 54) / np.sqrt(2300), rel=0.15)


def test_views_of_fewer_than_sixteen_corners_tell_no_roughness():
    rng = np.random.default_rng(3)
    views = np.tile(PLACES * 50, (2, 1, 1))
    views[1] += 5 * rng.normal(size=(BOARD.count, 2))
    present = np.ones((2, BOARD.count), bool)
    present[0, 15:] = False
    assert rough(views, present) > 0.05
    present[0, 15] = True
    assert rough(views, present) == pytest.approx(rough(views[1:]) / 2, rel=1e-6)  # the mean of both
    present[:, 15:] = False
    assert np.isnan(rough(views, present))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.28, "so the lens model"),
        (0.32, "--board describes another board, several cameras are mixed, or the lens model"),
        (np.nan, "--board describes another board, several cameras are mixed, or the lens model"),
    ],
)
def test_corners_in_the_order_of_the_board_leave_the_board_out_of_doubt(value, words):
    present = np.ones((4, 20), bool)
    found = Misfit(np.full((4, 20), 9.0), np.full(4, 50.0), present, value)
    with pytest.raises(InsufficientData) as refused:
        require_fit(found, list("abcd"), 0.1, "opencv5")
    assert words in refused.value.message
