"""camcal: calibrate, rectify and measure with cameras from the shell.

The names a program needs are here; each is imported when it is first used, so that `import camcal` costs nothing.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Board": "targets.board:Board",
    "Calibration": "calibrate.intrinsics:Calibration",
    "CalibrationOptions": "calibrate.intrinsics:Options",
    "CamcalError": "errors:CamcalError",
    "Camera": "cameras.model:Camera",
    "CameraFile": "formats.camera_file:CameraFile",
    "CameraModel": "cameras.model:CameraModel",
    "CloudMaker": "stereo.points.cloud:CloudMaker",
    "Confidence": "stereo.disparity:Confidence",
    "Detection": "targets.board:Detection",
    "Detections": "targets.board:Detections",
    "Development": "raw.develop:Development",
    "Disparity": "stereo.disparity:Disparity",
    "FileError": "errors:FileError",
    "InsufficientData": "errors:InsufficientData",
    "InvalidInput": "errors:InvalidInput",
    "MODELS": "cameras.catalogue:MODELS",
    "MatchOptions": "stereo.matching.match:MatchOptions",
    "Mosaic": "raw.mosaic:Mosaic",
    "NotConverged": "errors:NotConverged",
    "Pose": "geometry.pose:Pose",
    "StereoGeometry": "stereo.geometry:StereoGeometry",
    "StereoImage": "stereo.points.depth:StereoImage",
    "calibrate_camera": "calibrate.intrinsics:calibrate",
    "demosaic": "raw.demosaic:demosaic",
    "develop": "raw.develop:develop",
    "estimate_poses": "estimate.pnp:estimate_poses",
    "load_board": "formats.boards:load_board",
    "match_pair": "stereo.matching.match:match",
    "model_named": "cameras.catalogue:model_named",
    "read_camera": "formats.native:read_camera",
    "read_camera_file": "formats.native:read",
    "read_detections": "formats.detections:read",
    "read_disparity": "formats.disparity:read",
    "read_mosaic": "raw.reading:read_mosaic",
    "read_point_cloud": "formats.pointclouds:read",
    "write_camera_file": "formats.native:write",
    "write_detections": "formats.detections:write",
    "write_disparity": "formats.disparity:write",
    "write_point_cloud": "formats.pointclouds:write",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'camcal' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    return getattr(import_module(f"camcal.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
