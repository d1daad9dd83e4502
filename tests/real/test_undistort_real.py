"""A real image through the whole command: the textbook's picture to the last pixel, and OpenCV's closely."""

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import load
from camcal.images.options import ViewOptions
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

# the camera of the image, as the textbook states it (EuRoC cam0)
PARAMETERS = np.array([458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05])
KEEP = ViewOptions(keep_k=True)


@pytest.fixture
def scene(real_data):
    path = real_data / "chessboard" / "slambook2-distorted" / "distorted.png"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    return path


def undistorted(scene, folder, **options):
    native.write(folder / "lens.yaml", CameraFile({"cam0": CameraEntry(Camera(
        model_named("opencv4"), (752, 480), PARAMETERS
    ))}))  # fmt: skip
    undistort(UndistortOptions(str(folder / "lens.yaml"), folder / "out", (str(scene),), **options))
    return load(folder / "out" / scene.name).pixels


def test_the_textbook_picture_comes_out_to_the_last_pixel(scene, tmp_path):
    fx, fy, cx, cy, k1, k2, p1, p2 = PARAMETERS
    image = load(scene).pixels
    v, u = np.mgrid[:480, :752].astype(float)
    x, y = (u - cx) / fx, (v - cy) / fy
    square = x * x + y * y
    radial = 1 + k1 * square + k2 * square * square
    u_d = fx * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + cx
    v_d = fy * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + cy
    inside = (u_d >= 0) & (v_d >= 0) & (u_d < 752) & (v_d < 480)
    expected = np.zeros_like(image)
    expected[inside] = image[v_d[inside].astype(int), u_d[inside].astype(int)]
    drawn = undistorted(scene, tmp_path, view=KEEP, interpolation="nearest-truncate")
    np.testing.assert_array_equal(drawn, expected)


def test_opencv_draws_the_same_picture(scene, tmp_path):
    fx, fy, cx, cy = PARAMETERS[:4]
    theirs = cv2.undistort(load(scene).pixels, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), PARAMETERS[4:])
    apart = cv2.absdiff(theirs, undistorted(scene, tmp_path, view=KEEP))
    # OpenCV rounds positions to 1/32 px: a few levels at the strongest edges, none to speak of elsewhere
    assert apart.max() <= 6
    assert apart.mean() < 0.1


def test_the_crop_is_full_and_the_wide_view_has_empty_corners(scene, tmp_path):
    border = (255.0,)
    crop = undistorted(scene, tmp_path / "a", view=ViewOptions(alpha=0), border=border, mask=True)
    assert load(tmp_path / "a" / "out" / "valid_mask.png").pixels.min() == 255
    wide = undistorted(scene, tmp_path / "b", view=ViewOptions(alpha=1), border=border)
    assert (wide[[5, 5, -5, -5], [300, 375, 375, 300]] == 255).all()  # above and below a barrel's picture
    assert crop.shape == wide.shape == (480, 752)
