"""Cameras of a part of their images: cropped, binned, resized, with their covariance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import (
    CalibrationNoise,
    CameraEntry,
    CameraFile,
    Framing,
    JointCovariance,
    framed,
)

SIZE = (752, 480)
POINTS = np.column_stack([np.random.default_rng(1).uniform(-0.5, 0.5, (200, 2)), np.ones(200)])


def camera(model="opencv5"):
    count = len(MODELS[model].parameter_names)
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(count, count))
    parameters = [458.6, 457.3, 367.2, 248.4, *(0.01 * rng.normal(size=count - 4))]
    return Camera(MODELS[model], SIZE, np.array(parameters), factor @ factor.T)


@given(
    st.sampled_from(["pinhole", "opencv5", "opencv14", "kannala_brandt4"]),
    st.integers(0, 100),
    st.integers(0, 60),
    st.integers(1, 4),
    st.integers(1, 3),
)
def test_a_point_is_where_the_part_of_the_image_has_it(model, x, y, binning, times):
    width, height = 48 * 12, 32 * 12
    size = width // binning * times, height // binning * times
    usual = camera(model)
    found, jacobian = Framing((width, height, x, y), binning, size).of(usual)
    assert found.image_size == size
    pixels = usual.project(POINTS).pixels
    expected = ((pixels - (x, y) + 0.5) / binning * times) - 0.5
    assert np.nanmax(np.abs(found.project(POINTS).pixels - expected)) < 1e-9
    assert np.allclose(found.covariance, jacobian @ usual.covariance @ jacobian.T, rtol=1e-12)
    assert found.std("fx") == pytest.approx(usual.std("fx") * times / binning)
    assert found.std("k1") == usual.std("k1") if model != "pinhole" else True


def test_binning_leaves_out_the_last_pixels_of_an_odd_side():
    found, _ = Framing(binning=2).of(Camera(MODELS["pinhole"], (751, 481), [400.0, 400.0, 375.0, 240.0]))
    assert found.image_size == (375, 240)
    assert found.parameters.tolist() == [200.0, 200.0, 187.25, 119.75]


@pytest.mark.parametrize(
    ("framing", "said"),
    [
        (Framing(crop=(752, 480, 1, 0)), r"--crop 752x480\+1\+0: not within the image of 752x480 pixels"),
        (Framing(binning=481), "--binning 481: more than the image has pixels"),
        (Framing(scale_to=(640, 480)), "640 x 480 pixels are not resized images of 752 x 480"),
    ],
)
def test_what_is_no_part_of_the_image_is_refused(framing, said):
    with pytest.raises(InvalidInput, match=said):
        framing.of(camera())


def test_the_joint_covariance_of_a_rig_is_carried_along():
    entries = {name: CameraEntry(camera("pinhole"), noise=CalibrationNoise(0.1)) for name in ("left", "right")}
    names = (*(f"{name}.{each}" for name in entries for each in ("fx", "cx")), "right_T_left.tx")
    factor = np.random.default_rng(3).normal(size=(5, 5))
    joint = JointCovariance(names, factor @ factor.T)
    file = framed(CameraFile(entries, joint_covariance=joint), Framing(binning=2))
    half = np.diag([0.5, 0.5, 0.5, 0.5, 1.0])
    assert np.allclose(file.joint_covariance.matrix, half @ joint.matrix @ half)
    assert file.cameras["left"].noise is None
    assert file.cameras["left"].camera.image_size == (376, 240)
    assert framed(file, Framing()) is file
