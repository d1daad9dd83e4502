"""Rigs by camcal and by OpenCV from the same captures."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from real_rigs import LEAST_CORNERS, Rig

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import FIXED, Captures, RigCalibration, RigOptions
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.geometry.pose import Pose
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

FLAT = ShapeOptions(smooth=False, offsets=False)
_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)


def options_of(captures: Captures, model: CameraModel, **others: object) -> RigOptions:
    return replace(RigOptions(dict.fromkeys(captures.cameras, model)), **others)


def camcal_rig(captures: Captures, board: Board, model: CameraModel, **others: object) -> RigCalibration:
    """Return the calibration of a rig whose cameras all have the same lens model; others: of RigOptions."""
    return calibrate_rig(captures, board, options_of(captures, model, **others))


def fixed_lenses(captures: Captures, board: Board, model: CameraModel, **others: object) -> RigCalibration:
    """Return the calibration with lenses held that each camera's own views give."""
    given = {
        name: calibrate([view for view in captures.of(index) if view is not None], board, Options(model)).camera
        for index, name in enumerate(captures.cameras)
    }
    return camcal_rig(captures, board, model, lenses=FIXED, given=given, **others)


def as_rig(result: RigCalibration) -> Rig:
    return Rig({name: own.camera for name, own in result.calibrations.items()}, result.poses)


def opencv_rigs(captures: Captures, board: Board, model: CameraModel) -> list[Rig]:
    """Return the rigs of cv2.stereoCalibrate (or of cv2.fisheye's), one of each pair of cameras.

    Each camera is calibrated by itself first, from all of its views; lenses and poses of a pair are then estimated
    jointly, the board as drawn. Raises cv2.error, InsufficientData.
    """
    cameras = range(len(captures.cameras))
    lenses = [opencv_lens([view for view in captures.of(c) if view is not None], board, model) for c in cameras]
    return [_stereo(captures, board, model, pair, lenses) for pair in combinations(cameras, 2)]


def opencv_lens(views: Sequence[BoardDetection], board: Board, model: CameraModel) -> Camera:
    """Return the lens of cv2.calibrateCamera, or of cv2.fisheye.calibrate."""
    points = board.points().astype(np.float32)
    objects = [points[view.ids][None] for view in views]
    pixels = [view.pixels.astype(np.float32)[None] for view in views]
    size = views[0].size
    if model.opencv == "cv2.fisheye":
        width, height = size
        guess = np.array([[width / 4, 0, width / 2], [0, width / 4, height / 2], [0, 0, 1]])  # its own one fails
        names = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS")
        flags = sum(map(_fisheye, names))
        _, matrix, distortion, *_ = cv2.fisheye.calibrate(
            objects, pixels, size, guess, np.zeros(4), flags=flags, criteria=_STEPS
        )
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if model.name == "opencv8" else 0
        _, matrix, distortion, *_ = cv2.calibrateCamera(objects, pixels, size, None, None, flags=flags)
    return _camera(model, size, matrix, distortion)


def _fisheye(name: str) -> int:
    """Return a flag of cv2.fisheye: OpenCV 5 moved them."""
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))


def _camera(model: CameraModel, size: tuple[int, int], matrix: np.ndarray, distortion: np.ndarray) -> Camera:
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return Camera(model, size, np.array([*core, *distortion.ravel()])[: len(model.parameter_names)])


def matrix_of(camera: Camera) -> np.ndarray:
    """Return the camera matrix (3, 3)."""
    fx, fy, cx, cy = camera.parameters[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _stereo(
    captures: Captures, board: Board, model: CameraModel, pair: tuple[int, int], lenses: Sequence[Camera]
) -> Rig:
    """Return the rig of two cameras from the corners that both saw."""
    points = board.points().astype(np.float32)
    objects, first, second = [], [], []
    for row in captures.views:
        views = [row[camera] for camera in pair]
        if None in views:
            continue
        ids, *rows = np.intersect1d(*(view.ids for view in views), return_indices=True)
        if len(ids) >= LEAST_CORNERS:
            objects.append(points[ids][None])
            for pixels, view, own in zip((first, second), views, rows, strict=True):
                pixels.append(view.pixels[own].astype(np.float32)[None])
    if not objects:
        raise InsufficientData(f"no capture has both {captures.cameras[pair[0]]} and {captures.cameras[pair[1]]}")
    own = [lenses[camera] for camera in pair]
    arguments = [part for lens in own for part in (matrix_of(lens), lens.parameters[4:].copy())]
    if model.opencv == "cv2.fisheye":
        flags = _fisheye("CALIB_USE_INTRINSIC_GUESS") | _fisheye("CALIB_FIX_SKEW")
        found = cv2.fisheye.stereoCalibrate(
            objects, first, second, *arguments, own[0].image_size, flags=flags, criteria=_STEPS
        )
    else:
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | (cv2.CALIB_RATIONAL_MODEL if model.name == "opencv8" else 0)
        found = cv2.stereoCalibrate(objects, first, second, *arguments, own[0].image_size, flags=flags, criteria=_STEPS)
    _, matrix, distortion, other_matrix, other_distortion, rotation, translation, *_ = found
    names, size = [captures.cameras[camera] for camera in pair], own[0].image_size
    found_lenses = (_camera(model, size, matrix, distortion), _camera(model, size, other_matrix, other_distortion))
    poses = (Pose.identity(), Pose(rotation, translation.ravel()))
    return Rig(dict(zip(names, found_lenses, strict=True)), dict(zip(names, poses, strict=True)))
