"""What families mean by their numbers, against their own formulas: pixel origins, swapped coefficients, directions."""

import json
import re
import struct
import sys

import cv2
import h5py
import mat73
import numpy as np
import pytest
import yaml

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras import FORMATS, mat
from camcal.formats.cameras.record import Given
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

SIZE = (640, 480)
BROWN = Camera(MODELS["opencv5"], SIZE, [500.0, 501.0, 322.5, 238.25, -0.2, 0.05, 1e-3, -2e-3, 0.01])
FISHEYE = Camera(MODELS["kannala_brandt4"], SIZE, [300.0, 301.0, 322.5, 238.25, 0.02, -0.003, 0.001, -0.0002])
POINTS = np.column_stack([np.random.default_rng(2).uniform(-0.6, 0.6, (50, 2)), np.ones(50)])
PLACE = Pose.from_vector(np.array([0.3, -0.2, 0.1]), np.array([-0.12, 0.01, 0.02]))


def written(tmp_path, camera, name, file="file"):
    form = FORMATS[name]
    path = tmp_path / f"{file}{form.suffixes[0]}"
    cameras.write(path, CameraFile({"camera": CameraEntry(camera)}), form)
    return path


def read(tmp_path, text, name="file.txt", **given):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return cameras.read(path, given=Given(**given))


def test_metashape_as_its_manual_has_it(tmp_path):
    text = written(tmp_path, BROWN, "metashape").read_text()
    own = {key: float(value) for key, value in re.findall(r"<(\w+)>([-\d.e]+)</", text)}
    x, y = POINTS[:, 0], POINTS[:, 1]
    r2 = x * x + y * y
    radial = 1 + own["k1"] * r2 + own["k2"] * r2**2 + own["k3"] * r2**3
    x_d = x * radial + own["p1"] * (r2 + 2 * x * x) + 2 * own["p2"] * x * y
    y_d = y * radial + own["p2"] * (r2 + 2 * y * y) + 2 * own["p1"] * x * y
    u = own["width"] / 2 + own["cx"] + x_d * (own["f"] + own["b1"])
    v = own["height"] / 2 + own["cy"] + y_d * own["f"]
    assert np.abs(np.column_stack([u, v]) - 0.5 - BROWN.project(POINTS).pixels).max() < 1e-9


SENSOR = """<document version="2.0.0"><chunk><sensors><sensor id="0" label="M3M (12mm)" type="frame">
<resolution width="640" height="480"/>
<calibration type="frame" class="initial"><resolution width="640" height="480"/><f>400</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="640" height="480"/><f>500</f><cx>1.5</cx><b1>2</b1>
<k1>0.1</k1><p1>0.001</p1></calibration>
<covariance><params>f cx b1 p1</params><coeffs>4 0 0 0 0 1 0 0 0 0 9 0 0 0 0 1e-6</coeffs></covariance>
</sensor></sensors></chunk></document>
"""


def test_the_adjusted_calibration_of_metashape_is_read_with_its_covariance(tmp_path):
    file = read(tmp_path, SENSOR, "project.xml")
    assert list(file.cameras) == ["M3M_12mm"]
    camera = file.cameras["M3M_12mm"].camera
    assert [camera.value(name) for name in ("fx", "fy", "cx", "cy", "k1", "p1", "p2")] == [
        *(502.0, 500.0, 321.0, 239.5, 0.1, 0.0, 0.001)
    ]
    stds = [camera.std(name) for name in ("fx", "fy", "cx", "p2")]
    assert stds == pytest.approx([np.sqrt(13), 2.0, 1.0, 1e-3])
    only = SENSOR.replace("adjusted", "initial", 1)
    assert [warning.code for warning in read(tmp_path, only, "only.xml").warnings] == ["initial_calibration"]
    for key in ("k4", "b2"):
        with pytest.raises(InvalidInput, match=f"{key}: 0.1 is of a lens that camcal does not have: optimise"):
            read(tmp_path, SENSOR.replace("<k1>0.1</k1>", f"<{key}>0.1</{key}>"), "more.xml")


def test_opensfm_as_its_camera_has_it(tmp_path):
    (own,) = json.loads(written(tmp_path, BROWN, "opensfm").read_text()).values()
    x, y = POINTS[:, 0], POINTS[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (own["k1"] + r2 * (own["k2"] + r2 * own["k3"]))
    x_d = x * radial + 2 * own["p1"] * x * y + own["p2"] * (r2 + 2 * x * x)
    y_d = y * radial + 2 * own["p2"] * x * y + own["p1"] * (r2 + 2 * y * y)
    u = (own["focal_x"] * x_d + own["c_x"]) * 640 + (640 - 1) / 2
    v = (own["focal_y"] * y_d + own["c_y"]) * 640 + (480 - 1) / 2
    assert np.abs(np.column_stack([u, v]) - BROWN.project(POINTS).pixels).max() < 1e-9


@pytest.mark.parametrize(("name", "origin"), [("colmap", 0.5), ("nerfstudio", 0.5), ("matlab", 1.0), ("bouguet", 0.0)])
def test_the_principal_point_is_counted_as_the_family_counts(tmp_path, name, origin):
    path = written(tmp_path, BROWN, name) if name != "matlab" else tmp_path / "file.json"
    if name == "matlab":
        cameras.write(path, CameraFile({"camera": CameraEntry(BROWN)}), FORMATS[name])
    assert str(322.5 + origin) in path.read_text()
    assert str(238.25 + origin) in path.read_text()


def test_a_fisheye_of_gyroflow_and_nerfstudio_is_opencvs(tmp_path):
    lens = json.loads(written(tmp_path, FISHEYE, "gyroflow").read_text())["fisheye_params"]
    pixels, _ = cv2.fisheye.projectPoints(
        POINTS[:, None], np.zeros(3), np.zeros(3), np.array(lens["camera_matrix"]), np.array(lens["distortion_coeffs"])
    )
    assert np.abs(pixels[:, 0] - FISHEYE.project(POINTS).pixels).max() < 1e-9
    own = json.loads(written(tmp_path, FISHEYE, "nerfstudio").read_text())
    assert own["is_fisheye"] is True
    assert own["camera_model"] == "OPENCV_FISHEYE"
    assert "p1" not in own  # instant-ngp would take it for k3


def test_vins_counts_the_coefficients_of_kannala_and_brandt_from_two(tmp_path):
    block = yaml.safe_load(written(tmp_path, FISHEYE, "vins").read_text().replace("%YAML:1.0\n---", ""))
    assert block["model_type"] == "KANNALA_BRANDT"
    found = [block["projection_parameters"][key] for key in ("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5")]
    assert found == FISHEYE.parameters.tolist()


def test_what_opencv_reads_of_orb_slam_and_openvins(tmp_path):
    file = CameraFile(
        {"left": CameraEntry(FISHEYE), "right": CameraEntry(FISHEYE)},
        {"right_T_left": Transform(PLACE), "left_T_imu": Transform(PLACE)},
    )
    cameras.write(tmp_path / "orb.yaml", file, FORMATS["orbslam3"])
    storage = cv2.FileStorage(str(tmp_path / "orb.yaml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("Camera1.fx").real() == 300.0
    assert np.abs(storage.getNode("Stereo.T_c1_c2").mat() - PLACE.inverse().matrix()).max() < 1e-7  # as floats
    assert np.abs(storage.getNode("IMU.T_b_c1").mat() - PLACE.inverse().matrix()).max() < 1e-7
    assert storage.getNode("Camera.width").isInt()
    cameras.write(tmp_path / "vins.yaml", file, FORMATS["openvins"])
    storage = cv2.FileStorage(str(tmp_path / "vins.yaml"), cv2.FILE_STORAGE_READ)
    chain = storage.getNode("cam0")
    rows = chain.getNode("T_imu_cam")
    assert rows.at(0).at(3).real() == pytest.approx(PLACE.inverse().translation[0], abs=1e-15)
    assert chain.getNode("camera_model").string() == "pinhole"


def test_a_colmap_rig_has_sensor_from_rig(tmp_path):
    file = CameraFile({"left": CameraEntry(BROWN), "right": CameraEntry(FISHEYE)}, {"right_T_left": Transform(PLACE)})
    cameras.write(tmp_path / "cameras.txt", file, FORMATS["colmap"])
    words = (tmp_path / "rigs.txt").read_text().splitlines()[-1].split()
    assert words[:7] == ["1", "2", "CAMERA", "1", "CAMERA", "2", "1"]
    assert np.abs(so3.from_quaternion(np.array(words[7:11], float)) - PLACE.rotation).max() < 1e-15
    back = cameras.read(tmp_path / "cameras.txt", second=tmp_path / "rigs.txt")
    assert np.abs(pose_between(back, "camera_2", "camera_1").matrix() - PLACE.matrix()).max() < 1e-12
    with pytest.raises(InvalidInput, match=r"give cameras\.txt first"):
        cameras.read(tmp_path / "rigs.txt")
    content = written(tmp_path, FISHEYE, "colmap").with_suffix(".bin")
    cameras.write(content, CameraFile({"camera": CameraEntry(FISHEYE)}), FORMATS["colmap"])
    head = struct.unpack("<QIiQQ", content.read_bytes()[:32])
    assert head == (1, 1, 5, 640, 480)


def test_binary_rigs_of_colmap_are_those_of_its_text(tmp_path):
    file = CameraFile({"left": CameraEntry(BROWN), "right": CameraEntry(FISHEYE)}, {"right_T_left": Transform(PLACE)})
    cameras.write(tmp_path / "cameras.bin", file, FORMATS["colmap"])
    back = cameras.read(tmp_path / "cameras.bin", second=tmp_path / "rigs.bin")
    assert np.abs(pose_between(back, "camera_2", "camera_1").matrix() - PLACE.matrix()).max() < 1e-12
    # as COLMAP 4.2 writes rig 7 of camera 1 and camera 2, which stands at 1, 2, 3
    quaternion = so3.to_quaternion(PLACE.rotation)
    theirs = struct.pack("<QIIiIiI?7d", 1, 7, 2, 0, 1, 0, 2, True, *quaternion, 1.0, 2.0, 3.0)
    (tmp_path / "rigs.bin").write_bytes(theirs)
    back = cameras.read(tmp_path / "cameras.bin", second=tmp_path / "rigs.bin")
    assert pose_between(back, "camera_2", "camera_1").translation.tolist() == [1.0, 2.0, 3.0]
    (tmp_path / "rigs.bin").write_bytes(theirs[:-1])
    with pytest.raises(FileError, match=r"is truncated, or not a COLMAP rigs\.bin"):
        cameras.read(tmp_path / "cameras.bin", second=tmp_path / "rigs.bin")
    with pytest.raises(InvalidInput, match=r"give cameras\.txt first"):
        cameras.read(tmp_path / "rigs.bin")


def test_an_omnidirectional_lens_of_opencv_has_xi(tmp_path):
    omni = Camera(MODELS["mei"], (640, 480), [400.0, 401.0, 321.0, 242.0, 1.13, -0.25, 0.01, 1e-3, -5e-4])
    path = written(tmp_path, omni, "opencv")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    K, D, xi = (storage.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients", "xi"))
    points = np.array([[0.3, -0.2, 1.0], [1.5, 0.4, -0.1], [0.0, 0.0, 1.0]])
    expected = omni.project(points).pixels
    assert np.abs(cameras.read_camera(path).project(points).pixels - expected).max() < 1e-9
    if hasattr(cv2, "omnidir"):
        theirs, _ = cv2.omnidir.projectPoints(points[None], np.zeros(3), np.zeros(3), K, float(xi[0, 0]), D)
        assert np.abs(theirs.reshape(-1, 2) - expected).max() < 1e-9
    assert "cv2.omnidir.undistortImage(image, K, D, xi" in path.read_text()


MATLAB = {
    "K": [[500.0, 0.0, 321.0], [0.0, 501.0, 241.0], [0.0, 0.0, 1.0]],
    "RadialDistortion": [-0.2, 0.05, 0.01],
    "TangentialDistortion": [0.001, -0.002],
    "ImageSize": [480, 640],
}


def test_matlab_in_all_its_ways(tmp_path):
    from scipy.io import savemat

    transposed = {**MATLAB, "IntrinsicMatrix": np.array(MATLAB["K"]).T.tolist()}
    del transposed["K"]
    intrinsics = {**MATLAB, "FocalLength": [500.0, 501.0], "PrincipalPoint": [321.0, 241.0]}
    del intrinsics["K"]
    expected = [500.0, 501.0, 320.0, 240.0, -0.2, 0.05, 0.001, -0.002, 0.01]
    for number, each in enumerate((MATLAB, transposed, intrinsics)):
        savemat(tmp_path / f"{number}.mat", {"s": {key: np.array(value) for key, value in each.items()}})
        mat73.write(tmp_path / f"{number}_73.mat", {"s": each, "object": {"words": "a camera", "empty": []}})
        files = [cameras.read(tmp_path / f"{number}{version}.mat") for version in ("", "_73")]
        files.append(read(tmp_path, json.dumps(each), "a.json"))
        for file in files:
            camera = file.cameras["camera"].camera
            assert (camera.image_size, camera.parameters.tolist()) == (SIZE, expected)
    pair = {
        "CameraParameters1": MATLAB,
        "CameraParameters2": transposed,
        "RotationOfCamera2": PLACE.rotation.T.tolist(),
        "TranslationOfCamera2": (1000 * PLACE.translation).tolist(),
    }
    mat73.write(tmp_path / "pair.mat", {"stereo": {**pair, "WorldUnits": "mm"}})
    for file in (read(tmp_path, json.dumps(pair), "pair.json"), cameras.read(tmp_path / "pair.mat")):
        found = file.transforms["right_T_left"].pose
        assert np.abs(found.matrix() - PLACE.matrix()).max() < 1e-12
        assert file.cameras["right"].camera.parameters.tolist() == expected
    savemat(tmp_path / "none.mat", {"x": 1.0})
    with pytest.raises(InvalidInput, match="toStruct"):
        cameras.read(tmp_path / "none.mat")


def test_version_7_3_holds_what_version_5_does(tmp_path):
    content = {"number": 2.5, "row": [1.0, 2, 3], "matrix": np.arange(6.0).reshape(2, 3), "word": "left", "empty": []}
    cells = ("a", 1.0, np.eye(2))
    path = mat73.write(tmp_path / "a.mat", {**content, "inner": {"deeper": content}, "cells": cells})
    with h5py.File(path, "r+") as file:
        file["link"] = h5py.ExternalLink("b.mat", "/x")
        file["loop"] = file["/inner"]
        file["inner/loop"] = file["/inner"]
        file["complex"] = np.array([(1.0, 2.0)], [("real", "f8"), ("imag", "f8")])
        file.create_dataset("huge", (1 << 40,), chunks=(1024,), dtype="f8").attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("object", data=np.zeros((1, 6), np.uint32)).attrs["MATLAB_object_decode"] = np.int32(3)
    found = mat.variables(path.read_bytes())
    plain = {**content, "matrix": [[0.0, 1, 2], [3, 4, 5]]}
    assert {key: found[key] for key in plain} == plain
    assert found["inner"]["deeper"] == plain
    assert found["cells"] == ("a", 1.0, [[1.0, 0], [0, 1]])
    assert [found.get(key) for key in ("link", "complex", "huge", "object")] == [None] * 4


def test_version_7_3_without_h5py_names_the_extra(tmp_path, monkeypatch):
    path = mat73.write(tmp_path / "a.mat", {"s": MATLAB})
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InvalidInput, match=r"a\.mat: is a MAT-file of version 7\.3, .* pip install 'camcal\[matlab\]'"):
        cameras.read(path)


def test_a_fisheye_of_an_old_photonvision_is_refused_by_its_key(tmp_path):
    lens = Camera(MODELS["opencv5"], SIZE, np.array([300.0, 301, 322.5, 238.25, 0.1, 0.02, 0, 0, 0]))
    data = json.loads(written(tmp_path, lens, "photonvision").read_text())
    assert read(tmp_path, json.dumps(data | {"isFisheye": False}), "a.json").cameras
    with pytest.raises(InvalidInput, match="isFisheye: a version of 2023 with fisheyes is not read"):
        read(tmp_path, json.dumps(data | {"isFisheye": True}), "b.json")


def test_what_opencv_does_with_a_pair_and_beyond_90_degrees_is_said(tmp_path):
    wide = Camera(MODELS["kannala_brandt4"], (640, 480), [150.0, 150.0, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0])
    words = "wrong beyond 90 deg"
    assert words in written(tmp_path, wide, "opencv").read_text()
    assert words not in written(tmp_path, FISHEYE, "opencv").read_text()
    for lens, word in ((BROWN, "use cv2.stereoRectify(M1"), (FISHEYE, "use cv2.fisheye.stereoRectify(M1")):
        pair = CameraFile({"left": CameraEntry(lens), "right": CameraEntry(lens)}, {"right_T_left": Transform(PLACE)})
        cameras.write(tmp_path / "pair.yml", pair, FORMATS["opencv"])
        assert word in (tmp_path / "pair.yml").read_text()


def test_photonvision_has_one_word_for_opencvs_lenses(tmp_path):
    """Its enumeration has no other one, and its reader refuses what is not in it."""
    for number, model in enumerate(("opencv5", "opencv8")):
        lens = Camera(
            MODELS[model], SIZE, np.r_[500.0, 501, 322, 238, np.zeros(len(MODELS[model].parameter_names) - 4)]
        )
        path = written(tmp_path, lens, "photonvision", f"{number}")
        assert json.loads(path.read_text())["lensmodel"] == "LENSMODEL_OPENCV"


def test_a_fisheye_of_matlab_says_that_its_function_counts_as_opencv(tmp_path):
    path = tmp_path / "a.json"
    for lens, word in ((FISHEYE, "cameraIntrinsicsFromOpenCV with K(1:2,3) - 1"), (BROWN, "cameraIntrinsics([K(1,1)")):
        cameras.write(path, CameraFile({"camera": CameraEntry(lens)}), FORMATS["matlab"])
        assert word in json.loads(path.read_text())["comment"]


def test_gyroflows_insta360_is_meis_lens_without_a_third_term(tmp_path):
    profile = json.loads(written(tmp_path, FISHEYE, "gyroflow").read_text()) | {"distortion_model": "insta360"}
    k1, k2, p1, p2, xi = -0.3, 0.05, 1e-3, -2e-3, 1.6
    for k3, is_read in ((0.0, True), (-0.01, False)):
        lens = profile["fisheye_params"] | {"distortion_coeffs": [k1, k2, k3, p1, p2, xi]}
        text = json.dumps(profile | {"fisheye_params": lens})
        if not is_read:
            with pytest.raises(InvalidInput, match=r"k3: -0\.01"):
                read(tmp_path, text, "a.json")
            continue
        x, y, z = (POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)).T
        x, y = x / (z + xi), y / (z + xi)
        r2 = x**2 + y**2
        scale = 1 + k1 * r2 + k2 * r2**2
        u = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        v = y * scale + 2 * p2 * x * y + p1 * (r2 + 2 * y**2)
        expected = np.column_stack([u, v]) * [300.0, 301.0] + [322.5, 238.25]
        found = read(tmp_path, text, "a.json").cameras["camera"].camera
        assert np.abs(found.project(POINTS).pixels - expected).max() < 1e-9


def test_the_other_sides_of_gyroflow(tmp_path):
    profile = json.loads(written(tmp_path, FISHEYE, "gyroflow").read_text())
    assert cameras.read(tmp_path / "file.json").cameras["camera"].extra["x_gyroflow"]["fps"] == 0.0
    wrong = [
        ({"digital_lens": "gopro_superview"}, "'gopro_superview' bends the frames once more: calibrate"),
        ({"distortion_model": "sony"}, "'sony' is not among camcal's lens models; read are opencv_fisheye"),
        ({"distortion_model": "sonyx"}, "'sonyx' is not a lens of this program"),
    ]
    for change, said in wrong:
        with pytest.raises(InvalidInput, match=re.escape(said)):
            read(tmp_path, json.dumps(profile | change), "a.json")
    polynomial = profile | {"distortion_model": "poly5"}
    polynomial["fisheye_params"] = profile["fisheye_params"] | {"distortion_coeffs": [0.1, 0.02]}
    camera = read(tmp_path, json.dumps(polynomial), "a.json").cameras["camera"].camera
    assert camera.model.name == "opencv4"
    assert camera.dist.tolist() == [0.1, 0.02, 0.0, 0.0]
    # the scale of x and y is 1 + k1 r² for poly3, and 1 + k3 r + k2 r² + k1 r³ for ptlens, r of the plane Z = 1
    x, y = POINTS[:, 0], POINTS[:, 1]
    r = np.hypot(x, y)
    for word, coefficients, scale in (
        ("poly3", [0.1], 1 + 0.1 * r**2),
        ("poly5", [0.1, 0.02], 1 + 0.1 * r**2 + 0.02 * r**4),
        ("ptlens", [0.02, -0.05, 0.03], 1 + 0.03 * r - 0.05 * r**2 + 0.02 * r**3),
    ):
        lens = profile["fisheye_params"] | {"distortion_coeffs": coefficients}
        own = profile | {"distortion_model": word, "fisheye_params": lens}
        camera = read(tmp_path, json.dumps(own), "a.json").cameras["camera"].camera
        expected = np.column_stack([300.0 * x * scale + 322.5, 301.0 * y * scale + 238.25])
        np.testing.assert_allclose(camera.project(POINTS).pixels, expected, atol=1e-9)
    stretched = read(tmp_path, json.dumps(profile | {"input_horizontal_stretch": 1.33}), "a.json")
    assert [each.code for each in stretched.warnings] == ["stretched_images"]


def test_nerfstudio_with_angles_and_with_cameras_of_frames(tmp_path):
    camera = read(tmp_path, '{"camera_angle_x": 1.0, "w": 640, "h": 480, "frames": []}', "t.json").cameras["camera"]
    assert camera.camera.parameters.tolist() == [320 / np.tan(0.5), 320 / np.tan(0.5), 319.5, 239.5]
    frame = {"fl_x": 500, "fl_y": 500, "cx": 320, "cy": 240, "w": 640, "h": 480, "transform_matrix": []}
    frames = [frame, frame, frame | {"fl_x": 510}]
    assert list(read(tmp_path, json.dumps({"frames": frames}), "t.json").cameras) == ["camera_1", "camera_2"]
    with pytest.raises(InvalidInput, match="has poses and no lens"):
        read(tmp_path, '{"frames": [{"transform_matrix": []}]}', "t.json")


def test_depthai_is_in_centimetres_and_realsense_names_its_lenses(tmp_path):
    file = CameraFile({"left": CameraEntry(BROWN), "right": CameraEntry(BROWN)}, {"right_T_left": Transform(PLACE)})
    cameras.write(tmp_path / "oak.json", file, FORMATS["depthai"])
    second = json.loads((tmp_path / "oak.json").read_text())["cameraData"][1][1]
    assert second["extrinsics"]["toCameraSocket"] == 0
    assert second["extrinsics"]["translation"]["x"] == pytest.approx(100 * PLACE.inverse().translation[0])
    lens = {"width": 640, "height": 480, "ppx": 320, "ppy": 240, "fx": 500, "fy": 500, "coeffs": [0.1, 0, 0, 0, 0]}
    for model in ("brown_conrady", "RS2_DISTORTION_BROWN_CONRADY", "distortion.brown_conrady", "Brown Conrady", 4):
        assert read(tmp_path, json.dumps(lens | {"model": model}), "r.json").cameras["camera"].camera.value("k1") == 0.1
    with pytest.raises(InvalidInput, match=r"coeff: 0\.1 is of a lens that camcal does not have"):
        read(tmp_path, json.dumps(lens | {"model": "inverse_brown_conrady"}), "r.json")


BOOFCV = """# Pinhole camera model with radial and tangential distortion
pinhole:
  fx: 500.0
  fy: 501.0
  cx: 320.5
  cy: 240.5
  width: 640
  height: 480
  skew: 0.0
model: MODEL
"""


def test_boofcv_counts_from_the_corner_of_a_pixel_and_a_fisheye_holds_its_focal_length(tmp_path):
    brown = BOOFCV.replace("MODEL", "pinhole_radial_tangential")
    brown += "radial_tangential:\n  radial:\n  - -0.25\n  - 0.1\n  t1: 0.001\n  t2: 0.002\n"
    assert read(tmp_path, brown, "b.yaml").cameras["camera"].camera.parameters.tolist() == [
        *(500, 501, 320, 240),
        *(-0.25, 0.1, 0.001, 0.002, 0),
    ]
    fisheye = BOOFCV.replace("MODEL", "kannala_brandt") + "symmetric: [2.0, 0.02, -0.01]\nradial: []\ntangent: [0.0]\n"
    found = read(tmp_path, fisheye, "f.yaml").cameras["camera"].camera
    assert (found.model.name, *found.parameters) == ("kannala_brandt4", 1000, 1002, 320, 240, 0.01, -0.005, 0, 0)
    for text, told in (
        (fisheye.replace("tangent: [0.0]", "tangent: [0.1]"), "tangent: is of an asymmetric lens"),
        (fisheye.replace("2.0,", "0.0,"), "symmetric: its first number is to be above 0"),
        (fisheye.replace("-0.01]", "-0.01, 0, 0, 1e-3]"), "symmetric has 5 terms; kannala_brandt is read with 4"),
        (brown.replace("skew: 0.0", "skew: 0.5"), r"skew: 0\.5 is of a lens that camcal does not have"),
    ):
        with pytest.raises(InvalidInput, match=told):
            read(tmp_path, text, "wrong.yaml")


def test_a_pair_of_boofcv_has_the_place_of_the_right_camera_in_the_left(tmp_path):
    file = CameraFile({"a": CameraEntry(BROWN), "b": CameraEntry(BROWN)}, {"b_T_a": Transform(PLACE)})
    cameras.write(tmp_path / "pair.yaml", file, FORMATS["boofcv"])
    assert f"  x: {float(PLACE.inverse().translation[0])!r}" in (tmp_path / "pair.yaml").read_text()
    found = cameras.read(tmp_path / "pair.yaml").transforms["left_T_right"].pose
    np.testing.assert_allclose(found.matrix(), PLACE.inverse().matrix(), atol=1e-12)
    with pytest.raises(InvalidInput, match="BoofCV has no pairs without a transform between them"):
        cameras.write(tmp_path / "apart.yaml", CameraFile(file.cameras), FORMATS["boofcv"])


KITTI = """calib_time: 09-Jan-2012 13:57:47
S_00: 640 480
K_00: 500 0 320 0 500 240 0 0 1
D_00: -0.3 0.2 0.001 0.002 -0.1
R_00: 1 0 0 0 1 0 0 0 1
T_00: 0 0 0
S_01: 640 480
K_01: 500 0 320 0 500 240 0 0 1
D_01: -0.3 0.2 0.001 0.002 -0.1
R_01: 1 0 0 0 1 0 0 0 1
T_01: -0.54 0 0
"""


def test_data_sets_are_read(tmp_path):
    raw = read(tmp_path, KITTI)
    assert raw.transforms["cam1_T_cam0"].pose.translation.tolist() == [-0.54, 0.0, 0.0]
    assert raw.cameras["cam0"].camera.dist.tolist() == [-0.3, 0.2, 0.001, 0.002, -0.1]
    rectified = "P0: 500 0 320 0 0 500 240 0 0 0 1 0\nP1: 500 0 320 -270 0 500 240 0 0 0 1 0\n"
    assert read(tmp_path, rectified, image_size=SIZE).transforms["cam1_T_cam0"].pose.translation[0] == -0.54
    with pytest.raises(InvalidInput, match="give --size"):
        read(tmp_path, rectified)
    pair = read(tmp_path, "cam0=[500 0 320; 0 500 240; 0 0 1]\ncam1=[500 0 330; 0 500 240; 0 0 1]\nbaseline=120\n"
                "doffs=10\nwidth=640\nheight=480\n")  # fmt: skip
    assert pair.transforms["right_T_left"].pose.translation.tolist() == [-0.12, 0.0, 0.0]
    assert pair.cameras["right"].camera.value("cx") == 330.0
    with pytest.raises(InvalidInput, match=r"--to kitti: KITTI calib\.txt is read, not written"):
        cameras.format_for(tmp_path / "a.txt", "kitti", FORMATS["camcal"])


def test_fisheyes_of_toml_are_marked_and_places_are_of_the_world(tmp_path):
    text = """[cam_10]
name = "b"
size = [640, 480]
matrix = [[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.01, 0.0, 0.0, 0.0]
fisheye = true
rotation = [0.0, 0.0, 0.0]
translation = [1.0, 0.0, 0.0]
[cam_2]
name = "a"
size = [640, 480]
matrix = [[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.01, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]
[metadata]
adjusted = false
"""
    file = read(tmp_path, text, "calibration.toml")
    assert [(name, entry.camera.model.name) for name, entry in file.cameras.items()] == [
        ("a", "opencv5"),
        ("b", "kannala_brandt4"),
    ]
    assert pose_between(file, "b", "a").translation.tolist() == [1.0, 0.0, 0.0]
    new = re.sub(r"\[cam_(\d+)\]", r"[cameras.\1]", text).replace("[metadata]\nadjusted = false\n", "")
    assert list(read(tmp_path, new, "camera_array.toml").cameras) == ["a", "b"]


def test_a_driver_that_calls_a_fisheye_plumb_bob_is_doubted(tmp_path):
    text = """image_width: 848
image_height: 800
camera_matrix: {rows: 3, cols: 3, data: [284.9, 0, 420.5, 0, 285.1, 400.7, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.0053, 0.0123, -0.0195, 0.0038, 0]}
"""
    file = read(tmp_path, text, "t265.yaml")
    assert "doubtful_distortion_model" in [warning.code for warning in file.warnings]
    fisheye = read(tmp_path, text, "t265.yaml", model="fisheye").cameras["camera"].camera
    assert fisheye.model.name == "kannala_brandt4"
    assert fisheye.dist.tolist() == [-0.0053, 0.0123, -0.0195, 0.0038]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"value0": {"intrinsics": [{"camera_type": "kb4"}], "resolution": [[640, 480]]}}', "has no intrinsics"),
        ('{"camera_angle_x": 0.0, "w": 640, "h": 480}', "camera_angle_x: is not between 0 and pi"),
        ('{"fisheye_params": 3}', "fisheye_params: is not a mapping"),
        ('{"cameraData": {}}', "is not a list of sockets"),
    ],
)
def test_what_is_missing_in_json_is_named(tmp_path, text, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        read(tmp_path, text, "a.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [7, 7.3])
def test_damaged_and_compressed_files_of_matlab(tmp_path, version):
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    if version == 7:
        savemat(path, {"s": {key: np.array(value) for key, value in MATLAB.items()}}, do_compression=True)
        assert cameras.read(path).cameras["camera"].camera.value("cx") == 320.0
        cameras.write(path, CameraFile({"camera": CameraEntry(BROWN)}), FORMATS["matlab"])
    else:
        mat73.write(path, {"s": MATLAB, "cells": ("a", 1.0)})
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(content)
        for place in rng.integers(120, len(content), 3):
            damaged[place] = rng.integers(256)
        path.write_bytes(bytes(damaged[: rng.integers(130, len(content) + 1)]))
        try:
            found = cameras.read(path, given=Given(SIZE))
        except CamcalError:
            continue
        assert all(np.isfinite(entry.camera.parameters).all() for entry in found.cameras.values())
