# The public names of camcal and where they are: the one list, for type checkers and for `import camcal`.

from camcal.calibrate.intrinsics import Calibration as Calibration
from camcal.calibrate.rigs.record import Captures as Captures
from camcal.calibrate.rigs.record import RigCalibration as RigCalibration
from camcal.cameras.catalogue import MODELS as MODELS
from camcal.cameras.catalogue import model_named as model_named
from camcal.cameras.directions import projection_covariances as projection_covariances
from camcal.cameras.lens import CameraModel as CameraModel
from camcal.cameras.lens import Projection as Projection
from camcal.cameras.lens import Rays as Rays
from camcal.cameras.model import Camera as Camera
from camcal.cameras.model import Rig as Rig
from camcal.cameras.model import resized as resized
from camcal.errors import CamcalError as CamcalError
from camcal.errors import FileError as FileError
from camcal.errors import InsufficientData as InsufficientData
from camcal.errors import InvalidInput as InvalidInput
from camcal.errors import NotConverged as NotConverged
from camcal.estimate.curves.curve import Curve as Curve
from camcal.estimate.curves.curve import Data as CurveData
from camcal.estimate.curves.fit import fit_curve as fit_curve
from camcal.estimate.curves.search import SearchOptions as SearchOptions
from camcal.estimate.pnp import estimate_pose as estimate_pose
from camcal.estimate.pnp import estimate_poses as estimate_poses
from camcal.estimate.pnp import estimate_rig_poses as estimate_rig_poses
from camcal.estimate.pose_average import average_poses as average_poses
from camcal.estimate.poses.records import Correspondences as Correspondences
from camcal.estimate.poses.records import PoseEstimate as PoseEstimate
from camcal.estimate.poses.records import PoseOptions as PoseOptions
from camcal.estimate.poses.records import PosePrior as PosePrior
from camcal.estimate.smoothing.kalman import ExtendedModel as ExtendedModel
from camcal.estimate.smoothing.kalman import Gaussian as Gaussian
from camcal.estimate.smoothing.kalman import extended_filter as extended_filter
from camcal.estimate.smoothing.kalman import extended_smoother as extended_smoother
from camcal.estimate.smoothing.poses import PosesOptions as PosesOptions
from camcal.estimate.smoothing.poses import smooth_poses as smooth_poses
from camcal.estimate.smoothing.series import Series as Series
from camcal.estimate.smoothing.series import SeriesOptions as SeriesOptions
from camcal.estimate.smoothing.series import smooth_series as smooth_series
from camcal.estimate.tracking.track import TrackOptions as TrackOptions
from camcal.estimate.tracking.track import track_poses as track_poses
from camcal.estimate.trajectory_error import ErrorOptions as ErrorOptions
from camcal.estimate.trajectory_error import trajectory_error as trajectory_error
from camcal.formats.boards import load_board as load_board
from camcal.formats.camera_file import CameraFile as CameraFile
from camcal.formats.cameras import read as read_camera_file
from camcal.formats.cameras import read_camera as read_camera
from camcal.formats.detections import read as read_detections
from camcal.formats.detections import write as write_detections
from camcal.formats.disparity import read as read_disparity
from camcal.formats.disparity import write as write_disparity
from camcal.formats.frames import read as read_frames
from camcal.formats.frames import write as write_frames
from camcal.formats.pointclouds import read as read_point_cloud
from camcal.formats.pointclouds import write as write_point_cloud
from camcal.formats.poses import read as read_poses
from camcal.formats.poses import write as write_poses
from camcal.formats.tags import load_tags as load_tags
from camcal.formats.trajectories import read as read_trajectory
from camcal.formats.trajectories import write as write_trajectory
from camcal.geometry.frame_graph import FrameGraph as FrameGraph
from camcal.geometry.pose import NamedTransform as NamedTransform
from camcal.geometry.pose import Pose as Pose
from camcal.geometry.pose import Trajectory as Trajectory
from camcal.images.options import ViewOptions as ViewOptions
from camcal.images.remap import build_maps as build_maps
from camcal.images.views import make_view as make_view
from camcal.messages import Message as Message
from camcal.quality.camera_comparison import CameraComparison as CameraComparison
from camcal.quality.view_advice import ViewAdvice as ViewAdvice
from camcal.raw.demosaic import demosaic as demosaic
from camcal.raw.develop import develop as develop
from camcal.raw.mosaic import Mosaic as Mosaic
from camcal.raw.options import Development as Development
from camcal.raw.reading import read_mosaic as read_mosaic
from camcal.stereo.cloud import CloudMaker as CloudMaker
from camcal.stereo.depth import StereoImage as StereoImage
from camcal.stereo.disparity import Confidence as Confidence
from camcal.stereo.disparity import Disparity as Disparity
from camcal.stereo.disparity import StereoGeometry as StereoGeometry
from camcal.stereo.disparity import of_pair as stereo_geometry
from camcal.stereo.matching.match import match as match_pair
from camcal.stereo.options import MatchOptions as MatchOptions
from camcal.stereo.options import RectifiedViewOptions as RectifiedViewOptions
from camcal.stereo.rectify.plan import PairMaps as PairMaps
from camcal.stereo.rectify.plan import build_pair_maps as build_pair_maps
from camcal.stereo.rectify.plan import plan_rectification as plan_rectification
from camcal.stereo.rectify.record import Rectification as Rectification
from camcal.targets.board import Board as Board
from camcal.targets.detection import BoardDetection as BoardDetection
from camcal.targets.detection import Detections as Detections
from camcal.targets.markers import detect_markers as detect_markers
from camcal.tasks.calibration.advise import advise_views as advise_views
from camcal.tasks.calibration.camera_result import CalibrateReport as CalibrateReport
from camcal.tasks.calibration.check import check_camera as check_camera
from camcal.tasks.calibration.diff import compare_cameras as compare_cameras
from camcal.tasks.calibration.errors_at_range import RangeErrors as RangeErrors
from camcal.tasks.calibration.errors_at_range import errors_at_range as errors_at_range
from camcal.tasks.calibration.options import CalibrateOptions as CalibrateOptions
from camcal.tasks.calibration.options import DetectOptions as DetectOptions
from camcal.tasks.library import PointCloud as PointCloud
from camcal.tasks.library import RectifiedImages as RectifiedImages
from camcal.tasks.library import Undistorted as Undistorted
from camcal.tasks.library import calibrate_camera as calibrate_camera
from camcal.tasks.library import calibrate_rig as calibrate_rig
from camcal.tasks.library import detect_board as detect_board
from camcal.tasks.library import locate_board as locate_board
from camcal.tasks.library import measure_corners as measure_corners
from camcal.tasks.library import point_cloud as point_cloud
from camcal.tasks.library import rectify_pair as rectify_pair
from camcal.tasks.library import undistort_image as undistort_image
from camcal.tasks.library import write_camera_file as write_camera_file

__all__ = [
    "MODELS",
    "Board",
    "BoardDetection",
    "CalibrateOptions",
    "CalibrateReport",
    "Calibration",
    "CamcalError",
    "Camera",
    "CameraComparison",
    "CameraFile",
    "CameraModel",
    "CloudMaker",
    "Confidence",
    "Correspondences",
    "Curve",
    "CurveData",
    "DetectOptions",
    "Detections",
    "Development",
    "Disparity",
    "ErrorOptions",
    "ExtendedModel",
    "FileError",
    "FrameGraph",
    "Gaussian",
    "InsufficientData",
    "InvalidInput",
    "MatchOptions",
    "Message",
    "Mosaic",
    "NamedTransform",
    "NotConverged",
    "PairMaps",
    "PointCloud",
    "Pose",
    "PoseEstimate",
    "PoseOptions",
    "PosePrior",
    "PosesOptions",
    "Projection",
    "RangeErrors",
    "Rays",
    "Rectification",
    "RectifiedImages",
    "RectifiedViewOptions",
    "Rig",
    "SearchOptions",
    "Series",
    "SeriesOptions",
    "StereoGeometry",
    "StereoImage",
    "TrackOptions",
    "Trajectory",
    "Undistorted",
    "ViewAdvice",
    "ViewOptions",
    "advise_views",
    "average_poses",
    "build_maps",
    "build_pair_maps",
    "calibrate_camera",
    "check_camera",
    "compare_cameras",
    "demosaic",
    "detect_board",
    "detect_markers",
    "develop",
    "errors_at_range",
    "estimate_pose",
    "estimate_poses",
    "estimate_rig_poses",
    "extended_filter",
    "extended_smoother",
    "fit_curve",
    "load_board",
    "load_tags",
    "locate_board",
    "make_view",
    "match_pair",
    "measure_corners",
    "model_named",
    "plan_rectification",
    "point_cloud",
    "read_camera",
    "read_camera_file",
    "read_detections",
    "read_disparity",
    "read_frames",
    "read_mosaic",
    "read_point_cloud",
    "read_poses",
    "read_trajectory",
    "rectify_pair",
    "resized",
    "smooth_poses",
    "smooth_series",
    "stereo_geometry",
    "track_poses",
    "trajectory_error",
    "undistort_image",
    "write_camera_file",
    "write_detections",
    "write_disparity",
    "write_frames",
    "write_point_cloud",
    "write_poses",
    "write_trajectory",
]

__version__: str
from camcal.tasks.rigs.options import RigSettings as RigSettings
from camcal.tasks.rigs.rig_result import RigReport as RigReport
