"""A rectification as other programs read it: R1 R2 P1 P2 Q for OpenCV, camera_info of both cameras for ROS."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraFile, Transform
from camcal.formats.cameras import file_storage, ros
from camcal.geometry.pose import Pose
from camcal.stereo.rectify.record import OpenCVRectification, Rectification


def require_pinhole(rectification: Rectification, option: str) -> OpenCVRectification:
    """Return R1 R2 P1 P2 Q; raises InvalidInput, naming the option that asks for them, unless it is a pinhole pair."""
    found = rectification.opencv()
    if found is None:
        raise InvalidInput(
            f"{option} is for pinhole images, these are {rectification.projection}: give --projection pinhole, or use "
            "--maps"
        )
    return found


def write_opencv(path: Path, rectification: Rectification) -> None:
    """Write R1 R2 P1 P2 Q and the size of the rectified images, as cv2.FileStorage reads them; metres.

    Raises InvalidInput as `require_pinhole` does, FileError.
    """
    found = require_pinhole(rectification, "--opencv")
    width, height = rectification.size
    items: dict[str, file_storage.Item] = {"image_width": width, "image_height": height}
    items |= {name: np.array(getattr(found, name)) for name in ("R1", "R2", "P1", "P2", "Q")}
    usage = "use cv2.initUndistortRectifyMap(K, D, R1, P1, size, cv2.CV_32FC1), of a fisheye cv2.fisheye's"
    files.write_text(path, file_storage.text_of(items, path.suffix, usage))


def as_ros(file: CameraFile, rectification: Rectification, right_T_left: Pose) -> CameraFile:
    """Return both cameras with the R and P of their rectified images, which `ros.write` keeps.

    Raises InvalidInput as `require_pinhole` does, and for a lens that ROS does not have.
    """
    found = require_pinhole(rectification, "--ros")
    names = rectification.left, rectification.right
    matrices = {names[0]: (found.R1, found.P1), names[1]: (found.R2, found.P2)}
    entries = {name: replace(file.cameras[name], extra={ros.VENDOR_KEY: _kept(*matrices[name])}) for name in names}
    pair = CameraFile(entries, {f"{names[1]}_T_{names[0]}": Transform(right_T_left)})
    return cameras.prepared(pair, ros.FORMAT, "--ros").file


def _kept(rotation: np.ndarray, projection: np.ndarray) -> Mapping[str, list[float]]:
    return {"rectification": rotation.ravel().tolist(), "projection": projection.ravel().tolist()}
