"""The rig of a camera file: frames are found along transforms in either direction."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, rig_of
from camcal.geometry.pose import Pose

CAMERA = CameraEntry(Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 320.0, 240.0]))
POSES = [Pose.from_vector(np.array([0.1, 0.2, 0.3]) * index, np.array([0.1, 0.0, 0.2]) * index) for index in (1, 2, 3)]


def file(names, transforms):
    return CameraFile(dict.fromkeys(names, CAMERA), {name: Transform(pose) for name, pose in transforms.items()})


def test_the_first_camera_is_the_frame_where_no_rig_is_named():
    rig, frame = rig_of(file("abc", {"b_T_a": POSES[0], "b_T_c": POSES[1]}), "rig.yaml")
    assert frame == "a"
    np.testing.assert_array_equal(rig.rig_T_camera["a"].matrix(), np.eye(4))
    a_T_b = POSES[0].inverse()
    np.testing.assert_allclose(rig.rig_T_camera["b"].matrix(), a_T_b.matrix(), atol=1e-15)
    np.testing.assert_allclose(rig.rig_T_camera["c"].matrix(), (a_T_b @ POSES[1]).matrix(), atol=1e-15)


def test_a_frame_called_rig_is_the_frame():
    rig, frame = rig_of(file("ab", {"rig_T_a": POSES[0], "b_T_a": POSES[1]}), "rig.yaml")
    assert frame == "rig"
    np.testing.assert_allclose(rig.rig_T_camera["a"].matrix(), POSES[0].matrix(), atol=1e-15)
    expected = POSES[0] @ POSES[1].inverse()
    np.testing.assert_allclose(rig.rig_T_camera["b"].matrix(), expected.matrix(), atol=1e-15)


@pytest.mark.parametrize("transforms", [{}, {"b_T_body": POSES[0]}, {"rig_T_a": POSES[0]}])
def test_a_camera_of_which_nothing_says_where_it_stands_is_named(transforms):
    with pytest.raises(InvalidInput, match=r"rig\.yaml: no transform connects camera 'b'"):
        rig_of(file("ab", transforms), "rig.yaml")


def test_one_camera_is_a_rig_of_its_own():
    rig, frame = rig_of(file("a", {}), "camera.yaml")
    assert frame == "a"
    assert list(rig.cameras) == ["a"]
