"""Point clouds of real pairs whose scale is known from elsewhere."""

import numpy as np
import pytest

from camcal.formats import disparity
from camcal.images.load import load
from camcal.stereo.cloud import make_cloud
from camcal.stereo.geometry import StereoGeometry

# As the textbook prints them; KITTI's own calibration has a baseline of 0.537 m.
STREET = StereoGeometry(718.856, 718.856, 607.1928, 185.2157, 0.573)


def test_the_street_lies_below_the_car_by_the_height_of_its_cameras(real_data):
    folder = real_data / "stereo_gt" / "slambook2-ch5-ch8" / "ch8"
    found = disparity.read(folder / "disparity.png")
    cloud = make_cloud(found.values, STREET, load(folder / "left.png").pixels)
    x, y, z = cloud.points.T
    road = (abs(x) < 1.5) & (z < 9) & (y > 0)
    assert road.sum() > 5000
    # 1.65 m by KITTI's sensor setup, times 0.573 / 0.537; disparities are whole pixels and roads are cambered
    assert np.median(y[road]) == pytest.approx(1.65 * 0.573 / 0.537, rel=0.05)
    assert cloud.intensity is not None


def test_middlebury_disparities_lie_in_the_range_that_its_calibration_states(real_data):
    values = disparity.read(real_data / "stereo_gt" / "middlebury2014-motorcycleQ" / "disp0GT.pfm").values
    known = values[np.isfinite(values)]
    assert values.shape == (497, 741)
    assert known.min() >= 7
    assert known.max() <= 65
