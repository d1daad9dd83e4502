"""`camcal stereo run`: a rig, pairs, folders and videos to clouds and pages; what fails costs only itself."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from room_scene import BELOW, BESIDE, SIZE, RoomRig, errors

from camcal.formats import disparity_sidecar, native, pointclouds
from camcal.formats.camera_file import CalibrationVerdict, CameraFile

QUICK = ("--quality", "fast", "--jobs", "1")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A rig in a room; the names of its pictures are left.png and right.png."""
    return RoomRig(tmp_path_factory.mktemp("rig"), "pinhole", BESIDE)


@pytest.fixture
def folders(tmp_path, rig):
    """Two folders with three pairs of one scene."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for index in range(3):
            shutil.copy(getattr(rig, side), tmp_path / side / f"{index:02d}.png")
    return tmp_path / "left", tmp_path / "right"


def test_a_pair_becomes_rectified_images_a_map_a_cloud_and_a_page(run, tmp_path, rig):
    folder = tmp_path / "result"
    code, out, err = run("stereo", "run", rig.file, rig.left, rig.right, "-o", folder, *QUICK, "--sigma", "--json")
    assert code == 0, err
    report = json.loads(out)
    assert list(report) == [
        "schema", "rig", "rectified", "calibrated", "trustworthy", "projection", "axis", "image_size", "baseline_m",
        "left", "right", "pairs", "reused", "failures", "failed", "warnings",
    ]  # fmt: skip
    assert report["schema"] == "camcal/stereo-run/1"
    (pair,) = report["pairs"]
    assert list(pair) == [
        "name", "left", "right", "rectified", "disparity", "cloud", "page", "check", "matched", "median_px", "sigma_px",
        "points", "depth_m", "frame", "warnings",
    ]  # fmt: skip
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()) == [
        ".camcal-output",
        "clouds/.camcal-output",
        "clouds/left.ply",
        "disparity/.camcal-output",
        "disparity/left.tiff",
        "disparity/left.tiff.confidence.png",
        "disparity/left.tiff.json",
        "disparity/left.tiff.sigma.tiff",
        "rectified.yaml",
        "rectified/left/.camcal-output",
        "rectified/left/left.png",
        "rectified/right/.camcal-output",
        "rectified/right/left.png",
        "views/.camcal-output",
        "views/left.html",
    ]
    assert abs(pair["check"]["rows_px"]["rms"]) < 0.3
    error = errors(pointclouds.read(folder / "clouds" / "left.ply"), rig.camera, rig.points)
    assert np.quantile(np.abs(error), 0.68) < 0.02  # 0.3 px of disparities of 15 px
    assert "<html" in (folder / "views" / "left.html").read_text(encoding="utf-8")


def test_what_a_run_leaves_serves_the_commands_of_its_parts(run, tmp_path, rig):
    folder = tmp_path / "result"
    assert run("stereo", "run", rig.file, rig.left, rig.right, "-o", folder, *QUICK)[0] == 0
    image = disparity_sidecar.read(folder / "disparity" / "left.tiff").image
    assert image.samefile(folder / "rectified" / "left" / "left.png")
    cloud, page = tmp_path / "again.ply", tmp_path / "again.png"
    assert run("stereo", "cloud", folder / "disparity" / "left.tiff", "-o", cloud)[0] == 0
    assert (
        cloud.read_bytes().partition(b"end_header")[2]
        == ((folder / "clouds" / "left.ply").read_bytes().partition(b"end_header")[2])
    )
    assert run("view", folder / "clouds" / "left.ply", "-o", page)[0] == 0
    rectified = (folder / "rectified" / side / "left.png" for side in ("left", "right"))
    maps = run("stereo", "disparity", *rectified, folder / "rectified.yaml", "-o", tmp_path / "m.tiff", *QUICK)
    assert maps[0] == 0, maps[2]
    assert set(native.read(folder / "rectified.yaml").cameras) == {"left", "right"}


def test_the_rectified_camera_file_knows_the_uncertainty_of_the_calibration(run, tmp_path, rig):
    folder, path = tmp_path / "result", tmp_path / "map.tiff"
    assert run("stereo", "run", rig.file, rig.left, rig.right, "-o", folder, *QUICK)[0] == 0
    rectified = (folder / "rectified" / side / "left.png" for side in ("left", "right"))
    assert run("stereo", "disparity", *rectified, folder / "rectified.yaml", "-o", path, *QUICK)[0] == 0
    of_rig, of_file = (disparity_sidecar.read(each).calibration for each in (folder / "disparity/left.tiff", path))
    # at infinity, where the angles between the cameras count; the rectified lens has no distortion that could be off
    np.testing.assert_allclose(np.sqrt(of_file.variance[0]), np.sqrt(of_rig.variance[0]), rtol=0.1)
    exact = native.read(folder / "rectified.yaml")
    native.write(tmp_path / "exact.yaml", CameraFile(exact.cameras, exact.transforms))
    assert run("stereo", "cloud", path, tmp_path / "exact.yaml", "-o", tmp_path / "c.ply", "--sigma")[0] == 0


def test_an_untrustworthy_rig_ends_with_exit_7_where_trust_is_required(run, tmp_path, rig):
    file = native.read(rig.file)
    doubted = {
        name: replace(each, verdict=CalibrationVerdict(False, ("few views",))) for name, each in file.cameras.items()
    }
    native.write(tmp_path / "rig.yaml", replace(file, cameras=doubted))
    folder = tmp_path / "result"
    arguments = "stereo", "run", tmp_path / "rig.yaml", rig.left, rig.right, "-o", folder, *QUICK
    code, _, err = run(*arguments)
    assert code == 0
    assert "untrustworthy calibration: few views" in err
    code, _, err = run(*arguments, "--require", "trustworthy")
    assert code == 7
    assert "rig.yaml#left: untrustworthy calibration: few views" in " ".join(err.split())
    assert (folder / "clouds" / "left.ply").exists()


def test_a_second_run_replaces_the_first(run, tmp_path, rig):
    arguments = "stereo", "run", rig.file, rig.left, rig.right, "-o", tmp_path / "result", *QUICK
    assert run(*arguments)[0] == 0
    first = (tmp_path / "result" / "clouds" / "left.ply").read_bytes()
    code, _, err = run(*arguments)
    assert code == 0, err
    assert (tmp_path / "result" / "clouds" / "left.ply").read_bytes() == first


def test_a_damaged_image_costs_its_pair_only(run, tmp_path, rig, folders):
    (folders[1] / "01.png").write_bytes(b"no image")
    code, out, err = run("stereo", "run", rig.file, *folders, "-o", tmp_path / "result", *QUICK, "--json")
    assert code == 6
    report = json.loads(out)
    assert [pair["name"] for pair in report["pairs"]] == ["00", "02"]
    assert [failed["left"] for failed in report["failed"]] == [(folders[0] / "01.png").as_posix()]
    assert "01.png" in err
    assert not (tmp_path / "result" / "clouds" / "01.ply").exists()


def test_every_so_many_pairs_are_used(run, tmp_path, rig, folders):
    code, out, _ = run("stereo", "run", rig.file, *folders, "--every", 2, "-o", tmp_path / "result", *QUICK, "--json")
    assert code == 0
    assert [pair["name"] for pair in json.loads(out)["pairs"]] == ["00", "02"]


@pytest.mark.slow
def test_worker_processes_make_the_same_files(run, tmp_path, rig, folders):
    for jobs in (1, 2):
        folder = tmp_path / f"result{jobs}"
        code, _, err = run("stereo", "run", rig.file, *folders, "-o", folder, "--quality", "fast", "--jobs", jobs)
        assert code == 0, err
    for path in (tmp_path / "result1").rglob("*.*"):
        if path.suffix in (".ply", ".tiff", ".png", ".html"):
            other = tmp_path / "result2" / path.relative_to(tmp_path / "result1")
            assert path.read_bytes() == other.read_bytes(), path


def test_frames_of_two_videos_are_pairs(run, tmp_path, rig):
    videos = []
    for side in ("left", "right"):
        videos.append(tmp_path / f"{side}.avi")
        writer = cv2.VideoWriter(str(videos[-1]), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
        for _ in range(4):
            writer.write(cv2.imread(str(getattr(rig, side))))
        writer.release()
    code, out, err = run("stereo", "run", rig.file, *videos, "--every", 3, "-o", tmp_path / "result", *QUICK, "--json")
    assert code == 0, err
    assert [pair["name"] for pair in json.loads(out)["pairs"]] == ["left_000000", "left_000003"]
    assert (tmp_path / "result" / "views" / "left_000003.html").exists()


@pytest.mark.slow
def test_cameras_above_each_other_leave_upright_pictures(run, tmp_path):
    rig = RoomRig(tmp_path, "cylindrical", BELOW)
    code, out, err = run("stereo", "run", rig.file, rig.left, rig.right, "-o", tmp_path / "result", *QUICK, "--json")
    assert code == 0, err
    report = json.loads(out)
    assert (report["projection"], report["axis"]) == ("cylindrical", "y")
    assert report["pairs"][0]["check"]["rows_px"]["rms"] < 0.4
    error = errors(pointclouds.read(tmp_path / "result" / "clouds" / "left.ply"), rig.camera, rig.points)
    assert np.quantile(np.abs(error), 0.68) < 0.035


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["left", "right"], "camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml makes one"),
        (["rig.yaml", "left", "right", "--board", "chessboard:9x6:25mm"], "leave one out"),
        (["rig.yaml", "left", "right", "--scene", "a", "b"], "--scene goes with --board"),
        (["rig.yaml", "left", "right", "--frame", "enu"], "--frame enu needs a pose for every pair"),
        (["rig.yaml", "left"], "expected LEFT RIGHT after the rig file"),
        (["left", "right", "more"], "a rig file ends in .yaml"),
        (["left"], "expected [RIG] LEFT RIGHT, found 1"),
    ],
)
def test_what_makes_no_run_is_said_in_one_line(run, tmp_path, arguments, message):
    code, _, err = run("stereo", "run", *arguments, "-o", tmp_path / "result")
    assert code == 2
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--voxel", "0", "the side of a voxel must be positive, found 0"),
        ("--max-points", "0", "at least one point is needed, found 0"),
        ("--crop", "1,2", "--crop needs six numbers"),
        ("--frame", "north", "frame 'north' is unknown"),
    ],
)
def test_options_that_no_cloud_is_made_with_are_refused_before_a_pair_is_matched(
    run, tmp_path, rig, option, value, message
):
    folder = tmp_path / "result"
    code, _, err = run("stereo", "run", rig.file, rig.left, rig.right, "-o", folder, *QUICK, option, value)
    assert (code, message in err, folder.exists()) == (2, True, False)


def test_a_file_of_one_camera_is_no_rig(run, tmp_path, rig):
    file = native.read(rig.file)
    path = tmp_path / "camera.yaml"
    native.write(path, type(file)({"left": file.cameras["left"]}))
    code, _, err = run("stereo", "run", path, rig.left, rig.right, "-o", tmp_path / "result")
    assert code == 2
    assert "camera.yaml: is no rig: a file with two cameras" in err


def test_a_run_that_fails_leaves_nothing_and_names_a_near_file(run, tmp_path, rig):
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), np.full(SIZE[::-1], 128, np.uint8))
    blank = tmp_path / "left.png", tmp_path / "right.png"
    code, _, _ = run("stereo", "run", *blank, "--board", "chessboard:9x6:25mm", "-o", tmp_path / "result", *QUICK)
    assert code == 4
    assert not (tmp_path / "result").exists()
    code, _, err = run("stereo", "run", rig.file.with_suffix(".yml"), *blank, "-o", tmp_path / "result", *QUICK)
    assert code == 3
    assert "rig.yml: no such file. Did you mean" in err
