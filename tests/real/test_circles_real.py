"""Photographs of circle grids of BoofCV and ViSP: all are found, and their dots lie where a lens puts them.

What this does not prove: the sheets are paper, bent by more than the dots' errors.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.targets.board import parse_board
from camcal.targets.circles import find_circles
from camcal.targets.detection import BoardDetection

SETS = {
    "boofcv-circle-regular": ("circles:10x8:25mm:15mm", 6, 0.37),  # pixels RMS; 0.35 measured, of bent paper
    "visp-grid36": ("circles:6x6:30mm", 4, 0.19),  # 0.17 measured
}


@pytest.fixture(scope="module", params=SETS)
def photographs(request, real_data) -> tuple[str, list[Path]]:
    folder = real_data / "other_targets" / request.param
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return request.param, sorted(path for path in folder.iterdir() if path.suffix in (".jpg", ".pgm"))


def test_every_photograph_shows_all_dots_and_they_calibrate(photographs):
    name, paths = photographs
    text, count, limit = SETS[name]
    board = parse_board(text)
    detections = []
    for path in paths:
        gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        detection = find_circles(gray, board)
        assert len(detection.ids) == board.count, path.name
        assert np.sqrt(np.linalg.det(detection.covariance)).max() < 0.05**2
        detections.append(BoardDetection(path.name, gray.shape[::-1], detection.ids, detection.pixels))
    assert len(detections) == count
    assert calibrate(detections, board, Options(model_named("opencv5"))).rms_px < limit
