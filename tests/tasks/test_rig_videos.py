"""Videos of several cameras: the same instants are searched and used in all of them."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from moving_board import between

from camcal.calibrate.view_records import View
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.geometry.pose import Pose
from camcal.progress import SILENT
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.tasks.calibration.camera_result import image_record
from camcal.tasks.calibration.options import FrameOptions
from camcal.tasks.calibration.video_frames import detect_frame
from camcal.tasks.rigs.calibrate_rig import rig
from camcal.tasks.rigs.camera_inputs import CameraInputs
from camcal.tasks.rigs.matching import settled_together, survey_rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions

BOARD = Board("chessboard", 8, 5, 0.03)
SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, [420.0, 422, 236, 181])
RIGHT_T_LEFT = Pose.from_vector(np.array([0.0, -0.04, 0.01]), np.array([-0.1, 0.002, 0.0]))


def written(path, pictures, rate):
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for picture in pictures:
        writer.write(cv2.merge([picture] * 3))
    writer.release()
    return path


@pytest.fixture
def noise_videos(tmp_path):
    """Two videos of one second, of 20 and of 10 frames: those at 0.3 s and 0.7 s alone are sharp in both."""
    found = []
    for name, rate, sharp in (("left", 20, (6, 14, 17)), ("right", 10, (3, 7))):
        rng = np.random.default_rng(1)
        pictures = [rng.integers(0, 255 if index in sharp else 40, (48, 64), np.uint8) for index in range(rate)]
        found.append(CameraInputs(name, videos=(written(tmp_path / f"{name}.avi", pictures, rate),)))
    return found


def test_instants_are_those_of_the_video_with_fewer_frames(noise_videos):
    found = survey_rig(noise_videos, FrameOptions(whole=True), None, SILENT)
    assert found.instants.tolist() == [[2 * index, index] for index in range(10)]
    every = survey_rig(noise_videos, FrameOptions(whole=True, every=3), None, SILENT)
    assert every.instants.tolist() == [[0, 0], [6, 3], [12, 6], [18, 9]]
    assert every.videos["left"].numbers == (0, 6, 12, 18)
    assert found.time_of("right", "right_000003") == pytest.approx(0.3)


def test_the_sharpest_instants_of_all_cameras_together_are_searched(noise_videos, monkeypatch):
    monkeypatch.setattr("camcal.tasks.rigs.matching.SEARCHED_PER_CHOSEN", 1)
    found = survey_rig(noise_videos, FrameOptions(most=2), None, SILENT)
    assert found.instants.tolist() == [[6, 3], [14, 7]]


def test_images_beside_videos_and_several_videos_are_refused(noise_videos):
    left, right = noise_videos
    for other in (replace(right, videos=right.videos * 2), CameraInputs("right", images=right.videos)):
        with pytest.raises(InvalidInput, match="each camera has one and nothing else"):
            survey_rig([left, other], FrameOptions(), None, SILENT)


def test_an_instant_is_used_in_all_cameras_or_in_none(noise_videos):
    found = survey_rig(noise_videos, FrameOptions(whole=True), None, SILENT)
    rng = np.random.default_rng(2)
    poses = views(CAMERA, BOARD, 10, rng=rng)
    seen = {}
    for name, shift in (("left", Pose.identity()), ("right", RIGHT_T_LEFT)):
        own = observe(CAMERA, BOARD, [shift @ pose for pose in poses], rng=rng)[0]
        blurred = {"left": 4, "right": 7}[name]
        seen[name] = [
            replace(view, image=image, blur_px=9.0 if index == blurred else 1.0)
            for index, (view, image) in enumerate(zip(own.views, found.videos[name].names, strict=True))
        ]
    records = settled_together(found, seen, BOARD, FrameOptions(most=5))
    used = {
        name: {found.instant_of(name, record.view.image) for record in own if record.taken}
        for name, own in records.items()
    }
    assert used["left"] == used["right"]
    assert len(used["left"]) == 5
    assert not used["left"] & {4, 7}
    refused = next(record for record in records["right"] if record.view.image.endswith("_000004"))
    assert "camera left: blurred" in refused.reason


@pytest.mark.slow
def test_a_pair_is_calibrated_from_videos_of_different_rates(tmp_path):
    rng = np.random.default_rng(5)
    stops = views(CAMERA, BOARD, 9, rng=rng, max_tilt=np.radians(40))
    for name, rate, shift in (("left", 20, Pose.identity()), ("right", 10, RIGHT_T_LEFT)):
        times = np.arange(8 * rate // 4) / rate * 4  # in stops
        poses = [shift @ between(stops[int(time)], stops[int(time) + 1], time % 1) for time in times]
        pictures = [render(CAMERA, BOARD, pose, rng=rng, exposure=Exposure(noise_dn=1.0)) for pose in poses]
        written(tmp_path / f"{name}.avi", pictures, rate)
    settings = RigSettings(
        tmp_path / "rig.yaml", "chessboard:8x5:30mm", models=("pinhole",), flat_board=True, frames=FrameOptions(most=12)
    )
    report = rig(RigTaskOptions((f"left={tmp_path}/left.avi", f"right={tmp_path}/right.avi"), settings))
    assert report.views.matched.by == "time"
    assert report.views.matched.largest < 0.001
    assert len(report.views.captures) == 12
    found = native.read(tmp_path / "rig.yaml").transforms["right_T_left"].pose
    assert np.linalg.norm(found.translation - RIGHT_T_LEFT.translation) < 1e-3
    assert json.dumps(report.lines).count("frames used") == 2


def test_frames_have_hashes_of_their_own_that_calibrations_record(noise_videos):
    video = survey_rig(noise_videos, FrameOptions(whole=True, every=3), None, SILENT).videos["left"]
    first, again = ([detect_frame((frame.name, frame, BOARD)).sha256 for frame in video.frames()] for _ in range(2))
    assert first == again
    assert len(set(first)) == len(video.numbers) == 4
    records = [image_record(View(name, 0, sha256=digest)) for name, digest in zip(video.names, first, strict=True)]
    assert [record["sha256"] for record in records] == first
