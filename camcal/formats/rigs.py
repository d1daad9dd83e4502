"""The rig that a camera file with several cameras describes."""

from camcal.cameras.model import Rig
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraFile
from camcal.geometry.frame_graph import FrameGraph
from camcal.geometry.named import JOINT, NamedTransform, frames_of
from camcal.geometry.pose import Pose

FRAME = "rig"


def rig_of(file: CameraFile, where: str) -> tuple[Rig, str]:
    """Return the cameras of a file as a rig, and the name of the rig's frame.

    That is `rig` if a transform names such a frame, otherwise the first camera. The transforms are taken as exact.
    Raises InvalidInput naming the first camera of which no transforms say where it stands.
    """
    transforms = [NamedTransform(*frames_of(name), item.pose) for name, item in file.transforms.items()]
    graph = FrameGraph(transforms)
    first = next(iter(file.cameras))
    frame = FRAME if FRAME in graph.frames else first
    poses = {name: _pose(graph, frame, name, where) for name in file.cameras}
    return Rig({name: entry.camera for name, entry in file.cameras.items()}, poses), frame


def _pose(graph: FrameGraph, frame: str, camera: str, where: str) -> Pose:
    """Return frame_T_camera."""
    if camera == frame:
        return Pose.identity()
    try:
        return graph.along(graph.path(frame, camera)).pose
    except InvalidInput as error:
        raise InvalidInput(
            f"nothing says where camera {camera!r} stands: transforms such as {camera}{JOINT}{frame} are missing",
            where=where,
        ) from error
