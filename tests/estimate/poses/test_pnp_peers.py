"""The same minimum as PoseLib, where that is installed: an independent implementation on the same pixels."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.geometry.pose import Pose

poselib = pytest.importorskip("poselib")

PINHOLE = Camera(model_named("pinhole"), (1280, 960), [800.0, 805.0, 640.0, 480.0])
PEER = {"model": "PINHOLE", "width": 1280, "height": 960, "params": PINHOLE.parameters.tolist()}


@pytest.mark.parametrize("flat", [False, True], ids=["solid", "plane"])
@pytest.mark.parametrize("noise_px", [0.0, 0.5])
def test_poselib_finds_the_same_pose(flat, noise_px):
    rng = np.random.default_rng(1)
    for _ in range(5):
        truth = Pose.from_vector(rng.normal(0, 0.4, 3), np.array([0.05, 0.0, rng.uniform(1.5, 3.0)]))
        points = rng.uniform(-0.5, 0.5, (50, 3)) * [1, 1, 0 if flat else 1]
        pixels = PINHOLE.project(truth.apply(points)).pixels + noise_px * rng.standard_normal((50, 2))
        options = PoseOptions(noise_px=1.0, outliers="many", threshold_px=12.0)
        found = estimate_poses(PINHOLE, [Correspondences("a", points, pixels)], options)[0].value.transform
        settings = {"loss_type": "TRIVIAL", "gradient_tol": 1e-14, "step_tol": 1e-14, "max_iterations": 200}
        start = poselib.CameraPose()
        start.R, start.t = found.rotation, found.translation + 1e-3
        refined, _ = poselib.refine_absolute_pose(pixels, points, start, PEER, settings)
        np.testing.assert_allclose(refined.R, found.rotation, atol=1e-6)
        np.testing.assert_allclose(refined.t, found.translation, atol=1e-6)
        robust, _ = poselib.estimate_absolute_pose(pixels, points, PEER, {"seed": 1}, settings)
        np.testing.assert_allclose(robust.R, found.rotation, atol=1e-6)
        np.testing.assert_allclose(robust.t, found.translation, atol=1e-6)
