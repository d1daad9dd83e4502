"""Simulated motions: what they promise to who follows them."""

import motion
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose

STAMPS = np.arange(200) / 30
MIDDLE = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))


def test_accelerations_have_the_density_that_is_asked_for():
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(10):
        places = motion.drifting(STAMPS, MIDDLE, (0.02, 0.5), rng).translations
        squares.append((np.diff(places, n=2, axis=0) ** 2).mean())
    # the second difference of white-noise acceleration has the variance q dt³ 2/3
    assert np.mean(squares) == pytest.approx(0.02 * (1 / 30) ** 3 * 2 / 3, rel=0.08)  # 6000 correlated squares


def test_a_swaying_object_stays_within_its_reach():
    truth = motion.swaying(STAMPS, MIDDLE, 0.1, 0.3, np.random.default_rng(2))
    assert 0.05 < np.abs(truth.translations - MIDDLE.translation).max() <= 0.1


def test_frames_are_dropped_and_spoilt_by_the_shares_asked_for():
    camera = Camera(model_named("pinhole"), (640, 480), np.array([500.0, 500.0, 319.5, 239.5]))
    truth = motion.swaying(STAMPS, MIDDLE, 0.01, 0.1, np.random.default_rng(3))
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]])
    seen = motion.seen(camera, points, truth, 0.1, np.random.default_rng(4), dropped=0.2, outliers=0.1)
    there = [index for index, pixels in enumerate(seen) if pixels is not None]
    assert len(there) == pytest.approx(160, abs=17)  # 3 standard deviations
    ideal = [camera.project(truth.pose(index).apply(points)).pixels for index in there]
    off = np.array([np.sqrt(((seen[index] - pixels) ** 2).mean()) for index, pixels in zip(there, ideal, strict=True)])
    assert 0.02 < (off > 1.0).mean() < 0.2
    assert np.median(off) == pytest.approx(0.1, rel=0.2)
