"""`camcal transform convert`, `average`, `check` and `points`: what they give, say and refuse."""

import json

import numpy as np
import pytest

from camcal.formats import pointclouds, trajectories
from camcal.geometry.pose import Trajectory

RIG = """format: camcal-calibration
version: 1
cameras:
  left: {image_size: [640, 480], model: pinhole, intrinsics: {fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5}}
transforms:
  body_T_left: {R: [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], t: [0.1, 0.2, 0.3]}
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


def test_a_camera_of_a_camera_file_gets_other_axes_and_its_pixels_are_counted_from_the_corner(run, rig):
    code, out, err = run("transform", "convert", rig, "--axes", "left=opencv:nerf", "--as", "matrix")
    assert code == 0
    rows = np.array([line.split() for line in out.splitlines()[1:]], dtype=float)
    # the camera looked along x of the body: its back, z in NeRF, is -x
    np.testing.assert_array_equal(rows, [[0, 0, -1, 0.1], [-1, 0, 0, 0.2], [0, 1, 0, 0.3], [0, 0, 0, 1]])
    assert "left: principal point in nerf: cx 320, cy 240" in err


def test_a_camera_alone_is_enough_to_count_its_pixels_from_the_corner(run, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(RIG[: RIG.index("transforms:")])
    code, out, err = run("transform", "convert", path, "--axes", "left=opencv:colmap", "--json")
    assert code == 0
    assert json.loads(out)["principal_points"] == [{"camera": "left", "convention": "colmap", "cx": 320.0, "cy": 240.0}]
    assert err.count("\n") == 1
    code, _, err = run("transform", "convert", path, "-o", tmp_path / "out.yaml")
    assert code == 4
    assert "no transforms to write" in err
    assert not (tmp_path / "out.yaml").exists()


def test_the_json_document_of_convert(run, rig):
    _, out, _ = run("transform", "convert", rig, "--axes", "left=opencv:colmap", "--json")
    document = json.loads(out)
    assert list(document) == ["schema", "transforms", "axes", "principal_points", "trajectory", "output", "warnings"]
    assert document["transforms"][0]["name"] == "body_T_left"
    assert document["axes"] == [
        {"frame": "left", "from": "opencv", "to": "colmap", "words": "x right, y down, z forward",
         "left_handed": False, "pixel_centre": 0.5}
    ]  # fmt: skip
    assert document["principal_points"] == [{"camera": "left", "convention": "colmap", "cx": 320.0, "cy": 240.0}]


def test_unity_needs_both_frames_changed(run, rig):
    code, _, err = run("transform", "convert", rig, "--axes", "left=opencv:unity")
    assert code == 2
    assert "change the axes of both" in err
    code, out, _ = run("transform", "convert", rig, "--axes", "left=opencv:unity", "--axes", "body=ros:unity",
                       "--as", "quat:xyzw")  # fmt: skip
    assert code == 0
    # a body that looks ahead and its camera that looks ahead are alike in Unity; ros (x, y, z) is Unity's (-y, z, x)
    np.testing.assert_allclose(np.array(out.splitlines()[1].split(), float), [-0.2, 0.3, 0.1, 0, 0, 0, 1], atol=1e-12)


def test_forms_change_without_axes(run):
    code, out, _ = run("transform", "convert", 1, 2, 3, 0, 0, 90, "--form", "euler:xyz:deg", "--as", "dual-quat")
    assert code == 0
    half = 0.5**0.5
    # half of (i + 2j + 3k)(h + h k), by hand
    expected = [half, 0, 0, half, -1.5 * half, 1.5 * half, 0.5 * half, 1.5 * half]
    np.testing.assert_allclose(np.array(out.splitlines()[1].split(), float), expected, atol=1e-11)


def test_a_whole_trajectory_gets_other_axes(run, tmp_path):
    (tmp_path / "in.tum").write_text("0 1 2 3 0 0 0 1\n0.5 1 2 4 0 0 0.6 0.8\n")
    output = tmp_path / "out.csv"
    code, out, _ = run("transform", "convert", f"world_T_camera={tmp_path / 'in.tum'}", "--trajectory", "--axes",
                       "camera=opencv:opengl", "-o", output, "--json")  # fmt: skip
    assert code == 0
    assert json.loads(out)["trajectory"] == {
        "frames": "world_T_camera", "poses": 2, "start_s": 0.0, "end_s": 0.5, "covariances": False
    }  # fmt: skip
    found = trajectories.read(output)
    np.testing.assert_allclose(found.translations, [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(found.rotations[0], np.diag([1, -1, -1]), atol=1e-11)


UNCERTAIN = Trajectory(
    "world_T_camera",
    np.array([0.0, 1.0]),
    np.broadcast_to(np.eye(3), (2, 3, 3)),
    np.array([[0.0, 0, 0], [0, 0, 2]]),
    np.broadcast_to(np.diag([1e-2, 2e-2, 3e-2, 1e-4, 2e-4, 3e-4]), (2, 6, 6)),
    np.broadcast_to([1.0, 2, 3, 4, 5, 6], (2, 6)),
)


def test_covariances_and_velocities_of_a_trajectory_follow_the_axes_of_the_fixed_frame(run, tmp_path):
    trajectories.write(tmp_path / "in.yaml", UNCERTAIN)
    run("transform", "convert", tmp_path / "in.yaml", "--trajectory", "--axes", "world=opencv:ros", "-o",
        tmp_path / "out.yaml")  # fmt: skip
    found = trajectories.read(tmp_path / "out.yaml")
    # ros (x, y, z) is OpenCV's (z, -x, -y)
    np.testing.assert_allclose(np.diag(found.covariances[0]), [3e-2, 1e-2, 2e-2, 3e-4, 1e-4, 2e-4], rtol=1e-9)
    np.testing.assert_allclose(found.velocities[0], [3, -1, -2, 6, -4, -5])


def test_an_inverted_trajectory_has_the_covariances_of_its_inverses_and_no_velocities(run, tmp_path):
    trajectories.write(tmp_path / "in.yaml", UNCERTAIN)
    _, _, err = run("transform", "convert", tmp_path / "in.yaml", "--trajectory", "--inverse", "-o",
                    tmp_path / "out.yaml")  # fmt: skip
    found = trajectories.read(tmp_path / "out.yaml")
    # a turn about y of 2e-4 rad², seen from 2 m along z, moves along x by 4 · 2e-4 m²
    assert found.covariances[1][0, 0] == pytest.approx(1e-2 + 4 * 2e-4)
    assert abs(found.covariances[1][0, 4]) == pytest.approx(2 * 2e-4)
    assert found.velocities is None
    assert "velocities are not written" in err


def test_the_covariance_of_a_pose_follows_the_axes_of_its_first_frame(run, tmp_path):
    (tmp_path / "frames.yaml").write_text(
        "transforms:\n  world_T_cam: {rotation_vector: [0.0, 0.0, 0.0], t: [0.0, 0.0, 0.0], "
        "std: [0.1, 0.2, 0.3, 0.01, 0.02, 0.03]}\n"
    )
    for axes, expected in (("world", [0.3, 0.1, 0.2, 0.03, 0.01, 0.02]), ("cam", [0.1, 0.2, 0.3, 0.01, 0.02, 0.03])):
        _, out, _ = run("transform", "convert", tmp_path / "frames.yaml", "--axes", f"{axes}=opencv:ros", "--json")
        assert json.loads(out)["transforms"][0]["std"] == pytest.approx(expected)


def test_an_inverted_trajectory_comes_back(run, tmp_path):
    (tmp_path / "in.tum").write_text("0 1 2 3 0 0 0 1\n0.5 1 2 4 0 0 0.6 0.8\n")
    run("transform", "convert", f"world_T_camera={tmp_path / 'in.tum'}", "--trajectory", "--inverse", "-o",
        tmp_path / "there.csv")  # fmt: skip
    assert trajectories.read(tmp_path / "there.csv").frames == "camera_T_world"
    run("transform", "convert", tmp_path / "there.csv", "--trajectory", "--inverse", "-o", tmp_path / "back.csv")
    back = trajectories.read(tmp_path / "back.csv")
    np.testing.assert_allclose(back.translations, [[1, 2, 3], [1, 2, 4]], atol=1e-11)


def test_a_mean_is_said_with_its_poses(run):
    code, out, _ = run("transform", "average", "0 0 0 0 0 0.2", "0.2 0 0 0 0 0.4", "--form", "rvec")
    assert code == 0
    assert "0.10 0 0  ± 0.10 0 0" in out
    assert "the mean of 2 poses, all alike; ± from their scatter" in out
    assert out.count("5.73") == 2  # 0.1 rad off either way


def test_the_json_document_of_average(run, tmp_path):
    poses = "".join(
        f"  a_T_b: {{rotation_vector: [0.0, 0.0, 0.0], t: [{x}, 0.0, 0.0], std: [{s}, {s}, {s}, 0.1, 0.1, 0.1]}}\n|"
        for x, s in ((0.0, 1.0), (1.0, 2.0))
    ).split("|")
    for index, block in enumerate(poses[:2]):
        (tmp_path / f"{index}.yaml").write_text(f"transforms:\n{block}")
    _, out, _ = run("transform", "average", tmp_path / "0.yaml", tmp_path / "1.yaml", "--json")
    document = json.loads(out)
    assert list(document) == [
        "schema", "transform", "weighted", "unique", "chi_square", "degrees_of_freedom", "estimates", "output",
        "warnings",
    ]  # fmt: skip
    assert document["weighted"]
    assert document["transform"]["t"][0] == pytest.approx(0.2)  # weights 4 to 1
    assert list(document["estimates"][0]) == ["name", "where", "weight", "offset_m", "angle_deg"]
    assert document["degrees_of_freedom"] == 6


def test_the_poses_of_a_trajectory_are_averaged_by_their_covariances(run, tmp_path):
    path = tmp_path / "still.csv"
    covariances = np.array([1.0, 4.0, 4.0])[:, None, None] * 1e-4 * np.eye(6)
    translations = [[0.0, 0, 0], [3.0, 0, 0], [3.0, 0, 0]]
    rotations = np.broadcast_to(np.eye(3), (3, 3, 3))
    still = Trajectory("world_T_camera", np.arange(3.0), rotations, translations, covariances)
    trajectories.write(path, still)
    code, out, _ = run("transform", "average", path, "--trajectory", "--json")
    assert code == 0
    document = json.loads(out)
    assert document["weighted"]
    assert document["transform"]["name"] == "world_T_camera"
    assert document["transform"]["t"][0] == pytest.approx(1.0)  # weights 4, 1, 1
    assert document["estimates"][2]["where"] == f"{path}#2"
    (tmp_path / "still.tum").write_text("0 0 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n")
    _, out, _ = run("transform", "average", f"a_T_b={tmp_path / 'still.tum'}", "--trajectory", "--as", "tum")
    assert out.splitlines() == ["# a_T_b, tum", "0 1 0 0 0 0 0 1"]
    code, _, err = run("transform", "average", tmp_path / "still.tum")
    assert code == 2
    assert "--trajectory of 'camcal transform convert' and 'average' takes all" in err


def test_estimates_that_differ_more_than_they_say_are_warned_of(run, tmp_path):
    for index, x in enumerate((0.0, 1.0)):
        (tmp_path / f"{index}.yaml").write_text(
            f"transforms:\n  a_T_b: {{rotation_vector: [0.0, 0.0, 0.0], t: [{x}, 0.0, 0.0], "
            "std: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]}\n"
        )
    code, _, err = run("transform", "average", tmp_path / "0.yaml", tmp_path / "1.yaml")
    assert code == 0
    assert "differ more than their covariances (χ² = 50, 6 degrees of freedom)" in err


def test_a_check_says_its_numbers_and_fails_what_is_no_rotation(run):
    code, out, err = run("transform", "check", "1 0 0 0 0 1 0 0 0 0 1 0")
    assert (code, err) == (0, "")
    assert "ok" in out
    code, out, err = run("transform", "check", "1 0 0 0 0 1 0 0 0 0.001 1.001 0", "--json")
    document = json.loads(out)
    assert code == 7
    assert list(document) == ["schema", "poses", "fixed", "output", "warnings", "failures", "error", "exit"]
    assert list(document["poses"][0]) == [
        "name", "where", "verdict", "orthonormality_error", "determinant", "angle_to_nearest_deg",
        "quaternion_length",
    ]  # fmt: skip
    assert document["poses"][0]["verdict"] == "inexact"
    assert document["failures"][0]["code"] == "not_a_rotation"
    assert document["poses"][0]["determinant"] == pytest.approx(1.001)
    assert "the nearest rotation differs by 0.05°" in err


def test_only_fix_makes_a_rotation_and_never_of_a_reflection(run, tmp_path):
    output = tmp_path / "fixed.txt"
    code, _, err = run("transform", "check", "1 0 0 0 0 1 0 0 0 0.001 1.001 0", "-o", output)
    assert code == 2
    assert "--fix" in err
    assert run("transform", "check", "1 0 0 0 0 1 0 0 0 0.001 1.001 0", "--fix", "-o", output)[0] == 0
    assert run("transform", "check", output)[0] == 0
    code, out, err = run("transform", "check", "0 1 0 0 1 0 0 0 0 0 1 0", "--fix")
    assert code == 7
    assert "reflection" in out
    assert "det = -1, a reflection" in err


def test_a_quaternion_of_another_length_is_told(run):
    code, _, err = run("transform", "check", "0 0 0 1.01 0 0 0", "--form", "quat:wxyz")
    assert code == 7
    assert "quaternion norm 1.01, not 1" in err


def test_a_table_of_points_turns_with_normals_and_covariances(run, tmp_path):
    (tmp_path / "points.csv").write_text("id,x,y,z,nx,ny,nz,sxx,sxy,sxz,syy,syz,szz\na,1,0,0,1,0,0,4,0,0,1,0,9\n")
    (tmp_path / "frames.yaml").write_text(
        "transforms:\n  a_T_b: {rotation_vector_deg: [0.0, 0.0, 90.0], t: [0.0, 0.0, 5.0], "
        "std: [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]}\n"
    )
    output = tmp_path / "moved.csv"
    code, out, _ = run("transform", "points", tmp_path / "points.csv", "--with", tmp_path / "frames.yaml", "-o", output)
    assert code == 0
    assert "1 points with normals and covariances" in out
    row = output.read_text().splitlines()[1].split(",")
    # (1, 0, 0) turns to (0, 1, 0); half a radian about z moves it by 0.5 along x
    np.testing.assert_allclose(np.array(row[1:], float), [0, 1, 5, 0, 1, 0, 1.25, 0, 0, 4, 0, 9], atol=1e-12)


def test_the_uncertainty_of_a_transform_is_in_the_unit_of_the_points(run, tmp_path):
    (tmp_path / "points.csv").write_text("x,y,z\n1000,0,0\n")
    (tmp_path / "frames.yaml").write_text(
        "transforms:\n  a_T_b: {rotation_vector: [0.0, 0.0, 0.0], t: [0.0, 0.0, 0.0], "
        "std: [0.001, 0.0, 0.0, 0.0, 0.0, 0.002]}\n"
    )
    output = tmp_path / "moved.csv"
    run(
        "transform", "points", tmp_path / "points.csv", "--with", tmp_path / "frames.yaml", "--unit", "mm", "-o", output
    )
    # 1 mm along x, and 2 mrad a metre away are 2 mm along y
    assert output.read_text() == "x,y,z,sxx,sxy,sxz,syy,syz,szz\n1000,0,0,1,0,0,4,0,0\n"


def test_millimetres_and_the_way_back(run, tmp_path):
    (tmp_path / "points.csv").write_text("x,y,z\n1000,0,0\n")
    arguments = ("--with", "0.5 0 0 0 0 0", "--form", "rvec", "--unit", "mm")
    assert run("transform", "points", tmp_path / "points.csv", *arguments, "-o", tmp_path / "a.csv")[0] == 0
    assert (tmp_path / "a.csv").read_text() == "x,y,z\n1500,0,0\n"
    assert run("transform", "points", tmp_path / "a.csv", *arguments, "--inverse", "-o", tmp_path / "b.csv")[0] == 0
    assert (tmp_path / "b.csv").read_text() == "x,y,z\n1000,0,0\n"


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz", ".xyz"])
def test_clouds_are_moved_with_all_they_have(run, tmp_path, suffix):
    (tmp_path / "in.xyz").write_text("# columns: x y z red green blue nx ny nz\n1 0 0 10 20 30 1 0 0\n")
    output = tmp_path / f"out{suffix}"
    code, _, _ = run("transform", "points", tmp_path / "in.xyz", "--with", "world_T_cam=0 0 1 0 0 90", "--form",
                     "rvec:deg", "-o", output)  # fmt: skip
    assert code == 0
    vertex = pointclouds.read(output).vertices[0]
    found = [float(vertex[name]) for name in ("x", "y", "z", "red", "green", "blue", "nx", "ny", "nz")]
    np.testing.assert_allclose(found, [0, 1, 1, 10, 20, 30, 0, 1, 0], atol=1e-7)  # float32


def test_coordinates_of_a_map_keep_their_digits(run, tmp_path):
    (tmp_path / "map.xyz").write_text("500000.123 4000000.456 10\n500001.789 4000002.012 11\n")
    code, _, _ = run("transform", "points", tmp_path / "map.xyz", "--with", "0 0 0 0 0 90", "--form", "rvec:deg", "-o",
                     tmp_path / "out.npz")  # fmt: skip
    assert code == 0
    found = pointclouds.read(tmp_path / "out.npz")
    origin = np.array(found.notes["origin"].split(), float)
    np.testing.assert_allclose(found.vertices["x"][1] + origin[0], -4000002.012, atol=1e-6)
    np.testing.assert_allclose(found.vertices["y"][0] + origin[1], 500000.123, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("convert", "{rig}", "--axes", "left"), 2, "write FRAME=FROM:TO"),
        (("convert", "{rig}", "--axes", "left=opencv:unreal"), 2, "axes 'unreal' are unknown"),
        (("convert", "{rig}", "--axes", "lefd=opencv:ros"), 2, "no frame 'lefd'. Did you mean 'left'?"),
        (("convert", "{rig}", "--axes", "left=opencv:ros", "--axes", "left=ros:enu"), 2, "given twice"),
        (("convert", "{rig}", "--trajectory"), 2, "--trajectory needs one file and --output"),
        (("average", "0 0 0 0 0 0", "--form", "rvec"), 4, "two or more"),
        (("average", "{rig}", "a_T_b=0 0 0 0 0 0", "--form", "rvec"), 2, "a mean is of one"),
        (("points", "{rig}", "--with", "{rig}", "-o", "out.ply"), 2, "is not a point cloud format; use one of "),
        (("points", "in.csv", "--with", "{rig}", "-o", "out.ply"), 2, "a CSV is written as a CSV"),
        (
            ("points", "in.csv", "--with", "{rig}", "-o", "out.csv", "--unit", "inch"),
            2,
            "'--unit': 'inch' is not one of m, mm",
        ),
        (("points", "in.csv", "--with", "{rig}", "-o", "out.csv"), 3, "in.csv: no such file"),
        (("check", "{rig}", "--as", "euler:ZYX"), 2, "their axes and their unit"),
        (
            ("average", "{rig}", "--trajectory", "--form", "tum"),
            2,
            "--form applies to numbers, not to trajectory files",
        ),
        (
            ("convert", "in.tum", "--trajectory", "--form", "tum", "-o", "out.csv"),
            2,
            "--form applies to numbers, not to trajectory files",
        ),
    ],
)
def test_what_makes_no_sense_is_one_clear_line(run, rig, tmp_path, monkeypatch, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    found, out, err = run("transform", *(argument.format(rig=rig) for argument in arguments))
    assert found == code
    assert words in err
    assert out == ""
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.yaml"]
