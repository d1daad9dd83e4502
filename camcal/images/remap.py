"""Undistortion and rectification maps, and images drawn through them.

Where every pixel of a view comes from is found on a coarse lattice, with cubics between its nodes. A lens is smooth: on
a 12 MP image cubics over 16 pixels stay within 1e-4 px of it. Every cell is checked at its middle, and where they do
not hold, or the lens ends, the model itself is asked pixel by pixel.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray, readonly
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.images.image import Scratch
from camcal.images.options import require_view
from camcal.opencv import LONGEST_REMAPPED, remap

NEAREST_TRUNCATE = "nearest-truncate"
INTERPOLATIONS: Mapping[str, int] = MappingProxyType(
    {
        NEAREST_TRUNCATE: cv2.INTER_NEAREST,
        "nearest": cv2.INTER_NEAREST,
        "linear": cv2.INTER_LINEAR,
        "cubic": cv2.INTER_CUBIC,
        "lanczos": cv2.INTER_LANCZOS4,
    }
)
CHANNELS = ("blue", "green", "red")  # of a colour image, in its order
STEP = 16  # pixels between nodes, and rows in a band: a band of two maps stays in the processor's cache
ACCURACY = 2e-4  # px, at the middle of a cell, where a cubic is farthest off

_BAND = 32
_FOUR_ARE_FASTER = int(cv2.__version__.partition(".")[0]) >= 5
_OUTSIDE = -16.0  # so far from the image that no interpolation reaches it
_EDGE = 2e-3  # px; a position off the image by less than the map's own error is on its border
_POSITION_TOLERANCE = 1e-9  # px; rounding must not take a whole pixel from a position that is one


@dataclass(frozen=True, eq=False)
class Maps:
    """Where every pixel of a view comes from.

    x, y: (H, W) float32 source pixels, rounded already for the nearest pixel; far outside where there is none.
    source_size: (width, height) of the images these maps are for. aligned: maps of their own for channels 0, 1, 2 of
    colour images, valid where these are; gray and alpha never use them.
    """

    x: Float32Array
    y: Float32Array
    source_size: tuple[int, int]
    interpolation: str
    aligned: Mapping[int, "Maps"] = field(default_factory=dict)

    def valid(self) -> BoolArray:
        """Return the mask (H, W) of pixels that come from inside the source image."""
        return np.asarray(self.x != np.float32(_OUTSIDE))

    def apply(self, pixels: Array, border: Sequence[float] = (0.0,), scratch: Scratch | None = None) -> PixelArray:
        """Return the view (H, W[, C]) of an image (h, w[, C]) of the source's size, in the image's own type.

        border: what pixels without a source become, one number for all channels or one for each.
        scratch: memory for the result, which is its own until the next image is drawn with it.
        OpenCV places what it draws to 0.001 px (5.x) or 0.02 px (4.14) for linear interpolation, 0.06 px for cubic
        and 0.03 px for Lanczos interpolation: where the image is measured, linear is best.
        Raises InvalidInput for an image of another size, or a border that its type cannot hold.
        """
        if pixels.shape[1::-1] != self.source_size:
            raise InvalidInput("is {}x{}, the maps are for {}x{}".format(*pixels.shape[1::-1], *self.source_size))
        value = _border_value(border, pixels)
        scratch = scratch or Scratch()
        result = scratch.array("drawn", (*self.x.shape, *pixels.shape[2:]), pixels.dtype)
        if self.aligned and pixels.ndim == 3:
            self._draw_channels(pixels, value, scratch, result)
        else:
            self.draw(pixels, value, scratch, result)
        return result

    def _draw_channels(self, pixels: Array, value: Sequence[float], scratch: Scratch, result: Array) -> None:
        """Draw every channel through its own maps."""
        planes = []
        for channel in range(pixels.shape[2]):
            plane = scratch.array(f"channel {channel}", pixels.shape[:2], pixels.dtype)
            planes.append(scratch.array(f"channel {channel} drawn", self.x.shape, pixels.dtype))
            cv2.extractChannel(pixels, channel, plane)
            self.aligned.get(channel, self).draw(plane, (value[channel],) * 4, scratch, planes[-1])
        cv2.merge(planes, result)

    def draw(self, pixels: Array, value: Sequence[float], scratch: Scratch, result: Array) -> None:
        """Draw all channels of an image alike into `result`; value: four numbers for the border, one a channel."""
        colour = pixels.dtype == np.uint8 and pixels.shape[2:] == (3,)
        short = max(*pixels.shape[:2], *self.x.shape) <= LONGEST_REMAPPED
        if _FOUR_ARE_FASTER and colour and short and self.interpolation == "linear":
            self._draw_with_alpha(pixels, value, scratch, result)
            return
        narrow = INTERPOLATIONS[self.interpolation] in (cv2.INTER_NEAREST, cv2.INTER_LINEAR)
        if narrow and np.isfinite(value).all():
            self._draw(pixels, cv2.BORDER_CONSTANT, value, result)
            return
        # A wide kernel near the edge is to see the image's edge again, not the border value; nor may NaN, times 0.
        self._draw(pixels, cv2.BORDER_REPLICATE, (), result)
        result[~self.valid()] = value[: pixels.shape[2]] if pixels.ndim == 3 else value[0]

    def _draw(self, pixels: Array, border: int, value: Sequence[float], result: Array) -> None:
        flag = INTERPOLATIONS[self.interpolation]
        for rows in self._bands():
            remap(pixels, self.x[rows], self.y[rows], flag, border, value, result[rows])

    def _draw_with_alpha(self, pixels: Array, value: Sequence[float], scratch: Scratch, result: Array) -> None:
        """Draw colour by way of colour with alpha, which gives the same numbers in three quarters of the time."""
        wide = cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA, scratch.array("widened", (*pixels.shape[:2], 4), np.uint8))
        band = np.empty((_BAND, self.x.shape[1], 4), np.uint8)
        for rows in self._bands():
            part = band[: rows.stop - rows.start]
            cv2.remap(wide, self.x[rows], self.y[rows], cv2.INTER_LINEAR, part, cv2.BORDER_CONSTANT, value)
            cv2.cvtColor(part, cv2.COLOR_BGRA2BGR, result[rows])

    def _bands(self) -> Iterator[slice]:
        """Yield slices of rows: what a band reads and writes stays in the processor's cache."""
        height = len(self.x)
        return (slice(start, min(start + _BAND, height)) for start in range(0, height, _BAND))


def build_maps(
    source: Camera,
    view: Camera,
    interpolation: str = "linear",
    source_R_view: Array | None = None,
    circle: ImageCircle | None = None,
) -> Maps:
    """Return the maps from images of `source` to `view`; source_R_view (3, 3): the view's axes in the source's frame.

    circle: the source's image circle; what would come from outside of it has no source.
    Positions are good to 1e-3 px; for nearest-truncate they are the model's own, so that a textbook's loop over all
    pixels gives the same image.
    Raises InvalidInput for an unknown interpolation, or images or views of more pixels than are allowed.
    """
    if interpolation not in INTERPOLATIONS:
        raise InvalidInput(f"interpolation {interpolation!r} is unknown; use one of {', '.join(INTERPOLATIONS)}")
    for size in (source.image_size, view.image_size):
        require_view(size)
    turn = None if source_R_view is None else readonly(source_R_view, (3, 3), "source_R_view")
    trace = Trace(source, view, turn, circle)
    width, height = view.image_size
    x, y = np.empty((2, height, width), np.float32)
    for rows, band in exact_bands(trace) if interpolation == NEAREST_TRUNCATE else bands(trace):
        x[rows], y[rows] = _keep_inside(band, source.image_size, interpolation)
    x.setflags(write=False)
    y.setflags(write=False)
    return Maps(x, y, source.image_size, interpolation)


def align_channels(maps: Maps, lenses: Mapping[str, Camera], view: Camera) -> Maps:
    """Return maps that draw every colour of CHANNELS through its own lens, so that their images coincide in the view.

    lenses: of the colours that do not follow the camera of `maps`. Where that camera has a source, so has every colour:
    one that would come from just outside the image takes the pixel on its border.
    Raises InvalidInput for a colour that images do not have.
    """
    unknown = sorted(set(lenses) - set(CHANNELS))
    if unknown:
        raise InvalidInput(f"channel {unknown[0]!r} is not an image channel; use one of {', '.join(CHANNELS)}")
    aligned = {CHANNELS.index(colour): _follow(maps, lens, view) for colour, lens in lenses.items()}
    return replace(maps, aligned=MappingProxyType(aligned))


def _follow(maps: Maps, lens: Camera, view: Camera) -> Maps:
    """Return the maps of a lens with a source exactly where other maps have one; theirs, where it shows nothing."""
    x, y = np.empty((2, *maps.x.shape), np.float32)
    largest = np.array(maps.source_size, np.float32)[:, None, None] - 1
    trace = Trace(lens, view)
    for rows, band in exact_bands(trace) if maps.interpolation == NEAREST_TRUNCATE else bands(trace):
        main = np.stack([maps.x[rows], maps.y[rows]])
        places = np.clip(_round_band(band, maps.interpolation), 0, largest)
        x[rows], y[rows] = np.where(np.isfinite(places).all(axis=0) & (main[0] != _OUTSIDE), places, main)
    x.setflags(write=False)
    y.setflags(write=False)
    return replace(maps, x=x, y=y)


def _round_band(band: Array, interpolation: str) -> Array:
    """Return positions rounded in place where the interpolation asks for it."""
    if interpolation == "nearest":
        return np.rint(band, out=band)
    return np.floor(band + _POSITION_TOLERANCE, out=band) if interpolation == NEAREST_TRUNCATE else band


def _keep_inside(band: Array, source_size: tuple[int, int], interpolation: str) -> Array:
    """Return positions (2, rows, W) rounded where asked for, on the border if a hair outside, else far outside."""
    band = _round_band(band, interpolation)
    largest = np.array(source_size, band.dtype)[:, None, None] - 1
    if (band >= 0).all() and (band <= largest).all():
        return band
    near = (band >= -_EDGE) & (band <= largest + band.dtype.type(_EDGE))
    np.clip(band, 0, largest, out=band)
    np.copyto(band, _OUTSIDE, where=~(near[0] & near[1]))
    return band


def _border_value(border: Sequence[float], pixels: Array) -> tuple[float, ...]:
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    values = tuple(border) * (channels if len(border) == 1 else 1)
    if len(values) != channels:
        raise InvalidInput(f"{len(values)} border values for {channels} channels; give one, or one for each")
    if pixels.dtype != np.float32 and not all(0 <= value <= np.iinfo(pixels.dtype).max for value in values):
        raise InvalidInput(f"a border of {max(values, key=abs):g} does not fit {pixels.dtype} pixels")
    return values + (0.0,) * (4 - channels)


@dataclass(frozen=True, eq=False)
class Trace:
    """The way from pixels of a view to pixels of a camera.

    source_R_view: (3, 3) turns the view's rays, if given. circle: of the camera; there is no source outside of it.
    """

    source: Camera
    view: Camera
    source_R_view: Array | None = None
    circle: ImageCircle | None = None

    def positions(self, x: Array, y: Array) -> Array:
        """Return the source pixels (2, ...) of view pixels x, y, broadcast against each other; NaN where none is."""
        x, y = np.broadcast_arrays(x, y)
        rays = self.view.unproject(np.column_stack([x.ravel(), y.ravel()])).at()
        if self.source_R_view is not None:
            rays = rays @ self.source_R_view.T
        pixels = self.source.project(rays).pixels
        if self.circle is not None:
            pixels = np.where(self.circle.contains(pixels)[:, None], pixels, np.nan)
        return pixels.T.reshape(2, *x.shape)


def exact_bands(trace: Trace) -> Iterator[tuple[slice, Array]]:
    """Yield slices of rows of the view with the source pixels (2, rows, width) of theirs, from the model itself."""
    width, height = trace.view.image_size
    for start in range(0, height, STEP):
        rows = slice(start, min(start + STEP, height))
        yield rows, trace.positions(np.arange(width), np.arange(rows.start, rows.stop)[:, None])


def bands(trace: Trace) -> Iterator[tuple[slice, Array]]:
    """Yield the same as `exact_bands`, float32, good to a thousandth of a pixel and many times faster."""
    width, height = trace.view.image_size
    columns, rows = -(-width // STEP), -(-height // STEP)
    nodes = trace.positions((np.arange(columns + 3) - 1) * STEP, (np.arange(rows + 3) - 1)[:, None] * STEP)
    rough = _rough_cells(trace, nodes)
    shares = _cubic(np.arange(STEP) / STEP)
    across = (sliding_window_view(nodes, 4, axis=2) @ shares.T).reshape(2, rows + 3, -1)
    across = np.ascontiguousarray(across[:, :, :width], np.float32)
    downwards = shares.astype(np.float32)
    for row in range(rows):
        band = slice(row * STEP, min((row + 1) * STEP, height))
        result = downwards[: band.stop - band.start] @ across[:, row : row + 4]
        x = (np.flatnonzero(rough[row])[:, None] * STEP + np.arange(STEP)).ravel()
        x = x[x < width]
        if x.size:
            result[:, :, x] = trace.positions(x, np.arange(band.start, band.stop)[:, None])
        yield band, result


def _rough_cells(trace: Trace, nodes: Array) -> Array:
    """Return the mask (rows, columns) of the cells of nodes (2, rows + 3, columns + 3) that no cubic describes.

    A cell without a single known node, its neighbours' among them, lies beyond the lens as a whole and is not rough.
    """
    rows, columns = nodes.shape[1] - 3, nodes.shape[2] - 3
    middle = trace.positions((np.arange(columns) + 0.5) * STEP, (np.arange(rows)[:, None] + 0.5) * STEP)
    half = _cubic(np.array([0.5]))[0]
    guess = sliding_window_view(sliding_window_view(nodes, 4, axis=2) @ half, 4, axis=1) @ half
    within = sliding_window_view(np.isfinite(nodes[0]), (4, 4)).any(axis=(2, 3)) | np.isfinite(middle[0])
    return np.asarray(within & ~(np.abs(guess - middle).max(axis=0) < ACCURACY))


def _cubic(t: Array) -> Array:
    """Return the shares (n, 4) of the nodes at -1, 0, 1 and 2 in the value of their cubic at t (Lagrange)."""
    before, after, last = t + 1, t - 1, t - 2
    return np.stack(
        [-t * after * last / 6, before * after * last / 2, -before * t * last / 2, before * t * after / 6], 1
    )
