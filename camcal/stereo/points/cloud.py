"""From the pixels of a stereo image to vertices, some rows at a time: no cloud need be in memory as a whole."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.mosaic import full_scale
from camcal.stereo.points.depth import StereoImage, row_blocks
from camcal.stereo.points.frames import UNITS, BackProjection, Frame
from camcal.stereo.points.normals import normals
from camcal.stereo.points.vertices import COLOUR, INTENSITY, NORMAL, POSITION, SIGMA, VertexStream, vertex_type
from camcal.stereo.points.voxels import drawn, one_per_voxel

InOrder = Callable[[Callable[[slice], Array], Iterable[slice]], Iterable[Array]]

_BLOCK = 1 << 17  # pixels made into vertices at a time: few enough for the cache, enough for threads


@dataclass(frozen=True, eq=False)
class CloudMaker:
    """The points of an image whose pixels are `kept` (H, W) bool, as vertices in a frame.

    normals, sigma: whether vertices have them. organised: the vertices are all pixels of a grid of every `stride`-th
    row and column, with NaN for x y z where none is kept.
    """

    image: StereoImage
    kept: Array
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
        raise InvalidInput(
            "an organised cloud has a place for every pixel; voxels and a number of points are not for it"
        )
    vertices = np.concatenate([np.empty(0, stream.type), *stream.blocks])
    if voxel is not None:
        vertices = one_per_voxel(vertices, voxel)
    if max_points is not None:
        vertices = vertices[drawn(len(vertices), max_points)]
    return replace(stream, count=len(vertices), blocks=iter([vertices]))
