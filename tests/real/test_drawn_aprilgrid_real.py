"""Photographs of the AprilGrid of TUM-VI show, cell by cell, what is drawn of the board of the same target file.

The lens is TUM-VI's own (cam0 at 512 pixels, scaled to these images), so nothing is calibrated here.
"""

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats.boards import load_board
from camcal.geometry.pose import Pose
from camcal.images.files import gray_8bit, load
from camcal.targets.detect import detect
from camcal.targets.pattern import pattern_of

TARGET = "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
TUM_VI = [190.97848, 190.97331, 254.93171, 256.89744, 0.0034824, 0.000715, -0.0020532, 0.0002029]
STEP = 11  # cells from tag to tag: ten of a tag and a gap


@pytest.fixture
def camera():
    model = model_named("kannala_brandt4")
    return Camera(model, (1024, 1024), model.rescale(np.array(TUM_VI), (2.0, 2.0), (0.0, 0.0)))


@pytest.mark.parametrize("name", ["TUM_VI", "right", "top"])
def test_every_cell_of_the_drawing_is_as_dark_or_bright_as_in_the_photograph(real_data, tmp_path, camera, name):
    (tmp_path / "target.yaml").write_text(TARGET)
    board = load_board(str(tmp_path / "target.yaml"))
    gray = gray_8bit(load(real_data / "aprilgrid" / "tumvi-1024" / f"{name}.png").pixels)
    detection = detect(gray, board)
    assert len(detection.ids) > 0.9 * board.count

    rays = camera.unproject(detection.pixels).directions
    found, turn, shift = cv2.solvePnP(board.points()[detection.ids], rays[:, :2] / rays[:, 2:], np.eye(3), None)
    assert found
    pattern = pattern_of(board)
    x, y = (np.convolve(lines[1:-1], [0.5, 0.5], "valid") for lines in (pattern.x, pattern.y))
    middles = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1)
    pixels = camera.project(Pose(cv2.Rodrigues(turn)[0], shift.ravel()).apply(middles.reshape(-1, 3))).pixels
    u, v = pixels.astype(np.float32).T.reshape(2, *middles.shape[:2])
    shade = cv2.remap(gray.astype(np.float32), u, v, cv2.INTER_LINEAR)
    dark = shade < cv2.blur(shade, (STEP + 2, STEP + 2))  # than the cells of about one tag around
    inside = (np.minimum(u, v) > 2) & (np.maximum(u, v) < 1021)
    assert np.array_equal(dark[inside], pattern.ink[1:-1, 1:-1][inside] == 0)
    assert dark[::STEP, ::STEP][inside[::STEP, ::STEP]].all()  # the small squares between and around the tags
