"""A hand-held video of a board, with the published lens; no truth is known but that the hand moves smoothly.

The board looks the same after half a turn, and the pictures are successive at a rate that nobody wrote down.
"""

import json

import cv2
import numpy as np
import pytest

from camcal.cli.main import app
from camcal.images.video import frames

CAMERA = """\
format: camcal-calibration
version: 1
cameras:
  webcam:
    image_size: [640, 480]
    model: opencv4
    intrinsics: {fx: 529.0340750592192, fy: 528.7980189489572, cx: 316.67722865086887, cy: 226.93146144997266}
    distortion: {k1: 0.05587710526409107, k2: -0.16596851121196668, p1: 0.0, p2: 0.0}
"""
FIRST, COUNT = 40, 24


@pytest.fixture(scope="module")
def folder(real_data, tmp_path_factory):
    """A camera file and some frames of the video, two of them without the board."""
    return written(tmp_path_factory.mktemp("video"), real_data, FIRST, COUNT, blank=(50, 51))


def written(folder, real_data, first, count, blank=()):
    """Write a camera file and some frames of the video into a folder, those of `blank` without the board."""
    (folder / "camera.yaml").write_text(CAMERA)
    (folder / "frames").mkdir()
    for number, image in enumerate(frames(real_data / "pnp" / "boofcv-chessboard-video" / "movie.mjpeg")):
        if first <= number < first + count:
            pixels = np.full_like(image.pixels, 90) if number in blank else image.pixels
            cv2.imwrite(str(folder / "frames" / f"frame_{number:04d}.png"), pixels)
        if number == first + count:
            break
    return folder


def track(folder, capsys, *more):
    """Return what is said of the track of the board in the frames of a folder."""
    arguments = ["track", folder / "camera.yaml", folder / "frames", "--board", "chessboard:6x4:30mm", "--fps", 30]
    with pytest.raises(SystemExit) as leaving:
        app([str(each) for each in (*arguments, *more, "-o", folder / "track.json", "--json")])
    assert not leaving.value.code
    (found,) = json.loads(capsys.readouterr().out)["objects"]
    return found


def test_covariances_hold_where_a_hand_starts_to_move(real_data, tmp_path, capsys):
    """Steps to the highest evidence had lost pixels of these frames, and ended at a noise that was too small."""
    found = track(written(tmp_path, real_data, 19, 41), capsys)
    assert found["consistency"]["verdict"] == "consistent"
    assert 0.9 < found["consistency"]["mean_nis"] < 1.1


def test_a_board_in_a_moving_hand_is_followed_without_a_break(folder, capsys):
    found = track(folder, capsys, "--fill")
    assert found["detections"] == COUNT - 2
    assert found["predicted"] == 2
    assert len(found["rejected"]) <= 2
    assert len(found["segments"]) == 1
    assert found["consistency"]["verdict"] in ("consistent", "underconfident")
    blocks = json.loads((folder / "track.json").read_text())["tracks"][0]["poses"]
    places = np.array([block["translation"] for block in blocks if "translation" in block])
    assert len(places) >= COUNT - 2  # a first frame that does not fit is before the track
    assert places[:, 2].min() > 0.3
    assert places[:, 2].max() < 0.6
    # a hand does not move the board by 10 mm from one thirtieth of a second to the next
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.01
