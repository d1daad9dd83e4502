"""Maps and clouds of pairs that are not rectified, from a rig file, against rendered truth."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from room_scene import BELOW, BESIDE, SIZE, RoomRig, errors

from camcal.cameras.model import Camera
from camcal.formats import disparity_sidecar, native, pointclouds
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.stereo.rectify.record import PROJECTIONS


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A rig of ordinary lenses beside each other."""
    return RoomRig(tmp_path_factory.mktemp("beside"), "pinhole", BESIDE)


def test_a_cloud_of_an_unrectified_pair_is_in_the_real_left_camera(run, tmp_path, beside):
    path = tmp_path / "cloud.ply"
    code, out, err = run("stereo", "cloud", beside.left, beside.right, beside.file, "--sigma", "-o", path, "--json")
    assert code == 0, err
    assert json.loads(out)["frame"].startswith("left camera before rectification")
    cloud = pointclouds.read(path)
    error = errors(cloud, beside.camera, beside.points)
    assert len(error) > 0.6 * SIZE[0] * SIZE[1]
    assert abs(np.median(error)) < 0.01
    assert np.quantile(np.abs(error), 0.68) < 0.015  # 0.2 px of disparities of 15 px
    assert np.median(cloud.vertices["sigma"] / cloud.vertices["z"]) > 0.005


def test_a_map_of_an_unrectified_pair_knows_how_it_was_rectified(run, tmp_path, beside):
    path = tmp_path / "map.tiff"
    code, _, err = run("stereo", "disparity", beside.left, beside.right, beside.file, "-o", path)
    assert code == 0, err
    sidecar = disparity_sidecar.read(path)
    assert sidecar.image == tmp_path / "map.tiff.left.png"
    assert sidecar.geometry.baseline == pytest.approx(np.linalg.norm(BESIDE.translation))
    assert np.degrees(np.arccos((np.trace(sidecar.camera_R_rectified) - 1) / 2)) > 0.5
    assert run("stereo", "cloud", path, "--sigma", "-o", tmp_path / "map.ply")[0] == 0
    again = tmp_path / "pair.ply"
    assert run("stereo", "cloud", beside.left, beside.right, beside.file, "--sigma", "-o", again)[0] == 0
    of_map, of_pair = (pointclouds.read(each).vertices for each in (tmp_path / "map.ply", again))
    for name in ("x", "y", "z"):  # the same but for the order of multiplications
        np.testing.assert_allclose(of_map[name], of_pair[name], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(of_map["sigma"], of_pair["sigma"], rtol=1e-3)  # 12 digits of the sidecar's table


def test_the_calibration_makes_depths_less_certain(run, tmp_path, beside):
    file = native.read(beside.file)
    exact = CameraFile(
        {
            name: CameraEntry(Camera(each.camera.model, SIZE, each.camera.parameters))
            for name, each in file.cameras.items()
        },
        {name: Transform(each.pose) for name, each in file.transforms.items()},
    )
    native.write(tmp_path / "exact.yaml", exact)
    clouds = []
    for rig in (beside.file, tmp_path / "exact.yaml"):
        path = tmp_path / f"{rig.stem}.ply"
        assert run("stereo", "cloud", beside.left, beside.right, rig, "--sigma", "-o", path)[0] == 0
        clouds.append(pointclouds.read(path).vertices)
    assert np.all(clouds[0]["sigma"] > clouds[1]["sigma"])


def test_swapped_cameras_are_put_in_order_and_named(run, tmp_path, beside):
    path = tmp_path / "swapped.yaml"
    file = native.read(beside.file)
    # the first camera of the file, whose image is LEFT, stands to the right of the second one
    given = CameraFile(
        {"right": file.cameras["right"], "left": file.cameras["left"]},
        {"left_T_right": Transform(file.transforms["right_T_left"].pose.inverse())},
    )
    native.write(path, given)
    cloud = tmp_path / "cloud.ply"
    code, _, err = run("stereo", "cloud", beside.right, beside.left, path, "-o", cloud)
    assert code == 0, err
    assert "left is left of right: the pair is written in this order" in err
    error = errors(pointclouds.read(cloud), beside.camera, beside.points)
    assert np.quantile(np.abs(error), 0.68) < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("right_T_left", [BESIDE, BELOW], ids=["beside", "below"])
@pytest.mark.parametrize("kind", PROJECTIONS)
def test_every_view_gives_the_distances_of_the_room(run, tmp_path, kind, right_T_left):
    rig = RoomRig(tmp_path, kind, right_T_left)
    path, cloud = tmp_path / "map.tiff", tmp_path / "cloud.ply"
    code, _, err = run("stereo", "disparity", rig.left, rig.right, rig.file, "-o", path)
    assert code == 0, err
    geometry = disparity_sidecar.read(path).geometry
    assert (geometry.projection, geometry.axis) == (kind, "x" if right_T_left is BESIDE else "y")
    assert run("stereo", "cloud", path, "-o", cloud)[0] == 0
    error = errors(pointclouds.read(cloud), rig.camera, rig.points)
    assert len(error) > 0.4 * SIZE[0] * SIZE[1]
    assert abs(np.median(error)) < 0.02
    assert np.quantile(np.abs(error), 0.68) < {"pinhole": 0.015, "cylindrical": 0.025, "latlon": 0.04}[kind]


def test_images_that_were_never_rectified_lead_to_the_command_that_makes_a_rig_file(run, tmp_path, beside):
    turned = cv2.warpAffine(cv2.imread(str(beside.right), 0), cv2.getRotationMatrix2D((80, 60), 8, 1), SIZE)
    cv2.imwrite(str(tmp_path / "turned.png"), turned)
    code, _, err = run("stereo", "disparity", beside.left, tmp_path / "turned.png", "-o", tmp_path / "map.tiff")
    assert code == 7
    assert "camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml" in err


def test_a_rig_of_three_asks_which_two(run, tmp_path, beside):
    file = native.read(beside.file)
    cameras = {**file.cameras, "third": file.cameras["left"]}
    pose = file.transforms["right_T_left"].pose
    native.write(
        tmp_path / "rig.yaml", CameraFile(cameras, {"right_T_left": Transform(pose), "third_T_left": Transform(pose)})
    )
    pair = beside.left, beside.right
    code, _, err = run("stereo", "disparity", *pair, tmp_path / "rig.yaml", "-o", tmp_path / "map.tiff")
    assert code == 2
    assert f"holds 3 cameras (left, right, third); name two: {tmp_path / 'rig.yaml'}#left,right" in err
    chosen = f"{tmp_path / 'rig.yaml'}#left,right"
    assert run("stereo", "disparity", *pair, chosen, "-o", tmp_path / "map.tiff", "--quality", "fast")[0] == 0
    assert Path(tmp_path / "map.tiff").exists()
    check = ("stereo", "check", *pair, tmp_path / "rig.yaml")
    assert run(*check)[0] == 2
    by_option, by_address = run(*check, "--camera", "left,right"), run(*check[:-1], chosen)
    assert by_option == by_address
    assert by_option[0] == 0


@pytest.mark.parametrize("images", [("left",), ()])
def test_a_map_with_the_file_of_an_unrectified_rig_is_no_pair(run, tmp_path, beside, images):
    path = tmp_path / "map.npz"
    np.savez(path, np.full((SIZE[1] + 4, SIZE[0] + 4), 8.0, np.float32))
    paths = [getattr(beside, name) for name in images]
    code, _, err = run("stereo", "cloud", path, *paths, beside.file, "-o", tmp_path / "cloud.ply")
    assert code == 2
    assert "rig.yaml: the camera is distorted (opencv5)" in err
    assert "a disparity map needs the camera file of the rectified pair, or none if it has a sidecar" in err


def test_arrays_in_place_of_a_camera_file_are_named(run, tmp_path, beside):
    np.savez(tmp_path / "maps.npz", left_map1=np.zeros((3, 3)))
    for command in ("disparity", "check", "rectify"):
        words = (tmp_path / "maps.npz", beside.left, beside.right)
        ordered = words if command == "rectify" else (*words[1:], words[0])
        code, _, err = run("stereo", command, *ordered, "-o", tmp_path / "out.png")
        assert code == 2
        assert "maps.npz: holds arrays, such as maps, where a camera file is needed" in err


def test_images_of_another_size_than_the_camera_are_named(run, tmp_path, beside):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((60, 80), np.uint8))
    code, _, err = run(
        "stereo", "disparity", tmp_path / "small.png", beside.right, beside.file, "-o", tmp_path / "m.tiff"
    )
    assert code == 2
    assert "small.png: is 80x60, the maps are for 160x120" in err


def test_exchanged_images_of_a_rig_are_a_reason_for_few_matches(run, tmp_path, beside):
    pair = beside.right, beside.left, beside.file
    code, _, err = run("stereo", "disparity", *pair, "-o", tmp_path / "m.tiff", "--quality", "fast")
    assert code == 7
    assert "that LEFT and RIGHT are not exchanged, that the rig file is theirs" in err
