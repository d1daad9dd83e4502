"""A real robot through `camcal handeye`, beside what others published of it."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from robot_scenes import stacked

from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, estimate_known, prior_of
from camcal.calibrate.robot.estimator import estimate_robot
from camcal.calibrate.robot.problem import Poses, RobotPoses, closed_form
from camcal.cameras.observations import Observations
from camcal.formats import cameras, detections
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.check_options import HandEyeOptions
from camcal.tasks.calibration.handeye import handeye
from camcal.tasks.calibration.options import CalibrateOptions

PUBLISHED = np.array([0.05772, -0.03392, -0.04228])  # of eMc, by ViSP, with residuals of 5.4 mm and 0.46°
COUNT = 8


@pytest.fixture(scope="module")
def franka(real_data, tmp_path_factory):
    """A folder with a camera file, corners, and the poses of the hand with the names of their images; these poses."""
    folder, made = real_data / "pnp" / "visp-handeye-chessboard", tmp_path_factory.mktemp("franka")
    robot = []
    for number in range(1, COUNT + 1):
        text = (folder / f"franka_pose_rPe_{number}.yaml").read_text()
        robot.append(np.array(re.findall(r"\[([-\d.e]+)\]", text), float))
    named = zip(range(1, COUNT + 1), robot, strict=True)
    lines = [f"franka_image-{number}.png,{','.join(map(str, row))}" for number, row in named]
    (made / "robot.csv").write_text("\n".join(lines))
    calibrate(
        CalibrateOptions(
            (str(folder),),
            board="chessboard:9x6:23.6mm",
            output=made / "camera.yaml",
            save_detections=made / "corners.csv",
        )
    )
    return made, [Pose.from_vector(row[3:], row[:3]) for row in robot]


def test_a_camera_on_a_real_hand_is_where_visp_has_it_and_its_wrong_lengths_are_told(franka):
    folder, _ = franka
    options = HandEyeOptions(
        str(folder / "camera.yaml"), (str(folder / "corners.csv"),), folder / "robot.csv", output=folder / "hand.yaml"
    )
    report = handeye(options)
    assert report.words == "rvec:rad, base_T_hand, m"
    found = report.transforms["hand_T_camera"]
    std = np.sqrt(np.diag(found.covariance))[:3]
    assert (np.abs(found.pose.translation - PUBLISHED) < 2 * std).all()
    # a robot of 0.1 mm that is off by 3 mm: its noise is 0.8 mm once the lengths are free
    assert report.systematic["scale"][0] == pytest.approx(-0.13, abs=0.01)
    assert "robot_scale" in [each.code for each in report.warnings]
    assert report.noise[0][0] > 2.5e-3
    free = handeye(replace(options, robot_scale=True, output=folder / "free.yaml"))
    assert free.noise[0][0] < 1e-3


@pytest.mark.slow
def test_halves_of_a_real_set_agree_within_two_standard_deviations(franka):
    folder, poses = franka
    views, file = detections.read(folder / "corners.csv").views, cameras.read(folder / "camera.yaml")
    entry = file.cameras["camera"]
    scores = []
    for first in list(combinations(range(COUNT), COUNT // 2))[: 70 // 2 : 4]:
        found = []
        for half in (first, [place for place in range(COUNT) if place not in first]):
            seen = Observations.of([views[place] for place in half])
            known = KnownCamera(entry.camera, entry.noise.sigma_px, seen, np.arange(len(half)))
            rig, _ = estimate_known([known], [Pose.identity()], KnownBoard(file.board_shape, 8.0), {0: prior_of(known)})
            own = [poses[place] for place in half]
            robot = RobotPoses(stacked(own), np.arange(len(half)), True, (1.0, 1.0), np.ones(len(half)))
            camera = Poses(rig.state.rotations, rig.state.translations)
            found.append(estimate_robot(rig.problem, rig.state, robot, closed_form(robot.world_T_carrier, camera)))
        one, other = (each.carrier_T_rig for each in found)
        apart = np.r_[one.translation - other.translation, so3.log(one.rotation @ other.rotation.T)]
        scores.append(apart / np.sqrt(np.diag(found[0].covariance + found[1].covariance))[:6])
    assert np.mean(np.abs(scores) < 2) >= 0.95  # 97.1 % of all 35 ways to halve it
