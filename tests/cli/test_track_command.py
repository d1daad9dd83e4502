"""`camcal track`: what it reads and writes, what it says, and its exits."""

import json
from pathlib import Path

import cv2
import motion
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.formats import poses, trajectories
from camcal.formats.camera_file import CalibrationNoise
from camcal.formats.poses.record import PoseKey, PoseRecord, Poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

COUNT = 40
GIVEN = "--fps", 30, "--process-noise", "0.02,0.5"
TAG = np.array([[-0.05, 0.05, 0.0], [0.05, 0.05, 0.0], [0.05, -0.05, 0.0], [-0.05, -0.05, 0.0]])
CAMERA = Camera(model_named("pinhole"), (640, 480), np.array([800.0, 800.0, 319.5, 239.5]))


def record(estimate):
    return PoseRecord(
        estimate.transform,
        estimate.covariance,
        estimate.noise_covariance,
        estimate.status,
        estimate.rms_px,
        estimate.rms_px,
        4,
        4,
        estimate.p_wrong,
        alternatives=estimate.alternatives,
    )


def sighted(name, seed, rng):
    """Return the poses of a tag that moves, by sight, and the frames in which it was not found."""
    truth = motion.swaying(
        np.arange(COUNT) / 30, Pose(so3.about_x(np.pi - 0.5), np.array([0.0, 0.1 * seed, 1.0])), 0.05, 0.2, rng
    )
    seen = motion.seen(CAMERA, TAG, truth, 0.3, rng, dropped=0.1)
    views = [
        Correspondences(f"frame_{index:03d}.png", TAG, pixels, object=name)
        for index, pixels in enumerate(seen)
        if pixels is not None
    ]
    found = estimate_poses(CAMERA, views, PoseOptions(noise_px=0.3))
    estimates = {PoseKey(each.item.image, name): record(each.value) for each in found}
    names = {pose_key.image for pose_key in estimates}
    return estimates, [f"frame_{i:03d}.png" for i in range(COUNT) if f"frame_{i:03d}.png" not in names]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Pose files of one tag and of two."""
    folder = tmp_path_factory.mktemp("poses")
    rng = np.random.default_rng(1)
    first, lost = sighted("tag_3", 0, rng)
    second, _ = sighted("tag_5", 1, rng)
    single = {PoseKey(pose_key.image): each for pose_key, each in first.items()}
    one = Poses(
        "camera_T_object", "m", CalibrationNoise(0.3, None), single, {PoseKey(name): "nothing" for name in lost}
    )
    poses.write(folder / "one.json", one)
    poses.write(folder / "inverse.json", one.inverse())
    poses.write(folder / "two.json", Poses("camera_T_object", "m", CalibrationNoise(0.3, None), {**first, **second}))
    return folder


def test_a_pose_file_is_followed_and_judged(run, files, tmp_path):
    code, out, err = run("track", files / "one.json", "--fps", 30, "-o", tmp_path / "t.csv")
    assert code == 0
    assert err == ""
    assert "consistent:" in out
    for words in (
        f"of {COUNT} frames",
        "rejected 0",
        "track segments: 0.00–1.30 s (40 frames)",
        "process noise",
        "mean NIS",
        "wrote",
    ):
        assert words in out
    rows = (tmp_path / "t.csv").read_text().splitlines()
    assert rows[1].startswith("t,frame,id,segment,state,tx,ty,tz,qw,qx,qy,qz,vx,vy,vz,wx,wy,wz,std_tx,")
    assert rows[1].endswith("nis,candidate,p_wrong,rms_px,n")
    assert len(rows) == 2 + COUNT
    states = {row.split(",")[4] for row in rows[2:]}
    assert states == {"measured", "gap"}


def test_frames_without_a_detection_are_filled_on_request(run, files, tmp_path):
    assert run("track", files / "one.json", *GIVEN, "--fill", "-o", tmp_path / "t.json")[0] == 0
    document = json.loads((tmp_path / "t.json").read_text())
    blocks = document["tracks"][0]["poses"]
    assert {block["state"] for block in blocks} == {"measured", "predicted"}
    assert all(len(block["covariance"]) == 6 and len(block["velocity"]) == 6 for block in blocks)


def test_a_tum_file_is_the_path_of_the_camera_and_says_so(run, files, tmp_path):
    assert run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.tum")[0] == 0
    assert run("track", files / "one.json", *GIVEN, "-o", tmp_path / "c.tum", "--pose", "camera_T_object")[0] == 0
    path, straight = trajectories.read(tmp_path / "t.tum"), trajectories.read(tmp_path / "c.tum")
    assert (path.frames, straight.frames) == ("object_T_camera", "camera_T_object")
    np.testing.assert_allclose(path.pose(3).inverse().translation, straight.translations[3], atol=1e-9)


def test_ros_transforms_name_their_frames(run, files, tmp_path):
    assert run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.yaml", "--format", "tf")[0] == 0
    assert trajectories.read(tmp_path / "t.yaml").frames == "camera_T_object"


def test_poses_of_the_camera_give_the_same_track(run, files, tmp_path):
    for name in ("one", "inverse"):
        assert run("track", files / f"{name}.json", *GIVEN, "-o", tmp_path / f"{name}.csv")[0] == 0
    tables = [
        np.genfromtxt((tmp_path / f"{name}.csv").read_text().splitlines()[2:], delimiter=",")[:, 5:12]
        for name in ("one", "inverse")
    ]
    np.testing.assert_allclose(*tables, atol=1e-9)  # files have 12 digits


def test_objects_are_followed_one_by_one(run, files, tmp_path):
    code, out, _ = run("track", files / "two.json", *GIVEN, "-o", tmp_path / "t.yaml")
    assert code == 0
    assert "camera_T_object, tag_3:" in out
    assert "camera_T_object, tag_5:" in out
    assert (tmp_path / "t.yaml").read_text().count("object: tag_") == 2
    _, out, _ = run("track", files / "two.json", *GIVEN, "--id", 5, "--json")
    assert [each["object"] for each in json.loads(out)["objects"]] == ["tag_5"]
    code, _, err = run("track", files / "two.json", *GIVEN, "-o", tmp_path / "t.tum")
    assert code == 2
    assert "holds one object, and 2 were followed (tag_3, tag_5): choose one with --object" in err
    code, _, err = run("track", files / "two.json", "--fps", 30, "--object", "tag_4")
    assert code == 2
    assert "Did you mean" in err


def test_the_json_document(run, files):
    code, out, _ = run("track", files / "one.json", "--fps", 30, "--json", "--process-noise", "0.02,0.5")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "frame_count", "objects", "lost", "failed", "outputs", "warnings"]
    assert document["schema"] == "camcal/track/1"
    assert list(document["objects"][0]) == [
        "object", "frames", "detections", "measured", "predicted", "rejected", "mirrored", "jerks", "segments",
        "process_noise", "vibration", "ambiguous", "consistency", "jitter",
    ]  # fmt: skip
    assert document["objects"][0]["process_noise"] == {"qv": 0.02, "qw": 0.5, "factors": None, "fading_s": None}
    assert list(document["objects"][0]["segments"][0]) == ["first", "last", "start_s", "end_s", "frames"]
    assert list(document["objects"][0]["consistency"]) == [
        "innovations", "mean_nis", "interval", "beyond_95", "autocorrelation", "autocorrelation_limit", "verdict",
    ]  # fmt: skip


@pytest.mark.slow
def test_the_picture_has_a_line_for_the_track(run, files, tmp_path):
    code, _, _ = run(
        "track", files / "two.json", "--fps", 30, "--process-noise", "0.02,0.5", "--plot", tmp_path / "t.png"
    )
    assert code == 0
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == ["t_tag_3.png", "t_tag_5.png"]
    picture = cv2.imread(str(tmp_path / "t_tag_3.png")).astype(int)
    blue, _, red = np.moveaxis(picture, 2, 0)
    assert np.sum(blue > red + 60) > 2000


@pytest.mark.slow
def test_every_object_has_its_figures(run, files, tmp_path):
    words = ("--fps", 30, "--process-noise", "0.02,0.5", "--figures", tmp_path / "figures", "--json")
    code, out, _ = run("track", files / "two.json", *words)
    own = ("position", "rotation", "innovations", "trajectory_planes", "trajectory_space")
    names = {f"tag_{number}_{name}.png" for number in (3, 5) for name in own}
    assert (code, {Path(path).name for path in json.loads(out)["figure_files"]}) == (0, names)
    assert names < {path.name for path in (tmp_path / "figures").iterdir()}


def test_a_causal_track_starts_at_the_first_detection(run, files):
    for when in (["--causal"], ["--lag", 10]):
        _, out, _ = run("track", files / "one.json", "--fps", 30, *when, "--process-noise", "0.02,0.5", "--json")
        found = json.loads(out)["objects"][0]
        assert found["measured"] == found["detections"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ((), 2, "unknown times of the frames: set --fps, or --timestamps with a file, name or exif"),
        (("--fps", -1), 2, "--fps must be more than 0"),
        (("--fps", 30, "--gate", 1.5), 2, "a gate is a probability"),
        (("--fps", 30, "--max-gap", 0), 2, "a gap is longer than 0 s"),
        (("--fps", 30, "--process-noise", "0.1"), 2, "auto, or two numbers"),
        (("--fps", 30, "--process-noise", "0,1"), 2, "must be more than 0"),
        (("--fps", 30, "--causal", "--lag", 3), 2, "exclude each other"),
        (("--fps", 30, "--object", "a", "--id", 3), 2, "exclude each other"),
        (("--fps", 30, "--pose", "world_T_camera"), 2, "it is camera_T_object or object_T_camera here"),
        (("--fps", 30, "--board", "chessboard:6x4:30mm"), 2, "a pose file excludes --board and --tags"),
        (("--fps", 30, "-o", "t.obj"), 2, ".obj"),
        (("--fps", 30, "--format", "tf"), 2, "--format needs an output (-o)"),
        (("--fps", 30, "--plot", "t.gif"), 2, "use .png"),
        (("--fps", 30, "--max-gap", 0.001), 4, "are successive"),
        (("--timestamps", "missing.txt"), 3, "missing.txt"),
    ],
)
def test_options_that_make_no_sense_are_refused(run, files, arguments, code, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, _, err = run("track", files / "one.json", *arguments)
    assert found == code
    assert words in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_inputs_are_not_overwritten_and_missing_ones_named(run, files, tmp_path):
    code, _, err = run("track", files / "one.json", "--fps", 30, "-o", files / "one.json")
    assert (code, "is an input" in err) == (2, True)
    code, _, err = run("track", tmp_path / "nothing.yaml", "--fps", 30)
    assert (code, "no such file" in err) == (3, True)


def test_too_few_poses_are_too_little_data(run, files, tmp_path):
    few = poses.read(files / "one.json")
    kept = dict(list(few.estimates.items())[:2])
    lost = {PoseKey(f"frame_{index:03d}.png"): "nothing" for index in range(2, 9)}
    poses.write(tmp_path / "few.json", Poses(few.frames, few.unit, few.noise, kept, lost))
    code, _, err = run("track", tmp_path / "few.json", "--fps", 30)
    assert code == 4
    assert "found in 2 of" in err
    assert "(minimum 3)" in err


def test_times_are_asked_for_before_images_are_looked_at(run, tmp_path):
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "format: camcal-calibration\nversion: 1\ncameras:\n  a:\n    image_size: [64, 48]\n    model: pinhole\n"
        "    intrinsics: {fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5}\n"
    )
    (tmp_path / "frames").mkdir()
    cv2.imwrite(str(tmp_path / "frames" / "a.png"), np.zeros((48, 64), np.uint8))
    code, _, err = run("track", camera, tmp_path / "frames", "--board", "chessboard:6x4:30mm")
    assert (code, "unknown times of the frames: set --fps, or --timestamps with a file, name or exif" in err) == (
        2,
        True,
    )
    code, _, err = run("track", camera, tmp_path / "frames", "--board", "chessboard:6x4:30mm", "--fps", 30, "--jobs", 1)
    assert code == 4


def test_a_table_is_read_back_as_a_trajectory_by_other_commands(run, files, tmp_path):
    code, _, _ = run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.csv")
    assert code == 0
    run("track", files / "one.json", *GIVEN, "--format", "tum", "--pose", "camera_T_object", "-o", tmp_path / "t.tum")
    table, lines = (trajectories.read(tmp_path / name) for name in ("t.csv", "t.tum"))
    assert table.frames == "camera_T_object"
    assert len(table) < COUNT  # frames without a pose are left out
    np.testing.assert_allclose(table.stamps, lines.stamps, atol=1e-8)
    np.testing.assert_allclose(table.translations, lines.translations, atol=1e-8)
    assert np.all(np.diagonal(table.covariances, axis1=1, axis2=2) > 0)
    assert run("smooth", tmp_path / "t.csv", "-o", tmp_path / "smooth.tum")[0] == 0


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_yaml_and_json_are_read_back_with_all_they_hold(run, files, tmp_path, suffix):
    run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.csv")
    run("track", files / "one.json", *GIVEN, "-o", tmp_path / f"t.{suffix}")
    table, named = (trajectories.read(tmp_path / name) for name in ("t.csv", f"t.{suffix}"))
    np.testing.assert_allclose(named.translations, table.translations, atol=1e-11)  # 12 digits in either
    np.testing.assert_allclose(named.velocities, table.velocities, atol=1e-11)
    np.testing.assert_array_equal(named.segments, table.segments)
    assert np.abs(named.covariances - table.covariances).max() > 0  # correlations too
    assert run("smooth", tmp_path / f"t.{suffix}", "-o", tmp_path / "smooth.tum")[0] == 0


def test_half_a_pose_in_a_track_is_named(run, files, tmp_path):
    run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.json")
    document = json.loads((tmp_path / "t.json").read_text())
    del document["tracks"][0]["poses"][4]["velocity"]
    (tmp_path / "half.json").write_text(json.dumps(document))
    code, _, err = run("smooth", tmp_path / "half.json", "-o", tmp_path / "smooth.tum")
    assert code == 2
    assert "tracks[0].poses[4] has a translation and no velocity" in err


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_several_objects_are_not_taken_for_one_trajectory(run, files, tmp_path, suffix):
    run("track", files / "two.json", *GIVEN, "-o", tmp_path / f"t.{suffix}")
    code, _, err = run("smooth", tmp_path / f"t.{suffix}", "-o", tmp_path / "smooth.tum")
    assert code == 2
    assert "2 objects (tag_3, tag_5)" in err
    assert "--object" in err
    code, out, _ = run(
        "plot", tmp_path / f"t.{suffix}", "-o", tmp_path / "one.svg", "--figure", "tag_5_trajectory_planes", "--json"
    )
    document = json.loads(out)
    assert (code, document["inputs"][0]["kind"]) == (0, "tracks")
    kinds = ("trajectory_planes", "trajectory_space")
    assert list(document["captions"]) == [f"{tag}_{kind}" for tag in ("tag_3", "tag_5") for kind in kinds]


def test_what_a_pose_file_cannot_follow_is_said(run, files):
    for option, value, words in (("--object", "tag_9", "unnamed"), ("--noise", "0.2", "'camcal pnp'")):
        code, _, err = run("track", files / "one.json", *GIVEN, option, value)
        assert code == 2
        assert words in err


def test_a_table_with_half_a_pose_is_refused_at_its_line(run, files, tmp_path):
    run("track", files / "one.json", *GIVEN, "-o", tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    cells = lines[9].split(",")
    cells[lines[1].split(",").index("tx")] = ""
    lines[9] = ",".join(cells)
    (tmp_path / "half.csv").write_text("\n".join(lines))
    code, _, err = run("smooth", tmp_path / "half.csv", "-o", tmp_path / "smooth.tum")
    assert code == 2
    assert "half.csv:10: tx: '' is not a number" in err
