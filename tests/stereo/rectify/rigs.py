"""Cameras and pairs for tests of rectification, and what is seen of points in rectified images."""

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose


def camera(model="pinhole", size=(640, 480), focal=500.0, coefficients=(), centre=None):
    """Return a camera with its principal point in the middle of the image, or at `centre`."""
    centre = centre or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    return Camera(model_named(model), size, np.array([focal, focal, *centre, *coefficients]))


NARROW = camera("opencv5", coefficients=(-0.2, 0.05, 1e-3, -5e-4, 0.0))
WIDE = camera("kannala_brandt4", (800, 600), 300.0, (-0.01, 0.002, 0.0, 0.0))  # 154° across, 192° from corner to corner
PLAIN = camera()


def placed(centre, turn_deg=(0.0, 0.0, 0.0)):
    """Return right_T_left of a right camera at a place (m) in the left one's frame, turned by angles about x, y, z."""
    left_R_right = so3.exp(np.radians(np.array(turn_deg, float)))
    return Pose(left_R_right.T, -left_R_right.T @ np.array(centre, float))


def common_points(left, right, right_T_left, distance, count=4000, seed=1):
    """Return points (N, 3) in the left camera's frame, at a distance (m) from it, that both cameras see."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0, 1, (count, 2)) * (np.array(left.image_size) - 1)
    rays = left.unproject(pixels)
    points = distance * rays.directions[rays.valid]
    seen = right.project(right_T_left.apply(points)).pixels
    with np.errstate(invalid="ignore"):
        inside = ((seen >= 0) & (seen <= np.array(right.image_size) - 1)).all(axis=1)
    return points[inside]


def rectified_pixels(plan, names, points, second_T_first):
    """Return the pixels (N, 2) of points in the first camera's frame in both rectified images, left one first."""
    second = second_T_first.apply(points)
    own = {names[0]: points, names[1]: second}
    return (
        plan.left_camera.project(own[plan.left] @ plan.rect_R_left.T).pixels,
        plan.right_camera.project(own[plan.right] @ plan.rect_R_right.T).pixels,
    )


def inside(plan, pixels):
    """Return which pixels (N, 2) lie in the rectified image."""
    with np.errstate(invalid="ignore"):
        return ((pixels >= -0.5) & (pixels <= np.array(plan.size) - 0.5)).all(axis=1)
