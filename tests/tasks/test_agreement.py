"""When two results of a calibration agree, and what is said of a difference."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.tasks.reports.rerun import differences

STD = np.array([1.0, 1.0, 0.5, 0.5])
LEFT = CameraEntry(
    Camera(model_named("pinhole"), (640, 480), np.array([500.0, 500.0, 319.5, 239.5]), np.diag(STD**2)),
    quality={"rms_px": 0.1},
    verdict=CalibrationVerdict(trustworthy=True),
)
BESIDE = Transform(Pose(np.eye(3), np.array([-0.1, 0.0, 0.0])), np.diag(np.full(6, 1e-6)))
BEFORE = CameraFile({"left": LEFT, "right": LEFT}, {"right_T_left": BESIDE})


def named(**changes):
    """The names of the figures that differ after changes of the left camera."""
    return [each.name for each in differences(BEFORE, replace(BEFORE, cameras={**BEFORE.cameras, **after(**changes)}))]


def after(**changes):
    return {"left": replace(LEFT, **changes)}


def moved(parameter, by):
    parameters = LEFT.camera.parameters.copy()
    parameters[LEFT.camera.model.parameter_names.index(parameter)] += by
    return replace(LEFT.camera, parameters=parameters)


def test_a_result_agrees_with_itself():
    assert differences(BEFORE, BEFORE) == []


@pytest.mark.parametrize(("parameter", "std"), [("fx", 1.0), ("cy", 0.5)])
def test_figures_differ_by_more_than_a_millionth_of_their_standard_deviation(parameter, std):
    assert named(camera=moved(parameter, 0.7e-6 * std)) == []
    assert named(camera=moved(parameter, 1.5e-6 * std)) == [f"left.{parameter}"]


def test_standard_deviations_are_figures_too():
    assert named(camera=replace(LEFT.camera, covariance=np.diag((STD * [1.1, 1, 1, 1]) ** 2))) == ["left.fx std"]


def test_a_figure_that_is_no_longer_there_differs():
    assert named(quality={}) == ["left.rms_px"]
    assert named(quality={"rms_px": 0.1, "images_used": 9.0}) == ["left.images_used"]


@pytest.mark.parametrize(
    ("verdict", "words"), [(CalibrationVerdict(trustworthy=False), "not trustworthy"), (None, "unknown")]
)
def test_another_verdict_is_a_difference(verdict, words):
    (found,) = differences(BEFORE, replace(BEFORE, cameras={**BEFORE.cameras, **after(verdict=verdict)}))
    assert found.line == f"left: verdict: trustworthy in the report, {words} now"


def test_images_of_another_size_are_of_another_lens():
    assert named(camera=replace(LEFT.camera, image_size=(641, 480))) == ["left: lens model"]


def test_a_transform_that_is_new_gone_or_moved_is_a_difference():
    more = replace(BEFORE, transforms={**BEFORE.transforms, "third_T_left": BESIDE})
    assert [each.name for each in differences(BEFORE, more)] == ["transforms"]
    assert [each.name for each in differences(more, BEFORE)] == ["transforms"]
    shifted = replace(BESIDE, pose=Pose(np.eye(3), np.array([-0.1, 0.0, 2e-9])))
    found = differences(BEFORE, replace(BEFORE, transforms={"right_T_left": shifted}))
    assert [each.name for each in found] == ["right_T_left.tz change"]
