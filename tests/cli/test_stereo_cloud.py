"""`camcal stereo cloud`: a disparity map, numbers or a camera file in, a point cloud out."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose

CONFIG = Path(__file__).parents[2] / "sample_configs" / "stereo_cloud.yaml"
NUMBERS = ["--fx", 100, "--cx", 1, "--cy", 0, "--baseline", 0.5]
SIZE = (3, 2)
DISPARITY = np.array([[0, 10, 25], [50, 0, 5]], np.uint8)  # none, 5, 2; 1, none, 10 m with NUMBERS
DEPTHS = [5, 2, 1, 10]


@pytest.fixture
def disparity(tmp_path):
    cv2.imwrite(str(tmp_path / "disparity.png"), DISPARITY)
    return tmp_path / "disparity.png"


@pytest.fixture
def image(tmp_path):
    cv2.imwrite(str(tmp_path / "left.png"), np.arange(6, dtype=np.uint8).reshape(2, 3) * 51)
    return tmp_path / "left.png"


def rig(path, *, distortion=0.0, right_cx=1.0, translation=(-0.5, 0.0, 0.0), turn=0.0, size=SIZE, pair=True):
    """Write a camera file of a left and a right camera."""
    model = model_named("opencv4")
    lens = [distortion, 0, 0, 0]
    cameras = {
        "left": CameraEntry(Camera(model, size, np.array([100.0, 100, 1, 0, *lens]))),
        "right": CameraEntry(Camera(model, size, np.array([100.0, 100, right_cx, 0, *lens]))),
    }
    right_T_left = Pose.from_vector(np.array([0, turn, 0]), np.array(translation))
    native.write(path, CameraFile(cameras, {"right_T_left": Transform(right_T_left)} if pair else {}))
    return path


def xyz(path):
    return np.loadtxt(path, ndmin=2)


def test_a_disparity_map_and_four_numbers_give_a_cloud(run, tmp_path, disparity):
    code, out, _ = run("stereo", "cloud", disparity, *NUMBERS, "-o", tmp_path / "cloud.xyz")
    assert code == 0
    assert "disparity = count / 1, 4 of 6 pixels have a point" in out
    expected = [[0, 0, 5], [0.02, 0, 2], [-0.01, 0.01, 1], [0.1, 0.1, 10]]
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz"), expected, rtol=1e-6)  # float32


def test_a_gray_image_gives_colour_and_intensity(run, tmp_path, disparity, image):
    assert run("stereo", "cloud", disparity, image, *NUMBERS, "-o", tmp_path / "cloud.xyz")[0] == 0
    table = xyz(tmp_path / "cloud.xyz")
    np.testing.assert_array_equal(table[:, 3:6], [[51] * 3, [102] * 3, [153] * 3, [255] * 3])
    np.testing.assert_allclose(table[:, 6], [0.2, 0.4, 0.6, 1.0], rtol=1e-6)


@pytest.mark.parametrize("with_image", [False, True])
@pytest.mark.parametrize("address", ["rig.yaml", "rig.yaml#left"])
def test_a_camera_file_of_the_pair_takes_the_place_of_the_numbers(run, tmp_path, disparity, image, with_image, address):
    rig(tmp_path / "rig.yaml")
    arguments = [disparity, *([image] if with_image else []), tmp_path / address]
    assert run("stereo", "cloud", *arguments, "-o", tmp_path / "cloud.xyz")[0] == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], DEPTHS, rtol=1e-6)


def test_a_transform_written_the_other_way_round_is_the_same_pair(run, tmp_path, disparity):
    file = native.read(rig(tmp_path / "rig.yaml"))
    inverse = Transform(file.transforms["right_T_left"].pose.inverse())
    native.write(tmp_path / "other.yaml", CameraFile(file.cameras, {"left_T_right": inverse}))
    assert run("stereo", "cloud", disparity, tmp_path / "other.yaml", "-o", tmp_path / "cloud.xyz")[0] == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], DEPTHS, rtol=1e-6)


def test_the_offset_of_the_principal_points_comes_from_the_pair(run, tmp_path, disparity):
    code, out, _ = run("stereo", "cloud", disparity, rig(tmp_path / "rig.yaml", right_cx=11.0), "-o",
                       tmp_path / "cloud.xyz", "--json")  # fmt: skip
    assert code == 0
    assert json.loads(out)["geometry"]["doffs"] == 10
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[0, 2], 50 / 20, rtol=1e-6)


def test_a_number_on_the_command_line_wins_over_the_camera_file(run, tmp_path, disparity):
    arguments = [disparity, rig(tmp_path / "rig.yaml"), "--baseline", 1.0]
    assert run("stereo", "cloud", *arguments, "-o", tmp_path / "cloud.xyz")[0] == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], np.multiply(DEPTHS, 2), rtol=1e-6)


def test_one_camera_of_a_file_needs_the_baseline_besides(run, tmp_path, disparity):
    camera = f"{rig(tmp_path / 'rig.yaml', pair=False)}#left"
    code, _, err = run("stereo", "cloud", disparity, camera, "-o", tmp_path / "cloud.xyz")
    assert code == 2
    assert "give --baseline" in err
    assert run("stereo", "cloud", disparity, camera, "--baseline", 0.5, "-o", tmp_path / "cloud.xyz")[0] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distortion": -0.1}, "undistort or rectify the images first"),
        ({"turn": 0.01}, "not rectified"),
        ({"size": (30, 20)}, "30 × 20 pixels, the disparity map 3 × 2"),
    ],
)
def test_a_camera_file_that_does_not_fit_is_refused_by_name(run, tmp_path, disparity, change, message):
    camera = rig(tmp_path / "rig.yaml", **change)
    code, _, err = run("stereo", "cloud", disparity, camera, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert message in err
    assert "rig.yaml" in err
    assert not (tmp_path / "cloud.ply").exists()


def test_missing_numbers_are_named(run, tmp_path, disparity):
    code, _, err = run("stereo", "cloud", disparity, "--fx", 100, "--cx", 1, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "give --cy, --baseline" in err


def test_sixteen_bit_maps_are_divided_by_256_and_the_output_says_so(run, tmp_path):
    cv2.imwrite(str(tmp_path / "kitti.png"), DISPARITY.astype(np.uint16) * 256)
    code, out, _ = run("stereo", "cloud", tmp_path / "kitti.png", *NUMBERS, "-o", tmp_path / "cloud.xyz")
    assert code == 0
    assert "disparity = count / 256" in out
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], DEPTHS, rtol=1e-6)


def test_the_report_is_one_json_document(run, tmp_path, disparity, image):
    code, out, _ = run("stereo", "cloud", disparity, image, *NUMBERS, "-o", tmp_path / "cloud.ply", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "output", "points", "pixels", "scale", "geometry", "depth_m", "appearance"]
    assert document["schema"] == "camcal/stereo-cloud/1"
    assert (document["points"], document["appearance"]) == (4, "gray")
    assert document["depth_m"] == {"min": 1.0, "median": 3.5, "max": 10.0}


def test_a_depth_range_leaves_out_what_is_near_and_far(run, tmp_path, disparity):
    code, _, _ = run("stereo", "cloud", disparity, *NUMBERS, "--min-depth", 1.5, "--max-depth", 6, "-o",
                     tmp_path / "cloud.xyz")  # fmt: skip
    assert code == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], [5, 2], rtol=1e-6)


def test_a_map_without_a_match_warns_and_writes_an_empty_cloud(run, tmp_path):
    cv2.imwrite(str(tmp_path / "none.png"), np.zeros((4, 4), np.uint8))
    code, _, err = run("stereo", "cloud", tmp_path / "none.png", *NUMBERS, "-o", tmp_path / "cloud.ply")
    assert code == 0
    assert "the cloud is empty" in err
    assert b"element vertex 0\n" in (tmp_path / "cloud.ply").read_bytes()


def test_a_ply_file_is_text_when_asked_for(run, tmp_path, disparity):
    assert run("stereo", "cloud", disparity, *NUMBERS, "--ascii", "-o", tmp_path / "cloud.ply")[0] == 0
    assert (tmp_path / "cloud.ply").read_text(encoding="ascii").splitlines()[1] == "format ascii 1.0"


def test_an_image_of_another_size_is_refused_with_both_sizes(run, tmp_path, disparity):
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((4, 6), np.uint8))
    code, _, err = run("stereo", "cloud", disparity, tmp_path / "large.png", *NUMBERS, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "6 × 4" in err


def test_an_input_is_never_overwritten(run, tmp_path, image):
    ply = tmp_path / "disparity.ply"
    cv2.imwrite(str(tmp_path / "disparity.png"), DISPARITY)
    (tmp_path / "disparity.png").rename(ply)
    code, _, err = run("stereo", "cloud", ply, image, *NUMBERS, "-o", ply)
    assert code == 2
    assert "not overwritten" in err


@pytest.mark.parametrize(("name", "code"), [("missing.png", 3), ("two.yaml", 3)])
def test_what_cannot_be_read_is_a_file_error(run, tmp_path, disparity, name, code):
    assert run("stereo", "cloud", disparity, tmp_path / name, *NUMBERS, "-o", tmp_path / "cloud.ply")[0] == code


def test_two_images_are_refused(run, tmp_path, disparity, image):
    code, _, err = run("stereo", "cloud", disparity, image, image, *NUMBERS, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "one image and one camera file" in err


def test_the_sample_settings_give_the_geometry(run, tmp_path, disparity):
    code, out, _ = run("stereo", "cloud", disparity, "--config", CONFIG, "-o", tmp_path / "cloud.ply", "--json")
    assert code == 0
    assert json.loads(out)["geometry"]["baseline"] == 0.573
    assert json.loads(out)["points"] == 3  # the match of 5 px lies beyond 60 m
