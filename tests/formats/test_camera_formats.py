"""Camera files of OpenCV, ROS and Kalibr: round trips, what OpenCV and PyYAML read of them, what is refused."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.nearest import Nearest
from camcal.formats.cameras.record import Given, MissingSize, Source
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

SUFFIXES = {"opencv": (".yml", ".xml", ".json"), "ros": (".yaml",), "kalibr": (".yaml",), "camcal": (".yaml",)}
FOREIGN = [(name, suffix) for name, suffixes in SUFFIXES.items() for suffix in suffixes if name != "camcal"]
SIZE = (752, 480)
RIGHT_T_LEFT = Pose.from_vector(np.array([0.011, -0.023, 0.0071]), np.array([-0.1103, 0.00045792, -0.00064487]))


def camera(model, seed=0, size=SIZE):
    """Return a camera of a lens model whose coefficients all have 17 digits and none is zero."""
    rng = np.random.default_rng(seed)
    count = len(MODELS[model].parameter_names)
    core = np.array([458.654, 457.296, 367.215, 248.375]) + rng.normal(size=4)
    drawn = MODELS[model].prior_mean[4:] + 0.01 * rng.normal(size=count - 4)
    return Camera(MODELS[model], size, np.concatenate([core, drawn]))


def written(folder, file, name, suffix):
    path = folder / f"file{suffix}"
    cameras.write(path, file, FORMATS[name])
    return path


def one(model, **more):
    return CameraFile({"camera": CameraEntry(camera(model, **more))})


def pair(model):
    entries = {"left": CameraEntry(camera(model, 1)), "right": CameraEntry(camera(model, 2))}
    return CameraFile(entries, {"right_T_left": Transform(RIGHT_T_LEFT)})


def assert_same_lens(found, expected):
    """The same parameters to 1e-12 under the same names; those that only one of the models has are 0."""
    assert found.image_size == expected.image_size
    values = [dict(zip(each.model.parameter_names, each.parameters, strict=True)) for each in (found, expected)]
    for name in values[0] | values[1]:
        assert values[0].get(name, 0.0) == pytest.approx(values[1].get(name, 0.0), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("name", "suffix", "model"),
    [(name, suffix, model) for name, suffix in FOREIGN for model in ("pinhole", "opencv4", *FORMATS[name].models)],
)
def test_one_camera_comes_back_to_1e_12(tmp_path, name, suffix, model):
    path = written(tmp_path, one(model), name, suffix)
    assert cameras.format_of(path).name == name
    assert_same_lens(cameras.read_camera(path), camera(model))


@pytest.mark.parametrize("model", ["opencv5", "kannala_brandt4"])
@pytest.mark.parametrize("suffix", SUFFIXES["opencv"])
def test_a_pair_of_opencv_comes_back_to_1e_12(tmp_path, suffix, model):
    back = cameras.read(written(tmp_path, pair(model), "opencv", suffix))
    for side, seed in (("left", 1), ("right", 2)):
        assert_same_lens(back.cameras[side].camera, camera(model, seed))
    assert np.abs(back.transforms["right_T_left"].pose.matrix() - RIGHT_T_LEFT.matrix()).max() < 1e-12


@pytest.mark.parametrize("pose", [RIGHT_T_LEFT, Pose(RIGHT_T_LEFT.rotation, np.array([0.01, -0.2, 0.003]))])
@pytest.mark.parametrize("model", ["opencv5", "kannala_brandt4"])
def test_a_pair_of_ros_is_two_files_that_say_where_the_right_camera_stands(tmp_path, model, pose):
    file = replace(pair(model), transforms={"right_T_left": Transform(pose)})
    cameras.write(tmp_path / "pair", file, FORMATS["ros"])
    left, right = tmp_path / "pair" / "left.yaml", tmp_path / "pair" / "right.yaml"
    for first, second in ((left, right), (right, left)):
        back = cameras.read(first, second=second)
        assert np.abs(back.transforms["right_T_left"].pose.matrix() - pose.matrix()).max() < 1e-12
        assert_same_lens(back.cameras["right"].camera, camera(model, 2))
    cameras.write(tmp_path / "again", back, FORMATS["ros"])
    assert (tmp_path / "again" / "right.yaml").read_bytes() == right.read_bytes()


def test_the_rectified_views_of_a_pair_show_a_point_in_one_row(tmp_path):
    cameras.write(tmp_path / "pair", pair("opencv5"), FORMATS["ros"])
    blocks = [yaml.safe_load((tmp_path / "pair" / f"{side}.yaml").read_text()) for side in ("left", "right")]
    turns = [np.reshape(block["rectification_matrix"]["data"], (3, 3)) for block in blocks]
    views = [np.reshape(block["projection_matrix"]["data"], (3, 4)) for block in blocks]
    point = np.array([0.3, -0.2, 2.0])
    seen = [views[side] @ np.append(turns[0] @ point, 1.0) for side in (0, 1)]  # P takes the left one's rectified axes
    pixels = [each[:2] / each[2] for each in seen]
    by_right = views[1][:, :3] @ turns[1] @ RIGHT_T_LEFT.apply(point)
    assert by_right[:2] / by_right[2] == pytest.approx(pixels[1], abs=1e-9)
    assert pixels[0][1] == pytest.approx(pixels[1][1], abs=1e-9)
    baseline = np.linalg.norm(RIGHT_T_LEFT.translation)
    assert pixels[0][0] - pixels[1][0] == pytest.approx(views[0][0, 0] * baseline / seen[0][2], rel=1e-9)


def test_a_camchain_keeps_cameras_imu_and_what_else_kalibr_says(tmp_path):
    imu = Pose.from_vector(np.array([1.1, 0.2, -0.3]), np.array([0.07, -0.017, 0.004]))
    topic = {"x_kalibr": {"rostopic": "/left/image", "timeshift_cam_imu": -8.121e-05}}
    file = CameraFile(
        {"cam0": CameraEntry(camera("opencv4"), extra=topic), "cam1": CameraEntry(camera("kannala_brandt4"))},
        {"cam1_T_cam0": Transform(RIGHT_T_LEFT), "cam0_T_imu": Transform(imu)},
    )
    path = written(tmp_path, file, "kalibr", ".yaml")
    back = cameras.read(path)
    assert back.cameras["cam0"].extra["x_kalibr"]["rostopic"] == "/left/image"
    for name in file.transforms:
        difference = back.transforms[name].pose.matrix() - file.transforms[name].pose.matrix()
        assert np.abs(difference).max() < 1e-12
    chain = yaml.safe_load(path.read_text())
    assert chain["cam0"]["timeshift_cam_imu"] == -8.121e-05
    expected = RIGHT_T_LEFT @ imu
    assert np.abs(np.array(chain["cam1"]["T_cam_imu"]) - expected.matrix()).max() < 1e-12


@pytest.mark.parametrize("name", ["ros", "kalibr"])
def test_every_number_is_one_to_pyyaml_and_no_whole_one(tmp_path, name):
    tiny = replace(camera("opencv4"), parameters=np.array([460.0, 460.0, 320.0, 240.0, 1e-5, -3e-17, 1e16, 2.5]))
    path = written(tmp_path, CameraFile({"camera": CameraEntry(tiny)}), name, ".yaml")
    block = yaml.safe_load(path.read_text())
    if name == "ros":
        lens = [*block["camera_matrix"]["data"], *block["distortion_coefficients"]["data"]]
        assert lens == [460.0, 0.0, 320.0, 0.0, 460.0, 240.0, 0.0, 0.0, 1.0, 1e-5, -3e-17, 1e16, 2.5, 0.0]
    else:
        lens = [*block["cam0"]["intrinsics"], *block["cam0"]["distortion_coeffs"]]
        assert lens == tiny.parameters.tolist()
    assert {type(value) for value in lens} == {float}


@pytest.mark.parametrize(("name", "suffix"), [*((name, suffix) for name, suffix in FOREIGN if name != "kalibr")])
def test_opencv_reads_what_is_written(tmp_path, name, suffix):
    expected = camera("opencv8")
    storage = cv2.FileStorage(str(written(tmp_path, one("opencv8"), name, suffix)), cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("camera_matrix").mat(), expected.K)
    assert np.array_equal(storage.getNode("distortion_coefficients").mat().ravel(), expected.dist)
    assert storage.getNode("image_width").real() == SIZE[0]


@pytest.mark.parametrize("suffix", SUFFIXES["opencv"])
def test_opencv_reads_a_pair(tmp_path, suffix):
    storage = cv2.FileStorage(str(written(tmp_path, pair("opencv5"), "opencv", suffix)), cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("M2").mat(), camera("opencv5", 2).K)
    assert np.array_equal(storage.getNode("R").mat(), RIGHT_T_LEFT.rotation)
    assert np.array_equal(storage.getNode("T").mat(), RIGHT_T_LEFT.translation[:, None])


@pytest.mark.parametrize("suffix", SUFFIXES["opencv"])
def test_what_opencv_writes_is_read(tmp_path, suffix):
    path, expected = tmp_path / f"file{suffix}", camera("opencv14")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sat Nov 21 12:00:00 2026")
    storage.write("nframes", 13)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("camera_matrix", expected.K)
    storage.write("distortion_coefficients", expected.dist)  # one dimension: OpenCV 5 writes it in a form of its own
    storage.write("avg_reprojection_error", 0.39)
    storage.write("per_view_reprojection_errors", np.array([[0.1], [np.nan]]))
    storage.release()
    entry = cameras.read(path).cameras["camera"]
    assert_same_lens(entry.camera, expected)
    assert entry.quality == {"rms_px": 0.39, "images_used": 13}


def matrix(*numbers, rows, columns, kind="d"):
    data = ", ".join(map(str, numbers))
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: {kind}\n   data: [ {data} ]\n"


K = matrix(500.5, 0, 320, 0, 501.5, 240, 0, 0, 1, rows=3, columns=3)
D5 = matrix(-0.2, "1e-05", 0.0, 0.001, 0.03, rows=5, columns=1)
D4 = matrix(-0.2, 0.1, 0.0, 0.001, rows=1, columns=4)
BOTH = "image_width: 640\nimage_height: 480\n"
HEADS = ("%YAML:1.0\n---\n", "%YAML:1.0 # OpenVINS\n", "%YAML 1.2\n---\n", "")
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix: {rows: 3, cols: 3, data: [500.5, 0, 320, 0, 501.5, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.1, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [480, 0, 321, 0, 0, 480, 239, 0, 0, 0, 1, 0]}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [461, 460.152, 362.680, 246.049]
  distortion_model: radtan
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  resolution: [752, 480]
"""


def read(tmp_path, text, name="file.yml", **given):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return cameras.read(path, given=Given(**given))


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize(
    ("matrix_key", "coefficients_key"),
    [("camera_matrix", "distortion_coefficients"), ("Camera_Matrix", "Distortion_Coefficients"), ("K", "D"),
     ("cameraMatrix", "distCoeffs"), ("mtx", "dist")],
)  # fmt: skip
def test_the_names_people_give_are_read_under_both_headers(tmp_path, head, matrix_key, coefficients_key):
    found = read(tmp_path, f"{head}{BOTH}{matrix_key}: {K}{coefficients_key}: {D5}").cameras["camera"].camera
    assert found.model.name == "opencv5"
    assert found.parameters.tolist() == [500.5, 501.5, 320.0, 240.0, -0.2, 1e-5, 0.0, 0.001, 0.03]


def test_matrices_may_be_plain_lists(tmp_path):
    text = "image_size: [640, 480]\nK: [[500, 0, 320], [0, 500, 240], [0, 0, 1]]\nD: [0.1, 0.2, 0.0, 0.0, 0.0]\n"
    assert read(tmp_path, text).cameras["camera"].camera.dist.tolist() == [0.1, 0.2, 0.0, 0.0, 0.0]


def test_intrinsics_and_extrinsics_are_one_pair(tmp_path):
    rotation = so3.exp(np.array([0.01, -0.02, 0.03]))
    extrinsics = tmp_path / "extrinsics.yml"
    extrinsics.write_text(
        f"%YAML:1.0\nR: {matrix(*rotation.ravel(), rows=3, columns=3)}T: {matrix(-0.1, 0.001, 0, rows=3, columns=1)}"
        f"Q: {matrix(*range(16), rows=4, columns=4)}"
    )
    intrinsics = tmp_path / "intrinsics.yml"
    intrinsics.write_text(f"%YAML:1.0\nM1: {K}D1: {D5}M2: {K}D2: {D5}")
    file = cameras.read(intrinsics, given=Given((640, 480)), second=extrinsics)
    assert list(file.cameras) == ["left", "right"]
    pose = file.transforms["right_T_left"].pose
    assert np.array_equal(pose.rotation, rotation)
    assert pose.translation.tolist() == [-0.1, 0.001, 0.0]
    with pytest.raises(MissingSize, match="has no image size: give --size WxH"):
        cameras.read(intrinsics)
    with pytest.raises(
        InvalidInput, match="no camera matrix: give the file with M1 D1 M2 D2, and this one with --with"
    ):
        cameras.read(extrinsics)


def test_four_coefficients_are_asked_for_unless_something_says_what_they_are(tmp_path):
    text = f"{BOTH}camera_matrix: {K}distortion_coefficients: {D4}"
    with pytest.raises(
        InvalidInput, match=r"file\.yml:8: distortion_coefficients: 4 coefficients are .* --model fisheye"
    ):
        read(tmp_path, text)
    models = [
        read(tmp_path, text, model="fisheye"),
        read(tmp_path, text, model="opencv4"),
        read(tmp_path, text + "fisheye_model: 1\n"),
        read(tmp_path, text + "fisheye_model: 0\n"),
    ]
    names = [file.cameras["camera"].camera.model.name for file in models]
    assert names == ["kannala_brandt4", "opencv4", "kannala_brandt4", "opencv4"]
    with pytest.raises(InvalidInput, match="the file says fisheye, --model opencv4"):
        read(tmp_path, text + "fisheye_model: 1\n", model="opencv4")


def test_ros_as_people_write_it(tmp_path):
    found = read(tmp_path, ROS)
    assert list(found.cameras) == ["narrow_stereo_left"]
    assert found.cameras["narrow_stereo_left"].camera.value("fx") == 500.5
    assert found.converted_from == {"file": "file.yml", "format": "ros", "exact": True}
    again = written(tmp_path, found, "ros", ".yaml")  # P is a choice that is kept
    assert yaml.safe_load(again.read_text())["projection_matrix"]["data"][:3] == [480.0, 0.0, 321.0]


def test_openvins_camchains_have_the_transform_the_other_way(tmp_path):
    pose = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.02, -0.06, 0.01]))
    text = f"%YAML:1.0\n\n{KALIBR}  T_imu_cam: {pose.matrix().tolist()}\n"
    found = read(tmp_path, text).transforms["cam0_T_imu"].pose
    assert np.abs(found.matrix() - pose.inverse().matrix()).max() < 1e-15


def test_a_rotation_that_was_rounded_is_made_one_again_with_a_warning(tmp_path):
    rotation = so3.exp(np.array([0.3, -0.2, 0.1]))
    for digits, said in ((8, 0), (5, 1)):
        rounded = np.eye(4)
        rounded[:3, :3] = rotation.round(digits)
        found = read(tmp_path, f"{KALIBR}  T_cam_imu: {rounded.tolist()}\n")
        assert sum(warning.code == "rounded_rotation" for warning in found.warnings) == said
        assert np.abs(found.transforms["cam0_T_imu"].pose.rotation - rotation).max() < 2 * 10.0**-digits


LENS = f"camera_matrix: {K}distortion_coefficients: {D5}"
BAD = {
    f"{BOTH}{LENS.replace('cols: 3', 'cols: 300000000', 1)}": "camera_matrix: 9 numbers; 3 x 300000000 are 900000000",
    f"{BOTH}{LENS.replace('dt: d', 'dt: 2d', 1)}": "dt '2d' is not the type",
    f"{BOTH}{LENS.replace('500.5', '.Nan', 1)}": "'.Nan' is not a finite number",
    f"{BOTH}{LENS.replace('500.5', '-500.5', 1)}": "fx: -500.5 must be > 0",
    f"{BOTH}{LENS.replace('500.5', 'true', 1)}": "True is not a finite number",
    f"{BOTH}{LENS.replace('500.5, 0,', '500.5, 0.1,', 1)}": "camcal's lens models have no skew",
    f"{BOTH}K: [500, 0, 0, 0, 500, 0, 320, 240, 1]\nD: [0, 0, 0, 0, 0]\n": "possibly transposed: cx, cy in the last",
    f"{BOTH}camera_matrix: {K}distortion_coefficients: [1.0, 2.0, 3.0]\n": "3 coefficients; OpenCV's lenses have 4, 5",
    f"{BOTH}camera_matrix: {K}": "",
    f"{BOTH}{LENS}xi: 1.2\n": "5 coefficients; cv2.omnidir has 4",
    f"image_width: 64.5\nimage_height: 480\n{LENS}": "64.5 is not a number of pixels",
    f"{BOTH}{LENS}camera_matrix: {K}": "duplicate key",
    f"a: &a [1, 1]\n{BOTH}{LENS}": "anchor &a not supported",
    f"{LENS}": "has no image size",
    ROS.replace("plumb_bob", "thin_prism"): "distortion_model: 'thin_prism' is not one of plumb_bob",
    ROS.replace("plumb_bob", "equidistant"): "5 numbers; equidistant has 4",
    ROS.replace("image_width: 640\n", ""): "has no image_width",
    KALIBR.replace("pinhole", "ds"): "'ds-radtan' is not a lens of this program; read are pinhole-none, pinhole-radtan",
    KALIBR.replace("radtan", "fov"): "8 numbers; pinhole-fov has 5",
    KALIBR.replace("pinhole", "omni").replace("[461,", "[-1, 461,"): "xi: -1 is outside [0, 1e+06]",
    KALIBR.replace("461, ", ""): "7 numbers; pinhole-radtan has 8",
    KALIBR.replace("[752,", "[1e+7,"): "1e+07 x 480 is not a width and height in pixels",
    KALIBR.replace("461, ", "1e-30, "): "is outside [0.001, 1e+10]",
    f"{BOTH}{LENS.replace('500.5', '1e300', 1)}": "1e+300 is outside [-1e+12, 1e+12]",
    KALIBR + "  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]]\n": "its last row is",
    KALIBR + "  T_cam_imu: [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n": "not a rotation",
    "<opencv_storage><a>1</a></opencv_storage>": "has no camera matrix",
    "<opencv_storage><a>1</a><a>2</a></opencv_storage>": "<a> occurs twice",
    "<opencv_storage><a>1</a>": "invalid or truncated XML",
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "b">]><opencv_storage>&a;</opencv_storage>': "document type",
    "<opencv_storage>" + "<a>" * 100 + "</a>" * 100 + "</opencv_storage>": "more than 32 levels",
    "<opencv_storage><a>" + " 1" * (5 << 20) + "</a></opencv_storage>": "more than 8388608 characters in <a>",
    '{"camera_matrix": {"type_id": "opencv-matrix", "rows": 3,': "invalid or truncated text",
}


@pytest.mark.parametrize(("text", "said"), BAD.items(), ids=range(len(BAD)))
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, said):
    if not said:  # no coefficients: a warning
        (warning,) = (each for each in read(tmp_path, text).warnings if each.code == "assumed_no_distortion")
        assert warning.where.startswith(str(tmp_path / "file.yml:3"))
        return
    with pytest.raises((InvalidInput, FileError), match=re.escape(said)) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "file.yml"))


def test_a_reader_refuses_a_file_of_another_format():
    for name, said in (("kalibr", "has no cam0"), ("ros", "has no image_width"), ("opencv", "has no camera matrix")):
        with pytest.raises(InvalidInput, match=said):
            FORMATS[name].read([Source(Path("a.yml"), "a: 1\n")], Given())


@given(
    st.sampled_from([BOTH + LENS, ROS, KALIBR, f"<opencv_storage>{BOTH}</opencv_storage>", '{"K": [1, 0], "D": []}']),
    st.lists(st.tuples(st.integers(0, 600), st.sampled_from("[]{}:-.,1e &*!<>\"'\n\t\0é")), max_size=4),
)
def test_a_damaged_file_is_read_or_refused(text, edits):
    for place, letter in edits:
        text = text[: place % len(text)] + letter + text[place % len(text) + 1 :]
    for name in ("opencv", "ros", "kalibr"):
        try:
            found = FORMATS[name].read([Source(Path("damaged.yml"), text)], Given((640, 480), "opencv4"))
        except CamcalError:
            continue
        assert all(np.isfinite(entry.camera.parameters).all() for entry in found.cameras.values())


def test_lenses_are_written_exactly_or_not_at_all(tmp_path):
    with pytest.raises(
        InvalidInput, match=r"ROS camera_info has no lens model with s1 = .*tau_y = .*; the nearest opencv8 is"
    ):
        written(tmp_path, one("opencv14"), "ros", ".yaml")
    with pytest.raises(
        InvalidInput, match=r"with k3 = .*accept it with --max-error .*, calibrate with --model opencv4, undistort"
    ):
        written(tmp_path, one("opencv5"), "kalibr", ".yaml")
    with pytest.raises(InvalidInput, match=r"with k5 = .*; the nearest kannala_brandt4 is off by up to"):
        written(tmp_path, one("kannala_brandt5t"), "opencv", ".xml")
    assert list(tmp_path.iterdir()) == []
    without = camera("opencv14").parameters * (np.arange(18) < 8)
    flat = CameraFile({"camera": CameraEntry(replace(camera("opencv14"), parameters=without))})
    assert cameras.read_camera(written(tmp_path, flat, "kalibr", ".yaml")).model.name == "opencv4"


def test_a_lens_that_a_format_does_not_have_is_written_within_an_error_that_is_accepted(tmp_path):
    lens = Camera(MODELS["opencv5"], (640, 480), [536.0, 536.0, 342.0, 236.0, -0.266, -0.0386, 1.8e-3, -2.8e-4, 0.238])
    file = CameraFile({"camera": CameraEntry(lens)})
    with pytest.raises(InvalidInput, match=r"is off by up to 3\.72 px .*: accept it with --max-error 3\.8,"):
        cameras.write(tmp_path / "chain.yaml", file, FORMATS["kalibr"], Nearest(max_error_px=3.6))
    cameras.write(tmp_path / "chain.yaml", file, FORMATS["kalibr"], Nearest(max_error_px=3.8))
    near = cameras.read_camera(tmp_path / "chain.yaml")
    rays = lens.unproject(np.array([(0.0, 0.0), (639.0, 0.0), (320.0, 240.0), (639.0, 479.0)]))
    apart = np.linalg.norm(near.project(rays.directions).pixels - lens.project(rays.directions).pixels, axis=1)
    assert 1 < apart.max() < 3.8
    with pytest.raises(InvalidInput, match="cylinder cannot be written to Kalibr camchain, whose lens models are"):
        cameras.write(tmp_path / "chain.yaml", CameraFile({"view": CameraEntry(camera("cylinder"))}), FORMATS["kalibr"])


def test_more_cameras_than_a_format_holds_are_refused(tmp_path):
    three = CameraFile({name: CameraEntry(camera("opencv5")) for name in ("a", "b", "c")})
    with pytest.raises(InvalidInput, match="OpenCV FileStorage holds 2 cameras, not a, b, c: write them one by one"):
        written(tmp_path, three, "opencv", ".xml")
    apart = replace(pair("opencv4"), transforms={})
    with pytest.raises(InvalidInput, match="needs a transform between"):
        written(tmp_path, apart, "kalibr", ".yaml")
    mixed = CameraFile({"a": CameraEntry(camera("opencv5")), "b": CameraEntry(camera("opencv5", size=(640, 480)))})
    with pytest.raises(InvalidInput, match="no two sizes of images"):
        written(tmp_path, mixed, "opencv", ".xml")


def test_the_same_content_gives_the_same_bytes(tmp_path):
    for name, suffix in FOREIGN:
        first = written(tmp_path, one("opencv4"), name, suffix).read_bytes()
        assert written(tmp_path, one("opencv4"), name, suffix).read_bytes() == first


def test_a_native_file_is_converted_with_all_digits(tmp_path):
    lens = camera("opencv8")
    path = written(tmp_path, one("opencv8"), "camcal", ".yaml")
    assert cameras.read_camera(path).parameters.tolist() == lens.parameters.tolist()
