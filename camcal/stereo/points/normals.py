"""Normals of surfaces, from planes fitted to disparities.

The plane n · P = D is seen with the disparity d + doffs = (f b / D) (n_x x + n_y y + n_z) at the image point (x, y), so
a plane in space is a plane in the disparity map too: its fit needs sums over windows of pixels and no neighbour search.
"""

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.stereo.points.depth import StereoImage, widened

_REACH = 4  # pixels to all sides
_FEWEST = 6  # matches in a window
_ONE = np.ones(2 * _REACH + 1, np.float32)
_RAMP = np.arange(-_REACH, _REACH + 1, dtype=np.float32)
_SQUARE = _RAMP**2


def normals(image: StereoImage, rows: slice) -> Array:
    """Return unit normals of some rows, their components (3, N, W), float32, in the frame of the rectified left camera.

    They look towards the camera. The surface is taken as plane within 9 × 9 pixels. NaN where fewer than 6 of them, or
    only some in a line, have a match.
    """
    wide, within = widened(rows, _REACH, image.shape[0])
    shifted = image.shifted(wide)
    matched = np.isfinite(shifted)
    slope_u, slope_v, level = _fitted(np.where(matched, shifted, np.float32(0)), matched.astype(np.float32), within)
    geometry = image.geometry
    right = np.float32(geometry.cx) - np.arange(image.shape[1], dtype=np.float32)
    down = np.float32(geometry.cy) - np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    on_axis = level + slope_u * right + slope_v * down
    found = np.stack([slope_u * np.float32(-geometry.fx), slope_v * np.float32(-geometry.fy), -on_axis])
    found /= np.sqrt(found[0] ** 2 + found[1] ** 2 + found[2] ** 2)
    return np.asarray(found)


def _fitted(values: Array, matched: Array, within: slice) -> tuple[Array, Array, Array]:
    """Return slopes along u and v and the value at the pixel, each (N, W), of planes fitted to windows around pixels.

    values: (M, W), zero where there is none. matched: (M, W), 1 where there is one, else 0. within: the N of M rows.
    """

    def total(of: Array, along_u: Array, along_v: Array) -> Array:
        sums = cv2.sepFilter2D(of, cv2.CV_32F, along_u, along_v, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(sums[within])

    n, u, v = total(matched, _ONE, _ONE), total(matched, _RAMP, _ONE), total(matched, _ONE, _RAMP)
    s, su, sv = total(values, _ONE, _ONE), total(values, _RAMP, _ONE), total(values, _ONE, _RAMP)
    uu = n * total(matched, _SQUARE, _ONE) - u * u
    uv = n * total(matched, _RAMP, _RAMP) - u * v
    vv = n * total(matched, _ONE, _SQUARE) - v * v
    su, sv = n * su - u * s, n * sv - v * s
    determinant = uu * vv - uv * uv
    determinant[(n < _FEWEST) | (determinant <= 0)] = np.nan
    slope_u = (vv * su - uv * sv) / determinant
    slope_v = (uu * sv - uv * su) / determinant
    return slope_u, slope_v, (s - slope_u * u - slope_v * v) / np.maximum(n, 1)
