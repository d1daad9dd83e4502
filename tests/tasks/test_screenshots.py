"""Screenshots of a board are named as such; photographs and simulated images of it are not."""

import cv2
import numpy as np
import pytest

from camcal.errors import InsufficientData
from camcal.targets.board import parse_board
from camcal.targets.detect import detect
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.images_again import FEW_LEVELS, gray_levels
from camcal.tasks.calibration.options import CalibrateOptions

BOARD = parse_board("chessboard:9x6:25mm")
SIZE = (480, 640)
QUICK = {"model": "opencv4", "refine": False}


def write(folder, stretch=1.0, noise=0.0, suffix="png", quality=95):
    """Write pictures of a board on a monitor as a program saves them: moved and scaled."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[-1:8, -1:11]
    squares = np.where((row + column) % 2 | (row < 0) | (row > 6) | (column < 0) | (column > 9), 255, 0)
    drawn = np.kron(squares, np.ones((60, 60))).astype(np.uint8)
    for index in range(4):
        scale = rng.uniform(0.5, 0.7)
        small = cv2.resize(drawn, None, fx=stretch * scale, fy=scale, interpolation=cv2.INTER_AREA)
        image = np.full(SIZE, 255, np.uint8)
        top, left = (rng.integers(0, room - side) for room, side in zip(SIZE, small.shape, strict=True))
        image[top : top + small.shape[0], left : left + small.shape[1]] = small
        image = 20 + 0.8 * image + rng.normal(0, noise, SIZE) if noise else image
        path = folder / f"{index}.{suffix}"
        flags = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix == "jpg" else []
        cv2.imwrite(str(path), np.rint(image).astype(np.uint8), flags)
    return folder


def refusal(folder, **options):
    with pytest.raises(InsufficientData) as raised:
        calibrate(CalibrateOptions((str(folder),), board=BOARD, jobs=1, **options))
    return raised.value


@pytest.mark.parametrize(
    ("how", "options", "levels"),
    [({}, {}, {2}), ({"suffix": "jpg", "quality": 70}, QUICK, {3, 4, 5}), ({"stretch": 1.01}, QUICK, {2})],
    ids=["exact", "JPEG", "slightly stretched"],
)
def test_screenshots_are_named(tmp_path, how, options, levels):
    error = refusal(write(tmp_path, **how), **options)
    assert [failure.code for failure in error.failures] == ["screenshots"]
    found = error.failures[0].values["gray_levels"]
    assert found in levels
    assert str(error) == (
        "the images look like screenshots or drawings of the board, not photographs: every view is frontal and has "
        f"only {found} gray levels: photograph the board, tilted by 20° to 45° about both axes"
    )


@pytest.mark.parametrize("how", [{"noise": 1.0}, {"stretch": 1.02}], ids=["noise", "not as drawn"])
def test_frontal_views_with_noise_or_of_another_shape_are_not(tmp_path, how):
    assert str(refusal(write(tmp_path, **how), **QUICK)).startswith("nearly parallel views")


def test_photographs_have_more_gray_levels(real_data):
    for path in sorted((real_data / "chessboard" / "opencv-left-right").rglob("left0*.jpg"))[:4]:
        gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert gray_levels(gray, detect(gray, BOARD).pixels) > 2 * FEW_LEVELS
