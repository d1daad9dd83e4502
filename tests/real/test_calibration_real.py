"""Real sets through one command: the figures that the project promises for them."""

import numpy as np
import pytest

from camcal.formats import native
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions


@pytest.fixture(scope="module")
def gopro(real_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gopro")
    inputs = (str(real_data / "chessboard" / "udacity-gopro-wide"),)
    options = CalibrateOptions(
        inputs,
        folder / "camera.yaml",
        "chessboard:8x6",
        "opencv8",
        free_corners=False,
        save_detections=folder / "corners.csv",
    )
    return folder, calibrate(options)


def test_a_bent_board_is_no_noise_on_the_gopro_set(gopro):
    _, report = gopro
    assert report.calibration.rms_px <= 0.21  # cv2.calibrateCamera: 0.42
    assert len(report.calibration.used) >= 33


def test_free_corners_reach_the_noise_of_the_gopro_set_without_images(gopro):
    folder, smooth = gopro
    free = calibrate(CalibrateOptions((str(folder / "corners.csv"),), folder / "free.yaml", model="opencv8"))
    assert free.calibration.rms_px <= 0.16
    assert free.calibration.surface.offsets is not None
    assert native.read(folder / "free.yaml").board_shape.offsets is not None
    again = calibrate(
        CalibrateOptions((str(folder / "corners.csv"),), folder / "again.yaml", model="opencv8", free_corners=False)
    )
    assert (again.calibration.camera.parameters == smooth.calibration.camera.parameters).all()


def test_a_fisheye_needs_no_hint_but_the_board(real_data, tmp_path):
    inputs = (str(real_data / "fisheye" / "boofcv-theta-chess"),)
    report = calibrate(CalibrateOptions(inputs, tmp_path / "camera.yaml", "chessboard:6x4"))
    assert report.calibration.camera.model.name in ("kannala_brandt4", "kannala_brandt5t")
    assert report.calibration.rms_px < 0.3  # OpenCV: 3.6 with its default model, 0.62 at best


def test_charuco_of_either_pattern_is_calibrated(real_data, tmp_path):
    folder = real_data / "charuco" / "photonvision-2024-06-19_lifecam_1280_Old_Pattern"
    board = "charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000"
    images = [str(path) for path in sorted(folder.glob("*.jpg"))[::2]]
    report = calibrate(CalibrateOptions(tuple(images), tmp_path / "camera.yaml", board))
    assert report.calibration.board.legacy is True
    assert len(report.calibration.used) == len(images) == 7
    assert report.calibration.rms_px < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("images", "board"),
    [
        ("stereo_rig/boofcv-bumblebee2-chess/left*.jpg", "chessboard:6x4:30mm"),
        ("chessboard/opencv-left-right/right*.jpg", "chessboard:9x6:25mm"),
        ("fisheye/ocamcalib-fish2/Fisheye2_*.jpg", "chessboard:8x6:117mm"),
    ],
)
def test_images_and_the_detections_they_leave_lead_to_the_same_camera(real_data, tmp_path, images, board):
    table = tmp_path / "corners.csv"
    options = CalibrateOptions((str(real_data / images),), tmp_path / "a.yaml", board, save_detections=table)
    first, again = calibrate(options), calibrate(CalibrateOptions((str(table),), tmp_path / "b.yaml"))
    assert first.camera.model is again.camera.model
    std = np.sqrt(np.diag(first.camera.covariance))
    assert np.abs((again.camera.parameters - first.camera.parameters) / std).max() < 1e-6
    np.testing.assert_allclose(again.camera.covariance, first.camera.covariance, rtol=1e-6)
    assert again.trustworthy == first.trustworthy
