"""Process noise from the evidence of a track: found again where it is known, and not taken from outliers."""

import motion
import numpy as np
import pytest
from moving_objects import glances

from camcal.estimate.tracking.track import track_poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

MIDDLE = Pose(so3.about_x(2.6), np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize(("densities", "rate"), [((0.02, 0.5), 30.0), ((2.0, 0.005), 8.0)])
def test_densities_are_found_again(densities, rate):
    rng = np.random.default_rng(3)
    truth = motion.drifting(np.arange(150) / rate, MIDDLE, densities, rng)
    noise = track_poses(truth.stamps, glances(truth, rng, dropped=0.1, outliers=0.05)).noise
    for found, true, factor in zip(noise.densities, densities, noise.factors, strict=True):
        assert 1.02 < factor < 2.0
        assert abs(np.log(found / true)) < 0.6  # three standard deviations: 150 frames tell it to a fifth
