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
    folder = tmp_path_factory.mktemp("video")
    (folder / "camera.yaml").write_text(CAMERA)
    (folder / "frames").mkdir()
    for number, image in enumerate(frames(real_data / "pnp" / "boofcv-chessboard-video" / "movie.mjpeg")):
        if FIRST <= number < FIRST + COUNT:
            pixels = np.full_like(image.pixels, 90) if number in (50, 51) else image.pixels
            cv2.imwrite(str(folder / "frames" / f"frame_{number:04d}.png"), pixels)
        if number == FIRST + COUNT:
            break
    return folder


def test_a_board_in_a_moving_hand_is_followed_without_a_break(folder, capsys):
    arguments = ["track", folder / "camera.yaml", folder / "frames", "--board", "chessboard:6x4:30mm", "--fps", 30]
    with pytest.raises(SystemExit) as leaving:
        app([str(each) for each in (*arguments, "--fill", "-o", folder / "track.json", "--json")])
    assert not leaving.value.code
    (track,) = json.loads(capsys.readouterr().out)["objects"]
    assert track["detections"] == COUNT - 2
    assert track["predicted"] == 2
    assert len(track["rejected"]) <= 2
    assert len(track["segments"]) == 1
    assert track["consistency"]["verdict"] in ("consistent", "underconfident")
    blocks = json.loads((folder / "track.json").read_text())["tracks"][0]["poses"]
    places = np.array([block["translation"] for block in blocks if "translation" in block])
    assert len(places) >= COUNT - 2  # a first frame that does not fit is before the track
    assert places[:, 2].min() > 0.3
    assert places[:, 2].max() < 0.6
    # a hand does not move the board by 10 mm from one thirtieth of a second to the next
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.01
