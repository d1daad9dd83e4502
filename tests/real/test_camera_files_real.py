"""Camera files that OpenCV's own programs have written, against what cv2 reads in them."""

import cv2
import numpy as np
import pytest

from camcal.formats import cameras
from camcal.formats.cameras.record import Given

MONO = ("chessboard/opencv-left-right/left_intrinsics.yml", "charuco/opencv-tutorial/tutorial_camera_charuco.yml")
PAIR = "chessboard/opencv-left-right/intrinsics.yml"


def nodes(path, *names):
    """Return matrices of a file as OpenCV reads them."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    return [storage.getNode(name).mat() for name in names]


@pytest.mark.parametrize("name", MONO)
def test_a_file_of_calibration_cpp_is_what_opencv_reads_in_it(real_data, name, tmp_path):
    matrix, coefficients = nodes(real_data / name, "camera_matrix", "distortion_coefficients")
    file = cameras.read(real_data / name)
    lens = file.cameras["camera"].camera
    assert lens.image_size == (640, 480)
    assert np.array_equal(lens.K, matrix)
    assert np.array_equal(lens.dist, coefficients.ravel())
    assert 0.1 < file.cameras["camera"].quality["rms_px"] < 0.5
    cameras.write(tmp_path / "again.json", file, cameras.FORMATS["opencv"])
    assert np.array_equal(nodes(tmp_path / "again.json", "camera_matrix")[0], matrix)


def test_a_file_of_stereo_calib_cpp_is_what_opencv_reads_in_it(real_data):
    expected = nodes(real_data / PAIR, "M1", "D1", "M2", "D2")
    file = cameras.read(real_data / PAIR, given=Given((640, 480)))
    lenses = [file.cameras[side].camera for side in ("left", "right")]
    found = [each for lens in lenses for each in (lens.K, lens.dist[None])]
    assert all(np.array_equal(*both) for both in zip(found, expected, strict=True))


@pytest.mark.parametrize(
    ("name", "models"),
    [
        ("opencv_left_intrinsics.yml", ["opencv5"]),
        ("ros_plain.yaml", ["opencv5"]),
        ("ros_rtabmap_style.yaml", ["opencv5"]),
        ("kalibr_openvins_tumvi_equi.yaml", ["kannala_brandt4"] * 2),
        ("kalibr_openvins_euroc_T_imu_cam.yaml", ["opencv4"] * 2),
    ],
)
def test_files_of_other_programs_come_back_from_camcals_own(real_data, tmp_path, name, models):
    folder = real_data.parent / "reference" / "format_examples"
    if not folder.is_dir():
        pytest.skip(f"no example files in {folder}")
    file = cameras.read(folder / name)
    assert [entry.camera.model.name for entry in file.cameras.values()] == models
    cameras.write(tmp_path / "own.yaml", file, cameras.FORMATS["camcal"])
    again = cameras.read(tmp_path / "own.yaml")
    for camera_name, entry in file.cameras.items():
        assert again.cameras[camera_name].camera.parameters.tolist() == entry.camera.parameters.tolist()
    for key, item in file.transforms.items():
        assert np.abs(again.transforms[key].pose.matrix() - item.pose.matrix()).max() < 1e-12
