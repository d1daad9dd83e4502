"""How far one camera's projections are from another's, over the whole image, at infinity."""

import numpy as np

from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3

_GRID = (41, 31)


def projection_errors(truth: Camera, estimate: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) over the whole image and the distances (N,) by which the estimate misplaces their rays.

    A camera's own axes are a choice of its calibration: the rotation that suits the estimate best is taken out. NaN
    where one of them does not hold.
    """
    width, height = truth.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID[0]), np.linspace(0, height - 1, _GRID[1]))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = truth.unproject(pixels).directions
    rotation = np.eye(3)
    for _ in range(10):
        turned = rays @ rotation.T
        projected = estimate.model.project_with_jacobians(estimate.parameters, turned, within_domain=False)
        by_turn = np.einsum("nij,njk->nik", projected.d_point, -so3.hat(turned))
        off = pixels - projected.pixels
        held = np.isfinite(off).all(axis=1) & np.isfinite(by_turn).all(axis=(1, 2)) & projected.valid
        step = np.linalg.lstsq(by_turn[held].reshape(-1, 3), off[held].ravel(), rcond=None)[0]
        rotation = so3.exp(step) @ rotation
    return pixels, np.linalg.norm(projected.pixels - pixels, axis=1)


def rms_inside_and_outside(truth: Camera, estimate: Camera, seen: np.ndarray) -> tuple[float, float, float]:
    """Return the RMS errors in px over the full frame, within the radius that corners `seen` (N, 2) reach, beyond."""
    centre = np.array([truth.value("cx"), truth.value("cy")])
    reach = np.linalg.norm(seen - centre, axis=1).max()
    pixels, errors = projection_errors(truth, estimate)
    inside = np.linalg.norm(pixels - centre, axis=1) <= reach
    parts = (errors, errors[inside], errors[~inside] if (~inside).any() else np.array([np.nan]))
    return tuple(float(np.sqrt(np.nanmean(part**2))) for part in parts)  # type: ignore[return-value]
