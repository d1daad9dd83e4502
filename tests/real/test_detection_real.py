"""Real boards: images that one detector or another misses, and what the corners are worth.

The whole sets are run by benchmarks/detection.py. Each image here is missed or misread by at least one of OpenCV's
detectors with the sizes they offer (baseline files and INDEX.md of the data).
"""

import cv2
import numpy as np
import pytest

from camcal.errors import InsufficientData
from camcal.images.files import gray_8bit, load
from camcal.run.paths import find_images
from camcal.targets.board import parse_board
from camcal.targets.checker.charuco_search import search_charuco
from camcal.targets.checker.chessboard import find_chessboard
from camcal.targets.detect import detect
from camcal.tasks.calibration.detect import detect_images
from camcal.tasks.calibration.options import DetectOptions

GOPRO = "chessboard/udacity-gopro-wide"
TRINOCULAR = "multicam/boofcv-trinocular"


@pytest.mark.parametrize(
    ("image", "board"),
    [
        ("chessboard/bouguet-caltech/Image21.tif", "chessboard:12x13"),
        ("chessboard/bouguet-caltech/Image16.tif", "chessboard:12x13"),
        ("chessboard/opencv-left-right/right09.jpg", "chessboard:9x6"),
        ("chessboard/photonvision-lifecam-2024-01-02_lifecam_1280/img2.png", "chessboard:10x10"),
        (f"{GOPRO}/GOPR0053.jpg", "chessboard:8x6"),
        (f"{GOPRO}/GOPR0064.jpg", "chessboard:8x6"),
        ("fisheye/boofcv-theta-chess/16.jpg", "chessboard:6x4"),
        ("fisheye/ocamcalib-fish2/Fisheye2_5.jpg", "chessboard:8x6"),
        (f"{TRINOCULAR}/left/left17.jpg", "chessboard:13x9"),
        ("stereo_rig/sourishg-stereo/calib_imgs/2/right15.jpg", "chessboard:9x6"),
    ],
)
def test_boards_that_single_detectors_miss_are_found_whole(real_data, image, board):
    wanted = parse_board(board)
    detection = find_chessboard(gray_8bit(load(real_data / image).pixels), wanted)
    assert detection.reason is None
    assert len(detection.ids) == wanted.count


@pytest.mark.parametrize(
    ("image", "board", "reason"),
    [
        (f"{GOPRO}/GOPR0055.jpg", "chessboard:8x6", "board partly outside the image"),
        (f"{TRINOCULAR}/left/left24.jpg", "chessboard:13x9", "board partly outside the image"),
        ("chessboard/slambook2-distorted/distorted.png", "chessboard:9x6", "no chessboard found"),
        ("charuco/jmehami-pose/aruco_test.png", "charuco:8x6:40mm:30mm:DICT_4X4_50:legacy", "no marker"),
    ],
)
def test_images_without_a_whole_board_say_why(real_data, image, board, reason):
    assert (detect(gray_8bit(load(real_data / image).pixels), parse_board(board)).reason or "").startswith(reason)


@pytest.mark.parametrize(
    ("folder", "corners"), [("2024-05-07_lifecam_1280", 49), ("2024-06-19_lifecam_1280_Old_Pattern", 49)]
)
def test_charuco_boards_of_both_patterns_are_found(real_data, folder, corners):
    images = find_images([real_data / "charuco" / f"photonvision-{folder}" / "*.jpg"])[:2]
    board = parse_board("charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000")
    report = detect_images(DetectOptions(images, board, jobs=1))
    assert report.detections.board.legacy == ("Old" in folder)
    assert min(len(view.ids) for view in report.detections.views) >= corners


@pytest.mark.parametrize(
    ("folder", "asked", "differs", "pattern"),
    [
        ("2024-05-07_lifecam_1280", "8x8:25.4mm:15mm:DICT_4X4_1000", "markers of 19 mm, not 15 mm", ""),
        ("2024-05-07_lifecam_1280", "9x8:25.4mm:19mm:DICT_4X4_1000", "8x8 squares, not 9x8", ""),
        ("2024-06-19_lifecam_1280_Old_Pattern", "8x8:25.4mm:19mm:DICT_6X6_250", "DICT_4X4_50, not DICT_6X6_250", ""),
        ("2024-06-19_lifecam_1280_Old_Pattern", "9x7:25.4mm:19mm:DICT_4X4_1000", "8x8 squares, not 9x7", ""),
        (
            "2024-06-19_lifecam_1280_Old_Pattern",
            "8x8:25.4mm:19mm:DICT_4X4_1000:current",
            "the legacy pattern (OpenCV before 4.6), not the current pattern (OpenCV since 4.6)",
            ":legacy",
        ),
    ],
)
def test_the_charuco_board_that_images_show_is_proposed(real_data, folder, asked, differs, pattern):
    images = find_images([real_data / "charuco" / f"photonvision-{folder}" / "*.jpg"])
    with pytest.raises(InsufficientData) as raised:
        detect_images(DetectOptions(images, parse_board(f"charuco:{asked}"), jobs=1))
    words, _, form = str(raised.value).partition("; use --board ")
    assert words.endswith(f" tested images show {differs}")
    dictionary = "DICT_4X4_50" if "DICT_6X6" in asked else "DICT_4X4_1000"
    assert form == f"charuco:8x8:25.4mm:19mm:{dictionary}{pattern}"
    assert detect_images(DetectOptions(images, parse_board(form), jobs=1)).used == len(images)


@pytest.mark.parametrize("folder", ["chessboard/opencv-left-right", "other_targets/visp-grid36", "demosaic_gt/kodak24"])
def test_no_charuco_board_is_proposed_where_there_is_none(real_data, folder):
    asked = parse_board("charuco:9x7:30mm:22mm:DICT_5X5_100")
    images = [path for path in find_images([real_data / folder]) if path.suffix != ".tif"][:12]
    assert [search_charuco(gray_8bit(load(image).pixels), asked) for image in images] == [None] * len(images)


@pytest.mark.parametrize("asked", ["circles:9x7:25mm", "circles:10x7:25mm"])
def test_the_grid_of_circles_that_images_show_is_proposed(real_data, asked):
    images = [real_data / "other_targets" / "boofcv-circle-regular"]
    with pytest.raises(InsufficientData, match=r"but a grid of 10x8 circles in \d; use --board circles:10x8:25mm"):
        detect_images(DetectOptions(images, parse_board(asked), jobs=1))


def test_a_partly_hidden_charuco_board_is_used(real_data):
    image = real_data / "charuco" / "opencv-tutorial" / "chocclusion_original.jpg"
    detection = detect(gray_8bit(load(image).pixels), parse_board("charuco:5x7:40mm:20mm:DICT_6X6_250"))
    assert 18 <= len(detection.ids) < 24  # cv2.aruco.CharucoDetector: 16


@pytest.mark.parametrize(
    ("images", "board"),
    [
        ("chessboard/opencv-left-right/left*.jpg", "chessboard:9x6"),
        ("chessboard/bouguet-caltech/Image*.tif", "chessboard:12x13"),
        ("pnp/visp-handeye-chessboard/franka_image-*.png", "chessboard:9x6"),
    ],
)
def test_a_board_is_numbered_alike_in_all_views_of_a_set(real_data, images, board):
    """The square before corner 0 is dark in every view; id 0 is one corner of the board, as its colours say."""
    wanted = parse_board(board)
    for path in find_images([real_data / images])[:8]:
        gray = gray_8bit(load(path).pixels)
        grid = find_chessboard(gray, wanted).pixels.reshape(wanted.rows, wanted.columns, 2)
        before = np.rint(1.4 * grid[0, 0] - 0.4 * grid[1, 1]).astype(int)
        beside = np.rint(grid[0, 0] + 0.4 * (grid[0, 1] - grid[0, 0]) - 0.4 * (grid[1, 0] - grid[0, 0])).astype(int)
        assert int(gray[before[1], before[0]]) + 20 < int(gray[beside[1], beside[0]])


@pytest.mark.parametrize(
    ("images", "board"),
    [
        ("stereo_rig/boofcv-bumblebee2-chess/left*.jpg", "chessboard:6x4"),
        ("stereo_rig/boofcv-bumblebee2-chess/right*.jpg", "chessboard:6x4"),
        ("multicam/boofcv-trinocular/right/right1*.jpg", "chessboard:13x9"),
    ],
)
def test_rows_of_a_board_that_looks_the_same_turned_run_alike_in_all_views(real_data, images, board):
    """Upright in these sets, or on its side leaning both ways: one end stays the first in all views."""
    wanted = parse_board(board)
    for path in find_images([real_data / images]):
        grid = find_chessboard(gray_8bit(load(path).pixels), wanted).pixels.reshape(wanted.rows, wanted.columns, 2)
        along = grid[:, -1] - grid[:, 0]
        angle = np.degrees(np.arctan2(*along.sum(axis=0)[::-1]))
        assert -70 < angle < 110  # half a turn around 20°, see grid.uprightness


def test_a_board_that_leaves_the_image_is_numbered_by_the_sides_in_sight(real_data):
    for name, first in (("left24", 1), ("left27", 13)):  # its first column, its first row is outside
        gray = gray_8bit(load(real_data / TRINOCULAR / "left" / f"{name}.jpg").pixels)
        detection = find_chessboard(gray, parse_board("chessboard:13x9"), partial=True)
        assert detection.ids[0] == first
        assert len(detection.ids) in (104, 108)


def test_a_picture_of_the_board_on_a_screen_is_not_the_board(real_data):
    gray = gray_8bit(load(real_data / "chessboard" / "opencv-left-right" / "left12.jpg").pixels)
    grid = find_chessboard(gray, parse_board("chessboard:9x6")).pixels
    assert np.ptp(grid, axis=0).min() > 200  # px; the picture on the screen is smaller than 100


@pytest.mark.parametrize("folder", ["demosaic_gt/kodak24", "stereo_gt/middlebury2014-motorcycleQ"])
def test_photographs_without_a_board_have_none(real_data, folder):
    for path in find_images([real_data / folder / "*.png"])[:8]:
        gray = gray_8bit(load(path).pixels)
        assert not detect(gray, parse_board("chessboard:3x3"), partial=True).found
        assert not detect(gray, parse_board("charuco:5x4:40mm:30mm:DICT_4X4_50")).found


@pytest.mark.parametrize(
    ("images", "board", "limit"),
    [
        # RMS with the corners of SB and of findChessboardCorners + cornerSubPix: 0.130, 0.082 px
        ("stereo_rig/boofcv-bumblebee2-chess/left*.jpg", "chessboard:6x4", 0.075),
        # 0.242, 0.152 px
        ("chessboard/boofcv-sony-hx5v-chess/frame*.jpg", "chessboard:6x4", 0.145),
    ],
)
def test_corners_lead_to_a_smaller_reprojection_error_than_those_of_opencv(real_data, images, board, limit):
    wanted = parse_board(board)
    grays = [gray_8bit(load(path).pixels) for path in find_images([real_data / images])]
    found = [detect(gray, wanted) for gray in grays]
    pixels = [detection.pixels.astype(np.float32)[:, None] for detection in found]
    points = [wanted.points().astype(np.float32)[detection.ids] for detection in found]
    assert cv2.calibrateCamera(points, pixels, grays[0].shape[::-1], None, None)[0] < limit
