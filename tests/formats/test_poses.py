"""Pose files: the three forms hold the same numbers, and other programs read them."""

import csv
import json

import numpy as np
import pytest
import yaml

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.estimate.pnp import Correspondences, estimate_poses
from camcal.formats import poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

TAG = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.05


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(1)
    camera = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 320.0, 240.0])
    truth = Pose.from_vector(np.array([0.4, 0.1, 0]), np.array([0.1, 0, 2.0]))
    pixels = camera.project(truth.apply(TAG)).pixels + rng.normal(0, 0.3, (4, 2))
    estimate = estimate_poses(camera, [Correspondences("a, b.png", TAG, pixels)])[0].value
    assert estimate.alternative is not None
    return poses.Poses("camera_T_object", "m", {"a, b.png": estimate}, {"c.png": "no board found"})


def test_yaml_and_json_hold_the_same_numbers(found, tmp_path):
    for name in ("poses.yaml", "poses.json"):
        poses.write(tmp_path / name, found)
    from_yaml = yaml.safe_load((tmp_path / "poses.yaml").read_text("utf-8"))
    assert from_yaml == json.loads((tmp_path / "poses.json").read_text("utf-8"))
    (item,), estimate = from_yaml["poses"], found.estimates["a, b.png"]
    pose = item["camera_T_object"]
    quaternion = np.array([pose["quaternion"][name] for name in ("qw", "qx", "qy", "qz")])
    # 12 significant digits are written
    np.testing.assert_allclose(so3.from_quaternion(quaternion), estimate.transform.rotation, atol=1e-11)
    np.testing.assert_allclose(so3.exp(np.array(pose["rotation_vector"])), estimate.transform.rotation, atol=1e-11)
    np.testing.assert_allclose(item["covariance"], estimate.covariance, rtol=1e-11)
    assert item["alternative"]["probability"] == pytest.approx(estimate.p_wrong, rel=1e-11)
    assert from_yaml["missing"] == [{"image": "c.png", "reason": "no board found"}]
    assert from_yaml["noise"]["degrees_of_freedom"] == 2


def test_a_csv_row_has_the_pose_and_the_upper_triangle_of_its_covariance(found, tmp_path):
    path = tmp_path / "poses.csv"
    poses.write(path, found)
    first, *lines = path.read_text("utf-8").splitlines()
    assert first.startswith("# camcal-poses 1 frames=camera_T_object unit=m sigma_px=")
    (row,) = csv.DictReader(line for line in lines if not line.startswith("#"))
    estimate = found.estimates["a, b.png"]
    assert row["image"] == "a, b.png"
    assert [float(row[name]) for name in ("tx", "ty", "tz")] == pytest.approx(estimate.transform.translation.tolist())
    assert float(row["cov_tz_rx"]) == pytest.approx(estimate.covariance[2, 3], rel=1e-11)
    assert lines[-1] == "# none c.png,no board found"


def test_other_kinds_of_file_are_refused(found, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.yaml, \.yml, \.json, \.csv"):
        poses.write(tmp_path / "poses.txt", found)
