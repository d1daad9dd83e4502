"""Vertices from the pixels of a stereo image, computed in blocks of rows.

Normals of surfaces come from planes fitted to parallaxes, f b / depth. The plane n · P = D is seen with the parallax
(f b / D) n · ray, for a pinhole view (f b / D) (n_x x + n_y y + n_z) at the image point (x, y): a plane in space is a
plane in the map too, in other views within a small window. Its fit needs sums over windows of pixels and no neighbour
search.

A cloud is thinned to one point for each cube of a grid, or to so many drawn at random.
"""

from collections.abc import Callable, Iterable

import cv2
import numpy as np

from camcal.arrays import Array, BoolArray
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.raw.mosaic import full_scale
from camcal.records import Brief
from camcal.stereo.depth import (
    COLOUR,
    INTENSITY,
    NORMAL,
    POSITION,
    SIGMA,
    UNITS,
    BackProjection,
    Frame,
    StereoImage,
    VertexStream,
    row_blocks,
    vertex_type,
    widened,
)
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import LATLON, PINHOLE

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
    parallax = image.parallax(wide)
    matched = np.isfinite(parallax)
    slopes = _fitted(np.where(matched, parallax, np.float32(0)), matched.astype(np.float32), within)
    found = _plane(image.geometry, image.shape, rows, *slopes)
    found /= -np.sqrt(found[0] ** 2 + found[1] ** 2 + found[2] ** 2)
    return found


def _plane(
    geometry: StereoGeometry, shape: tuple[int, int], rows: slice, slope_u: Array, slope_v: Array, level: Array
) -> Array:
    """Return m (3, N, W) of the planes m · X = f b that have such parallaxes and slopes of it, px and px per pixel.

    With X = depth · ray the parallax is m · ray, and its slopes are m · d(ray)/du and m · d(ray)/dv.
    """
    columns, down = (part.astype(np.float32) for part in geometry.rays(shape))
    down = down[:, rows, None]
    if geometry.projection == PINHOLE:
        x, y = slope_u * np.float32(geometry.fx), slope_v * np.float32(geometry.fy)
        return np.stack([x, y, level - x * columns[0] - y * down[1]])
    along, angle = (down[1], columns[:, None]) if geometry.upright else (columns[0][None], down)
    slope_along, slope_across = (slope_v, slope_u) if geometry.upright else (slope_u, slope_v)
    across_focal = np.float32(geometry.fx if geometry.upright else geometry.fy)
    stretch = 1 + along**2 if geometry.projection == LATLON else np.float32(1)
    sine, cosine = angle[0 if geometry.upright else 1], angle[2]
    first = slope_along * np.float32(geometry.focal) / stretch
    radial, turning = level - first * along, slope_across * across_focal
    second, third = radial * sine + turning * cosine, radial * cosine - turning * sine
    return np.stack([second, first, third] if geometry.upright else [first, second, third])


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


InOrder = Callable[[Callable[[slice], Array], Iterable[slice]], Iterable[Array]]

_BLOCK = 1 << 17  # pixels made into vertices at a time: few enough for the cache, enough for threads


@dataclass(frozen=True, eq=False)
class CloudMaker(Brief):
    """The points of an image whose pixels are `kept` (H, W) bool, as vertices in a frame.

    normals, sigma: whether vertices have them. organised: the vertices are all pixels of a grid of every `stride`-th
    row and column, with NaN for x y z where none is kept.
    """

    image: StereoImage
    kept: BoolArray
    frame: Frame = field(default_factory=Frame)
    normals: bool = False
    sigma: bool = False
    organised: bool = False
    stride: int = 1

    def stream(self, notes: dict[str, str] | None = None, in_order: InOrder = map) -> VertexStream:
        """Return the cloud, made while its blocks are gone through.

        notes: more that files say. in_order: maps a function over blocks of rows in their order, like `map`, ahead of
        what is asked for if it has threads.
        """
        grid = self._grid() if self.organised else None
        return VertexStream(
            count=grid[0] * grid[1] if grid else int(np.count_nonzero(self.kept)),
            type=self.type,
            blocks=in_order(_VertexBlocks(self).of_rows, row_blocks(self.image.shape, _BLOCK)),
            unit=self.frame.unit,
            frame=self.frame.words,
            notes=notes or {},
            grid=grid,
        )

    @property
    def type(self) -> np.dtype[np.void]:
        """The record of a vertex."""
        pixels = self.image.pixels
        return vertex_type(
            colour=pixels is not None,
            intensity=pixels is not None and pixels.ndim == 2,
            normals=self.normals,
            sigma=self.sigma,
        )

    def _grid(self) -> tuple[int, int]:
        height, width = self.image.shape
        return -(-width // self.stride), -(-height // self.stride)


class _VertexBlocks:
    """Makes the vertices of blocks of rows; blocks do not depend on one another."""

    def __init__(self, maker: CloudMaker) -> None:
        self._maker = maker
        self._type = maker.type
        self._places = BackProjection(maker.image.geometry, maker.image.shape, maker.frame)

    def of_rows(self, rows: slice) -> Array:
        """Return the vertices of some rows, structured (N,)."""
        maker = self._maker
        kept = maker.kept[rows]
        dense = self._dense(rows)
        if not maker.organised:
            # An item of so many bytes moves several times faster than a record of fields does.
            return np.asarray(dense.view(np.dtype((np.void, self._type.itemsize)))[kept].view(self._type))
        for name in POSITION:
            dense[name][~kept] = np.nan
        return dense[-rows.start % maker.stride :: maker.stride, :: maker.stride].reshape(-1)

    def _dense(self, rows: slice) -> Array:
        """Return a vertex for every pixel of some rows, (N, W), whether it has a match or not."""
        maker = self._maker
        depth = maker.image.depth_of_matches(rows)
        dense = np.empty(depth.shape, self._type)
        with np.errstate(invalid="ignore", over="ignore"):  # where there is no match
            for axis, name in enumerate(POSITION):
                dense[name] = self._places.coordinate(axis, rows, depth)
        if maker.image.pixels is not None:
            _fill_appearance(dense, maker.image.pixels[rows])
        if maker.normals:
            for name, component in zip(NORMAL, self._places.turned(normals(maker.image, rows)), strict=True):
                dense[name] = component
        if maker.sigma:
            dense[SIGMA] = maker.image.relative_sigma(rows) * depth * np.float32(UNITS[maker.frame.unit])
        return dense


def _fill_appearance(dense: Array, pixels: Array) -> None:
    """Write the colour 0 … 255 of pixels (N, W[, 3 or 4]) into vertices (N, W), and the intensity of gray."""
    colours = pixels
    if pixels.dtype != np.uint8 or pixels.ndim == 2:
        light = pixels / np.float32(full_scale(pixels.dtype))
        if pixels.ndim == 2:
            dense[INTENSITY] = light
        if pixels.dtype != np.uint8:
            colours = np.rint(np.clip(np.nan_to_num(light), 0, 1) * 255).astype(np.uint8)
    for name, channel in zip(COLOUR, (2, 1, 0), strict=True):
        dense[name] = colours if pixels.ndim == 2 else colours[..., channel]


def thinned(stream: VertexStream, voxel: float | None = None, max_points: int | None = None) -> VertexStream:
    """Return the cloud with one vertex for each voxel, and then no more than so many; it is in memory as a whole.

    voxel: side in the unit of the cloud. Raises InvalidInput for a cloud that is organised as an image.
    """
    if voxel is None and max_points is None:
        return stream
    if stream.grid is not None:
        raise InvalidInput("an organised cloud has a point for every pixel: leave out voxels and the number of points")
    vertices = np.concatenate([np.empty(0, stream.type), *stream.blocks])
    if voxel is not None:
        vertices = one_per_voxel(vertices, voxel)
    if max_points is not None:
        vertices = vertices[drawn(len(vertices), max_points)]
    return replace(stream, count=len(vertices), blocks=iter([vertices]))


_LARGEST_KEY = 2**62


def require_thinning(size: float | None, wanted: int | None) -> None:
    """Raise InvalidInput for the side of a voxel that is none, and for less than one point."""
    if size is not None and not (np.isfinite(size) and size > 0):
        raise InvalidInput(f"the side of a voxel must be positive, found {size:g}")
    if wanted is not None and wanted < 1:
        raise InvalidInput(f"at least one point is needed, found {wanted}")


def one_per_voxel(vertices: Array, size: float) -> Array:
    """Return one vertex for each cube of a grid that holds any, in the order of the cubes.

    vertices: structured (N,), see `vertex_type`. size: side of the cubes, in the unit of x y z; (0, 0, 0) is a corner.
    A vertex is the mean of those in its cube. Of sigma it is the root of the mean square: what neighbouring pixels
    have wrong is much the same, so that a mean of many is hardly better than one.
    Raises InvalidInput unless the side is positive and the cubes can be counted.
    """
    require_thinning(size, None)
    _, cube, count = np.unique(_keys(vertices, size), return_inverse=True, return_counts=True)
    merged = np.empty(len(count), vertices.dtype)
    for name in vertices.dtype.names or ():
        column = vertices[name].astype(np.float64)
        if name == SIGMA:
            merged[name] = np.sqrt(np.bincount(cube, column**2, len(count)) / count)
        elif name not in NORMAL:
            mean = np.bincount(cube, column, len(count)) / count
            merged[name] = np.rint(mean) if vertices.dtype[name].kind == "u" else mean
    if NORMAL[0] in (vertices.dtype.names or ()):
        _merge_normals(vertices, cube, merged)
    return merged


def _keys(vertices: Array, size: float) -> Array:
    """Return a number for each vertex (N,), int64, the same for those in one cube."""
    key = np.zeros(len(vertices), np.int64)
    cubes = 1.0
    for name in POSITION:
        place = np.floor(vertices[name] / np.float32(size))
        first = place.min(initial=np.inf)
        extent = float(place.max(initial=-np.inf)) - float(first) + 1 if len(place) else 1.0
        cubes *= extent
        if not cubes < _LARGEST_KEY:
            raise InvalidInput(f"voxels of {size:g} are too many for the extent of the cloud: use a larger side")
        key *= int(extent)
        key += (place - first).astype(np.int64)
    return key


def _merge_normals(vertices: Array, cube: Array, merged: Array) -> None:
    """Write the direction of the mean normal, NaN for a cube in which none is known."""
    sums = [np.bincount(cube, np.nan_to_num(vertices[name]), len(merged)) for name in NORMAL]
    length = np.sqrt(sum(component**2 for component in sums))
    for name, component in zip(NORMAL, sums, strict=True):
        merged[name] = np.divide(component, length, out=np.full(len(merged), np.nan), where=length > 0)


def drawn(count: int, wanted: int) -> Array:
    """Return (count,) bool, True for so many drawn at random, or for all if there are no more; always the same ones.

    Raises InvalidInput if `wanted` is less than 1.
    """
    require_thinning(None, wanted)
    taken = np.ones(count, bool)
    if count > wanted:
        taken[np.random.default_rng(0).choice(count, count - wanted, replace=False, shuffle=False)] = False
    return taken
