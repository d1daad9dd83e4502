"""What is shown of a cloud, and from where."""

import numpy as np
import pytest
from clouds import BLUE, RED, ROS, in_ros, scene_of, square, stream_of, two_squares

from camcal.errors import InsufficientData, InvalidInput
from camcal.report.cloud_scene import around, axes_of, evenly, gather, named_views, turn, view_of
from camcal.stereo.depth import VertexStream, vertex_type


def test_a_thinned_cloud_has_points_of_every_stretch_of_the_file(rng):
    points = rng.normal(size=(10_000, 3)) + np.array([0, 0, 10])
    scene = gather(stream_of(points, blocks=7), most=500)
    assert (len(scene.points) + scene.outside, scene.total) == (500, 10_000)
    places = evenly(10_000, 500)
    assert np.all(places // 20 == np.arange(500))  # one of each 20
    assert len(np.unique(np.diff(places))) > 5  # and not every 20th


def test_thinning_is_the_same_every_time_and_however_the_file_is_cut(rng):
    points = rng.normal(size=(5000, 3)) + np.array([0, 0, 10])
    once, again = (gather(stream_of(points, blocks=blocks), most=300).points for blocks in (1, 11))
    np.testing.assert_array_equal(once, again)


def test_points_that_are_not_finite_are_none():
    points = np.array([[0, 0, 1], [np.nan, 0, 1], [0, np.inf, 1], [0, 0.1, 1]])
    scene = gather(stream_of(points), most=10)
    assert scene.total == 2
    np.testing.assert_array_equal(scene.points, np.float32([[0, 0, 1], [0, 0.1, 1]]))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((4, 3), np.nan)])
def test_a_cloud_without_points_is_refused(points):
    with pytest.raises(InsufficientData, match="no points"):
        gather(stream_of(points), most=10)


def test_a_few_points_far_from_all_others_are_left_out_and_counted(rng):
    points = np.concatenate([rng.uniform(-1, 1, (3000, 3)) + np.array([0, 0, 5]), [[0, 0, 1e6], [900, 0, 5]]])
    scene = gather(stream_of(points), most=10**6)
    assert (scene.outside, len(scene.points)) == (2, 3000)
    assert scene.points[:, 2].max() < 7


def test_intensity_is_shown_as_gray():
    vertices = np.zeros(3, vertex_type(intensity=True))
    vertices["intensity"] = [0, 0.5, 1]
    vertices["z"] = [1, 1, 2]
    scene = gather(VertexStream(3, vertices.dtype, [vertices]), most=10)
    np.testing.assert_array_equal(scene.colours, [[0] * 3, [128] * 3, [255] * 3])


def test_the_words_of_the_frame_tell_which_way_is_forward():
    points, *_ = two_squares()
    optical, ros = scene_of(points), scene_of(in_ros(points), frame=ROS)
    np.testing.assert_allclose(ros.seen, optical.seen, atol=1e-6)  # float32
    assert ros.from_camera
    assert named_views(ros)["camera"].target == pytest.approx(named_views(optical)["camera"].target, abs=1e-6)


def test_what_lies_around_the_origin_was_not_seen_by_a_camera_there(rng):
    assert not scene_of(rng.normal(size=(2000, 3))).from_camera
    assert scene_of(rng.normal(size=(2000, 3)) + np.array([0, 0, 10])).from_camera


def test_the_spacing_of_a_camera_s_points_grows_with_the_distance(rng):
    tangents = square((0, 0, 0), 0.5, 101)[:, :2]
    depth = rng.choice([2.0, 3.0, 8.0], size=5).repeat(101 * 101 // 5 + 1)[: 101 * 101]
    spacing, grows = scene_of(np.column_stack([tangents * depth[:, None], depth])).spacing
    assert grows
    # 100 steps over one unit; the rays are up to 20 % longer than the depth.
    assert spacing == pytest.approx(0.01, rel=0.2)


def test_the_spacing_of_a_grid_in_space_is_that_of_the_grid():
    steps = np.arange(-1, 1.0001, 0.05)
    cube = np.stack(np.meshgrid(steps, steps, [4.0, 5.0, 6.0]), axis=-1).reshape(-1, 3)
    spacing, grows = scene_of(cube).spacing
    assert not grows
    assert spacing == pytest.approx(0.05, rel=0.01)


def test_the_camera_s_view_looks_from_behind_the_origin_at_the_median_depth():
    points, *_ = two_squares()
    scene = scene_of(points)
    view = named_views(scene)["camera"]
    assert view.target[2] == pytest.approx(np.median(points[:, 2]), rel=1e-3)
    assert -0.5 < view.eye[2] < 0
    np.testing.assert_allclose(np.cross(view.axes[2], np.subtract(view.target, view.eye)), 0, atol=1e-9)


@pytest.mark.parametrize("name", ["camera", "front", "top", "side", "30,20", "-70,-45"])
@pytest.mark.parametrize("size", [(400, 300), (200, 500)])
def test_every_view_shows_nearly_all_points(name, size):
    points, *_ = two_squares()
    scene = scene_of(points)
    view = view_of(name, scene)
    beside = (scene.seen - view.eye) @ view.axes.T
    depth = view.distance if view.parallel else beside[:, 2:]
    pixels = beside[:, :2] * view.focal(size) / depth + np.divide(size, 2)
    inside = np.all((pixels > 0) & (pixels < size), axis=1)
    assert inside.mean() > 0.98
    spread = np.ptp(pixels[inside], axis=0) / size
    assert spread.max() > 0.75  # and fills the picture


def test_the_viewer_goes_to_the_right_and_up():
    assert axes_of(0, 0) == pytest.approx(np.eye(3))
    right, down, forward = axes_of(np.radians(90), 0)
    np.testing.assert_allclose([right, down, forward], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-12)
    _, down, forward = axes_of(0, np.radians(90))
    np.testing.assert_allclose([down, forward], [[0, 0, -1], [0, 1, 0]], atol=1e-12)


def test_an_angle_may_have_a_distance():
    scene = scene_of(two_squares()[0])
    assert view_of("10,-5,7.5", scene).distance == 7.5
    assert view_of("10,-5", scene).azimuth == pytest.approx(np.radians(10))


@pytest.mark.parametrize("text", ["", "back", "1", "1,2,3,4", "1,x", "0,91", "0,0,0", "nan,0"])
def test_a_view_that_is_none_is_refused(text):
    with pytest.raises(InvalidInput, match="is not one of camera, front, top, side"):
        view_of(text, scene_of(two_squares()[0]))


def test_a_turn_goes_round_or_to_and_fro():
    start = around(scene_of(two_squares()[0]), 0.1, 0.2)
    round_once = [view.azimuth for view in turn(start, 2 * np.pi, 8)]
    np.testing.assert_allclose(np.diff(round_once), np.pi / 4)
    to_and_fro = [view.azimuth - 0.1 for view in turn(start, np.radians(60), 8)]
    assert (min(to_and_fro), max(to_and_fro)) == pytest.approx((-np.radians(30), np.radians(30)))
    assert to_and_fro[0] == 0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points_are_looked_at_too(count):
    scene = scene_of([(0.1 * i, 0, 2.0) for i in range(count)], [RED, BLUE, RED][:count])
    for name in ("camera", "front", "top", "side", "20,20"):
        view = view_of(name, scene)
        assert np.isfinite(view.eye).all()
        assert np.isfinite(view.focal((100, 100)))


@pytest.fixture
def rng():
    return np.random.default_rng(7)
