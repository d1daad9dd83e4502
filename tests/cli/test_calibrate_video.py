"""`camcal calibrate` from a video: a rendered one, in which the board is elsewhere in every frame."""

import json

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import Board

BOARD = Board("chessboard", 8, 5, 0.03)
SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([420.0, 422, 236, 181]))
FRAMES = 12


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "video.avi"
    rng = np.random.default_rng(5)
    poses = views(CAMERA, BOARD, FRAMES, rng=rng, max_tilt=np.radians(40))
    pictures = [render(CAMERA, BOARD, pose, rng=rng, exposure=Exposure(noise_dn=1.0)) for pose in poses]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, SIZE)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for picture in pictures:
        writer.write(cv2.merge([picture] * 3))
    writer.release()
    return path


@pytest.mark.slow
def test_a_video_is_calibrated_like_images(run, video, tmp_path):
    """Every frame shows another pose and has moved far since the one before: nothing is left out for that."""
    output = tmp_path / "camera.yaml"
    arguments = ("calibrate", video, "-b", "chessboard:8x5:30mm", "-o", output, "--model", "pinhole", "--jobs", 1)
    report = tmp_path / "report.html"
    code, out, _ = run(*arguments, "--flat-board", "--max-frames", 8, "--report", report, "--json")
    assert code == 0
    assert report.read_text(encoding="utf-8").count("<image data-photo=") == 8
    told = json.loads(out)
    assert sum(frame["taken"] for frame in told["frames"]) == 8
    assert len(told["views"]) == 8
    file = native.read(output)
    assert "--max-frames 8" in file.provenance["command"]
    camera = file.cameras["camera"].camera
    error = (camera.parameters - CAMERA.parameters) / np.sqrt(np.diag(camera.covariance))
    assert np.abs(error).max() < 6  # MJPG's errors are alike from corner to corner, which σ does not know


def test_all_that_were_searched_are_listed_if_asked_for(run, video, tmp_path):
    arguments = ("calibrate", video, "-b", "chessboard:8x5:30mm", "-o", tmp_path / "camera.yaml", "--jobs", 1)
    code, out, _ = run(*arguments, "--model", "pinhole", "--flat-board", "--max-frames", 9, "--verbose")
    assert code == 0
    assert out.startswith("9 of 12 searched frames used\n")
    assert out.count(str(video.with_suffix(""))) >= FRAMES
