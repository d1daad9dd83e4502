"""The geometry of rectification: rows, order, orientation, field of view and focal length, for all kinds of pairs."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs import NARROW, PLAIN, WIDE, camera, common_points, inside, placed, rectified_pixels

from camcal.cameras.validity import ImageCircle
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry.pose import Pose
from camcal.stereo.options import RectifiedViewOptions
from camcal.stereo.rectify.plan import plan_rectification

NAMES = ("one", "two")
TURN = placed((0.1, 0.002, -0.003), (0.5, 3.0, 1.0))
KINDS = {
    "parallel": (PLAIN, PLAIN, placed((0.1, 0, 0)), "pinhole", "x"),
    "distorted": (NARROW, NARROW, TURN, "pinhole", "x"),
    "toed-in": (NARROW, NARROW, placed((0.3, 0, 0.04), (0, -15, 0)), "pinhole", "x"),
    "strongly toed-in": (NARROW, NARROW, placed((0.3, 0, 0), (0, -50, 2)), "latlon", "x"),
    "swapped": (NARROW, NARROW, placed((-0.1, 0.003, 0), (1, 2, 0)), "pinhole", "x"),
    "above": (NARROW, NARROW, placed((0.002, -0.1, 0), (1, 0, 2)), "pinhole", "y"),
    "below": (NARROW, NARROW, placed((0.002, 0.1, 0), (1, 0, 2)), "pinhole", "y"),
    "upside-down": (NARROW, NARROW, placed((0.1, 0, 0), (0, 0, 180)), "pinhole", "x"),
    "wide": (WIDE, WIDE, placed((0.1, 0.001, 0), (1, 2, 0)), "latlon", "x"),
    "wide above": (WIDE, WIDE, placed((0, 0.1, 0.001), (1, 2, 0)), "latlon", "y"),
    "mixed": (WIDE, NARROW, placed((0.1, 0.001, 0), (1, 2, 0)), "pinhole", "x"),
    "oblique": (PLAIN, PLAIN, placed((0.1, 0, 0.06)), "latlon", "x"),
}


def planned(first, second, pose, **options):
    return plan_rectification(dict(zip(NAMES, (first, second), strict=True)), pose, RectifiedViewOptions(**options))


@pytest.mark.parametrize("kind", KINDS)
def test_common_points_are_in_one_row_and_in_both_images(kind):
    first, second, pose, projection, axis = KINDS[kind]
    plan = planned(first, second, pose)
    assert (plan.projection, plan.axis) == (projection, axis)
    baseline = np.linalg.norm(pose.translation)
    assert plan.baseline == pytest.approx(baseline, rel=1e-12)
    assert plan.focal > 0
    assert plan.kept > 0.97
    for distance in (5 * baseline, 50 * baseline):
        points = common_points(first, second, pose, distance)
        left, right = rectified_pixels(plan, NAMES, points, pose)
        held = inside(plan, left) & inside(plan, right)
        assert held.mean() > 0.9  # what both see, kept
        along = plan.along
        np.testing.assert_allclose(left[held, 1 - along], right[held, 1 - along], atol=1e-9)  # rounding
        assert (left[held, along] - right[held, along] + plan.doffs).min() > 0


@pytest.mark.parametrize("kind", KINDS)
def test_disparity_gives_the_distance(kind):
    first, second, pose, *_ = KINDS[kind]
    plan = planned(first, second, pose)
    points = common_points(first, second, pose, 8 * plan.baseline)
    left, right = rectified_pixels(plan, NAMES, points, pose)
    own = points if plan.left == NAMES[0] else pose.apply(points)
    own = own @ plan.rect_R_left.T
    along = plan.along
    disparity = left[:, along] - right[:, along] + plan.doffs
    if plan.projection == "latlon":
        angles = [(side[:, along] - centre[along]) / plan.focal for side, centre in
                  ((left, plan.left_centre), (right, plan.right_centre))]  # fmt: skip
        found = plan.baseline / (np.tan(angles[0]) - np.tan(angles[1]))
    else:
        found = plan.focal * plan.baseline / disparity
    depth = own[:, 2] if plan.projection == "pinhole" else np.hypot(own[:, 1 - along], own[:, 2])
    known = np.isfinite(disparity)
    np.testing.assert_allclose(found[known], depth[known], rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_images_are_upright_as_those_of_the_first_camera(kind):
    first, second, pose, *_ = KINDS[kind]
    plan = planned(first, second, pose)
    side = plan.left_camera if plan.left == NAMES[0] else plan.right_camera
    rotation = plan.rect_R_left if plan.left == NAMES[0] else plan.rect_R_right
    middle = np.array([(size - 1) / 2 for size in first.image_size])
    steps = middle + np.array([[0, 0], [1, 0], [0, 1]])
    here, right, below = side.project(first.unproject(steps).directions @ rotation.T).pixels
    assert (right - here)[0] > 0.3 * np.linalg.norm(right - here)
    assert (below - here)[1] > 0.3 * np.linalg.norm(below - here)


def test_a_parallel_pair_keeps_its_own_pixels():
    plan = planned(PLAIN, PLAIN, placed((0.1, 0, 0)))
    assert plan.size == PLAIN.image_size
    np.testing.assert_allclose(plan.left_camera.parameters, PLAIN.parameters, atol=1e-4)  # finite differences
    np.testing.assert_allclose(plan.rect_R_left, np.eye(3), atol=1e-12)
    assert plan.doffs == 0


@pytest.mark.parametrize("centre", [(0.1, 0, 0), (0.1, 0.004, -0.002), (0, 0.1, 0)])
def test_matrices_are_those_of_opencv_but_for_focal_length_and_centre(centre):
    pose = placed(centre)
    plan = planned(PLAIN, PLAIN, pose)
    r1, r2, p1, p2, q, *_ = cv2.stereoRectify(
        PLAIN.K, np.zeros(5), PLAIN.K, np.zeros(5), PLAIN.image_size, pose.rotation, pose.translation[:, None]
    )
    found = plan.opencv()
    # both turn the baseline into an axis by the smallest rotation, but for a turn about the baseline of second order
    np.testing.assert_allclose(found.R1, r1, atol=2e-3)
    np.testing.assert_allclose(found.R2, r2, atol=2e-3)
    assert found.P2[plan.along, 3] / found.P2[0, 0] == pytest.approx(p2[plan.along, 3] / p2[0, 0], rel=1e-9)
    assert found.Q[3, 2] == pytest.approx(q[3, 2], rel=1e-9)
    np.testing.assert_array_equal(np.sign(found.P1), np.sign(p1))


def test_q_takes_pixel_and_disparity_to_the_point():
    first, second, pose, *_ = KINDS["toed-in"]
    plan = planned(first, second, pose)
    points = common_points(first, second, pose, 3.0)[:20]
    left, right = rectified_pixels(plan, NAMES, points, pose)
    homogeneous = np.column_stack([left, left[:, 0] - right[:, 0], np.ones(len(left))]) @ plan.opencv().Q.T
    np.testing.assert_allclose(homogeneous[:, :3] / homogeneous[:, 3:], points @ plan.rect_R_left.T, rtol=1e-9)


@pytest.mark.parametrize("kind", ["toed-in", "swapped", "above", "wide", "wide above"])
def test_both_cameras_of_a_plan_see_a_point_of_its_left_frame(kind):
    first, second, pose, *_ = KINDS[kind]
    plan = planned(first, second, pose)
    points = common_points(first, second, pose, 3.0)[:50]
    own = points if plan.left == NAMES[0] else pose.apply(points)
    left, right = plan.pixels(own @ plan.rect_R_left.T)
    expected = rectified_pixels(plan, NAMES, points, pose)
    np.testing.assert_allclose(left.pixels, expected[0], atol=1e-9)
    np.testing.assert_allclose(right.pixels, expected[1], atol=1e-9)
    rays = plan.rays(left.pixels, right.pixels)[0].directions
    np.testing.assert_allclose(np.cross(rays, own @ plan.rect_R_left.T), 0, atol=1e-9)


def test_the_finer_camera_keeps_its_resolution_within_twice_the_pixels():
    fine = camera(size=(640, 480), focal=1000.0)
    assert planned(PLAIN, fine, placed((0.1, 0, 0))).focal == pytest.approx(1000.0, rel=1e-3)
    plan = planned(camera(focal=4000.0), PLAIN, placed((0.1, 0, 0)))
    assert plan.focal < 4000
    assert plan.size[0] * plan.size[1] == pytest.approx(2 * 640 * 480, rel=0.01)


def test_exchanged_cameras_are_named_in_the_order_of_positive_disparities():
    plan = planned(*KINDS["swapped"][:3])
    assert (plan.left, plan.right, plan.swapped) == ("two", "one", True)
    assert [warning.code for warning in plan.warnings] == ["exchanged_cameras"]
    assert "two is left of one" in str(plan.warnings[0])
    assert planned(*KINDS["above"][:3]).left == "two"


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        (placed((0, 0, 0.1)), "axial pair: one and two look 0° off their baseline"),
        (placed((0.005, 0, 0.1)), "axial pair: one and two look 3° off"),
        (placed((0.1, 0, 0), (0, 180, 0)), "no common field of view: their optical axes are 180° apart"),
        (placed((0.1, 0, 0), (0, 90, 0)), "no common field of view: their optical axes are 90° apart"),
        (placed((0, 0, 0)), "at one place"),
    ],
)
def test_pairs_without_rectification_are_refused_by_name(pose, said):
    with pytest.raises(InsufficientData, match=said):
        planned(NARROW, NARROW, pose)


def test_oblique_pairs_are_refused_if_they_lose_much_unless_a_part_is_asked_for():
    pose = placed((0.1, 0, 0.1))
    with pytest.raises(InsufficientData, match="oblique pair: one and two look 45° off their baseline"):
        planned(WIDE, WIDE, pose)
    part = planned(WIDE, WIDE, pose, fov_deg=(60.0, 80.0))
    assert "of the common field kept: --fov 60x80 holds no more" in str(part.warnings[0])


def test_lenses_that_see_far_behind_them_keep_what_is_in_front():
    around = camera("kannala_brandt4", (800, 600), 190.0, (0.0, 0.0, 0.0, 0.0))  # 301° from corner to corner
    plan = planned(around, around, placed((0.1, 0, 0)))
    assert plan.projection == "latlon"
    assert [warning.code for warning in plan.warnings] == ["field_not_kept"]
    points = common_points(around, around, placed((0.1, 0, 0)), 5.0)
    front = points[:, 2] > 0
    left, right = rectified_pixels(plan, NAMES, points, placed((0.1, 0, 0)))
    assert (inside(plan, left) & inside(plan, right))[front].mean() > 0.97


def test_the_image_circle_limits_the_field():
    whole = planned(WIDE, WIDE, placed((0.1, 0, 0)))
    circle = ImageCircle(WIDE.image_size, (399.5, 299.5), 200.0)
    part = plan_rectification(dict.fromkeys(NAMES, WIDE), placed((0.1, 0, 0)), circles=dict.fromkeys(NAMES, circle))
    assert part.kept > 0.97
    assert part.size[1] < 0.75 * whole.size[1]


def test_options_choose_projection_field_and_size():
    pose = placed((0.1, 0, 0))
    assert planned(WIDE, WIDE, pose, projection="cylindrical").projection == "cylindrical"
    chosen = planned(WIDE, WIDE, pose, fov_deg=(80.0, 60.0))
    assert chosen.projection == "pinhole"
    ends = chosen.left_camera.unproject(
        np.array([[0, chosen.left_centre[1]], [chosen.size[0] - 1, chosen.left_centre[1]]])
    )
    angle = np.degrees(np.arccos(ends.directions[0] @ ends.directions[1]))
    assert angle == pytest.approx(80, abs=0.2)  # half a pixel
    assert planned(PLAIN, PLAIN, pose, size=(320, 200)).size == (320, 200)
    half = planned(PLAIN, PLAIN, pose, scale=0.5)
    assert half.focal == pytest.approx(250, rel=1e-6)
    assert half.size == (320, 240)  # pixel centres 639 / 2 and 479 / 2 apart, rounded


def test_what_is_not_kept_is_said():
    plan = planned(WIDE, WIDE, placed((0.1, 0, 0)), fov_deg=(60.0, 40.0))
    assert plan.kept < 0.5
    assert "--fov 60x40 holds no more" in str(plan.warnings[0])
    forced = planned(WIDE, WIDE, placed((0.1, 0, 0)), projection="pinhole")
    assert forced.projection == "pinhole"
    assert forced.focal > 0


@pytest.mark.parametrize(("roll", "rotated"), [(30, []), (88, ["right"]), (-120, ["right"]), (180, ["right"])])
def test_a_camera_mounted_at_another_roll_is_said_to_be_rotated(roll, rotated):
    plan = plan_rectification({"left": NARROW, "right": NARROW}, placed((0.2, 0.0, 0.0), (0, 0, roll)))
    said = [warning for warning in plan.warnings if warning.code == "rotated_images"]
    assert [warning.values["rotation_deg"] for warning in said] == [pytest.approx(abs(roll), abs=6) for _ in rotated]
    assert all(
        f"rectified images of {name} are rotated by" in each.text for name, each in zip(rotated, said, strict=True)
    )


def test_axes_that_meet_next_to_the_cameras_are_said():
    plan = plan_rectification({"left": WIDE, "right": WIDE}, placed((0.2, 0.0, 0.0), (0, -75, 0)))
    (warning,) = (each for each in plan.warnings if each.code == "converging_cameras")
    assert warning.values["baselines"] == pytest.approx(1 / np.tan(np.radians(75)), rel=1e-6)


def test_axes_that_pass_each_other_next_to_the_cameras_are_said():
    plan = plan_rectification({"left": WIDE, "right": WIDE}, placed((0.2, 0.0, 0.1), (40, -50, 0)))
    (warning,) = (each for each in plan.warnings if each.code == "converging_cameras")
    assert warning.values["baselines"] < 0.75


def test_oblique_pairs_hold_what_is_three_baselines_along_their_axes():
    tele, wide = camera(focal=2500.0), camera("kannala_brandt4", (800, 600), 300.0, (0.0, 0.0, 0.0, 0.0))
    angle = np.radians(50)
    pose = placed((0.2 * np.cos(angle), 0.0, -0.2 * np.sin(angle)))
    plan = plan_rectification({"left": tele, "right": wide}, pose)
    pixels = rectified_pixels(plan, ("left", "right"), common_points(tele, wide, pose, 0.6), pose)
    assert np.logical_and(*(inside(plan, each) for each in pixels)).mean() > 0.9


def test_of_150_rigs_in_any_orientation_each_is_upright_and_whole_or_refused_or_said():
    rng = np.random.default_rng(15)
    said = {"rotated_images", "field_not_kept", "converging_cameras"}
    counts = dict.fromkeys(("good", "said", "refused"), 0)
    while sum(counts.values()) < 150:
        lens = NARROW if rng.random() < 0.5 else WIDE
        direction, roll = rng.normal(size=3), rng.uniform(-180, 180) if rng.random() < 0.5 else rng.normal(0, 15)
        pose = placed(0.2 * direction / np.linalg.norm(direction), (*rng.normal(0, 15, 2), roll))
        try:
            plan = plan_rectification({"left": lens, "right": lens}, pose)
        except InsufficientData:
            counts["refused"] += 1
            continue
        if said & {warning.code for warning in plan.warnings}:
            counts["said"] += 1
            continue
        assert median_turn(lens, plan.rect_R_left, plan.left_camera) < 60
        assert median_turn(lens, plan.rect_R_right, plan.right_camera) < 60
        assert share_held(plan, lens, pose) > 0.85
        counts["good"] += 1
    assert counts["good"] > 30


def median_turn(lens, rotation, camera):
    """Return by what angle (degrees, median) what the lens sees is turned in the rectified images."""
    grid = np.meshgrid(*(np.linspace(0.5, side - 1.5, 30) for side in camera.image_size))
    here = np.column_stack([axis.ravel() for axis in grid])
    beside = here + np.array([0.5, 0])
    first, second = (lens.project(camera.unproject(each).directions @ rotation).pixels for each in (here, beside))
    with np.errstate(invalid="ignore"):
        seen = ((first >= 0) & (first <= np.array(lens.image_size) - 1)).all(axis=1)
    step = (second - first)[seen]
    return float(np.nanmedian(np.abs(np.degrees(np.arctan2(step[:, 1], step[:, 0])))))


def share_held(plan, lens, pose):
    """Return the share of the points from 3 baselines on, which both cameras see, that both rectified images hold."""
    held = []
    for distance in (0.6, 2.0, 200.0):
        points = common_points(lens, lens, pose, distance)
        pixels = rectified_pixels(plan, ("left", "right"), points, pose)
        held.append(np.logical_and(*(inside(plan, each) for each in pixels)))
    return np.mean(np.concatenate(held))


def test_one_centre_for_both_where_it_is_asked_for():
    first, second, pose, *_ = KINDS["strongly toed-in"]
    assert planned(first, second, pose).doffs != 0
    assert planned(first, second, pose, zero_disparity=True).doffs == 0


def test_a_crop_has_pixels_of_both_cameras_everywhere():
    plan = planned(NARROW, NARROW, TURN, alpha=0.0)
    width, height = plan.size
    edges = np.array([[x, y] for x in np.linspace(0, width - 1, 30) for y in (0, height - 1)])
    for side, turn in ((plan.left_camera, plan.rect_R_left), (plan.right_camera, plan.rect_R_right)):
        pixels = NARROW.project(side.unproject(edges).directions @ turn).pixels
        assert ((pixels >= 0) & (pixels <= np.array(NARROW.image_size) - 1)).all()
    assert plan.kept > 0.85


def test_bad_options_are_refused():
    for wrong in ({"scale": 0.0}, {"scale": 1.0, "size": (9, 9)}, {"fov_deg": (0.0, 60.0)}, {"size": (1, 9)}):
        with pytest.raises(InvalidInput):
            RectifiedViewOptions(**wrong)
    with pytest.raises(InvalidInput, match="a pair is two cameras, found 1"):
        plan_rectification({"one": PLAIN}, placed((0.1, 0, 0)))


angles = st.floats(-15, 15)
offsets = st.floats(-0.3, 0.3)


@settings(max_examples=8, deadline=None)
@given(
    turn=st.tuples(angles, angles, angles),
    offset=st.tuples(offsets, offsets),
    vertical=st.booleans(),
    sign=st.sampled_from((-1, 1)),
    lenses=st.sampled_from([(NARROW, NARROW), (WIDE, WIDE), (PLAIN, WIDE), (camera(focal=2000.0), PLAIN)]),
)
def test_any_pair_side_by_side_is_rectified(turn, offset, vertical, sign, lenses):
    centre = np.array([1.0, *offset]) * 0.1 * sign
    pose = placed(centre[[1, 0, 2]] if vertical else centre, turn)
    plan = planned(*lenses, pose)
    assert plan.focal > 0
    assert plan.size[0] * plan.size[1] < 2.1 * max(lens.image_size[0] * lens.image_size[1] for lens in lenses)
    points = common_points(*lenses, pose, 2.0, count=500)
    left, right = rectified_pixels(plan, NAMES, points, pose)
    held = inside(plan, left) & inside(plan, right)
    if len(points) > 50:
        assert held.mean() > 0.85
    np.testing.assert_allclose(left[held, 1 - plan.along], right[held, 1 - plan.along], atol=1e-9)
    assert isinstance(plan.right_T_left, Pose)
