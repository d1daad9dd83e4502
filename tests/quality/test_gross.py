"""Where corners are wrong and not merely noisy: what counts as wrong, when the result is refused, what is named."""

import re
from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.refusals import Misfit, misfit, require_fit, roughness
from camcal.calibrate.several_cameras import SMOOTH
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.040)
FOCAL = 1200.0
PINHOLE = Camera(model_named("pinhole"), (1600, 1200), np.array([FOCAL, FOCAL, 799.5, 599.5]))
VIEWS, POINTS = 10, 50
IMAGES = [f"{index}.png" for index in range(VIEWS)]
LARGE, SMALL = 100.0, 10.0  # px, sides of squares: 4 % of them are 4 px and less than 1 px
MOST = 0.1


def found(distances, side=LARGE, present=None):
    present = np.ones(np.shape(distances), bool) if present is None else present
    return Misfit(np.array(distances), np.full(len(distances), side), present)


def wrong_in(*counts):
    """Distances in ten views, the first of them with so many corners that are off by 20 px, the others by nothing."""
    distances = np.zeros((VIEWS, POINTS))
    for view, count in enumerate(counts):
        distances[view, :count] = 20.0
    return distances


def refusal(distances, **how):
    """What is said of ten views of 50 corners, None if nothing is."""
    try:
        require_fit(found(distances, **how), IMAGES, MOST, "opencv5")
    except InsufficientData as error:
        return error.message


def seen_by(poses):
    """The problem of a flat board in these poses, and its solution."""
    seen, _ = observe(PINHOLE, BOARD, poses, rng=np.random.default_rng(1), inside=False)
    rotations = np.stack([pose.rotation for pose in poses])
    translations = np.stack([pose.translation for pose in poses])
    state = State(PINHOLE.parameters, rotations, translations, np.zeros(0), np.zeros((BOARD.count, 3)))
    return BoardProblem(PINHOLE.model, BOARD, Observations.of(seen.views), np.arange(4)), state


def upright(distance, tilt=0.0):
    turn = so3.exp(np.array([0.0, tilt, 0.0]))
    return Pose(turn, np.array([0.0, 0.0, distance]) - turn @ np.array([*BOARD.extent, 0.0]) / 2)


def test_the_side_of_a_square_is_in_pixels_of_every_view():
    problem, state = seen_by([upright(0.5), upright(2.0), upright(50.0, np.radians(60))])
    sides = misfit(problem, state, problem.residuals(state)).sides
    assert sides[:2] == pytest.approx(FOCAL * 0.040 / np.array([0.5, 2.0]), rel=1e-9)
    # seen from afar at 60° it is half as wide: a square of its area has sides smaller by √2
    assert sides[2] == pytest.approx(FOCAL * 0.040 / 50 / np.sqrt(2), rel=0.01)


def test_the_side_of_a_square_is_that_of_the_corners_that_were_seen():
    problem, state = seen_by([upright(0.5, np.radians(60))] * 2)
    columns = np.arange(BOARD.count) % BOARD.columns
    present = np.stack([columns < 4, columns > 4])  # the right half is nearer
    problem = replace(problem, observations=replace(problem.observations, present=present))
    sides = misfit(problem, state, problem.residuals(state)).sides
    assert sides[1] > 1.5 * sides[0]


def test_distances_are_those_of_the_corners_and_infinite_without_an_image():
    problem, state = seen_by([upright(0.5), upright(2.0)])
    residuals = np.zeros((2, 2, BOARD.count))
    residuals[:, 0, 7] = 3.0, -4.0
    residuals[:, 1, 8] = np.nan, 1.0
    fit = misfit(problem, state, residuals)
    assert fit.distances[0, 7] == 5.0
    assert fit.distances[1, 8] == np.inf
    assert np.count_nonzero(fit.distances) == 2
    assert np.argwhere(fit.gross).tolist() == [[0, 7], [1, 8]]


def test_rows_of_the_table_without_a_corner_do_not_count():
    problem, state = seen_by([upright(0.5), upright(2.0)])
    present = np.ones((2, BOARD.count), bool)
    present[0, 20:] = False
    problem = replace(problem, observations=replace(problem.observations, present=present))
    residuals = np.where(present, 0.1, 500.0) * np.ones((2, 1, 1))
    fit = misfit(problem, state, residuals)
    assert not fit.gross.any()
    assert fit.median_px == pytest.approx(np.hypot(0.1, 0.1))  # most are in the second view
    assert fit.sides[0] == pytest.approx(96)
    require_fit(fit, IMAGES, 0.0, "pinhole")


@pytest.mark.parametrize(
    ("side", "limit"), [(SMALL, 1.0), (24.0, 1.0), (26.0, 1.04), (LARGE, 4.0)], ids=lambda value: f"{value:g}"
)
def test_a_corner_is_wrong_beyond_4_percent_of_a_square_and_1_px(side, limit):
    assert found([[0.98 * limit, 1.02 * limit]], side).gross.tolist() == [[False, True]]


def test_every_view_has_a_limit_of_its_own():
    fit = Misfit(np.full((2, 3), 2.0), np.array([SMALL, LARGE]), np.ones((2, 3), bool))
    assert fit.gross.tolist() == [[True] * 3, [False] * 3]
    assert fit.median_limit_px == pytest.approx(1.1)  # 2 % of a square of 55 px


def test_squares_of_few_pixels_may_be_off_by_half_a_pixel():
    assert found([[0.45] * 9], SMALL).median_limit_px == 0.5
    require_fit(found([[0.45] * 9], SMALL), IMAGES, 0.1, "opencv5")
    with pytest.raises(InsufficientData, match=r"the median by 0\.55 px \(limit 0\.5 px\)"):
        require_fit(found([[0.55] * 9], SMALL), IMAGES, 0.1, "opencv5")


def test_a_tenth_of_the_corners_may_be_wrong():
    assert refusal(wrong_in(*[5] * VIEWS)) is None  # 50 of 500
    message = refusal(wrong_in(6, *[5] * 9))
    assert re.match(r"51 of 500 corners \(10 %, limit 10 %\) are off by more than 4 % of a square", message)
    require_fit(found(wrong_in(6, *[5] * 9)), IMAGES, 0.11, "opencv5")
    with pytest.raises(InsufficientData, match="limit 0 %"):
        require_fit(found(wrong_in(1)), IMAGES, 0.0, "opencv5")


def test_the_typical_corner_may_be_off_by_2_percent_of_a_square():
    assert refusal(np.full((VIEWS, POINTS), 1.95)) is None
    message = refusal(np.full((VIEWS, POINTS), 2.06))  # half of what makes a corner wrong
    assert message.startswith("0 of 500 corners")
    assert "the median by 2.1 px (limit 2 px)" in message
    assert "--board" in message


def test_corners_without_an_image_are_wrong():
    distances = np.zeros((VIEWS, POINTS))
    distances[:, :6] = np.inf
    assert refusal(distances).startswith("60 of 500 corners (12 %, limit 10 %)")
    distances[:, 5] = 0.0
    assert refusal(distances) is None


def test_views_that_do_not_fit_are_named():
    message = refusal(wrong_in(50, 0, 50))
    assert "100 of 500 corners (20 %, limit 10 %)" in message
    assert message.endswith(": 2 of 10 views rejected (other order of ids, board or camera): leave out 0.png, 2.png")


@pytest.mark.parametrize(("count", "rest"), [(5, ""), (6, " and 1 more"), (8, " and 3 more")])
def test_at_most_five_views_are_named(count, rest):
    distances = np.zeros((20, POINTS))
    distances[4 : 4 + count] = 20.0
    with pytest.raises(InsufficientData, match=f": {count} of 20 views rejected") as refused:
        require_fit(found(distances), [f"{index:02}.png" for index in range(20)], MOST, "opencv5")
    assert refused.value.message.endswith(f"leave out 04.png, 05.png, 06.png, 07.png, 08.png{rest}")


def test_a_view_is_wrong_if_more_than_half_of_its_corners_are():
    assert refusal(wrong_in(25, 26)).endswith("leave out 1.png")
    assert "leave out" not in refusal(wrong_in(25, 25, 1))


def test_views_are_not_blamed_if_the_others_are_wrong_too():
    assert refusal(wrong_in(50, 50, *[5] * 8)).endswith("leave out 0.png, 1.png")
    assert "leave out" not in refusal(wrong_in(50, 50, 6, *[5] * 7))  # 41 of the other 400


def test_the_board_is_in_doubt_when_most_views_are_wrong():
    assert refusal(wrong_in(*[50] * 5)).endswith("leave out 0.png, 1.png, 2.png, 3.png, 4.png")
    message = refusal(wrong_in(*[50] * 6))
    assert "leave out" not in message
    assert message.endswith(
        "--board describes another board, several cameras are mixed, or the lens model (opencv5) "
        "does not fit: check columns, rows and type of the board, and calibrate each camera separately"
    )


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(1)
    poses = views(PINHOLE, BOARD, 12, rng=rng)
    return observe(PINHOLE, BOARD, poses, rng=rng, noise_px=0.1)[0].views


def calibrated(views, board=BOARD):
    return calibrate(views, board, Options(PINHOLE.model, shape=ShapeOptions(smooth=False, offsets=False)))


def test_views_with_shuffled_ids_are_named_by_the_calibration(seen):
    rng = np.random.default_rng(3)
    shuffled = {2, 9}
    views = [
        replace(view, ids=rng.permutation(view.ids)) if index in shuffled else view for index, view in enumerate(seen)
    ]
    with pytest.raises(InsufficientData, match="2 of 12 views rejected") as refused:
        calibrated(views)
    assert refused.value.message.endswith(f"leave out {seen[2].image}, {seen[9].image}")
    fitting = calibrated([view for index, view in enumerate(views) if index not in shuffled])
    assert fitting.camera.value("fx") == pytest.approx(FOCAL, rel=0.005)


def test_corners_numbered_for_another_board_are_refused(seen):
    with pytest.raises(InsufficientData, match=r"--board describes another board.*check columns, rows"):
        calibrated(seen, BOARD.transposed())


def rough_by(value, distances):
    return replace(found(distances), roughness=value)


@pytest.mark.parametrize(("value", "words"), [(0.28, "the lens model"), (0.32, "--board"), (np.nan, "--board")])
def test_the_lens_model_is_in_doubt_where_corners_are_in_the_order_of_the_board(value, words):
    far_off = np.full((VIEWS, POINTS), 20.0)
    with pytest.raises(
        InsufficientData, match=f"{words}.*(does not fit, or images are blurred|describes another board)"
    ):
        require_fit(rough_by(value, far_off), IMAGES, MOST, "opencv5")


def test_detections_are_in_doubt_where_most_corners_fit():
    message = refusal(wrong_in(*[10] * VIEWS))
    assert "100 of 500 corners (20 %, limit 10 %)" in message
    assert message.endswith(
        "board and lens model fit most corners, but many views have wrong corners: check them with camcal "
        "detect --draw, use sharper images, or set --max-rejected"
    )


@pytest.mark.parametrize(
    ("smooth", "words"), [(0.5 * SMOOTH, "many views have wrong corners"), (2 * SMOOTH, "residuals vary smoothly")]
)
def test_the_lens_model_is_in_doubt_where_most_corners_fit_and_the_others_are_off_smoothly(smooth, words):
    fit = replace(found(wrong_in(*[10] * VIEWS)), roughness=0.01, smoothness=smooth)
    with pytest.raises(InsufficientData, match=words):
        require_fit(fit, IMAGES, MOST, "opencv5")


def test_how_smooth_views_are_says_whether_corners_are_numbered_for_the_board(seen):
    def rough_on(board):
        problem, _ = seen_by([upright(0.5)] * len(seen))
        problem = replace(problem, board=board, observations=Observations.of(seen))
        return roughness(problem)

    assert rough_on(BOARD) < 0.01  # of noise of 0.1 px, and what a cubic leaves of a perspective
    assert rough_on(BOARD.transposed()) > 1
    assert rough_on(replace(BOARD, columns=10)) > 1


def test_how_smooth_views_are_is_asked_where_corners_are_wrong():
    problem, state = seen_by([upright(0.5)] * 3)
    shape = problem.observations.weights.shape
    near, far = (misfit(problem, state, np.full((2, *shape), px)) for px in (0.1, 20.0))
    assert np.isnan(near.roughness)
    assert far.roughness == roughness(problem)


@pytest.mark.parametrize(("wrong", "asked"), [(2, False), (8, True)])
def test_how_smooth_views_are_is_asked_where_more_corners_are_wrong_than_may_be(wrong, asked):
    problem, state = seen_by([upright(0.5)] * 3)
    residuals = np.zeros((2, *problem.observations.weights.shape))
    residuals[:, :, :wrong] = 20.0  # of 54 corners in each view
    assert misfit(problem, state, residuals, MOST).share == pytest.approx(wrong / BOARD.count)
    assert (misfit(problem, state, residuals, MOST).roughness == roughness(problem)) == asked


@pytest.mark.slow
def test_a_wide_lens_that_is_called_a_pinhole_is_refused_for_its_model():
    wide = Camera(model_named("kannala_brandt4"), (1600, 1200), np.array([520.0, 520, 799, 599, 0.02, -0.01, 0.004, 0]))
    rng = np.random.default_rng(1)
    views_of_it = observe(wide, BOARD, views(wide, BOARD, 12, rng=rng), rng=rng, noise_px=0.1)[0].views
    with pytest.raises(InsufficientData, match=r"residuals vary smoothly, so the lens model \(pinhole\) does not fit"):
        calibrated(views_of_it)


def test_a_refusal_says_what_to_do():
    """Every one of them has an imperative."""
    wrong = np.full((VIEWS, POINTS), 20.0)
    for fit in (found(wrong), rough_by(0.01, wrong), found(wrong_in(50, 0, 50)), found(wrong_in(*[10] * VIEWS))):
        with pytest.raises(InsufficientData, match=r": (.*\b(check|use|leave out|look at)\b)"):
            require_fit(fit, IMAGES, MOST, "opencv5")
