"""Two cameras in one input: which views are whose, how clear it is, and what is no second camera.

The limits of the verdict are those of quality/criteria.py; here is what the ratio comes out as on either side.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene, turned
from scipy.stats import norm

from camcal.calibrate import several_cameras
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.refusals import require_one_camera
from camcal.calibrate.several_cameras import TwoCameras, smoothness
from camcal.calibrate.single_views import ViewQuadratics
from camcal.cameras.catalogue import model_named
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData
from camcal.quality.assess import assess
from camcal.targets.board import Board

MODEL = model_named("opencv5")
FIRST = [1200.0, 1203.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]
FLAT = ShapeOptions(smooth=False, offsets=False)
CLEAR, CLEAR_BY_NAME = 1.4, 1.2


def views_of(letter, count, seed, focal=1200.0, centre=(805.0, 590.0), board=None, noise_px=0.1):
    """Views by a camera of this focal length and principal point, px, in a folder of their own."""
    parameters = [focal, focal * 1.0025, *centre, *FIRST[4:]]
    scene = make_scene(board=board, count=count, seed=seed, parameters=parameters)
    return [replace(view, image=f"{letter}/{view.image}") for view in scene.observe(seed, noise_px=noise_px)]


def mixed(larger, smaller, focal, centre=(793.0, 606.0)):
    return views_of("a", larger, 1) + views_of("b", smaller, 2, focal, centre)


def found_in(views, groups=(), board=None, shape=FLAT):
    board = board or make_scene(count=1).board
    return calibrate(views, board, Options(MODEL, shape=shape, max_rejected=1.0, named_groups=groups))


def folders(found):
    return tuple({image[0] for image in group} for group in found.groups)


@pytest.mark.slow
def test_of_many_views_all_those_of_the_second_camera_are_named():
    """More views than are looked at first; of one camera, nothing is found."""
    found = found_in(mixed(60, 20, 1250.0)).two_cameras
    assert [len(group) for group in found.groups] == [60, 20]
    assert folders(found) == ({"a"}, {"b"})
    assert found_in(views_of("a", 70, 1)).two_cameras is None


@pytest.mark.parametrize(
    ("larger", "smaller", "focal"), [(17, 3, 1215.0), (10, 10, 1215.0), (12, 5, 1250.0), (10, 9, 1400.0)]
)
def test_views_of_two_cameras_are_told_apart_one_by_one(larger, smaller, focal):
    found = found_in(mixed(larger, smaller, focal)).two_cameras
    assert found.ratio > CLEAR
    assert sorted(map(len, found.groups)) == sorted((larger, smaller))
    assert folders(found) in (({"a"}, {"b"}), ({"b"}, {"a"}))
    assert sorted(found.focal_px) == pytest.approx([1200.0, focal], rel=0.005)
    assert found.own_px < 0.15 < found.other_px  # noise of 0.1 px has a median length of 0.12 px
    assert not found.by_name


def test_the_verdict_names_both_groups(scene):
    assessment = assess(found_in(mixed(12, 5, 1215.0)))
    assert not assessment.trustworthy
    (failure,) = [own for own in assessment.failures if own.code == "several_cameras"]
    assert "12 views (a/view0000.png, a/view0001.png, a/view0002.png and 9 more)" in failure.text
    assert "5 views (b/view0000.png" in failure.text
    assert failure.text.endswith("calibrate each group separately")


@pytest.mark.slow
@pytest.mark.parametrize("focal", [600.0, 2400.0])
def test_lenses_so_different_that_nothing_fits_end_without_a_result_and_both_groups_are_named(focal):
    views = mixed(12, 6, focal)
    with pytest.raises(
        InsufficientData, match=r"corners.*are off.*two cameras, or of one with changed zoom"
    ) as refused:
        calibrate(views, make_scene(count=1).board, Options(MODEL, shape=FLAT))
    # at 600 px one view of the second camera suits the lens of the first as well as noise lets it
    assert re.search(r"1[23] views \(a/view0000.*[56] views \(b/view000[01]", refused.value.message)
    assert refused.value.message.endswith("calibrate each group separately")


@pytest.mark.parametrize(("ratio", "refused"), [(1.95, False), (2.05, True)])
def test_views_are_refused_for_two_cameras_where_these_are_clear(ratio, refused):
    cameras = TwoCameras(
        (("a.png",), ("b.png",)), by_name=False, ratio=ratio, own_px=0.1, other_px=9.0, focal_px=(1, 2)
    )
    if refused:
        with pytest.raises(InsufficientData, match=r"1 view \(a\.png\) and 1 view \(b\.png\)"):
            require_one_camera(cameras)
    else:
        require_one_camera(cameras)
    require_one_camera(None)


@pytest.mark.slow
def test_cameras_that_differ_little_are_told_by_their_names_where_their_lenses_do_not_tell_them():
    views = mixed(10, 10, 1205.0, (794.0, 604.0))
    assert not {"several_cameras", "several_cameras_by_name"} & codes(views)
    named = (frozenset(view.image for view in views if view.image[0] == "b"),)
    assert "several_cameras_by_name" in codes(views, named)


def codes(views, groups=()):
    return {own.code for own in assess(found_in(views, groups)).messages}


@pytest.mark.parametrize("count", [6, 10, 30])
@pytest.mark.parametrize("seed", [1, 2])
def test_views_of_one_camera_are_not_looked_at_twice(monkeypatch, count, seed):
    """Estimating lenses of groups costs as much as a calibration; the screen leaves it out."""
    monkeypatch.setattr(several_cameras, "_compared", lambda *given, **how: pytest.fail("a group has been estimated"))
    views = views_of("a", count, seed)
    halves = (frozenset(view.image for view in views[::2]), frozenset(view.image for view in views[: count // 2]))
    assert found_in(views, halves).two_cameras is None


def test_wrong_corners_and_views_are_no_second_camera(scene):
    rng = np.random.default_rng(5)
    views = list(scene.observe(3, noise_px=0.1, outliers=0.03))
    views[:4] = [replace(view, ids=rng.permutation(view.ids)) for view in views[:4]]
    calibration = calibrate(views, scene.board, Options(MODEL, shape=FLAT, max_rejected=0.5))
    assert calibration.two_cameras is None or calibration.two_cameras.ratio < CLEAR_BY_NAME


def test_noisy_views_are_no_second_camera(scene):
    views = list(scene.observe(3, noise_px=0.1))
    views[:8] = scene.observe(4, noise_px=1.0)[:8]
    found = found_in(views, (frozenset(view.image for view in views[:8]),)).two_cameras
    assert found is None or found.ratio < CLEAR_BY_NAME


def test_the_bend_of_a_board_and_views_numbered_from_its_other_end_are_no_second_camera(even_scene):
    views = even_scene.observe(2, noise_px=0.1)
    views = [turned(view, even_scene.board, index % 2) for index, view in enumerate(views)]
    found = found_in(views, board=even_scene.board, shape=ShapeOptions()).two_cameras
    assert found is None or found.ratio < CLEAR_BY_NAME


@pytest.mark.slow
@pytest.mark.parametrize("model", ["opencv4", "opencv5"])
def test_a_wrong_lens_model_is_no_second_camera(model):
    """Any two groups of views have two lenses then, of which neither describes its views."""
    wide = make_scene("kannala_brandt4", count=18, seed=1)
    views = wide.observe(1, noise_px=0.1)
    with pytest.raises(InsufficientData, match=rf"the lens model \({model}\) does not fit"):
        calibrate(views, wide.board, Options(model_named(model), shape=FLAT))


@pytest.mark.parametrize(("limit", "told"), [(0.8, False), (1.8, True)])
def test_lenses_whose_residuals_are_smooth_over_the_board_are_not_believed(monkeypatch, limit, told):
    """Noise alone leaves a ratio of 1, on one side of the limit; wrong models are the test above on the other."""
    monkeypatch.setattr(several_cameras, "SMOOTH", limit)
    assert (found_in(mixed(12, 5, 1250.0)).two_cameras is not None) == told


def test_two_views_are_no_group():
    assert found_in(mixed(12, 2, 1400.0)).two_cameras is None
    assert found_in(mixed(3, 2, 1400.0)[:5]).two_cameras is None


def test_a_lens_that_is_given_is_not_looked_for(scene):
    camera = scene.camera
    known = Options(MODEL, fixed=MODEL.parameter_names, guess=camera, shape=FLAT, max_rejected=1.0)
    assert calibrate(mixed(10, 5, 1215.0), scene.board, known).two_cameras is None


@pytest.mark.slow
def test_a_large_board_of_many_views_is_taken_in_parts(monkeypatch):
    """Parts of the views give what all of them give at once."""
    board = Board("chessboard", 9, 6, 0.040)
    views = mixed(12, 5, 1250.0)
    whole = found_in(views, board=board).two_cameras
    monkeypatch.setattr("camcal.calibrate.single_views._CHUNK", 4)
    parts = found_in(views, board=board).two_cameras
    assert parts.groups == whole.groups
    assert parts.ratio == pytest.approx(whole.ratio, rel=1e-9)


def test_the_gain_of_two_lenses_is_that_of_the_likelihood_of_all_residuals():
    """Residuals by one parameter of the lens, with the noise of each view; the prior is too wide to matter."""
    rng = np.random.default_rng(3)
    smaller = np.arange(7) >= 5
    slopes = 100 * rng.normal(size=(7, 40))
    observed = slopes * np.where(smaller, 1.5, 0.0)[:, None] + 20 * rng.normal(size=(7, 40))
    found = ViewQuadratics(
        (observed**2).sum(axis=1),
        -(slopes * observed).sum(axis=1)[:, None],
        curvature=(slopes**2).sum(axis=1)[:, None, None],
        count=np.full(7, 40.0),
        weights=np.ones((7, 20)),
    )

    def likelihood(members):
        lens = found.best(members)[0]
        residuals = (observed - slopes * lens)[members]
        return norm.logpdf(residuals, scale=np.sqrt((residuals**2).mean(axis=1, keepdims=True))).sum()

    gain = likelihood(smaller) + likelihood(~smaller) - likelihood(np.ones(7, bool))
    assert found.gain(smaller) == pytest.approx(gain / (2 * 40), rel=1e-9)


@pytest.mark.parametrize(("larger", "smaller", "focal", "by_name"), [(10, 8, 1212.0, True), (17, 4, 1212.0, False)])
def test_groups_by_lenses_must_be_clearer_by_half_than_those_that_names_suggest(larger, smaller, focal, by_name):
    """The name of one view of the second camera is as those of the first: ratios of 1.70 to 1.64, and 1.19 to 0.76."""
    views = mixed(larger, smaller, focal)
    named = (frozenset(view.image for view in views[larger:-1]),)
    assert found_in(views, named).two_cameras.by_name == by_name


def test_the_ratio_of_few_views_is_its_mean_less_its_standard_error():
    """Four ratios of errors of 2, 2, 2 and 8: their logarithms to base 2 are 1.5 on average, with a deviation of 1."""
    found = several_cameras._ratio(np.array([4.0, 4.0, 4.0, 64.0]), np.ones(4), np.full(4, 100.0))
    assert found == pytest.approx(2 ** (1.5 - 1 / 2), rel=1e-12)


@pytest.mark.filterwarnings("error")
def test_a_view_whose_pose_leaves_hardly_a_corner_in_front_of_the_camera_tells_nothing_of_the_lens():
    scene = make_scene(count=3)
    problem = BoardProblem(scene.camera.model, scene.board, Observations.of(scene.observe(1)), np.arange(9))
    rotations, translations = (
        np.stack([getattr(pose, name) for pose in scene.poses]) for name in ("rotation", "translation")
    )
    translations[1, 2] -= 10.0  # behind the camera
    state = State(
        np.array(scene.camera.parameters), rotations, translations, np.zeros(0), np.zeros((scene.board.count, 3))
    )
    weights = problem.observations.weights
    assert np.isnan(problem.residuals(state)[:, 1]).all()
    assert smoothness(problem, state, weights) == smoothness(problem, state, weights * np.array([[1], [0], [1]]))
