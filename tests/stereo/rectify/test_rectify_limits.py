"""Where the limits of rectification are: what is refused, what is said, where windows end and axes point."""

import numpy as np
import pytest
from rigs import NARROW, PLAIN, WIDE, camera, placed

from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.stereo.options import RectifiedViewOptions
from camcal.stereo.rectify.field import extent
from camcal.stereo.rectify.plan import plan_rectification

BESIDE = placed((0.1, 0, 0))


def planned(first, second, pose, **options):
    return plan_rectification({"one": first, "two": second}, pose, RectifiedViewOptions(**options))


def codes(plan):
    return [warning.code for warning in plan.warnings]


def looking(angle_deg):
    """The pose of a second camera parallel to the first one, at so many degrees from where they look."""
    angle = np.radians(angle_deg)
    return placed((0.1 * np.sin(angle), 0, 0.1 * np.cos(angle)))


def test_a_pair_is_refused_that_would_turn_a_fourteenth_of_an_image():
    with pytest.raises(InsufficientData, match=r"oblique pair: .* would turn a part of them"):
        planned(NARROW, NARROW, looking(30))


@pytest.mark.parametrize(("angle", "kind"), [(10, "axial"), (20, "oblique")])
def test_a_pair_within_15_degrees_of_its_baseline_is_axial(angle, kind):
    with pytest.raises(InsufficientData, match=f"{kind} pair: one and two look {angle}° off"):
        planned(WIDE, WIDE, looking(angle))


@pytest.mark.parametrize(("below", "turned_deg"), [(30, 0.0), (65, 6.05)])
def test_the_axis_is_that_of_the_field_where_this_is_more_than_5_degrees_off_it(below, turned_deg):
    """Below the middle of the image the lens has its axis: the field reaches farther up than down."""
    lens = camera(centre=(319.5, 239.5 - below))
    plan = planned(lens, lens, BESIDE)
    assert np.degrees(np.linalg.norm(so3.log(plan.rect_R_left))) == pytest.approx(turned_deg, abs=0.01)
    assert plan.kept > 0.99


def test_windows_end_where_the_images_do():
    plan = planned(NARROW, NARROW, BESIDE)
    last = np.array(NARROW.image_size) - 1
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * last
    for side, rotation in ((plan.left_camera, plan.rect_R_left), (plan.right_camera, plan.rect_R_right)):
        pixels = side.project(NARROW.unproject(corners).directions @ rotation.T).pixels
        # the size is rounded, the outline is followed in steps; cells of the grid of directions are 4 px wide
        np.testing.assert_allclose(pixels.min(axis=0), 0, atol=1.6)
        np.testing.assert_allclose(pixels.max(axis=0), np.array(plan.size) - 1, atol=1.6)


@pytest.mark.parametrize(("roll_deg", "said"), [(40, []), (80, ["rotated_images"])])
def test_images_rotated_by_more_than_50_degrees_are_said(roll_deg, said):
    assert codes(planned(NARROW, NARROW, placed((0.2, 0, 0), (0, 0, roll_deg)))) == said


@pytest.mark.parametrize(("axis_deg", "roll_deg"), [(40, 40), (40, -40), (-40, 40), (130, 40)])
def test_the_axis_of_the_pair_turns_neither_of_two_images_by_more_than_60_degrees(axis_deg, roll_deg):
    """Seen by the first camera alone, the other axis may be nearer: the second one's images would turn by 80°."""
    direction = np.radians(axis_deg)
    plan = planned(NARROW, NARROW, placed((0.2 * np.cos(direction), 0.2 * np.sin(direction), 0), (0, 0, roll_deg)))
    for rotation in (plan.rect_R_left, plan.rect_R_right):
        assert np.degrees(np.linalg.norm(so3.log(rotation))) < 60


@pytest.mark.parametrize(("turn_deg", "said"), [(-45, []), (-65, ["converging_cameras"])])
def test_axes_that_meet_nearer_than_3_quarters_of_the_baseline_are_said(turn_deg, said):
    assert codes(planned(WIDE, WIDE, placed((0.2, 0, 0), (0, turn_deg, 0)))) == said


@pytest.mark.parametrize(
    ("fov_deg", "said"), [((140, 130), []), ((130, 120), ["field_not_kept"]), ((110, 90), ["field_not_kept"])]
)
def test_less_than_85_percent_of_the_common_field_is_said(fov_deg, said):
    assert codes(planned(WIDE, WIDE, BESIDE, fov_deg=fov_deg)) == said


@pytest.mark.parametrize(("turn_deg", "one"), [(-5, True), (-15, False)])
def test_both_images_have_one_window_that_is_up_to_15_percent_wider(turn_deg, one):
    plan = planned(NARROW, NARROW, placed((0.3, 0, 0), (0, turn_deg, 0)))
    assert (plan.doffs == 0) == one


def test_what_no_projection_holds_is_not_put_down_to_faint_rows():
    lens = camera("kannala_brandt4", (800, 600), 250.0, (0.0, 0.0, 0.0, 0.0))
    plan = planned(lens, lens, BESIDE, projection="pinhole")
    (warning,) = plan.warnings
    assert "a pinhole image holds up to 70° off the plane" in warning.text


def test_the_upper_one_of_exchanged_cameras_is_said_to_be_above():
    plan = planned(PLAIN, PLAIN, placed((0.002, -0.1, 0)))
    assert codes(plan) == ["exchanged_cameras"]
    assert "two is above one" in plan.warnings[0].text


def test_images_are_upright_as_those_of_the_first_camera_on_whichever_side_it_is():
    plan = planned(NARROW, NARROW, placed((-0.1, 0.003, 0), (0, 0, 180)))
    assert (plan.left, codes(plan)) == ("two", ["exchanged_cameras", "rotated_images"])
    assert "rectified images of two are rotated" in plan.warnings[1].text


def test_rows_with_less_than_a_twentieth_of_the_fullest_are_left_out():
    found = extent(np.array([0.01, 0.04, 0.07, 1.0, 1.0, 0.07, 0.04, 0.0]), np.arange(8.0))
    assert found == (1.5, 5.5)
