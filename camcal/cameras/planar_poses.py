"""Initial poses of planar objects for any lens."""

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3

_HELD = 1e-12  # keeps points on a single ray, whose distance is open, from being singular


def planar_poses(rays: Array, points: Array, mask: Array) -> tuple[Array, Array]:
    """Return camera_T_plane, rotations (W, 3, 3) and translations (W, 3), of planes z = 0.

    rays: (3, W, N) unit, through points (3, W, N) of the planes where the mask (W, N) is True; what points have of z is
    left out. Points that spread by about 1 around the origin leave the least errors.
    A plane's points p and their rays d obey d × (H p) = 0; the 3 × 3 matrix H of least algebraic error holds the
    first two columns of the rotation and the translation. Works for rays behind the image plane as well.
    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 4.1, with rays in place of pixels.
    """
    present = mask.astype(float)
    flat = np.stack([points[0] * present, points[1] * present, present])
    # ‖d × v‖² = v · (I - d dᵀ) v for unit d, so the normal matrix needs only these two Gram matrices
    plain = np.einsum("awn,bwn->wab", flat, flat)
    mixed = (rays[:, None] * flat[None]).reshape(9, *mask.shape).transpose(1, 0, 2)
    normal = np.einsum("ij,wab->wiajb", np.eye(3), plain).reshape(-1, 9, 9) - mixed @ mixed.transpose(0, 2, 1)
    homographies = np.linalg.eigh(normal)[1][:, :, 0].reshape(-1, 3, 3)
    size = np.linalg.norm(homographies[:, :, :2], axis=1).mean(axis=1)
    first = homographies[:, :, :2] / np.maximum(size, np.finfo(float).tiny)[:, None, None]
    turns = so3.nearest(np.concatenate([first, np.cross(first[:, :, 0], first[:, :, 1])[..., None]], axis=2))
    # the sign of the homography is open, and with it that of the first two columns
    other = turns * [-1, -1, 1]
    front, behind = (_translations(rays, flat, each) for each in (turns, other))
    placed = np.concatenate([turns[:, :, :2], front[:, :, None]], axis=2)
    wrong = np.einsum("iwn,wij,jwn->w", rays, placed, flat) <= 0
    return np.where(wrong[:, None, None], other, turns), np.where(wrong[:, None], behind, front)


def _translations(rays: Array, flat: Array, rotations: Array) -> Array:
    """Return the translations (W, 3) that bring points, turned by rotations (W, 3, 3), nearest to their rays.

    flat: (3, W, N) x, y, 1 of the points, 0 for those that are not there.
    """
    turned = (rotations[:, :, :2] @ flat[:2].transpose(1, 0, 2)).transpose(1, 0, 2)
    along = np.sum(rays * turned, axis=0) * rays
    across = np.einsum("ij,wn->wij", (1 + _HELD) * np.eye(3), flat[2]) - np.einsum(
        "iwn,jwn,wn->wij", rays, rays, flat[2]
    )
    return np.asarray(-np.linalg.solve(across, (turned - along).sum(axis=2).T[..., None])[..., 0])
