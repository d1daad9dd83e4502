"""Static transforms of a rig as a ROS launch file: .launch.xml of ROS 2, .launch of ROS 1; lenses are not part of it.

Source: tf2_ros's static_transform_publisher: parent_T_child in metres, quaternion x y z w, then parent and child.
"""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from camcal import files
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.record import ANY_FRAME, EVERY_LENS, CameraFormat, write_only
from camcal.formats.cameras.urdf import COVARIANCE, NO_LENSES, covariance_lines, frames_in_root
from camcal.formats.emit import exact_text
from camcal.geometry import rotation

_ROS_1 = ".launch"
_KEYS = ("x", "y", "z", "qx", "qy", "qz", "qw", "frame-id", "child-frame-id")


def write(path: Path, file: CameraFile) -> None:
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


FORMAT = CameraFormat(
    name="ros_tf",
    title="ROS launch file",
    suffixes=(".launch", ".xml"),
    models=EVERY_LENS,
    read=write_only("ROS launch file"),
    write=write,
    poses="static_transform_publisher: root_T_frame, quaternion x y z w; covariance as a comment",
    keeps=COVARIANCE,
    note=NO_LENSES,
    frames=ANY_FRAME,
)
