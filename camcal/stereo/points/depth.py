"""Depth and its uncertainty from the disparities of a rectified pair, computed in blocks of rows.

Maps have tens of megapixels; everything here works on a slice of rows, so that what stands between the map and its
points stays in the cache.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray
from camcal.brief import Brief
from camcal.errors import InvalidInput
from camcal.stereo.geometry import StereoGeometry
from camcal.stereo.points.calibration_error import CalibrationError
from camcal.stereo.rectify.record import LATLON

_FARTHEST = 1e38  # metres; hardly more fits into a float32


@dataclass(frozen=True, eq=False)
class StereoImage(Brief):
    """The left image of a rectified pair and what is known of its pixels. The arrays are neither copied nor changed.

    disparity: (H, W) pixels, left minus right; NaN and infinite values mean no match, zero and less as well unless
    signed: then the search went below zero, as for cameras that are toed in, and d + doffs > 0 alone decides.
    pixels: (H, W) gray, (H, W, 3) blue, green, red or (H, W, 4) with alpha; uint8, uint16 or float32 0 … 1.
    sigma: (H, W) or one number, pixels, standard deviation of the disparity, NaN where it is not known.
    confidence: (H, W), see `Confidence`. calibration: what its uncertainty adds, None for an exact one.
    Raises InvalidInput if a picture has another size than the map.
    """

    disparity: Float32Array
    geometry: StereoGeometry
    signed: bool = False
    pixels: PixelArray | None = None
    sigma: Float32Array | float | None = None
    confidence: NDArray[np.uint8] | None = None
    calibration: CalibrationError | None = None

    def __post_init__(self) -> None:
        require_size(self.pixels, self.shape, "image")
        require_size(self.sigma if isinstance(self.sigma, np.ndarray) else None, self.shape, "image of sigma")
        require_size(self.confidence, self.shape, "image of confidence")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.disparity.shape
        return height, width

    def matched(self, rows: slice) -> BoolArray:
        """Return where in some rows there is a match before the cameras, (N, W) bool."""
        return self._matched(rows, self._shifted_as_is(rows))

    def shifted(self, rows: slice) -> Float32Array:
        """Return d + doffs of some rows (N, W), float32 pixels, NaN where there is no match before the cameras."""
        shifted = self._shifted_as_is(rows)
        return np.where(self._matched(rows, shifted), shifted, np.float32(np.nan))

    def parallax(self, rows: slice) -> Float32Array:
        """Return f b / depth of some rows (N, W), float32 pixels, NaN where there is no match before the cameras."""
        return self.geometry.parallax(self.shifted(rows), rows)

    def depth(self, rows: slice) -> Float32Array:
        """Return the depth of some rows (N, W), float32 metres, NaN where there is no match.

        z along the optical axis, f b / (d + doffs): Hartley & Zisserman, 2nd ed., ch. 9; where the geometry is not
        pinhole, the distance from the baseline's line.
        """
        return np.asarray(np.float32(self.geometry.scale) / self.parallax(rows))

    def depth_of_matches(self, rows: slice) -> Float32Array:
        """Return the same as `depth`, but any number where there is no match: for who knows where that is."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return np.asarray(np.float32(self.geometry.scale) / self.geometry.parallax(self._shifted_as_is(rows), rows))

    def _shifted_as_is(self, rows: slice) -> Array:
        disparity = self.disparity[rows].astype(np.float32, copy=False)
        return np.asarray(disparity + np.float32(self.geometry.doffs))

    def _matched(self, rows: slice, shifted: Array) -> Array:
        least = np.float32(self.geometry.scale / _FARTHEST)
        matched = (shifted > least) & (shifted < np.inf)
        if self.geometry.projection == LATLON:
            with np.errstate(invalid="ignore", over="ignore"):
                matched &= self.geometry.parallax(shifted, rows) > least
        if self.geometry.doffs > 0 and not self.signed:
            matched &= self.disparity[rows] > 0
        return np.asarray(matched)

    def relative_sigma(self, rows: slice) -> Float32Array:
        """Return the standard deviation of the depth of some rows as a share of it, (N, W), NaN where not known.

        (sigma_z / z)² = (sigma_d² + what the calibration adds) / (d + doffs)²; for latlon see StereoGeometry.effective.
        Raises InvalidInput if sigma is not known at all.
        """
        if self.sigma is None:
            raise InvalidInput("unknown standard deviation of the disparity: set --sigma-disparity")
        sigma = np.asarray(self.sigma[rows] if isinstance(self.sigma, np.ndarray) else self.sigma, np.float32)
        effective = self.geometry.effective(self.shifted(rows), rows)
        with np.errstate(over="ignore"):
            if self.calibration is None:
                return np.asarray(sigma / effective)
            return np.asarray(np.sqrt(sigma**2 + self.calibration.variance_of(effective, rows)) / effective)


def row_blocks(shape: tuple[int, int], pixels: int) -> Iterator[slice]:
    """Yield slices of rows that together are all rows of an image (height, width), each of about so many pixels."""
    height, width = shape
    step = max(1, pixels // width)
    return (slice(start, min(start + step, height)) for start in range(0, height, step))


def widened(rows: slice, halo: int, height: int) -> tuple[slice, slice]:
    """Return rows with up to `halo` more on either side, and where in those the rows themselves are."""
    start, stop = max(rows.start - halo, 0), min(rows.stop + halo, height)
    return slice(start, stop), slice(rows.start - start, rows.stop - start)


def require_size(image: Array | None, shape: tuple[int, int], name: str) -> None:
    """Raise InvalidInput if there is an image and it has another size than the disparity map (height, width)."""
    if image is not None and image.shape[:2] != shape:
        height, width = image.shape[:2]
        raise InvalidInput(
            f"the {name} is {width} × {height}, the disparity map {shape[1]} × {shape[0]}; they must be the same"
        )
