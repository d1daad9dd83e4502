"""The pose solvers of OpenCV, PoseLib and pycolmap under one signature, for benchmarks/pnp.py and pnp_outliers.py.

Each takes points (N, 3), pixels (N, 2) and the threshold (px) of an inlier, and returns camera_T_object or None.
The lens is a pinhole. What is not installed is left out of the tables.
"""

from collections.abc import Callable
from importlib.util import find_spec

import cv2
import numpy as np

from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose

Solver = Callable[[np.ndarray, np.ndarray, float], Pose | None]
ITERATIONS, CONFIDENCE = 5000, 0.999


def plain_solvers(camera: Camera) -> dict[str, Solver]:
    """Return the solvers for clean points by name."""
    matrix = matrix_of(camera)

    def opencv(method: int, *, refine: bool) -> Solver:
        def solve(points: np.ndarray, pixels: np.ndarray, _: float) -> Pose | None:
            try:
                found, vector, place = cv2.solvePnP(points, pixels, matrix, None, flags=method)
                if found and refine:
                    vector, place = cv2.solvePnPRefineLM(points, pixels, matrix, None, vector, place)
            except cv2.error:
                return None
            return _pose(vector, place) if found else None

        return solve

    solvers = {
        "OpenCV ITERATIVE": opencv(cv2.SOLVEPNP_ITERATIVE, refine=False),
        "OpenCV EPNP": opencv(cv2.SOLVEPNP_EPNP, refine=False),
        "OpenCV SQPNP": opencv(cv2.SOLVEPNP_SQPNP, refine=False),
        "OpenCV SQPNP + LM": opencv(cv2.SOLVEPNP_SQPNP, refine=True),
        "OpenCV IPPE + LM": opencv(cv2.SOLVEPNP_IPPE, refine=True),
    }
    if find_spec("poselib"):
        solvers["PoseLib"] = _poselib(camera, {"loss_type": "TRIVIAL"}, 100.0)
    if find_spec("pycolmap"):
        solvers["pycolmap"] = _pycolmap(camera, 100.0)
    return solvers


def robust_solvers(camera: Camera) -> dict[str, Solver]:
    """Return the solvers for points with outliers by name."""
    matrix = matrix_of(camera)

    def ransac(points: np.ndarray, pixels: np.ndarray, threshold: float) -> Pose | None:
        settings = {"iterationsCount": ITERATIONS, "reprojectionError": threshold, "confidence": CONFIDENCE}
        found, vector, place, _ = cv2.solvePnPRansac(points, pixels, matrix, None, flags=cv2.SOLVEPNP_SQPNP, **settings)
        return _pose(vector, place) if found else None

    def defaults(points: np.ndarray, pixels: np.ndarray, _: float) -> Pose | None:
        found, vector, place, _ = cv2.solvePnPRansac(points, pixels, matrix, None)
        return _pose(vector, place) if found else None

    solvers: dict[str, Solver] = {
        "OpenCV Ransac defaults": defaults,
        "OpenCV Ransac SQPNP": ransac,
        "OpenCV USAC_DEFAULT": _usac(camera, cv2.USAC_DEFAULT),
        "OpenCV USAC_MAGSAC": _usac(camera, cv2.USAC_MAGSAC),
    }
    if find_spec("poselib"):
        solvers["PoseLib default"] = _poselib(camera, {}, None)
        solvers["PoseLib truncated"] = _poselib(camera, {"loss_type": "TRUNCATED"}, None)
    if find_spec("pycolmap"):
        solvers["pycolmap"] = _pycolmap(camera, None)
    return solvers


def _usac(camera: Camera, method: int) -> Solver:
    matrix = matrix_of(camera)

    def solve(points: np.ndarray, pixels: np.ndarray, threshold: float) -> Pose | None:
        settings = cv2.UsacParams()
        settings.score = cv2.SCORE_METHOD_MAGSAC if method == cv2.USAC_MAGSAC else cv2.SCORE_METHOD_MSAC
        settings.threshold, settings.confidence, settings.maxIterations = threshold, CONFIDENCE, ITERATIONS
        settings.loMethod = cv2.LOCAL_OPTIM_INNER_LO
        try:
            found, _, vector, place, _ = cv2.solvePnPRansac(points, pixels, matrix, None, params=settings)
        except cv2.error:
            return None
        return _pose(vector, place) if found else None

    return solve


def matrix_of(camera: Camera) -> np.ndarray:
    """Return the camera matrix (3, 3)."""
    fx, fy, cx, cy = camera.parameters[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _poselib(camera: Camera, settings: dict[str, object], fixed: float | None) -> Solver:
    import poselib

    width, height = camera.image_size
    lens = {"model": "PINHOLE", "width": width, "height": height, "params": camera.parameters.tolist()}

    def solve(points: np.ndarray, pixels: np.ndarray, threshold: float) -> Pose | None:
        limit = fixed or threshold
        ransac = {"max_reproj_error": limit, "max_iterations": ITERATIONS, "success_prob": CONFIDENCE, "seed": 0}
        scale = {"loss_scale": limit} if settings.get("loss_type") == "TRUNCATED" else {}
        found, _ = poselib.estimate_absolute_pose(pixels, points, lens, ransac, {**settings, **scale})
        return Pose(found.R, found.t) if np.isfinite(found.t).all() and np.any(found.t) else None

    return solve


def _pycolmap(camera: Camera, fixed: float | None) -> Solver:
    import pycolmap

    width, height = camera.image_size
    # its pixels have their centres at 0.5
    shifted = camera.parameters[:4] + np.array([0, 0, 0.5, 0.5])
    lens = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=shifted)

    def solve(points: np.ndarray, pixels: np.ndarray, threshold: float) -> Pose | None:
        options = pycolmap.AbsolutePoseEstimationOptions()
        options.ransac.max_error = fixed or threshold
        options.ransac.confidence, options.ransac.max_num_trials = CONFIDENCE, ITERATIONS
        found = pycolmap.estimate_and_refine_absolute_pose(pixels + 0.5, points, lens, options)
        if found is None:
            return None
        matrix = found["cam_from_world"].matrix()
        return Pose(matrix[:, :3], matrix[:, 3])

    return solve


def _pose(vector: np.ndarray, place: np.ndarray) -> Pose | None:
    if not (np.isfinite(vector).all() and np.isfinite(place).all()):
        return None
    return Pose.from_vector(np.ravel(vector), np.ravel(place))
