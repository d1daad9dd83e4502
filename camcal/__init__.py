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
    "Correspondences": "estimate.poses.records:Correspondences",
    "Curve": "estimate.curves.curve:Curve",
    "CurveData": "estimate.curves.curve:Data",
    "Detection": "targets.detection:Detection",
    "Detections": "targets.detection:Detections",
    "Development": "raw.develop:Development",
    "Disparity": "stereo.disparity:Disparity",
    "ExtendedModel": "estimate.smoothing.kalman:ExtendedModel",
    "FileError": "errors:FileError",
    "FrameGraph": "geometry.frame_graph:FrameGraph",
    "Gaussian": "estimate.smoothing.kalman:Gaussian",
    "InsufficientData": "errors:InsufficientData",
    "InvalidInput": "errors:InvalidInput",
    "MODELS": "cameras.catalogue:MODELS",
    "MatchOptions": "stereo.options:MatchOptions",
    "Mosaic": "raw.mosaic:Mosaic",
    "NamedTransform": "geometry.pose:NamedTransform",
    "NotConverged": "errors:NotConverged",
    "Pose": "geometry.pose:Pose",
    "PoseEstimate": "estimate.poses.records:PoseEstimate",
    "PoseOptions": "estimate.poses.records:PoseOptions",
    "PosePrior": "estimate.poses.records:PosePrior",
    "Rig": "cameras.model:Rig",
    "Series": "estimate.smoothing.series:Series",
    "StereoGeometry": "stereo.geometry:StereoGeometry",
    "StereoImage": "stereo.points.depth:StereoImage",
    "TrackOptions": "estimate.tracking.track:TrackOptions",
    "Trajectory": "geometry.pose:Trajectory",
    "average_poses": "estimate.pose_average:average_poses",
    "calibrate_camera": "calibrate.intrinsics:calibrate",
    "demosaic": "raw.demosaic:demosaic",
    "detect_markers": "targets.markers.markers:detect_markers",
    "develop": "raw.develop:develop",
    "estimate_poses": "estimate.pnp:estimate_poses",
    "estimate_rig_poses": "estimate.pnp:estimate_rig_poses",
    "extended_filter": "estimate.smoothing.kalman:extended_filter",
    "extended_smoother": "estimate.smoothing.kalman:extended_smoother",
    "fit_curve": "estimate.curves.fit:fit_curve",
    "load_board": "formats.boards:load_board",
    "load_tags": "formats.tags:load_tags",
    "match_pair": "stereo.matching.match:match",
    "model_named": "cameras.catalogue:model_named",
    "read_camera": "formats.native:read_camera",
    "read_camera_file": "formats.native:read",
    "read_detections": "formats.detections:read",
    "read_disparity": "formats.disparity:read",
    "read_frames": "formats.frames:read",
    "read_mosaic": "raw.reading:read_mosaic",
    "read_point_cloud": "formats.pointclouds:read",
    "read_poses": "formats.poses:read",
    "read_trajectory": "formats.trajectories:read",
    "smooth_poses": "estimate.smoothing.poses:smooth_poses",
    "smooth_series": "estimate.smoothing.series:smooth_series",
    "track_poses": "estimate.tracking.track:track_poses",
    "trajectory_error": "estimate.trajectory_error:trajectory_error",
    "write_camera_file": "formats.native:write",
    "write_detections": "formats.detections:write",
    "write_disparity": "formats.disparity:write",
    "write_frames": "formats.frames:write",
    "write_point_cloud": "formats.pointclouds:write",
    "write_poses": "formats.poses:write",
    "write_trajectory": "formats.trajectories:write",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'camcal' has no attribute {name!r}")
    module, _, attribute = _HOMES[name].partition(":")
    return getattr(import_module(f"camcal.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
