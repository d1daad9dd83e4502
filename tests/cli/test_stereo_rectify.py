"""`camcal stereo rectify`: the files it writes, rigs of every format, and its exits."""

import json

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.images.files import load, save
from camcal.stereo.disparity import of_pair

SIZE = (160, 120)
LENS = Camera(model_named("opencv5"), SIZE, np.array([150.0, 150.5, 80.0, 58.5, -0.2, 0.05, 1e-3, 0.0, 0.0]))
WIDE = Camera(model_named("kannala_brandt4"), SIZE, np.array([60.0, 60.0, 79.5, 59.5, 0.0, 0.0, 0.0, 0.0]))
POSE = Pose.from_vector(np.array([0.01, 0.04, -0.005]), np.array([-0.1, 0.002, 0.004]))


def write_rig(path, left=LENS, right=LENS, pose=POSE, names=("left", "right")):
    entries = dict(zip(names, (CameraEntry(left), CameraEntry(right)), strict=True))
    native.write(path, CameraFile(entries, {f"{names[1]}_T_{names[0]}": Transform(pose)}))
    return path


def noise(path, seed=1, size=SIZE):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (size[1] // 8, size[0] // 8, 3), np.uint8)
    save(path, cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC))
    return path


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.yaml")
    for number in (1, 2):
        noise(tmp_path / "left" / f"l{number}.png", number)
        noise(tmp_path / "right" / f"r{number}.png", number + 2)
    return tmp_path


def test_folders_become_rectified_pairs_with_camera_file_and_masks(run, folder):
    code, out, err = run("stereo", "rectify", "rig.yaml", "left", "right", "-o", "out", "-j", 1)
    assert (code, err) == (0, "")
    assert "pinhole, " in out
    assert "left left, right right; baseline 0.1001" in out
    written = sorted(path.relative_to(folder / "out").as_posix() for path in (folder / "out").rglob("*.*"))
    expected = ["left/l1.png", "left/l2.png", "left_mask.png", "rectified.yaml", "right/r1.png", "right/r2.png"]
    assert [name for name in written if not name.endswith(".camcal-output")] == [*expected, "right_mask.png"]
    file = native.read(folder / "out" / "rectified.yaml")
    left, right = (file.cameras[name].camera for name in ("left", "right"))
    geometry = of_pair(left, right, file.transforms["right_T_left"].pose)
    assert geometry.baseline == pytest.approx(np.linalg.norm(POSE.translation), rel=1e-9)
    assert load(folder / "out" / "left" / "l1.png").size == left.image_size
    mask = load(folder / "out" / "left_mask.png").pixels
    assert mask.shape[::-1] == left.image_size
    assert set(np.unique(mask)) == {0, 255}
    assert file.provenance["rig"]["cameras"] == ["left", "right"]


def test_the_covariance_of_the_rig_goes_to_the_rectified_cameras(run, folder):
    spread = np.diag(np.array([0.3, 0.3, 0.2, 0.2, 1e-3, 1e-3, 1e-5, 1e-5, 1e-3]) ** 2)
    entry = CameraEntry(Camera(LENS.model, SIZE, LENS.parameters, spread))
    transform = Transform(POSE, np.diag(np.array([1e-4, 1e-4, 2e-4, 1e-4, 3e-4, 1e-4]) ** 2))
    native.write(folder / "rig.yaml", CameraFile({"left": entry, "right": entry}, {"right_T_left": transform}))
    assert run("stereo", "rectify", "rig.yaml", "-o", "out")[0] == 0
    file = native.read(folder / "out/rectified.yaml")
    assert 0.1 < file.cameras["left"].camera.std("fx") < 1.0
    std = np.sqrt(np.diag(file.transforms["right_T_left"].covariance))
    assert std[0] == pytest.approx(1e-4, rel=0.05)  # along the baseline, which is nearly x
    assert file.joint_covariance.names[::9] == ("left.fx", "right_T_left.ty")


def test_maps_and_files_for_other_programs_need_no_images(run, folder):
    command = ("stereo", "rectify", "rig.yaml", "-o", "out", "--maps", "--opencv", "--ros", "--json")
    code, out, _ = run(*command)
    assert code == 0
    found = json.loads(out)
    assert found["schema"] == "camcal/stereo-rectify/1"
    assert found["images"] == found["failed"] == []
    assert found["image_size"] == list(SIZE)  # as ROS has it
    with np.load("out/maps.npz") as stored:
        maps = dict(stored)
    source = load(noise(folder / "one.png")).pixels
    run("stereo", "rectify", "rig.yaml", "one.png", noise(folder / "two.png"), "-o", "out", "--ros")
    drawn = cv2.remap(source, maps["left_map1"], maps["left_map2"], cv2.INTER_LINEAR)
    assert cv2.absdiff(drawn, load(folder / "out" / "left" / "one.png").pixels).max() <= 1  # rounding
    np.testing.assert_array_equal(maps["left_valid"], load(folder / "out" / "left_mask.png").pixels > 0)
    storage = cv2.FileStorage("out/opencv.yml", cv2.FILE_STORAGE_READ)
    matrices = {name: storage.getNode(name).mat() for name in ("R1", "R2", "P1", "P2", "Q")}
    np.testing.assert_allclose(matrices["R1"], found["rect_R_left"], atol=1e-12)
    assert matrices["P2"][0, 3] == pytest.approx(-found["focal"] * found["baseline"])
    assert matrices["Q"][2, 3] == pytest.approx(found["focal"])
    ros = cameras.read(folder / "out/ros/left.yaml", second=folder / "out/ros/right.yaml")
    np.testing.assert_allclose(ros.transforms["right_T_left"].pose.matrix(), POSE.matrix(), atol=1e-9)
    extra = ros.cameras["right"].extra["x_ros"]
    np.testing.assert_allclose(np.reshape(extra["projection"], (3, 4)), matrices["P2"], rtol=1e-12)


@pytest.mark.parametrize("kind", ["opencv.yml", "ros", "kalibr.yaml"])
def test_rigs_of_other_formats_are_read(run, folder, kind):
    target = {"opencv.yml": "opencv", "ros": "ros", "kalibr.yaml": "kalibr"}[kind]
    lens = Camera(model_named("opencv4"), SIZE, LENS.parameters[:8]) if target == "kalibr" else LENS
    write_rig(folder / "own.yaml", lens, lens)
    assert run("convert", "own.yaml", kind, "--to", target)[0] == 0
    rig = ("ros/left.yaml", "--with", "ros/right.yaml") if target == "ros" else (kind,)
    code, out, err = run("stereo", "rectify", *rig, "-o", "out", "--json")
    assert (code, err) == (0, "")
    expected = json.loads(run("stereo", "rectify", "own.yaml", "-o", "own", "--json")[1])
    found = json.loads(out)
    np.testing.assert_allclose(found["rect_R_right"], expected["rect_R_right"], atol=1e-8)
    assert found["focal"] == pytest.approx(expected["focal"], rel=1e-6)


def test_exchanged_cameras_are_named_and_files_follow_their_names(run, folder):
    write_rig(folder / "rig.yaml", pose=POSE.inverse())
    code, out, err = run("stereo", "rectify", "rig.yaml", "left", "right", "-o", "out")
    assert code == 0
    assert "right is left of left" in " ".join(err.split())
    assert "left right, right left" in " ".join(out.split())
    assert (folder / "out/left/l1.png").exists()
    assert list(native.read(folder / "out/rectified.yaml").cameras) == ["right", "left"]


def test_wide_lenses_make_latlon_images_of_their_own_lens_model(run, folder):
    write_rig(folder / "rig.yaml", WIDE, WIDE)
    code, out, _ = run("stereo", "rectify", "rig.yaml", "left", "right", "-o", "out")
    assert code == 0
    assert "latlon, " in out
    assert native.read(folder / "out/rectified.yaml").cameras["left"].camera.model.name == "latlon_x"
    code, _, err = run("stereo", "rectify", "rig.yaml", "-o", "out", "--opencv")
    assert code == 2
    assert "--opencv is for pinhole images, these are latlon: give --projection pinhole, or use --maps" in err
    assert run("stereo", "rectify", "rig.yaml", "-o", "out", "--opencv", "--projection", "pinhole")[0] == 0


def test_videos_become_pairs_of_frames(run, folder):
    for side in ("left", "right"):
        writer = cv2.VideoWriter(f"{side}.avi", cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
        for number in range(3):
            writer.write(load(folder / side / f"{side[0]}{1 + number % 2}.png").pixels)
        writer.release()
    code, _, err = run("stereo", "rectify", "rig.yaml", "left.avi", "right.avi", "-o", "out", "-j", 1)
    assert (code, err) == (0, "")
    assert sorted(path.name for path in (folder / "out/right").glob("*.jpg")) == [
        f"right_{number:06d}.jpg" for number in range(3)
    ]


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("rig.yaml left -o out", 2, "LEFT and RIGHT go together"),
        ("rig.yaml left right -o out --cameras left,middle", 2, "no camera 'middle'"),
        ("rig.yaml left right -o out --cameras left", 2, "'left' is not two names, such as left,right"),
        ("three.yaml left right -o out", 2, "holds 3 cameras (a, b, c); name two: three.yaml#a,b"),
        ("three.yaml#a,c left right -o out", 2, "no transform joins a and c: c_T_a is missing"),
        ("behind.yaml left right -o out", 4, "axial pair: left and right look 2° off their baseline"),
        ("rig.yaml left small -o out", 6, "small/1.png: is 80x60, the camera 160x120"),
        ("rig.yaml left none -o out", 3, "none"),
        ("left right rig.yaml -o out", 2, "is a folder where a camera file is needed"),
    ],
)
def test_what_cannot_be_rectified_is_said(run, folder, line, code, said):
    entry = CameraEntry(LENS)
    file = CameraFile({"a": entry, "b": entry, "c": entry}, {"b_T_a": Transform(POSE)})
    native.write(folder / "three.yaml", file)
    write_rig(folder / "behind.yaml", pose=Pose(np.eye(3), np.array([0.003, 0.0, -0.1])))
    for number in (1, 2):
        noise(folder / "small" / f"{number}.png", size=(80, 60))
    found, _, err = run("stereo", "rectify", *line.split(), "-j", 1)
    assert said in err
    assert found == code
