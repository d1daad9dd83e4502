"""The frames of clouds: a point ahead, to the right and below, said in each of them."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.stereo.depth import FRAMES, BackProjection, Frame, frame_named
from camcal.stereo.disparity import StereoGeometry

POINT = np.array([1.0, 2.0, 10.0])  # to the right, below, ahead
TURN = so3.about_y(0.1)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("optical", (1, 2, 10)), ("ros", (10, -1, -2)), ("opengl", (1, -2, -10)), ("camera", TURN @ POINT)],
)
def test_a_point_is_where_the_frame_has_it(name, expected):
    frame = frame_named(name, camera_R_rectified=TURN)
    np.testing.assert_allclose(frame.frame_T_left.apply(POINT), expected, atol=1e-12)
    assert "left camera" in frame.words


def test_a_pose_takes_points_from_the_frame_named_to_the_world():
    world_T_camera = Pose.from_vector(np.array([0.0, 0.0, np.pi / 2]), np.array([100.0, 200.0, 0.0]))
    frame = frame_named("ros", world_T_camera=world_T_camera)
    np.testing.assert_allclose(frame.frame_T_left.apply(POINT), (101, 210, -2), atol=1e-12)
    assert frame.words == "world of the pose given"


def test_east_north_up_is_the_world_of_a_pose_of_the_optical_frame():
    looking_north = Pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, 0.0, 1.5]))
    frame = frame_named("enu", world_T_camera=looking_north)
    np.testing.assert_allclose(frame.frame_T_left.apply(POINT), (1, 10, -0.5), atol=1e-12)
    assert frame.words == "world: x east, y north, z up"


@pytest.mark.parametrize(
    ("name", "unit", "message"),
    [
        ("enu", "m", "--pose"),
        ("camera", "m", "--frame camera needs the rectification of the pair, which no sidecar of the map has"),
        ("ned", "m", "use one of optical, camera, ros, opengl, enu"),
        ("ros", "km", "use one of m, mm"),
    ],
)
def test_a_frame_without_what_it_needs_is_refused(name, unit, message):
    with pytest.raises(InvalidInput, match=message):
        frame_named(name, unit=unit)


@pytest.mark.parametrize("unit", ["m", "mm"])
@pytest.mark.parametrize("name", FRAMES)
def test_pixels_are_projected_back_into_every_frame(name, unit):
    geometry = StereoGeometry(50.0, 60.0, 2.0, 3.0, 0.1)
    pose = Pose.from_vector(np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    frame = frame_named(name, TURN, pose, unit)
    depth = np.random.default_rng(0).uniform(1, 9, (4, 5)).astype(np.float32)
    v, u = np.mgrid[3:7, :5]
    left = np.stack([(u - 2) * depth / 50, (v - 3) * depth / 60, depth], axis=-1)
    found = BackProjection(geometry, (9, 5), frame).points(slice(3, 7), depth)
    expected = frame.frame_T_left.apply(left.astype(float)) * {"m": 1, "mm": 1000}[unit]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())  # float32


def test_without_a_frame_points_are_the_left_cameras():
    assert Frame().words == "left camera: x right, y down, z forward"
    np.testing.assert_array_equal(Frame().frame_T_left.matrix(), np.eye(4))
