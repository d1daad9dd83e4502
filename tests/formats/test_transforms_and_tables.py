"""Files that are written only: transforms of a rig for ROS, tables of a lens for Isaac Sim."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose, inverse_jacobian

LENS = Camera(MODELS["kannala_brandt4"], (64, 48), [20.0, 20.5, 30, 25, 0.01, 0, 0, 0])
RIGHT_T_LEFT = Pose.from_vector(np.array([0.3, -0.4, 0.2]), np.array([-0.11, 0.02, 0.03]))
IMU_T_LEFT = Pose.from_vector(np.array([1.1, 0.7, -0.6]), np.array([0.5, 0.6, 0.7]))
RIG = CameraFile(
    {"left": CameraEntry(LENS), "right": CameraEntry(LENS)},
    {"right_T_left": Transform(RIGHT_T_LEFT), "imu_T_left": Transform(IMU_T_LEFT)},
)
KEYS = ("x", "y", "z", "qx", "qy", "qz", "qw", "frame-id", "child-frame-id")
EXPECTED = {"right_optical_frame": RIGHT_T_LEFT.inverse(), "imu": IMU_T_LEFT.inverse()}  # left_T_…


def write(path, file=RIG):
    form = cameras.format_for(path, None, cameras.FORMATS["camcal"])
    cameras.write(path, file, form)
    assert cameras.left_out(file, form) == ()
    return path


def test_joints_of_a_robot_place_every_frame_in_the_first_camera(tmp_path):
    robot = ET.parse(write(tmp_path / "rig.urdf")).getroot()
    assert [link.get("name") for link in robot.iter("link")] == ["left_optical_frame", *EXPECTED]
    for joint in robot.iter("joint"):
        assert (joint.get("type"), joint.find("parent").get("link")) == ("fixed", "left_optical_frame")
        pose = EXPECTED[joint.find("child").get("link")]
        xyz, rpy = (np.array(joint.find("origin").get(key).split(), float) for key in ("xyz", "rpy"))
        np.testing.assert_allclose(xyz, pose.translation, atol=1e-12)
        np.testing.assert_allclose(Rotation.from_euler("xyz", rpy).as_matrix(), pose.rotation, atol=1e-12)


@pytest.mark.parametrize(("name", "run"), [("rig.launch.xml", "exec"), ("rig.launch", "type")])
def test_publishers_of_static_transforms_have_the_order_of_their_ros(tmp_path, name, run):
    nodes = list(ET.parse(write(tmp_path / name)).getroot().iter("node"))
    assert {node.get(run) for node in nodes} == {"static_transform_publisher"}
    for node in nodes:
        words = node.get("args").split()
        if run == "exec":
            assert words[::2] == [f"--{key}" for key in KEYS]
            words = words[1::2]
        assert words[7] == "left_optical_frame"
        np.testing.assert_allclose(np.array(words[:3], float), EXPECTED[words[8]].translation, atol=1e-12)
        turn = Rotation.from_quat(np.array(words[3:7], float)).as_matrix()  # x y z w
        np.testing.assert_allclose(turn, EXPECTED[words[8]].rotation, atol=1e-12)


@pytest.mark.parametrize("name", ["rig.urdf", "rig.launch"])
def test_a_file_of_transforms_needs_some_and_is_not_read(tmp_path, name):
    with pytest.raises(InvalidInput, match="has no transforms: such a file says where cameras stand"):
        write(tmp_path / name, CameraFile({"left": CameraEntry(LENS)}))
    with pytest.raises(InvalidInput, match="not read; give the camera_info of its camera"):
        cameras.read(write(tmp_path / name))


def test_a_camera_on_a_hand_hangs_on_the_hand_and_what_is_not_joined_is_said(tmp_path):
    file = CameraFile(
        {"camera": CameraEntry(LENS)}, {"hand_T_camera": Transform(IMU_T_LEFT), "base_T_board": Transform(RIGHT_T_LEFT)}
    )
    cameras.write(tmp_path / "hand.urdf", file, cameras.FORMATS["urdf"])
    (joint,) = ET.parse(tmp_path / "hand.urdf").getroot().iter("joint")
    assert (joint.find("parent").get("link"), joint.find("child").get("link")) == ("hand", "camera_optical_frame")
    xyz = np.array(joint.find("origin").get("xyz").split(), float)
    np.testing.assert_allclose(xyz, IMU_T_LEFT.translation, atol=1e-12)
    assert cameras.left_out(file, cameras.FORMATS["urdf"]) == ("base_T_board",)


def test_covariances_of_transforms_stand_beside_them_as_ros_has_them(tmp_path):
    spread = np.diag(np.arange(1.0, 7.0) * 1e-6)
    spread[0, 4] = spread[4, 0] = 5e-7
    file = CameraFile({"camera": CameraEntry(LENS)}, {"camera_T_hand": Transform(IMU_T_LEFT.inverse(), spread)})
    back = inverse_jacobian(IMU_T_LEFT.inverse())
    for name in ("hand.urdf", "hand.launch"):
        (found,) = re.findall(r"<!-- covariance .*m and rad: (.*) -->", write(tmp_path / name, file).read_text())
        numbers = np.array(found.split(), float).reshape(6, 6)
        np.testing.assert_allclose(numbers, back @ spread @ back.T, rtol=1e-9, atol=1e-18)
        assert "covariance" not in write(tmp_path / f"rig{name}").read_text()


def channels(path, names, shape):
    rows = path.read_bytes()[-shape[0] * (8 + 4 * shape[1] * len(names)) :]
    values = np.frombuffer(rows, np.uint8).reshape(shape[0], -1)[:, 8:]
    planes = np.ascontiguousarray(values).view("<f4").reshape(shape[0], len(names), -1).swapaxes(0, 1)
    return dict(zip(names, planes, strict=True))


def test_tables_for_isaac_sim_have_rays_of_pixels_and_places_of_directions(tmp_path):
    path = write(tmp_path / "camera.usda", CameraFile({"left": CameraEntry(LENS)}))
    usd = path.read_text()
    assert 'prepend apiSchemas = ["OmniLensDistortionLutAPI"]' in usd
    assert "lut:opticalCenter = (32, 24)" in usd
    rays_name, places_name = re.findall(r"@\./(.*)@", usd)
    rays = channels(tmp_path / rays_name, "BGR", (48, 64))
    u, v = 50, 10
    ray = LENS.unproject(np.array([[u, v]], float)).directions[0]
    found = [rays[name][v, u] for name in "RGB"]
    np.testing.assert_allclose(found, ray * [1, -1, -1], atol=1e-6)  # x right, y up, z back
    side = 1024
    places = channels(tmp_path / places_name, "GR", (side, side))
    # octahedral coordinates of the ray: the plane |x| + |y| + |z| = 1, forward in the middle
    x, y, z = ray * [1, -1, -1]
    assert z < 0
    across, down = np.array([x, y]) / (abs(x) + abs(y) + abs(z))
    column, row = round((across + 1) / 2 * side - 0.5), round((down + 1) / 2 * side - 0.5)
    assert places["R"][row, column] * 64 - 0.5 == pytest.approx(u, abs=0.1)
    assert places["G"][row, column] * 48 - 0.5 == pytest.approx(v, abs=0.1)
    assert places["R"][0, 0] == -1  # straight back
    with pytest.raises(InvalidInput, match=r"USD camera .* not read"):
        cameras.read(path)
