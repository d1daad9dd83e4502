"""Point clouds of real pairs whose scale is known from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.formats import disparity, pair_calibration
from camcal.images.files import load
from camcal.stereo.cloud import CloudMaker
from camcal.stereo.depth import Frame, StereoImage
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.selection import Selection, select

# As the textbook prints them; KITTI's own calibration has a baseline of 0.537 m.
STREET = StereoGeometry(718.856, 718.856, 607.1928, 185.2157, 0.573)
CAMERAS_ABOVE_ROAD = 1.65  # metres, KITTI's sensor setup


def cloud_of(image):
    selected = select(image, Selection(), Frame())
    return np.concatenate(list(CloudMaker(image, selected.kept, normals=True).stream().blocks))


def distance_of_plane(points):
    """Return how far from the camera the plane y = a x + b z + c passes, fitted to points, some of them strangers."""
    columns = np.stack([points["x"], points["z"], np.ones(len(points))], axis=1).astype(float)
    weight = np.ones(len(points))
    for _ in range(10):
        a, b, c = np.linalg.lstsq(columns * weight[:, None], points["y"] * weight, rcond=None)[0]
        weight = 1 / np.hypot(1, (points["y"] - columns @ (a, b, c)) / 0.05)
    return c / np.sqrt(1 + a * a + b * b)


@pytest.mark.parametrize("baseline", [0.573, 0.537])
def test_the_street_lies_below_the_car_by_the_height_of_its_cameras_times_the_baseline(real_data, baseline):
    folder = real_data / "stereo_gt" / "slambook2-ch5-ch8" / "ch8"
    found = disparity.read(folder / "disparity.png")
    geometry = replace(STREET, baseline=baseline)
    cloud = cloud_of(StereoImage(found.values, geometry, pixels=load(folder / "left.png").pixels))
    road = (abs(cloud["x"]) < 1.5) & (cloud["z"] < 15) & (cloud["y"] > 1.2)
    assert road.sum() > 20000
    # disparities are whole pixels; the book's baseline would be 7 % off
    assert distance_of_plane(cloud[road]) == pytest.approx(CAMERAS_ABOVE_ROAD * baseline / 0.537, rel=0.02)
    assert "intensity" in cloud.dtype.names


def test_the_floor_below_the_motorcycle_is_flat_and_its_normals_agree(real_data):
    folder = real_data / "stereo_gt" / "middlebury2014-motorcycleQ"
    geometry = pair_calibration.read(folder / "calib.txt").geometry
    image = StereoImage(disparity.read(folder / "disp0GT.pfm").values, geometry, pixels=load(folder / "im0.png").pixels)
    cloud = cloud_of(image)
    points = np.stack([cloud[name] for name in "xyz"], axis=1).astype(float)
    floor = points[:, 1] > np.quantile(points[:, 1], 0.85)
    normal = np.linalg.svd(points[floor] - points[floor].mean(axis=0), full_matrices=False)[2][2]
    normal *= -np.sign(normal[1])
    assert (points[floor] @ normal).std() < 0.01  # metres, of a floor four metres long
    found = np.stack([cloud[name][floor] for name in ("nx", "ny", "nz")], axis=1)
    angles = np.degrees(np.arccos(np.clip(found @ normal, -1, 1)))
    assert np.nanmedian(angles) < 2  # the truth was measured with structured light, to about 0.1 px


def test_middlebury_disparities_lie_in_the_range_that_its_calibration_states(real_data):
    values = disparity.read(real_data / "stereo_gt" / "middlebury2014-motorcycleQ" / "disp0GT.pfm").values
    known = values[np.isfinite(values)]
    assert values.shape == (497, 741)
    assert known.min() >= 7
    assert known.max() <= 65
