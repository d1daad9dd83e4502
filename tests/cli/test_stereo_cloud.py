"""`camcal stereo cloud`: a disparity map, numbers or a camera file in, a point cloud out."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import disparity as disparity_map
from camcal.formats import disparity_sidecar, native, pointclouds
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.stereo.disparity import Confidence, StereoGeometry

CONFIG = Path(__file__).parents[2] / "sample_configs" / "stereo_cloud.yaml"
FEW = ["--outliers", "none"]  # six pixels are no company to one another
NUMBERS = ["--fx", 100, "--cx", 1, "--cy", 0, "--baseline", 0.5, *FEW]
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
    assert "disparity = count / 1, 4 points of 6 pixels (4 with a match, 0 outliers)" in out
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
    arguments = [disparity, *([image] if with_image else []), tmp_path / address, *FEW]
    assert run("stereo", "cloud", *arguments, "-o", tmp_path / "cloud.xyz")[0] == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], DEPTHS, rtol=1e-6)


def test_a_transform_written_the_other_way_round_is_the_same_pair(run, tmp_path, disparity):
    file = native.read(rig(tmp_path / "rig.yaml"))
    inverse = Transform(file.transforms["right_T_left"].pose.inverse())
    native.write(tmp_path / "other.yaml", CameraFile(file.cameras, {"left_T_right": inverse}))
    assert run("stereo", "cloud", disparity, tmp_path / "other.yaml", *FEW, "-o", tmp_path / "cloud.xyz")[0] == 0
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[:, 2], DEPTHS, rtol=1e-6)


def test_the_offset_of_the_principal_points_comes_from_the_pair(run, tmp_path, disparity):
    code, out, _ = run("stereo", "cloud", disparity, rig(tmp_path / "rig.yaml", right_cx=11.0), *FEW, "-o",
                       tmp_path / "cloud.xyz", "--json")  # fmt: skip
    assert code == 0
    assert json.loads(out)["geometry"]["doffs"] == 10
    np.testing.assert_allclose(xyz(tmp_path / "cloud.xyz")[0, 2], 50 / 20, rtol=1e-6)


def test_a_number_on_the_command_line_wins_over_the_camera_file(run, tmp_path, disparity):
    arguments = [disparity, rig(tmp_path / "rig.yaml"), "--baseline", 1.0, *FEW]
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
        ({"size": (30, 20)}, "30 × 20 pixels, the left image 3 × 2"),
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
    keys = ["schema", "output", "points", "pixels", "matched", "outliers", "scale", "geometry", "depth_m", "appearance"]
    assert list(document) == [*keys, "frame", "unit", "fields", "calibration_known", "reused", "warnings"]
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
    assert "empty cloud: " in err
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


def test_a_map_that_is_not_there_is_said_before_what_is_wrong_with_the_output(run, tmp_path):
    code, _, err = run("stereo", "cloud", tmp_path / "nowhere", "-o", tmp_path / "clouds")
    assert code == 3
    assert f"{tmp_path / 'nowhere'}: no such file" in err


def test_two_images_are_refused(run, tmp_path, disparity, image):
    code, _, err = run("stereo", "cloud", disparity, image, image, *NUMBERS, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "one image and one camera file" in err


def test_the_sample_settings_give_the_geometry(run, tmp_path, disparity):
    code, out, _ = run("stereo", "cloud", disparity, *FEW, "--config", CONFIG, "-o", tmp_path / "cloud.ply", "--json")
    assert code == 0
    assert json.loads(out)["geometry"]["baseline"] == 0.537
    assert json.loads(out)["points"] == 3  # the match of 5 px lies beyond 60 m


PAIR = StereoGeometry(fx=100.0, fy=100.0, cx=10.0, cy=8.0, baseline=0.5)
RAMP = np.tile(np.linspace(10, 12, 20, dtype=np.float32), (16, 1))


@pytest.fixture
def measured(tmp_path):
    """A map as `stereo disparity` leaves it: with a sidecar, a left image, sigma and confidence; one pixel is wrong."""
    values = RAMP.copy()
    values[5, 5], values[0, 0] = 40, np.nan
    map_path = tmp_path / "map" / "disparity.pfm"
    map_path.parent.mkdir()
    disparity_map.write(map_path, values)
    cv2.imwrite(str(tmp_path / "left.png"), np.full((16, 20, 3), (10, 20, 30), np.uint8))
    disparity_map.write(map_path.with_name("sigma.tiff"), np.full_like(values, 0.3))
    confidence = np.full(values.shape, Confidence.AGREED, np.uint8)
    confidence[:, :10] = Confidence.SINGLE
    cv2.imwrite(str(map_path.with_name("confidence.png")), confidence)
    sidecar = Sidecar(
        invalid="inf",
        geometry=PAIR,
        image=tmp_path / "left.png",
        sigma=map_path.with_name("sigma.tiff"),
        confidence=map_path.with_name("confidence.png"),
        searched=(0, 64),
        relative_sigma={"fx": 0.03, "baseline": 0.04},
    )
    disparity_sidecar.write(map_path, sidecar)
    return map_path


def cloud_of(run, path, *options):
    """Return the vertices of the cloud that a command line makes, and the report."""
    code, out, err = run("stereo", "cloud", path, *options, "--json")
    assert code == 0, err
    report = json.loads(out)
    return pointclouds.read(Path(report["output"])), report


def test_a_map_with_its_sidecar_needs_nothing_else(run, tmp_path, measured):
    cloud, report = cloud_of(run, measured, "-o", tmp_path / "cloud.ply")
    numbers = {"fx": 100, "fy": 100, "cx": 10, "cy": 8, "baseline": 0.5, "doffs": 0}
    assert report["geometry"] == numbers | {"projection": "pinhole", "axis": "x"}
    assert (report["points"], report["matched"], report["outliers"]) == (318, 319, 1)
    assert cloud.vertices[["red", "green", "blue"]][0].tolist() == (30, 20, 10)
    assert cloud.notes == {"disparity": "disparity.pfm", "fx": "100 px", "baseline": "0.5 m"}


def test_an_image_the_sidecar_names_and_that_is_gone_costs_the_colour_only(run, tmp_path, measured):
    (tmp_path / "left.png").unlink()
    code, _, err = run("stereo", "cloud", measured, "-o", tmp_path / "cloud.ply")
    assert code == 0
    assert "disparity.pfm.json: left.png not found; not used" in err


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (["--sigma"], "sigma.tiff"),
        (["--max-sigma", 5], "sigma.tiff"),
        (["--min-confidence", "apart"], "confidence.png"),
    ],
)
def test_what_the_sidecar_names_and_is_gone_is_missed_only_if_asked_for(run, tmp_path, measured, options, name):
    measured.with_name(name).unlink()
    code, _, err = run("stereo", "cloud", measured, "-o", tmp_path / "cloud.ply")
    assert (code, err) == (0, "")
    code, _, err = run("stereo", "cloud", measured, *options, "-o", tmp_path / "asked.ply")
    assert code == 3
    assert f"disparity.pfm.json: {name} not found, and {options[0]} needs it" in err
    assert not (tmp_path / "asked.ply").exists()


def test_frame_and_unit_are_in_the_file_and_in_its_coordinates(run, tmp_path, measured):
    plain, _ = cloud_of(run, measured, "-o", tmp_path / "plain.ply")
    turned, report = cloud_of(run, measured, "--frame", "ros", "--unit", "mm", "-o", tmp_path / "turned.ply")
    assert (turned.unit, turned.frame) == ("mm", "left camera: x forward, y left, z up")
    assert (report["unit"], report["frame"]) == (turned.unit, turned.frame)
    np.testing.assert_allclose(turned.vertices["x"], plain.vertices["z"] * 1000, rtol=1e-6)  # float32
    np.testing.assert_allclose(turned.vertices["y"], plain.vertices["x"] * -1000, rtol=1e-6)


def test_a_cloud_of_images_rectified_here_is_in_the_frame_of_the_real_left_camera(run, tmp_path, measured):
    plain, _ = cloud_of(run, measured, "-o", tmp_path / "plain.ply")
    turn = so3.about_y(np.pi / 2)
    disparity_sidecar.write(measured, replace(disparity_sidecar.read(measured), camera_R_rectified=turn))
    before, _ = cloud_of(run, measured, "-o", tmp_path / "before.ply")
    optical, _ = cloud_of(run, measured, "--frame", "optical", "-o", tmp_path / "optical.ply")
    assert before.frame.startswith("left camera before rectification")
    np.testing.assert_allclose(before.vertices["x"], plain.vertices["z"], rtol=1e-6)
    np.testing.assert_array_equal(optical.vertices, plain.vertices)


def test_a_pose_takes_the_cloud_to_the_world(run, tmp_path, measured):
    (tmp_path / "pose.txt").write_text("1 0 0 7\n0 0 1 8\n0 -1 0 9\n0 0 0 1\n")
    plain, _ = cloud_of(run, measured, "-o", tmp_path / "plain.ply")
    pose = ["--frame", "enu", "--pose", tmp_path / "pose.txt"]
    cloud, report = cloud_of(run, measured, *pose, "-o", tmp_path / "world.ply")
    assert report["frame"] == "world: x east, y north, z up"
    np.testing.assert_allclose(cloud.vertices["y"], plain.vertices["z"] + 8, rtol=1e-6)  # float32
    crop = ["--crop", "-99,99,12.5,12.8,-99,99"]
    cut, _ = cloud_of(run, measured, *pose, *crop, "-o", tmp_path / "cut.ply")
    y = cloud.vertices["y"]
    np.testing.assert_array_equal(cut.vertices, cloud.vertices[(y >= 12.5) & (y <= 12.8)])


def test_coordinates_too_large_for_their_digits_are_warned_of(run, tmp_path, measured):
    (tmp_path / "pose.txt").write_text("0 500000 5400000 300 0 0 0 1\n")
    code, _, err = run("stereo", "cloud", measured, "--pose", tmp_path / "pose.txt", "-o", tmp_path / "cloud.ply")
    assert code == 0
    assert "0.5 m: subtract an offset" in err


def test_sigma_is_that_of_disparity_and_calibration(run, tmp_path, measured):
    cloud, report = cloud_of(run, measured, "--sigma", "-o", tmp_path / "cloud.ply")
    assert report["fields"][-1] == "sigma"
    z = cloud.vertices["z"].astype(float)
    np.testing.assert_allclose(cloud.vertices["sigma"] / z, np.hypot(0.3 * z / 50, 0.05), rtol=1e-5)  # float32
    given, _ = cloud_of(run, measured, "--sigma", "--sigma-disparity", 0.6, "-o", tmp_path / "given.ply")
    np.testing.assert_allclose(given.vertices["sigma"] / z, np.hypot(0.6 * z / 50, 0.05), rtol=1e-5)


@pytest.mark.parametrize(("name", "points"), [("single", 318), ("2", 318), ("apart", 160), ("AGREED", 160)])
def test_confidence_is_asked_for_by_name_or_number(run, tmp_path, measured, name, points):
    _, report = cloud_of(run, measured, "--min-confidence", name, "-o", tmp_path / "cloud.ply")
    assert report["points"] == points


def test_depths_known_badly_are_left_out(run, tmp_path, measured):
    limit = 100 * np.hypot(0.3 / 11, 0.05)
    cloud, _ = cloud_of(run, measured, "--max-sigma", limit, "-o", tmp_path / "cloud.ply")
    assert cloud.vertices["z"].max() <= 50 / 11 * (1 + 1e-6)


def test_a_mask_and_a_stride_choose_pixels(run, tmp_path, measured):
    mask = np.zeros((16, 20, 3), np.uint8)
    mask[:, 10:, 1] = 1
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    _, report = cloud_of(run, measured, "--mask", tmp_path / "mask.png", "--stride", 2, "-o", tmp_path / "cloud.ply")
    assert report["points"] == 40


def test_normals_voxels_and_a_number_of_points(run, tmp_path, measured):
    cloud, _ = cloud_of(run, measured, "--normals", "-o", tmp_path / "normals.ply")
    lengths = np.sqrt(sum(cloud.vertices[name].astype(float) ** 2 for name in ("nx", "ny", "nz")))
    np.testing.assert_allclose(lengths, 1, atol=1e-5)
    _, voxels = cloud_of(run, measured, "--voxel", 0.1, "--unit", "mm", "-o", tmp_path / "voxels.ply")
    assert 20 < voxels["points"] < 200
    _, some = cloud_of(run, measured, "--max-points", 17, "-o", tmp_path / "some.ply")
    assert some["points"] == 17


def test_an_organised_cloud_is_for_formats_that_have_rows(run, tmp_path, measured):
    code, _, err = run("stereo", "cloud", measured, "--organised", "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert ".pcd" in err


def test_points_that_stand_alone_may_stay(run, tmp_path, measured):
    _, report = cloud_of(run, measured, "--outliers", "none", "-o", tmp_path / "cloud.ply")
    assert (report["points"], report["outliers"]) == (319, 0)
    _, near = cloud_of(run, measured, "--outliers", "radius:0.2", "-o", tmp_path / "near.ply")
    assert near["outliers"] >= 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--crop", "1,2"], "--crop needs six numbers"),
        (["--outliers", "radius:far"], "a number of metres"),
        (["--outliers", "organised:2"], "only radius takes a number"),
        (["--outliers", "all"], "use one of organised"),
        (["--min-confidence", "good"], "4 near, 5 agreed"),
        (["--min-confidence", "9"], "unknown"),
        (["--frame", "enu"], "--pose"),
        (["--frame", "up"], "use one of optical"),
        (["--unit", "cm"], "use one of m, mm"),
        (["--max-points", "0"], "at least one point"),
        (["--voxel", "-1"], "side of a voxel"),
        (["--stride", "0"], "stride of 0"),
        (["--mask", "missing.png"], "missing.png"),
        (["--pose", "missing.txt"], "missing.txt"),
        (["--fx", "-1"], "fx must be positive"),
    ],
)
def test_what_makes_no_sense_ends_with_one_line_and_no_file(run, tmp_path, measured, options, message):
    code, out, err = run("stereo", "cloud", measured, *options, "-o", tmp_path / "cloud.ply")
    assert code in (2, 3)
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "cloud.ply").exists()


def test_what_is_asked_for_and_not_known_is_said(run, tmp_path, disparity):
    for option, message in ((["--sigma"], "--sigma-disparity"), (["--min-confidence", "near"], "no sidecar")):
        code, _, err = run("stereo", "cloud", disparity, *NUMBERS, *option, "-o", tmp_path / "cloud.ply")
        assert code == 2
        assert message in err


def test_without_any_geometry_the_ways_to_give_it_are_named(run, tmp_path, disparity):
    code, _, err = run("stereo", "cloud", disparity, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "camera file of the rectified pair, or --fx, --cx, --cy and --baseline" in err


def test_a_search_below_zero_lets_matches_be_there(run, tmp_path, measured):
    values = np.full((16, 20), -2.0, np.float32)
    disparity_map.write(measured, values)
    known = disparity_sidecar.read(measured)
    disparity_sidecar.write(measured, replace(known, searched=(-8, 8), geometry=replace(PAIR, doffs=12.0)))
    cloud, _ = cloud_of(run, measured, "-o", tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.vertices["z"], 5.0, rtol=1e-6)  # 50 / (12 - 2)
    disparity_sidecar.write(measured, replace(known, searched=(0, 8), geometry=replace(PAIR, doffs=12.0)))
    assert "no pixel has a match" in run("stereo", "cloud", measured, "-o", tmp_path / "none.ply")[2]


def test_the_same_input_gives_the_same_bytes_on_any_number_of_cores(run, tmp_path, measured):
    for jobs in (1, 2):
        run("stereo", "cloud", measured, "--normals", "--sigma", "--jobs", jobs, "-o", tmp_path / f"{jobs}.ply")
    assert (tmp_path / "1.ply").read_bytes() == (tmp_path / "2.ply").read_bytes()


def test_a_folder_of_maps_gives_a_folder_of_clouds_and_a_bad_map_costs_only_itself(run, tmp_path):
    for name in ("frame10", "frame2", "broken"):
        (tmp_path / "maps").mkdir(exist_ok=True)
        disparity_map.write(tmp_path / "maps" / f"{name}.pfm", RAMP)
        disparity_sidecar.write(tmp_path / "maps" / f"{name}.pfm", Sidecar(invalid="inf", geometry=PAIR))
    (tmp_path / "maps" / "broken.pfm").write_bytes(b"Pf")
    cv2.imwrite(str(tmp_path / "maps" / "left.png"), np.zeros((16, 20), np.uint8))  # no map: it has no sidecar
    code, out, err = run("stereo", "cloud", tmp_path / "maps", "-o", tmp_path / "clouds", "--json")
    document = json.loads(out)
    assert code == 6
    assert "1 of 3 maps failed" in err
    assert list(document) == ["schema", "clouds", "reused", "failed", "warnings", "error", "exit"]
    assert [Path(report["output"]).name for report in document["clouds"]] == ["frame2.ply", "frame10.ply"]
    assert [Path(failure["source"]).name for failure in document["failed"]] == ["broken.pfm"]
    assert sorted(path.name for path in (tmp_path / "clouds").glob("[!.]*")) == ["frame10.ply", "frame2.ply"]


def test_a_folder_of_images_goes_with_a_folder_of_maps_by_name(run, tmp_path, image):
    for folder in ("maps", "images"):
        (tmp_path / folder).mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / "maps" / f"{name}.png"), DISPARITY)
    image.rename(tmp_path / "images" / "a.png")
    code, out, err = run("stereo", "cloud", tmp_path / "maps", tmp_path / "images", *NUMBERS, "-o", tmp_path / "out")
    assert code == 6
    assert "images: holds 0 images named b, need one" in err
    assert "  a.ply       4       6" in out
    assert "red" in pointclouds.read(tmp_path / "out" / "a.ply").vertices.dtype.names


def test_a_folder_without_maps_is_a_file_error(run, tmp_path):
    (tmp_path / "empty").mkdir()
    code, _, err = run("stereo", "cloud", tmp_path / "empty", *NUMBERS, "-o", tmp_path / "clouds")
    assert code == 3
    assert "contains no disparity map (" in err


def test_an_organised_cloud_is_the_image_with_its_holes(run, tmp_path, measured):
    cloud, report = cloud_of(run, measured, "--organised", "--normals", "-o", tmp_path / "cloud.pcd")
    assert cloud.grid == (20, 16)
    z = cloud.vertices["z"].reshape(16, 20)
    assert np.argwhere(np.isnan(z)).tolist() == [[0, 0], [5, 5]]
    np.testing.assert_allclose(z[1], 50 / RAMP[1], rtol=1e-6)  # float32
    assert report["points"] == 318
