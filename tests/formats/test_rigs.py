"""The rig of a camera file: frames are found along transforms in either direction."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import frames, native
from camcal.formats.camera_file import (
    STEP,
    CameraEntry,
    CameraFile,
    JointCovariance,
    Transform,
    parameters_covariance,
    rig_of,
)
from camcal.geometry.pose import Pose, inverse_jacobian

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


def uncertain_file(seed=1):
    """Return a file of three cameras with a joint covariance that has all cross-terms."""
    rng = np.random.default_rng(seed)
    poses = {"b_T_a": POSES[0], "c_T_a": POSES[1]}
    names = [f"{camera}.{name}" for camera in "abc" for name in CAMERA.camera.model.parameter_names]
    names += [f"{name}.{step}" for name in poses for step in STEP]
    factor = rng.standard_normal((len(names), len(names))) * np.where(np.arange(len(names)) < 12, 0.3, 1e-3)[:, None]
    joint = JointCovariance(tuple(names), factor @ factor.T)
    own = {
        name: joint.matrix[12 + 6 * place : 18 + 6 * place, 12 + 6 * place : 18 + 6 * place]
        for place, name in enumerate(poses)
    }
    transforms = {name: Transform(pose, own[name]) for name, pose in poses.items()}
    return CameraFile(dict.fromkeys("abc", CAMERA), transforms, joint)


def test_the_joint_covariance_of_a_file_becomes_that_of_its_rig():
    file = uncertain_file()
    rig, _ = rig_of(file, "rig.yaml")
    joint = file.joint_covariance.matrix
    assert not rig.covariance[4:10].any()  # where the first camera stands is certain
    lens, pose = rig.rows("b"), rig.rows("b").stop - 6
    np.testing.assert_allclose(rig.covariance[lens.start : pose, :4], joint[4:8, :4])
    np.testing.assert_allclose(rig.covariance[pose : lens.stop, :4], joint[12:18, :4])
    np.testing.assert_allclose(rig.covariance[pose : lens.stop, -6:], joint[12:18, 18:])


def test_the_rig_follows_transforms_in_either_direction():
    file = uncertain_file()
    turned = replace(file, transforms={"b_T_a": file.transforms["b_T_a"], "a_T_c": file.transforms["c_T_a"]})
    names = tuple(name.replace("c_T_a", "a_T_c") for name in file.joint_covariance.names)
    rig, _ = rig_of(replace(turned, joint_covariance=replace(file.joint_covariance, names=names)), "rig.yaml")
    jacobian, joint = inverse_jacobian(POSES[1]), file.joint_covariance.matrix
    np.testing.assert_allclose(rig.covariance[-6:, -6:], jacobian @ joint[18:, 18:] @ jacobian.T)
    np.testing.assert_allclose(rig.covariance[-6:, :4], jacobian @ joint[18:, :4])


def test_what_the_joint_covariance_leaves_out_has_the_covariance_of_its_own():
    file = uncertain_file()
    camera = replace(CAMERA, camera=replace(CAMERA.camera, covariance=np.diag([1.0, 2, 3, 4])))
    names = file.joint_covariance.names[4:]
    joint = JointCovariance(names, file.joint_covariance.matrix[4:, 4:])
    found = parameters_covariance(replace(file, cameras={**file.cameras, "a": camera}, joint_covariance=joint))
    np.testing.assert_array_equal(np.diag(found.matrix)[:4], [1, 2, 3, 4])
    assert not found.matrix[:4, 4:].any()
    np.testing.assert_array_equal(found.matrix[4:, 4:], joint.matrix)


def test_transforms_without_a_covariance_are_exact():
    assert rig_of(file("ab", {"b_T_a": POSES[0]}), "rig.yaml")[0].covariance is None


def test_a_rig_file_is_read_back_and_its_transforms_know_their_cross_terms(tmp_path):
    path, content = tmp_path / "rig.yaml", uncertain_file()
    native.write(path, content)
    again = native.read(path)
    assert again.joint_covariance.names == content.joint_covariance.names
    np.testing.assert_allclose(again.joint_covariance.matrix, content.joint_covariance.matrix, rtol=1e-11)
    first, second = frames.read(path)
    np.testing.assert_allclose(first.cross[second.where], content.joint_covariance.matrix[12:18, 18:], rtol=1e-11)
    np.testing.assert_array_equal(first.cross[second.where], second.cross[first.where].T)


def test_a_large_joint_covariance_stands_beside_the_file_and_is_read_back_exactly(tmp_path):
    count = 26  # cameras of 4 parameters: more than 100 names
    names = tuple(f"c{index}.{name}" for index in range(count) for name in CAMERA.camera.model.parameter_names)
    factor = np.random.default_rng(2).standard_normal((len(names), len(names)))
    content = CameraFile({f"c{index}": CAMERA for index in range(count)}, {}, JointCovariance(names, factor @ factor.T))
    native.write(tmp_path / "rig.yaml", content)
    np.testing.assert_array_equal(
        native.read(tmp_path / "rig.yaml").joint_covariance.matrix, content.joint_covariance.matrix
    )
    assert len(list(tmp_path.glob("rig.covariance-*.npz"))) == 1
