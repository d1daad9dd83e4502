"""Where the cameras of a rig stand, for ROS: links of a robot as URDF, or static transforms as a launch file.

Lenses are not part of either; covariances are comments. A link of URDF named CAMERA_optical_frame has the axes of a
camera's image: x right, y down, z forward (REP 103). The origin of a joint is parent_T_child; rpy turn about the fixed
axes x, y, z, in this order. Launch files are .launch.xml of ROS 2 and .launch of ROS 1.
Source: tf2_ros's static_transform_publisher: parent_T_child in metres, quaternion x y z w, then parent and child.
"""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraFile, Transform, pose_between, rig_of, transform_between
from camcal.formats.cameras.record import ANY_FRAME, EVERY_LENS, CameraFormat, write_only
from camcal.formats.emit import exact_text
from camcal.geometry import rotation
from camcal.geometry.pose import frames_of

OPTICAL = "_optical_frame"
COVARIANCE = frozenset({"covariance of transforms"})
NO_LENSES = "lenses are not part of it: write camera_info as well, --to ros"
_ABOUT_FIXED_AXES = rotation.EulerOrder("xyz", intrinsic=False)

_ROS_1 = ".launch"
_KEYS = ("x", "y", "z", "qx", "qy", "qz", "qw", "frame-id", "child-frame-id")


def frames_in_root(path: Path, file: CameraFile) -> tuple[str, dict[str, Transform]]:
    """Return the name of the frame that all others of a file hang on, and root_T_frame of these, by ROS's names.

    That is the rig's, or what a single camera is mounted on, such as a hand. Raises InvalidInput where transforms do
    not join the cameras, or there are none.
    """
    names = {name: f"{name}{OPTICAL}" for name in file.cameras}
    rig, root = rig_of(file, str(path))
    every = dict.fromkeys((*rig.cameras, *(frame for name in file.transforms for frame in frames_of(name))))
    if len(file.cameras) == 1:
        root = next((each for each in every if each != root and pose_between(file, each, root) is not None), root)
    poses = {frame: transform_between(file, root, frame) for frame in every if frame != root}
    if not poses:
        raise InvalidInput("has no transforms: such a file says where cameras stand", where=str(path))
    found = {names.get(frame, frame): pose for frame, pose in poses.items() if pose is not None}
    return names.get(root, root), found


def covariance_lines(transform: Transform) -> list[str]:
    """Return a comment with a covariance in ROS's order, which is the one of steps here; none where it is not known."""
    if transform.covariance is None:
        return []
    numbers = " ".join(map(exact_text, transform.covariance.ravel().tolist()))
    return [f"<!-- covariance of geometry_msgs/PoseWithCovariance, m and rad: {numbers} -->"]


def write_urdf(path: Path, file: CameraFile) -> None:
    """Write the frames as links on one root; raises InvalidInput as `frames_in_root` does, FileError."""
    root, poses = frames_in_root(path, file)
    lines = ['<?xml version="1.0"?>', '<robot name="rig">', f"  <link name={quoteattr(root)}/>"]
    for name, item in poses.items():
        pose = item.pose
        angles = rotation.to_euler(pose.rotation, _ABOUT_FIXED_AXES)[0]
        xyz, rpy = (" ".join(map(exact_text, values.tolist())) for values in (pose.translation, angles))
        lines += [
            f"  <link name={quoteattr(name)}/>",
            f'  <joint name={quoteattr(f"{root}_to_{name}")} type="fixed">',
            f"    <parent link={quoteattr(root)}/>",
            f"    <child link={quoteattr(name)}/>",
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            *(f"    {line}" for line in covariance_lines(item)),
            "  </joint>",
        ]
    files.write_text(path, "\n".join([*lines, "</robot>", ""]))


URDF = CameraFormat(
    name="urdf",
    title="URDF robot",
    suffixes=(".urdf",),
    models=EVERY_LENS,
    read=write_only("URDF robot"),
    write=write_urdf,
    poses="origin: root_T_frame, rpy about fixed axes; covariance as a comment",
    keeps=COVARIANCE,
    note=NO_LENSES,
    frames=ANY_FRAME,
)


def write_ros_tf(path: Path, file: CameraFile) -> None:
    """Write a publisher for every frame; raises InvalidInput as `frames_in_root` does, FileError."""
    root, poses = frames_in_root(path, file)
    old = path.suffix.lower() == _ROS_1
    run = "type" if old else "exec"
    lines = ["<launch>"]
    for name, item in poses.items():
        pose = item.pose
        w, *imaginary = rotation.to_quaternion(pose.rotation).tolist()
        values = [*(exact_text(value) for value in (*pose.translation.tolist(), *imaginary, w)), root, name]
        words = values if old else [f"--{key} {value}" for key, value in zip(_KEYS, values, strict=True)]
        node = f'  <node pkg="tf2_ros" {run}="static_transform_publisher" name={quoteattr(f"{name}_publisher")}'
        lines += [f"  {line}" for line in covariance_lines(item)]
        lines.append(f"{node} args={quoteattr(' '.join(words))}/>")
    files.write_text(path, "\n".join([*lines, "</launch>", ""]))


ROS_TF = CameraFormat(
    name="ros_tf",
    title="ROS launch file",
    suffixes=(".launch", ".xml"),
    models=EVERY_LENS,
    read=write_only("ROS launch file"),
    write=write_ros_tf,
    poses="static_transform_publisher: root_T_frame, quaternion x y z w; covariance as a comment",
    keeps=COVARIANCE,
    note=NO_LENSES,
    frames=ANY_FRAME,
)
