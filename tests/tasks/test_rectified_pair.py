"""Where the geometry of a pair comes from, and which source wins."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry.pose import Pose
from camcal.stereo.disparity import StereoGeometry
from camcal.tasks.stereo.options import GeometryOptions
from camcal.tasks.stereo.rectified_pair import RectifiedPair, geometry_of, pair_of

SIZE = (640, 480)
KNOWN = StereoGeometry(500.0, 501.0, 320.0, 240.0, 0.25, 3.0)
SIDECAR = Sidecar(geometry=KNOWN, relative_sigma={"fx": 0.003, "baseline": 0.004})
FLAGS = GeometryOptions(fx=700.0, cx=300.0, cy=200.0, baseline=0.5)

MIDDLEBURY = """cam0=[600 0 310; 0 600 250; 0 0 1]
cam1=[600 0 320; 0 600 250; 0 0 1]
doffs=10
baseline=200
width=640
height=480
"""
KITTI = """P0: 718 0 607 0 0 718 185 0 0 0 1 0
P1: 718 0 607 -385.5 0 718 185 0 0 0 1 0
"""


def rig(path, *, inverted=False, pair=True):
    """Write a camera file of a pair whose fx is known to 1 % and whose baseline to 2 %."""
    model = model_named("pinhole")
    covariance = np.diag([25.0, 25, 1, 1])
    left = Camera(model, SIZE, np.array([500.0, 500, 320, 240]), covariance)
    right = Camera(model, SIZE, np.array([500.0, 500, 324, 240]))
    right_T_left = Pose(np.eye(3), np.array([-0.1, 0, 0]))
    spread = np.diag([0.002, 0.001, 0.001, 1e-4, 1e-4, 1e-4]) ** 2
    name, pose = ("left_T_right", right_T_left.inverse()) if inverted else ("right_T_left", right_T_left)
    cameras = {"left": CameraEntry(left), "right": CameraEntry(right)}
    native.write(path, CameraFile(cameras, {name: Transform(pose, spread)} if pair else {}))
    return str(path)


def written(path, text):
    path.write_text(text)
    return str(path)


def test_nothing_known_is_no_geometry():
    assert geometry_of(GeometryOptions(), None, SIZE) is None
    assert geometry_of(GeometryOptions(), None, SIZE, Sidecar()) is None


def test_numbers_are_a_geometry_with_square_pixels():
    assert geometry_of(FLAGS, None, SIZE) == StereoGeometry(700.0, 700.0, 300.0, 200.0, 0.5)


def test_a_part_of_the_numbers_is_refused_by_name():
    with pytest.raises(InvalidInput, match="give --cy, --baseline, or a camera file"):
        geometry_of(GeometryOptions(fx=700.0, cx=3.0), None, SIZE)


def test_the_sidecar_is_enough():
    pair = pair_of(GeometryOptions(), None, SIZE, SIDECAR)
    assert pair.geometry == KNOWN
    assert pair.sigma_of_product == pytest.approx(0.005)


def test_a_number_given_comes_before_the_sidecar_and_counts_as_exact():
    pair = pair_of(GeometryOptions(baseline=0.5), None, SIZE, SIDECAR)
    assert pair.geometry == StereoGeometry(500.0, 501.0, 320.0, 240.0, 0.5, 3.0)
    assert pair.relative_sigma == {"fx": 0.003}


@pytest.mark.parametrize("inverted", [False, True])
def test_a_camera_file_comes_before_the_sidecar_and_says_how_well_it_knows(tmp_path, inverted):
    pair = pair_of(GeometryOptions(), rig(tmp_path / "rig.yaml", inverted=inverted), SIZE, SIDECAR)
    assert pair.geometry == StereoGeometry(500.0, 500.0, 320.0, 240.0, 0.1, 4.0)
    assert pair.relative_sigma == pytest.approx({"fx": 0.01, "baseline": 0.02})


def test_a_single_camera_gets_its_baseline_from_elsewhere(tmp_path):
    address = rig(tmp_path / "rig.yaml", pair=False) + "#left"
    with pytest.raises(InvalidInput, match="no camera to the right of it: give --baseline"):
        geometry_of(GeometryOptions(), address, SIZE)
    assert geometry_of(GeometryOptions(baseline=0.3), address, SIZE).baseline == 0.3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MIDDLEBURY, StereoGeometry(600.0, 600.0, 310.0, 250.0, 0.2, 10.0)),
        (KITTI, StereoGeometry(718.0, 718.0, 607.0, 185.0, 385.5 / 718)),
    ],
)
def test_calibrations_of_public_pairs_are_read(tmp_path, text, expected):
    found = geometry_of(GeometryOptions(), written(tmp_path / "calib.txt", text), SIZE)
    np.testing.assert_allclose(
        [found.fx, found.fy, found.cx, found.cy, found.baseline, found.doffs],
        [expected.fx, expected.fy, expected.cx, expected.cy, expected.baseline, expected.doffs],
        rtol=1e-12,
    )


@pytest.mark.parametrize("name", ["rig.yaml", "calib.txt"])
def test_a_calibration_of_another_size_is_refused_with_both(tmp_path, name):
    path = tmp_path / name
    address = rig(path) if name == "rig.yaml" else written(path, MIDDLEBURY)
    with pytest.raises(InvalidInput, match="640 × 480 pixels, the left image 320 × 240") as raised:
        geometry_of(GeometryOptions(), address, (320, 240))
    assert raised.value.where == address


def test_a_camera_named_without_a_file_is_refused():
    with pytest.raises(InvalidInput, match="'left' is one of a camera file"):
        geometry_of(GeometryOptions(camera="left"), None, SIZE)


def test_what_is_not_known_counts_as_exact():
    assert RectifiedPair(KNOWN).sigma_of_product == 0
    assert RectifiedPair(KNOWN, {"baseline": 0.01}).sigma_of_product == 0.01
