"""When two cameras are a rectified pair, and what is refused."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.stereo.disparity import StereoGeometry, of_pair, pinhole_intrinsics


def camera(cx=320.0, cy=240.0, fx=500.0, model="pinhole", distortion=()):
    return Camera(model_named(model), (640, 480), np.array([fx, 500.0, cx, cy, *distortion]))


def beside(translation=(-0.1, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    return Pose.from_vector(np.array(turn), np.array(translation))


def test_a_rectified_pair_gives_baseline_and_the_offset_of_its_principal_points():
    assert of_pair(camera(cx=310.0), camera(cx=325.5), beside()) == StereoGeometry(500, 500, 310, 240, 0.1, 15.5)


@pytest.mark.parametrize(
    ("right", "right_T_left", "message"),
    [
        (camera(), beside(turn=(0, 1e-3, 0)), "axes differ by 0.001 rad"),
        (camera(), beside((-0.1, 1e-4, 0)), "not rectified"),
        (camera(cx=321.0), beside((0, -0.1, 0)), "fx, fy or cx differ by 1 px"),
        (camera(), beside((0, 0.1, 0)), "the lower camera is above the upper one: exchange"),
        (camera(model="cylinder"), beside(), "one camera is pinhole, the other cylinder"),
        (camera(), beside((-0.1, 0, 0.01)), "not rectified"),
        (camera(cy=241.0), beside(), "differ by 1 px"),
        (camera(fx=500.5), beside(), "differ by 0.5 px"),
        (camera(), beside((0.1, 0, 0)), "exchange the cameras"),
    ],
)
def test_a_pair_that_is_not_rectified_is_refused_with_the_amount(right, right_T_left, message):
    with pytest.raises(InvalidInput, match=message):
        of_pair(camera(), right, right_T_left)


def test_coefficients_that_are_all_zero_are_no_distortion():
    assert pinhole_intrinsics(camera(model="opencv5", distortion=[0.0] * 5)) == (500, 500, 320, 240)


@pytest.mark.parametrize(
    "distorted",
    [camera(model="opencv4", distortion=[0.0, 0.0, 1e-6, 0.0]), camera(model="kannala_brandt4", distortion=[0.0] * 4)],
)
def test_a_distorted_camera_is_refused_with_what_to_do(distorted):
    with pytest.raises(InvalidInput, match="undistort"):
        pinhole_intrinsics(distorted)


@pytest.mark.parametrize(
    ("model", "projection"), [("pinhole", "pinhole"), ("cylinder", "cylindrical"), ("equirectangular", "latlon")]
)
def test_a_pair_above_each_other_gives_the_offset_of_its_rows(model, projection):
    found = of_pair(camera(cy=230.0, model=model), camera(cy=234.5, model=model), beside((0, -0.1, 0)))
    assert found == StereoGeometry(500, 500, 320, 230, 0.1, 4.5, projection, "y")


@pytest.mark.parametrize(("model", "projection"), [("cylinder_x", "cylindrical"), ("latlon_x", "latlon")])
def test_views_about_the_baseline_are_a_pair_beside_each_other(model, projection):
    found = of_pair(camera(cx=310.0, model=model), camera(cx=320.0, model=model), beside())
    assert found == StereoGeometry(500, 500, 310, 240, 0.1, 10.0, projection)


def test_upright_views_are_no_pair_beside_each_other():
    with pytest.raises(InvalidInput, match="cylinder cameras whose baseline is along x"):
        of_pair(camera(model="cylinder"), camera(model="cylinder"), beside())
