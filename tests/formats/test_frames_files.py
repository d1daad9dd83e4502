"""Files of named transforms: what is read, in which words the rest is refused, and that nothing is lost on the way."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import frames
from camcal.formats.pose_text import form_named
from camcal.geometry.pose import NamedTransform, Pose

POSE = Pose.from_vector(np.array([0.3, -0.2, 1.0]), np.array([1.0, -2.0, 3.5]))
NUMBERS = st.floats(-2, 2)
POSES = st.tuples(*[NUMBERS] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))
PLAIN = "R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], t: [1.0, 2.0, 3.0]"


def read(tmp_path, text, name="frames.yaml"):
    (tmp_path / name).write_text(text)
    return frames.read(tmp_path / name)


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@settings(max_examples=15)
@given(POSES)
def test_what_is_written_comes_back(tmp_path_factory, suffix, pose):
    path = tmp_path_factory.getbasetemp() / f"frames{suffix}"
    root = np.random.default_rng(1).normal(size=(6, 6)) * 1e-3
    frames.write(path, [NamedTransform("a", "b", pose, root @ root.T), NamedTransform("b", "a", pose)])
    first, second = frames.read(path)
    assert (first.name, second.name) == ("a_T_b", "b_T_a")
    np.testing.assert_allclose(first.pose.matrix(), pose.matrix(), atol=1e-11)  # 12 digits are written
    np.testing.assert_allclose(first.covariance, root @ root.T, rtol=1e-10)
    assert second.covariance is None


@pytest.mark.parametrize(
    "form", ["matrix", "quat:wxyz", "quat:xyzw", "rvec", "rvec:deg", "euler:ZYX:deg", "euler:xyz:rad"]
)
def test_rotations_are_written_in_a_form_that_is_asked_for(tmp_path, form):
    path = tmp_path / "frames.yaml"
    frames.write(path, [NamedTransform("a", "b", POSE)], form_named(form))
    assert ("R:" in path.read_text()) == (form == "matrix")
    np.testing.assert_allclose(frames.read(path)[0].pose.matrix(), POSE.matrix(), atol=1e-10)  # 12 digits are written


def test_forms_that_are_rows_of_numbers_are_not_written_into_a_file_of_frames(tmp_path):
    with pytest.raises(InvalidInput, match=r"not tum; write a \.txt"):
        frames.write(tmp_path / "frames.yaml", [NamedTransform("a", "b", POSE)], form_named("tum"))


@pytest.mark.parametrize(
    "rotation",
    [
        "quaternion: {qw: 0.7071068, qx: 0.0, qy: 0.0, qz: 0.7071068}, t: [0.0, 0.0, 1.0]",
        "quaternion: {w: 0.7071068, x: 0.0, y: 0.0, z: 0.7071068}, t: [0.0, 0.0, 1.0]",
        "rotation_vector: [0.0, 0.0, 1.5707963268], t: [0.0, 0.0, 1.0]",
        "rotation_vector_deg: [0.0, 0.0, 90.0], t: [0.0, 0.0, 1.0]",
        "euler: {axes: ZYX, deg: [90.0, 0.0, 0.0]}, t: [0.0, 0.0, 1.0]",
        "euler: {axes: xyz, rad: [0.0, 0.0, 1.5707963268]}, t: [0.0, 0.0, 1.0]",
        "R: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], t: [0.0, 0.0, 1.0]",
        "matrix: [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]",
    ],
)
def test_a_rotation_is_read_in_every_form(tmp_path, rotation):
    (found,) = read(tmp_path, f"transforms:\n  a_T_b: {{{rotation}}}\n")
    np.testing.assert_allclose(found.pose.apply(np.array([1.0, 0, 0])), [0, 1, 1], atol=1e-6)  # seven digits


def test_standard_deviations_are_a_covariance_without_correlations(tmp_path):
    (found,) = read(tmp_path, f"transforms: {{a_T_b: {{{PLAIN}, std: [0.1, 0.1, 0.2, 0.01, 0.01, 0.02]}}}}")
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [0.1, 0.1, 0.2, 0.01, 0.01, 0.02])


def test_a_transform_says_where_it_stands(tmp_path):
    found = read(tmp_path, f"transforms:\n  a_T_b: {{{PLAIN}}}\n  c_T_b: {{{PLAIN}}}\n")
    assert [item.where for item in found] == [f"{tmp_path / 'frames.yaml'}:{line}" for line in (2, 3)]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("a_T_b: {t: [0.0, 0.0, 0.0]}", "frames.yaml:2: transforms.a_T_b: no rotation; give one of R, quaternion"),
        ("a_T_b: {rotation_vector: [0.0, 0.0, 0.0]}", "missing key 't'"),
        (f"a_T_b: {{{PLAIN}, rotation_vector: [0.0, 0.0, 0.0]}}", "R and rotation_vector are redundant"),
        (f"a_T_b: {{{PLAIN}, covarianse: 1}}", "unknown key. Did you mean 'covariance'?"),
        (f"a_T_b: {{{PLAIN}, std: [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]}}", "outside"),
        ("a_T_b: {quaternion: [1.0, 0.0, 0.0, 0.0], t: [0.0, 0.0, 0.0]}", "quaternion: a list is not a mapping"),
        ("a_T_b: {euler: {axes: ZYX}, t: [0.0, 0.0, 0.0]}", "angles as deg or as rad"),
        ("a_T_b: {euler: {axes: ZZX, deg: [0.0, 0.0, 0.0]}, t: [0.0, 0.0, 0.0]}", "three of XYZ"),
        ("a_T_b: {euler: {axes: ZYX, deg: [1.0e+9, 0.0, 0.0]}, t: [0.0, 0.0, 0.0]}", "more than 1e+06 rad"),
        (f"ab: {{{PLAIN}}}", "is not a transform name such as a_T_b"),
        (f"a_T_b_T_c: {{{PLAIN}}}", "is not a transform name such as a_T_b"),
        (f"a_T_b-c: {{{PLAIN}}}", "is not a valid name: letters and digits"),
        ("a_T_b: {R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], t: [0.0, 0.0, 0.0]}", "a reflection"),
        ("a_T_b: {quaternion: {w: 2.0, x: 0.0, y: 0.0, z: 0.0}, t: [0.0, 0.0, 0.0]}", "is not 1 but 2"),
        ("a_T_b: {matrix: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], t: [1.0, 0.0, 0.0]}",
         "leave t out"),
    ],
)  # fmt: skip
def test_what_is_no_transform_is_refused_with_its_line(tmp_path, block, message):
    with pytest.raises(InvalidInput) as raised:
        read(tmp_path, f"transforms:\n  {block}\n")
    assert message in str(raised.value)
    assert "frames.yaml:2" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_covariance_that_is_none_is_refused(tmp_path):
    rows = (-np.eye(6)).tolist()
    with pytest.raises(InvalidInput, match="not a covariance"):
        read(tmp_path, json.dumps({"transforms": {"a_T_b": {**frames.block(NamedTransform("a", "b", POSE)),
                                                           "covariance": rows}}}), "frames.json")  # fmt: skip


@pytest.mark.parametrize(("text", "error"), [("- 1\n", FileError), ("", FileError), ("cameras: {}\n", InvalidInput)])
def test_other_files_are_refused(tmp_path, text, error):
    with pytest.raises(error):
        read(tmp_path, text)


def test_the_transforms_of_a_camera_file_are_read_as_they_are(tmp_path):
    (tmp_path / "rig.yaml").write_text(
        "format: camcal-calibration\nversion: 1\ncameras:\n  left: {image_size: [640, 480], model: pinhole, "
        f"intrinsics: {{fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0}}}}\ntransforms:\n  body_T_left: {{{PLAIN}}}\n"
    )
    (found,) = frames.read(tmp_path / "rig.yaml")
    assert found.name == "body_T_left"
    assert found.where.endswith("rig.yaml:6")
    (loose,) = frames.read_loose(tmp_path / "rig.yaml")
    assert loose.name == "body_T_left"


def test_a_loose_transform_is_read_as_it_is_written(tmp_path):
    (tmp_path / "frames.yaml").write_text(
        "transforms:\n  a_T_b: {R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]], t: [0.0, 0.0, 0.0]}\n"
    )
    (found,) = frames.read_loose(tmp_path / "frames.yaml")
    assert found.pose.matrix[2, 2] == 3


def test_two_transforms_of_one_name_are_not_written(tmp_path):
    with pytest.raises(InvalidInput, match="two transforms are named 'a_T_b'"):
        frames.write(tmp_path / "out.yaml", [NamedTransform("a", "b", POSE)] * 2)
    assert not (tmp_path / "out.yaml").exists()
