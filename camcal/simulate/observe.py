"""Synthetic observations without images: corners of a board as a detector would hand them on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.shapes import FLAT, Shape
from camcal.targets.board import Board, Detection, Detections


@dataclass(frozen=True, eq=False)
class Truth:
    """What a set of views was made from: poses are camera_T_board, one per view.

    outliers: for every view the mask (N,) of the corners that were displaced, in the order of its detection.
    """

    camera: Camera
    board: Board
    shape: Shape
    poses: tuple[Pose, ...]
    outliers: tuple[Array, ...] = ()


def view_name(index: int) -> str:
    """Return the image name of a simulated view."""
    return f"view{index:04d}.png"


def observe(
    camera: Camera,
    board: Board,
    poses: Sequence[Pose],
    *,
    rng: np.random.Generator,
    noise_px: float = 0.0,
    shape: Shape = FLAT,
    outliers: float = 0.0,
    outlier_px: float = 6.0,
    inside: bool = True,
) -> tuple[Detections, Truth]:
    """Return the corners of a board seen from `poses` (camera_T_board), and what they were made from.

    noise_px: standard deviation per axis. outliers: the share of corners displaced by outlier_px in any direction.
    inside: drop the corners measured outside the image; those outside the lens's domain are always dropped.
    The draws depend on the numbers of views and of points only, so that two cameras or shapes meet the same noise.
    Raises InvalidInput if the noise or the share of outliers is out of range.
    """
    if noise_px < 0 or not 0 <= outliers <= 1:
        raise InvalidInput(f"noise {noise_px} must not be negative, the share of outliers {outliers} within 0…1")
    rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
    translations = np.array([pose.translation for pose in poses]).reshape(-1, 3)
    exact, valid = project_all(camera, shape.points(board), rotations, translations)
    displaced = rng.random(valid.shape) < outliers
    angle = rng.uniform(0, 2 * np.pi, valid.shape)
    jump = outlier_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pixels = exact + noise_px * rng.standard_normal(exact.shape) + displaced[..., None] * jump
    seen = valid & in_image(camera, pixels) if inside else valid
    views = tuple(_detection(camera, index, seen[index], pixels[index]) for index in range(len(poses)))
    masks = tuple(mask[kept] for mask, kept in zip(displaced, seen, strict=True))
    return Detections(board, views), Truth(camera, board, shape, tuple(poses), masks)


def project_all(camera: Camera, points: Array, rotations: Array, translations: Array) -> tuple[Array, Array]:
    """Return pixels (V, N, 2) and the mask (V, N) of board points (N, 3) under V poses (V, 3, 3), (V, 3)."""
    projection = camera.project(in_camera(points, rotations, translations).reshape(-1, 3))
    shape = (len(rotations), len(points))
    return projection.pixels.reshape(*shape, 2), projection.valid.reshape(shape)


def in_camera(points: Array, rotations: Array, translations: Array) -> Array:
    """Return board points (N, 3) in the camera frame (V, N, 3) under V poses camera_T_board (V, 3, 3), (V, 3)."""
    return np.asarray(points @ np.swapaxes(rotations, -1, -2) + translations[:, None])


def in_image(camera: Camera, pixels: Array) -> Array:
    """Return the mask (...) of pixels (..., 2) that lie within the image."""
    return np.asarray(((pixels >= -0.5) & (pixels <= np.array(camera.image_size) - 0.5)).all(axis=-1))


def _detection(camera: Camera, index: int, seen: Array, pixels: Array) -> Detection:
    if not seen.any():
        return Detection.nothing(view_name(index), camera.image_size, "no corner of the board is in the image")
    return Detection(view_name(index), camera.image_size, np.flatnonzero(seen), pixels[seen])
