"""From a disparity map of a rectified pair to points in space."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.raw.mosaic import full_scale
from camcal.stereo.geometry import StereoGeometry

_BLOCK_ROWS = 32  # of a 12 MP map: what stands between disparity and points then stays in the cache


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points (N, 3), metres, in the left camera's frame (x right, y down, z forward), in the order of the pixels.

    colours: (N, 3) red, green, blue, 0 … 255. intensity: (N,) 0 … 1, for gray images. None where there is no image.
    """

    points: Array
    colours: Array | None = None
    intensity: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", readonly(self.points, (None, 3), "points", np.float32))
        count = len(self.points)
        if self.colours is not None:
            object.__setattr__(self, "colours", readonly(self.colours, (count, 3), "colours", np.uint8))
        if self.intensity is not None:
            object.__setattr__(self, "intensity", readonly(self.intensity, (count,), "intensity", np.float32))


def make_cloud(
    disparity: Array,
    geometry: StereoGeometry,
    image: Array | None = None,
    depth_range: tuple[float, float] = (0.0, np.inf),
) -> PointCloud:
    """Return the points of a disparity map, coloured by the left image.

    disparity: (H, W) pixels, left minus right; NaN, infinite and non-positive values mean no match and never become
    points. image: (H, W) gray, (H, W, 3) blue, green, red or (H, W, 4) with alpha; uint8, uint16 or float32 0 … 1.
    depth_range: nearest and farthest z kept, metres.
    Raises InvalidInput if the image has another size or the range is empty.
    """
    if not depth_range[0] < depth_range[1]:
        raise InvalidInput(f"the depth range {depth_range[0]:g} … {depth_range[1]:g} m is empty")
    if image is not None and image.shape[:2] != disparity.shape:
        raise InvalidInput(f"the image is {_size(image)}, the disparity map {_size(disparity)}; they must be the same")
    depth = depth_map(disparity, geometry)
    kept = (depth >= depth_range[0]) & (depth <= depth_range[1])  # False where the depth is NaN
    points = _back_projected(depth, kept, geometry)
    if image is None:
        return PointCloud(points)
    return PointCloud(points, *_appearance(image[kept] if image.ndim == 2 else _kept(image, kept)))


def depth_map(disparity: Array, geometry: StereoGeometry) -> Array:
    """Return depth along the optical axis (H, W), float32 metres, NaN where there is no match.

    disparity: (H, W) pixels, left minus right. z = f b / (d + doffs): Hartley & Zisserman, 2nd ed., ch. 9.
    """
    shifted = disparity.astype(np.float32) + np.float32(geometry.doffs)
    shifted[~((disparity > 0) & (shifted > 0))] = np.nan
    with np.errstate(over="ignore"):
        depth = np.float32(geometry.fx * geometry.baseline) / shifted
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan  # beyond any number, or an infinite disparity
    return depth


def _back_projected(depth: Array, kept: Array, geometry: StereoGeometry) -> Array:
    """Return the points (N, 3) of the pixels kept: X = (u - cx) z / fx, Y = (v - cy) z / fy."""
    height, width = depth.shape
    across = ((np.arange(width) - geometry.cx) / geometry.fx).astype(np.float32)
    down = ((np.arange(height) - geometry.cy) / geometry.fy).astype(np.float32)[:, None]
    blocks = []
    for start in range(0, height, _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        z = depth[rows]
        blocks.append(_kept(np.stack([across * z, down[rows] * z, z], axis=-1), kept[rows]))
    return np.concatenate(blocks)


def _kept(values: Array, kept: Array) -> Array:
    """Return values[kept] of (H, W, C) as (N, C); one item per pixel moves five times faster than C numbers."""
    whole = np.ascontiguousarray(values)
    items = whole.view(np.dtype((np.void, whole.dtype.itemsize * whole.shape[2])))[..., 0]
    return items[kept].view(whole.dtype).reshape(-1, whole.shape[2])


def _appearance(pixels: Array) -> tuple[Array, Array | None]:
    """Return colours (N, 3) red, green, blue, 0 … 255, of pixels (N,) or (N, 3 or 4); and the intensity of gray."""
    light = pixels / np.float32(full_scale(pixels.dtype))
    colours = pixels if pixels.dtype == np.uint8 else np.rint(np.clip(light, 0, 1) * 255).astype(np.uint8)
    if pixels.ndim == 1:
        return np.repeat(colours[:, None], 3, axis=1), light
    return colours[:, 2::-1], None


def _size(array: Array) -> str:
    return f"{array.shape[1]} × {array.shape[0]}"
