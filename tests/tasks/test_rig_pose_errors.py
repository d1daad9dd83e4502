"""From simulated captures to a rig file to poses: their errors are as large as the file's covariance says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import Captures, RigOptions
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_rig_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.formats.camera_file import CameraEntry, CameraFile, JointCovariance, Transform, rig_of
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.03)
CAMERAS = {
    "left": Camera(model_named("opencv4"), (1280, 960), [1000.0, 1002, 640, 480, -0.1, 0.05, 1e-4, -2e-4]),
    "right": Camera(model_named("opencv4"), (960, 720), [800.0, 801, 480, 360, -0.12, 0.05, 1e-4, -2e-4]),
}
RIGHT_T_LEFT = Pose.from_vector(np.array([0.01, -0.15, 0.02]), np.array([-0.2, 0.002, 0.004]))
FROM_LEFT = {"left": Pose.identity(), "right": RIGHT_T_LEFT}
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.1
RUNS = 60


def calibrated(poses, rng):
    """Return the rig of a file that is made of captures of the board at these poses."""
    seen = [
        observe(camera, BOARD, [FROM_LEFT[name] @ pose for pose in poses], rng=rng, noise_px=0.2)[0]
        for name, camera in CAMERAS.items()
    ]
    captures = Captures(tuple(CAMERAS), tuple(map(str, range(len(poses)))), tuple(zip(*seen, strict=True)))
    models = {name: camera.model for name, camera in CAMERAS.items()}
    found = calibrate_rig(captures, BOARD, RigOptions(models, shape=ShapeOptions(smooth=False, offsets=False)))
    entries = {name: CameraEntry(own.camera) for name, own in found.calibrations.items()}
    transforms = {"right_T_left": Transform(found.poses["right"], found.pose_covariance("right"))}
    return rig_of(CameraFile(entries, transforms, JointCovariance(found.names, found.covariance)), "rig.yaml")[0]


def distance(rig, truth):
    """Return the squared error of a pose from exact pixels in standard deviations of the calibration's part."""
    seen = [
        Correspondences("a", CUBE, camera.project((FROM_LEFT[name] @ truth).apply(CUBE)).pixels, camera=name)
        for name, camera in CAMERAS.items()
    ]
    found = estimate_rig_poses(rig, [seen], PoseOptions(noise_px=0.05, outliers="none"))[0].value
    step = (found.transform @ truth.inverse()).vector()
    error = np.concatenate([found.transform.translation - truth.translation, step])
    return error @ np.linalg.pinv(found.covariance - found.noise_covariance, rcond=1e-14) @ error


@pytest.mark.slow
def test_errors_of_poses_are_those_that_the_rig_file_says():
    rng = np.random.default_rng(3)
    poses = views(CAMERAS["left"], BOARD, 15, rng=rng)
    joint, lenses = [], []
    for _ in range(RUNS):
        rig = calibrated(poses, rng)
        truth = Pose.from_vector(rng.normal(0, 0.4, 3), np.array([0.1, 0, 1.2]) + rng.normal(0, 0.05, 3))
        joint.append(distance(rig, truth))
        lenses.append(distance(replace(rig, covariance=None), truth))
    low, high = stats.chi2.interval(0.99, 6 * RUNS)
    # a covariance from the scatter of 15 captures is itself known to 10 %
    assert 0.85 * low < sum(joint) < 1.2 * high
    assert sum(lenses) > 10 * high  # transforms taken as exact
