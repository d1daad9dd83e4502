"""The shape of every type of board comes out of its points, and symmetric boards may be seen from any end.

The images are left out: points as a detector would hand them on.
"""

import numpy as np
import pytest
from observed import make_scene, turned

from camcal.calibrate.initialise import opposed_views
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.refusals import reason_unusable
from camcal.simulate import render
from camcal.targets.board import TIERS, basis, parse_board
from camcal.targets.detection import BoardDetection

BOARDS = {
    "aprilgrid": "aprilgrid:6x4:45mm:0.3",
    "circles": "circles:10x8:30mm:18mm",
    "square circles": "circles:8x8:30mm:18mm",
    "asymmetric circles": "asymmetric_circles:6x11:25mm:18mm",
    "even asymmetric circles": "asymmetric_circles:6x10:25mm:18mm",
}
TERMS = tuple(term for tier in TIERS.values() for term in tier)


@pytest.mark.parametrize("form", BOARDS.values(), ids=BOARDS)
def test_the_terms_of_a_shape_are_those_of_the_formulas(form):
    """Legendre polynomials over [-1, 1] on the points, written here from their definition; equal but for rounding."""
    board = parse_board(form)
    x, y = (2 * board.points()[:, :2] / np.array(board.extent) - 1).T
    columns = dict(zip(TERMS, np.moveaxis(basis(board, TERMS), 2, 0), strict=True))
    np.testing.assert_allclose(columns["xy"][:, 2], x * y, atol=1e-12)
    np.testing.assert_allclose(columns["P2(y)"][:, 2], 1.5 * y**2 - 0.5, atol=1e-12)
    np.testing.assert_allclose(columns["P3(x)"][:, 2], 2.5 * x**3 - 1.5 * x, atol=1e-12)
    np.testing.assert_allclose(columns["x/y scale"][:, 0], x * board.extent[0] / 4, atol=1e-12)
    np.testing.assert_allclose(columns["shear"][:, 0], y * board.extent[1] / 4, atol=1e-12)


@pytest.mark.parametrize("form", BOARDS.values(), ids=BOARDS)
def test_a_bent_board_of_any_type_does_not_bend_the_camera(form):
    scene = make_scene(board=parse_board(form), count=20)
    shape = render.bow(1e-3, 5e-4) + render.cubic(5e-4)
    rng = np.random.default_rng(3)
    ends = len(scene.board.symmetries())  # a detector takes any of them for the first
    exact = scene.observe(1, noise_px=0.1, shape=shape)
    views = [turned(view, scene.board, int(rng.integers(ends))) for view in exact]
    calibration = calibrate(views, scene.board, Options(scene.camera.model))
    focal = calibration.camera
    assert abs(focal.value("fx") - scene.camera.value("fx")) < 4 * focal.std("fx")
    deflection = shape.deflection(scene.board)
    assert abs(calibration.surface.deflection - deflection) < 4 * calibration.surface.deflection_std
    assert calibration.surface.deflection_std < 0.1 * deflection
    assert len(calibration.rejected) < 0.01 * sum(len(view.ids) for view in views)


def test_the_corners_of_tags_in_one_row_lie_on_no_line():
    board = parse_board("aprilgrid:6x1:45mm:0.3")
    view = BoardDetection("a.png", (640, 480), np.arange(board.count), np.zeros((board.count, 2)))
    assert reason_unusable(view, board) is None


@pytest.mark.parametrize(
    ("form", "ids"),
    [
        ("aprilgrid:6x4:45mm:0.3", [0, 1, 4, 5, 8, 9, 12, 13]),  # the lower edges of the lowest row
        ("circles:10x8:30mm", range(10)),
        ("asymmetric_circles:4x11:25mm", [0, 8, 16, 24, 32, 40]),
    ],
)
def test_points_on_one_line_are_refused_for_all_types(form, ids):
    view = BoardDetection("a.png", (640, 480), np.array(ids), np.zeros((len(ids), 2)))
    assert reason_unusable(view, parse_board(form)) == "all corners are collinear: show more of the board"


def test_views_are_guessed_to_be_turned_where_their_pulls_are_opposed_and_not_where_they_are_noise():
    """Pulls with the variance of their information; signs that suit noise best would raise χ² by up to 0.9 a view."""
    rng = np.random.default_rng(6)
    ends = rng.permutation(np.arange(30) % 2)
    for _ in range(40):
        noise = rng.normal(size=(30, 4))
        assert not opposed_views(noise, 30 * np.eye(4)).any()
        found = opposed_views(noise + 20 * np.where(ends, -1, 1)[:, None] * [1, 0, 0, 0], 30 * np.eye(4))
        assert np.array_equal(found, ends) or np.array_equal(found, 1 - ends)
