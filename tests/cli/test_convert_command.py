"""`camcal convert`: what it says, its document, its exit codes; every camera argument reads what it writes."""

import json

import cv2
import numpy as np
import pytest
import yaml

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, native
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose

LENS = Camera(model_named("opencv5"), (640, 480), [512.0, 511.5, 321.5, 238.25, -0.2, 0.05, 1e-3, -2e-4, 0.01])


@pytest.fixture
def rig(tmp_path):
    """The path of a file with two cameras, one of them with noise, and the transform between them."""
    entries = {"left": CameraEntry(LENS, noise=CalibrationNoise(0.1)), "right": CameraEntry(LENS)}
    path = tmp_path / "rig.yaml"
    native.write(path, CameraFile(entries, {"right_T_left": Transform(Pose(np.eye(3), [-0.12, 0.0, 0.0]))}))
    return path


def test_it_says_what_was_written_and_what_is_not_held(run, tmp_path, rig):
    code, out, err = run("convert", f"{rig}#left", tmp_path / "left.yaml", "--to", "ros")
    assert (code, err) == (0, "")
    assert out == f"ROS camera_info, exact; not stored: noise\nwrote {tmp_path / 'left.yaml'}\n"
    assert yaml.safe_load((tmp_path / "left.yaml").read_text())["camera_name"] == "left"


@pytest.mark.parametrize("name", ["camera.yml", "camera.xml", "camera.json"])
def test_a_fisheye_is_said_to_be_used_with_the_functions_for_it(run, tmp_path, name):
    said = {
        "opencv5": "use cv2.undistort(image, K, D)",
        "kannala_brandt4": "fisheye: use cv2.fisheye.undistortImage(image, K, D, Knew=K), not cv2.undistort",
    }
    fisheye = Camera(model_named("kannala_brandt4"), (640, 480), [300.0, 301.0, 320.0, 240.0, 0.01, 0.0, 0.0, 0.0])
    for camera in (LENS, fisheye):
        words = said[camera.model.name]
        native.write(tmp_path / "camera.camcal.yaml", CameraFile({"camera": CameraEntry(camera)}))
        _, out, _ = run("convert", tmp_path / "camera.camcal.yaml", tmp_path / name, "--to", "opencv", "--overwrite")
        assert out.startswith(f"OpenCV FileStorage, exact; {words}\n")
        assert (tmp_path / name).read_text().count(words) == 1
        stored = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_READ)
        np.testing.assert_array_equal(stored.getNode("camera_matrix").mat(), camera.K)


def test_the_document(run, tmp_path, rig):
    code, out, _ = run("convert", rig, tmp_path / "rig.json", "--json")
    assert code == 0
    assert json.loads(out) == {
        "schema": "camcal/convert/1",
        "source_format": "camcal",
        "files": [
            {
                "format": "opencv",
                "outputs": [str(tmp_path / "rig.json")],
                "cameras": [
                    {"name": "left", "model": "opencv5", "image_size": [640, 480], "refit": None},
                    {"name": "right", "model": "opencv5", "image_size": [640, 480], "refit": None},
                ],
                "transforms": ["right_T_left"],
                "left_out": ["noise"],
            }
        ],
        "warnings": [],
    }


def test_several_files_are_written_at_once_or_none(run, tmp_path, rig):
    xml, ros = tmp_path / "opencv.xml", tmp_path / "ros.yaml"
    code, out, _ = run("convert", f"{rig}#left", xml, ros, "--to", "ros")
    assert code == 0
    assert out.splitlines()[0].startswith("OpenCV FileStorage, exact")
    assert out.splitlines()[1].startswith("ROS camera_info, exact")
    assert [cameras.format_of(path).name for path in (xml, ros)] == ["opencv", "ros"]
    other = tmp_path / "other.xml"
    code, _, err = run("convert", f"{rig}#left", other, tmp_path / "kalibr.yaml", "--to", "kalibr")
    assert (code, other.exists()) == (2, False)
    assert "k3 = 0.01" in err
    assert "standard output takes one file" in run("convert", rig, other, "-")[2]


def test_a_pair_goes_to_ros_and_back(run, tmp_path, rig):
    assert run("convert", rig, tmp_path / "ros", "--to", "ros")[0] == 0
    left, right = tmp_path / "ros" / "left.yaml", tmp_path / "ros" / "right.yaml"
    code, _, err = run("convert", left, tmp_path / "back.yaml", "--with", right)
    assert (code, err) == (0, "")
    file = cameras.read(tmp_path / "back.yaml")
    assert file.transforms["right_T_left"].pose.translation == pytest.approx([-0.12, 0.0, 0.0], abs=1e-12)
    assert file.converted_from == {"file": "left.yaml", "format": "ros", "exact": True}
    assert file.provenance["command"].startswith("camcal convert")


def test_what_is_refused_and_how(run, tmp_path, rig):
    out = tmp_path / "out.yaml"
    rows = [
        (
            (rig, out),
            2,
            "out.yaml: .yaml is written in several formats: give --to and one of camcal",
        ),
        ((f"{rig}#left", out, "--to", "kalibr"), 2, "left: Kalibr camchain has no lens model with k3 = 0.01"),
        ((rig, out, "--to", "rso"), 2, "--to rso: no camera format of this name. Did you mean 'ros'?"),
        ((rig, out, "--to", "ros"), 2, "out.yaml: a pair is two files for ROS (left.yaml, right.yaml): give a folder"),
        ((rig, tmp_path / "out.xml", "--to", "ros"), 2, "out.xml: ROS camera_info is written as .yaml or .yml"),
        ((rig, tmp_path / "out.dat"), 2, "out.dat: .dat is not written; use .yaml, .yml, .xml, .json"),
        (
            (rig, tmp_path / "out.txt"),
            2,
            "out.txt: .txt is written in another format only: give --to and one of colmap",
        ),
        ((rig, tmp_path / "a.cam"), 2, "a.cam: .cam is not written"),
        ((rig, rig, "--to", "camcal"), 2, "rig.yaml: is an input and is not overwritten"),
        ((rig, out, "--to", "camcal", "--with", rig), 2, "are all in one"),
        ((f"{rig}#middle", out, "--to", "ros"), 2, "no camera 'middle'"),
        ((tmp_path / "none.yaml", out), 3, "none.yaml"),
        ((tmp_path, out), 2, "is a folder where a camera file is needed"),
    ]
    for arguments, expected, said in rows:
        code, printed, err = run("convert", *arguments)
        assert (code, printed) == (expected, ""), arguments
        assert said in err
        assert err.count("\n") == 1
    assert not out.exists()


def test_a_file_without_a_size_gets_one(run, tmp_path):
    bare = tmp_path / "bare.yml"
    bare.write_text("K: [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]\nD: [0.1, 0.0, 0.0, 0.0, 0.0]\n")
    assert "has no image size: give --size WxH" in run("convert", bare, tmp_path / "a.yaml")[2]
    assert "has no image size" in run("inspect", bare)[2]
    assert run("convert", bare, tmp_path / "a.yaml", "--size", "640x480")[0] == 0
    assert cameras.read_camera(tmp_path / "a.yaml").image_size == (640, 480)


def test_inspect_reads_other_programs_files(run, tmp_path, rig):
    run("convert", f"{rig}#left", tmp_path / "left.xml")
    code, out, _ = run("inspect", tmp_path / "left.xml")
    assert code == 0
    assert "converted from left.xml (opencv)" in out
    assert run("inspect", tmp_path / "left.xml", "--get", "cameras.camera.intrinsics.fx")[1] == "512.0\n"


def test_transforms_of_a_camchain_are_frames(run, tmp_path, rig):
    file = cameras.read(rig)
    flat = CameraFile(
        {name: CameraEntry(Camera(model_named("pinhole"), (640, 480), LENS.parameters[:4])) for name in file.cameras},
        file.transforms,
    )
    cameras.write(tmp_path / "camchain.yaml", flat, cameras.FORMATS["kalibr"])
    code, out, _ = run("transform", "chain", tmp_path / "camchain.yaml", "--to", "cam0", "--from", "cam1", "--json")
    assert code == 0
    assert json.loads(out)["schema"] == "camcal/transform-chain/1"
    assert "0.12" in out


def test_commands_take_a_part_of_the_image(run, tmp_path):
    cameras.write(tmp_path / "a.xml", CameraFile({"camera": CameraEntry(LENS)}), cameras.FORMATS["opencv"])
    code, _, err = run("convert", tmp_path / "a.xml", tmp_path / "b.yaml", "--crop", "600x400+20+30", "--binning", "2")
    assert (code, err) == (0, "")
    found = cameras.read_camera(tmp_path / "b.yaml")
    assert found.image_size == (300, 200)
    assert found.value("cx") == pytest.approx((321.5 - 20 + 0.5) / 2 - 0.5)
    code, _, err = run("convert", tmp_path / "a.xml", tmp_path / "c.yaml", "--scale-to", "1280x960")
    assert code == 0
    assert cameras.read_camera(tmp_path / "c.yaml").value("fx") == pytest.approx(2 * 512.0)
    for wrong, said in (("640x480", "written as WxH+X+Y"), ("800x400+0+0", "not within the image")):
        code, _, err = run("convert", tmp_path / "a.xml", tmp_path / "d.yaml", "--crop", wrong)
        assert code == 2
        assert said in err


FISHEYE = Camera(model_named("kannala_brandt4"), (512, 512), [190.98, 190.97, 254.9, 256.9, 3.5e-3, 7e-4, -2e-3, 2e-4])


def test_the_nearest_lens_of_a_model_is_written_with_its_covariance_and_a_map_of_the_difference(run, tmp_path):
    covariance = np.diag([0.5, 0.5, 0.3, 0.3, 1e-3, 2e-3, 1e-4, 1e-4, 2e-3]) ** 2
    known = Camera(LENS.model, LENS.image_size, LENS.parameters, covariance)
    native.write(tmp_path / "camera.yaml", CameraFile({"camera": CameraEntry(known)}))
    out, plot = tmp_path / "near.yaml", tmp_path / "difference.png"
    command = ["convert", tmp_path / "camera.yaml", out, "--refit", "opencv4"]
    code, _, err = run(*command, "--max-error", "0.001")
    assert code == 2
    assert "the nearest opencv4 is off by up to" in err
    limit = err.split("--max-error ")[1].split(",")[0]  # the remedy, tried
    code, said, _ = run(*command, "--max-error", limit, "--plot", plot)
    assert code == 0
    assert "camera as the nearest opencv4, off by up to" in said
    assert plot.read_bytes()[:4] == b"\x89PNG"
    (entry,) = native.read(out).cameras.values()
    assert entry.camera.model.name == "opencv4"
    assert 0.3 < entry.camera.std("fx") < 0.8
    assert yaml.safe_load(out.read_text())["converted_from"]["exact"] is False
    code, _, err = run("convert", tmp_path / "camera.yaml", out, "--refit", "opencv8", "--plot", plot, "--overwrite")
    assert (code, "the lenses written here are exact" in err) == (2, True)


def test_a_lens_that_is_near_up_to_an_angle_is_used_up_to_it(run, tmp_path):
    native.write(tmp_path / "fisheye.yaml", CameraFile({"camera": CameraEntry(FISHEYE)}))
    out = tmp_path / "narrow.yaml"
    code, _, err = run("convert", tmp_path / "fisheye.yaml", out, "--refit", "opencv8")
    assert (code, "--max-error 0.27 --max-theta 85" in err or "--max-theta 85" in err) == (2, True)
    code, _, _ = run("convert", tmp_path / "fisheye.yaml", out, "--refit", "opencv8", "--max-theta", "70")
    assert code == 0
    (entry,) = native.read(out).cameras.values()
    assert np.degrees(entry.valid.max_theta) == pytest.approx(70, abs=0.1)
    edge = FISHEYE.project(np.array([[np.sin(np.radians(70)), 0, np.cos(np.radians(70))]])).pixels[0]
    circle = entry.image_circle  # beyond it no command has a ray
    assert circle.radius == pytest.approx(edge[0] - circle.centre[0], rel=2e-3)
    code, _, err = run("convert", tmp_path / "fisheye.yaml", tmp_path / "camera.cameramodel")
    assert (code, "mrcal camera model has no lens model kannala_brandt4" in err) == (2, True)


def test_a_camera_file_of_camcal_stays_one_where_a_lens_or_its_images_change(run, tmp_path, rig):
    code, said, _ = run("convert", rig, tmp_path / "half.yaml", "--scale-to", "320x240")
    assert (code, said.startswith("camcal's own, exact")) == (0, True)
    code, said, _ = run("convert", f"{rig}#left", tmp_path / "more.yaml", "--refit", "opencv8")
    assert (code, said.startswith("camcal's own, exact")) == (0, True)
