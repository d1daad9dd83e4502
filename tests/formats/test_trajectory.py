"""Trajectory files: what is written is read, and whatever is wrong is told with file and line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import trajectories
from camcal.formats.pose_text import static_transform_publisher
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

TUM = "0 1 2 3 0 0 0 1\n"
YAML = """format: camcal-trajectory
version: 1
frames: a_T_b
poses:
  - {t: 0.0, translation: [0.0, 0.0, 0.0], quaternion: {qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}}
  - {t: 1.0, translation: [0.0, 0.0, 1.0], quaternion: {qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}}
"""


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def poses(rng, count=20, full=True):
    roots = rng.normal(size=(count, 6, 6))
    return Trajectory(
        "base_link_T_camera",
        1.5e9 + np.cumsum(rng.uniform(0.01, 0.1, count)).round(6),
        so3.exp(rng.normal(size=(count, 3))),
        10 * rng.normal(size=(count, 3)),
        1e-4 * roots @ np.swapaxes(roots, 1, 2) if full else None,
        rng.normal(size=(count, 6)) if full else None,
        np.arange(count) // 7 if full else None,
    )


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("name", ["a.tum", "a.txt", "a.csv", "a.yaml", "a.yml", "a.json"])
def test_what_is_written_is_read(tmp_path, rng, name, full):
    written = poses(rng, full=full)
    trajectories.write(tmp_path / name, written)
    found = trajectories.read(tmp_path / name)
    assert found.frames == written.frames
    # 12 significant digits; times as near as a float comes to those of a clock
    np.testing.assert_allclose(found.stamps, written.stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.rotations, written.rotations, atol=1e-11)
    np.testing.assert_allclose(found.translations, written.translations, rtol=1e-11)
    if name.endswith((".tum", ".txt")) or not full:
        assert found.covariances is None
    else:
        np.testing.assert_allclose(found.covariances, written.covariances, rtol=1e-11, atol=1e-15)
        np.testing.assert_allclose(found.velocities, written.velocities, rtol=1e-11)
        np.testing.assert_array_equal(found.segments, written.segments)


def test_kitti_and_ros_hold_the_poses(tmp_path, rng):
    written = poses(rng)
    trajectories.write(tmp_path / "poses.txt", written, "kitti")
    found = trajectories.read(tmp_path / "poses.txt", "base_link_T_camera")
    np.testing.assert_array_equal(found.stamps, np.arange(20))
    np.testing.assert_allclose(found.rotations, written.rotations, atol=1e-11)
    trajectories.write(tmp_path / "tf.yaml", written, "tf")
    found = trajectories.read(tmp_path / "tf.yaml")
    assert found.frames == "base_link_T_camera"
    np.testing.assert_allclose(found.stamps, written.stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.translations, written.translations, rtol=1e-11)
    assert "frame_id: base_link}" in (tmp_path / "tf.yaml").read_text()


def test_a_single_pose_for_ros_says_how_to_publish_it(tmp_path):
    single = Trajectory("base_T_cam", np.array([0.0]), so3.about_z(np.pi / 2)[None], np.array([[1.0, 2, 3]]))
    trajectories.write(tmp_path / "tf.yaml", single, "tf")
    line = static_transform_publisher("base_T_cam", single.pose(0))
    assert line in (tmp_path / "tf.yaml").read_text()
    assert line.endswith("--frame-id base --child-frame-id cam")
    assert "--x 1 --y 2 --z 3 --qx 0 --qy 0 --qz 0.70710678" in line


def test_euroc_is_read_in_nanoseconds(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
        "1403715273262142976,0.9,2.2,0.9,1,0,0,0\n1403715273267142976,0.9,2.2,1.0,0.7071068,0.7071068,0,0\n"
    )
    found = trajectories.read(path, "world_T_imu")
    assert found.frames == "world_T_imu"
    assert np.diff(found.stamps) == pytest.approx(0.005, abs=3e-7)  # what a float resolves of 1.4e9 s
    assert found.pose(1).vector()[0] == pytest.approx(np.pi / 2, abs=1e-6)


def test_a_quaternion_is_real_part_last_in_tum_and_normalised(tmp_path):
    path = tmp_path / "a.tum"
    path.write_text("# a remark\n0 1 2 3 0.70711 0 0 0.70711\n")
    found = trajectories.read(path)
    assert found.frames == "world_T_camera"
    np.testing.assert_allclose(found.pose(0).vector(), [np.pi / 2, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "line", "words"),
    [
        ("a.tum", TUM + "1 1 2 3 0 0 0\n", 2, "7 numbers; 8 are needed"),
        ("a.tum", "# remark\n\n" + TUM + "1 1 2 x 0 0 0 1\n", 4, "'x' is not a number"),
        ("a.tum", TUM + "1 1 2 nan 0 0 0 1\n", 2, "not finite"),
        ("a.tum", TUM + "1 1 2 3 0 0 0 1.1\n", 2, "length 1.1, not 1"),
        ("a.tum", TUM + "0 1 2 3 0 0 0 1\n", 2, "not later than the one before"),
        ("a.tum", "# frames: camera\n" + TUM, None, "is not a transform name such as a_T_b"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 2 0\n", 1, "not a rotation"),
        ("a.csv", "t,tx,ty,tz,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n1,2,3\n", 3, "3 numbers; 8 are needed"),
        ("a.csv", "t,tx,ty,tz,qw,qx,qy,qw\n0,1,2,3,1,0,0,0\n", 1, "missing column 'qz'"),
        ("a.csv", "t,tx,ty,tz,qw,qx,qy,qz,vx\n0,1,2,3,1,0,0,0,1\n", None, "missing column 'vy'"),
        (
            "a.csv",
            "# x frames=cam; m\nt,tx,ty,tz,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n",
            None,
            "is not a transform name such as a_T_b",
        ),
        ("a.yaml", YAML.replace("[0.0, 0.0, 1.0]", "[0.0, 0.0]"), 6, "3 are needed"),
        ("a.yaml", YAML.replace("t: 1.0", "t: 0.0"), 6, "not later than the one before"),
        ("a.yaml", "format: camcal-trajectory\nversion: 1\nframes: a_T_b\npose: []\n", 4, "Did you mean 'poses'"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_line(tmp_path, name, text, line, words):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidInput) as caught:
        trajectories.read(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path) if line is None else f"{path}:{line}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.tum", "a.csv", "a.json"])
def test_a_file_without_poses_is_told(tmp_path, name):
    path = tmp_path / name
    text = {"a.tum": "# nothing\n", "a.csv": "t,tx,ty,tz,qw,qx,qy,qz\n"}
    path.write_text(text.get(name, '{"format": "camcal-trajectory", "version": 1, "frames": "a_T_b", "poses": []}'))
    with pytest.raises(FileError, match="holds no poses"):
        trajectories.read(path)


def test_a_reference_may_repeat_times_and_says_how_often(tmp_path):
    path = tmp_path / "truth.txt"
    path.write_text(TUM + "1 1 2 3 0 0 0 1\n1 5 5 5 0 0 0 1\n2 1 2 3 0 0 0 1\n")
    found, repeated = trajectories.read_reference(path)
    assert repeated == 1
    np.testing.assert_array_equal(found.stamps, [0, 1, 2])
    np.testing.assert_array_equal(found.translations[1], [1, 2, 3])


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [("a.ply", None, "found .ply"), ("a.tum", "tf", "written as .yaml"), ("a.tum", "bag", "use one of tum")],
)
def test_forms_that_do_not_exist_are_refused(name, kind, words, tmp_path):
    with pytest.raises(InvalidInput, match=words):
        trajectories.kind_of(tmp_path / name, kind)


def test_too_many_poses_for_yaml_are_refused(tmp_path, rng):
    with pytest.raises(InvalidInput, match="exceed YAML; write"):
        trajectories.write(tmp_path / "a.yaml", poses(rng, 2000))
    assert not (tmp_path / "a.yaml").exists()


def test_several_transforms_in_one_ros_file_are_refused(tmp_path, rng):
    path = tmp_path / "tf.yaml"
    trajectories.write(path, poses(rng, 3), "tf")
    path.write_text(path.read_text().replace("child_frame_id: camera", "child_frame_id: other", 1))
    with pytest.raises(InvalidInput, match="one file holds one transform"):
        trajectories.read(path)


@given(st.lists(st.text("0123456789.eE+- \t,#", max_size=40), max_size=6))
def test_no_text_breaks_the_reader(tmp_path_factory, lines):
    path = tmp_path_factory.mktemp("fuzz") / "a.tum"
    path.write_text("\n".join(lines))
    try:
        found = trajectories.read(path)
    except (InvalidInput, FileError) as error:
        said = str(error)
    else:
        said = f"{path}: {len(found)} poses"
    assert said.startswith(str(path))
