"""Hand and eye of rendered images, from pixels to transforms."""

import numpy as np
import pytest
from robot_scenes import CARRIER, hand_of, write_poses

from camcal.formats import cameras, poses
from camcal.geometry import rotation as so3

BOARD = "chessboard:9x6:25mm"


@pytest.mark.slow
def test_an_exact_robot_and_rendered_images_give_the_hand_to_hundredths_of_a_millimetre(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("simulate", BOARD, "--size", "800x600", "--views", "15", "--seed", "1", "-o", "first")[0] == 0
    assert run("simulate", BOARD, "first/truth.yaml", "--views", "15", "--seed", "2", "-o", "second")[0] == 0
    assert run("calibrate", "first/images", "-b", BOARD, "-o", "camera.yaml")[0] == 0
    listed = poses.read(tmp_path / "second" / "poses.csv").estimates
    exact = [record.transform for record in listed.values()]
    write_poses(tmp_path / "robot.csv", hand_of(exact), before=[key.image.split("/")[-1] for key in listed])
    for option in ((), ("--free-lens",)):
        code, _, err = run(
            "handeye", "camera.yaml", "second/images", "--robot", "robot.csv", "-b", BOARD, *option, "-o", "hand.yaml",
            "--overwrite",
        )  # fmt: skip
        assert code == 0, err
        found = cameras.read(tmp_path / "hand.yaml").transforms["hand_T_camera"]
        apart = found.pose.translation - CARRIER.translation
        assert np.linalg.norm(apart) < 3e-5
        assert np.linalg.norm(so3.log(found.pose.rotation @ CARRIER.rotation.T)) < np.radians(0.005)
        assert (np.abs(apart) < 4 * np.sqrt(np.diag(found.covariance))[:3]).all()
