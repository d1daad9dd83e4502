"""What blur and disparity do to measurements, against simulated edges and differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal import optics


def test_motion_blur_is_the_path_in_pixels():
    assert optics.motion_blur(0.5, 0.01, 0.2e-3) == pytest.approx(25)  # 5 mm of 0.2 mm
    exposure = optics.longest_exposure(0.5, 1.0, 0.2e-3)
    assert optics.motion_blur(0.5, exposure, 0.2e-3) == pytest.approx(1)


def test_depth_is_as_uncertain_as_at_kitti():
    focal, baseline = 718.856, 386.1448 / 718.856  # the baseline is 0.537 m; 0.573 m is a common slip
    assert baseline == pytest.approx(0.5372, abs=5e-5)
    assert optics.depth_error(20, focal, baseline, 0.25) == pytest.approx(0.26, abs=5e-3)


@given(st.floats(0.5, 100), st.floats(300, 3000), st.floats(0.02, 1))
def test_the_depth_error_is_the_derivative_of_depth_by_disparity(depth, focal, baseline):
    step = 1e-4 * focal * baseline / depth
    disparity = focal * baseline / depth
    change = focal * baseline / (disparity - step) - focal * baseline / (disparity + step)
    error = optics.depth_error(depth, focal, baseline, step)
    assert error == pytest.approx(change / 2, rel=1e-7)  # a central difference is good to the step's square


def test_an_edge_is_spread_by_the_variance_of_every_blur():
    rng = np.random.default_rng(3)
    count = 400_000
    angle, radius = rng.uniform(0, 2 * np.pi, count), 2.0 * np.sqrt(rng.random(count))  # a disc of 4 px
    places = rng.random(count) + 0.5 * rng.normal(size=count) + radius * np.cos(angle) + 3 * rng.random(count)
    assert optics.edge_spread(0.5, 4.0, 3.0) == pytest.approx(places.std(), rel=5e-3)  # of so many samples 0.1 %


def test_a_blurred_edge_scatters_with_the_root_of_its_spread():
    x, noise = np.arange(-40, 41), 0.01

    def bound(spread):
        slope = np.exp(-(x**2) / (2 * spread**2)) / (np.sqrt(2 * np.pi) * spread)
        return noise / np.sqrt(np.sum(slope**2))

    assert optics.edge_noise_factor(4.0, 1.0) == pytest.approx(bound(4.0) / bound(1.0), rel=1e-3)  # sampling
    assert optics.edge_noise_factor(1.0, 1.0) == 1
