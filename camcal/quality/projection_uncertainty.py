"""Uncertainty of projected directions due to the calibration.

A camera's own axes are a choice of its calibration: a rotation of all directions changes what the parameters are, not
what the camera measures. The rotation that best undoes a change of the parameters is therefore taken out.
"""

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, readonly
from camcal.cameras.directions import GRID, direction_covariances, grid_pixels, in_hull
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, border_pixels
from camcal.dataclass import dataclass, replace
from camcal.messages import Message
from camcal.records import Brief

_STEPS = 200  # of the way from the middle of a region to the border of the image


@dataclass(frozen=True, eq=False)
class ProjectionUncertainty(Brief):
    """The uncertainty of the projection of directions (points at infinity), at the pixels of a grid over the image.

    u, v: coordinates of the columns and rows of the grid, from the centre of the first pixel to that of the last.
    covariances: (N, 2, 2) px², N = rows · columns, row by row; NaN where the lens is not valid or lights no
    image. inside: (N,) pixels in the convex hull of the corners that were seen, None where they are not known.
    """

    u: FloatArray
    v: FloatArray
    covariances: FloatArray
    inside: BoolArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", readonly(self.u, (None,), "u"))
        object.__setattr__(self, "v", readonly(self.v, (None,), "v"))
        count = len(self.u) * len(self.v)
        object.__setattr__(self, "covariances", readonly(self.covariances, (count, 2, 2), "covariances"))
        if self.inside is not None:
            object.__setattr__(self, "inside", readonly(self.inside, (count,), "inside", bool))

    @property
    def pixels(self) -> FloatArray:
        """The pixels (N, 2) of the grid, row by row."""
        return grid_pixels(self.u, self.v)

    @property
    def std_rms(self) -> FloatArray:
        """The RMS over all image directions of the standard deviation (N,), px."""
        return np.asarray(np.sqrt(np.trace(self.covariances, axis1=1, axis2=2) / 2))

    @property
    def std_worst(self) -> FloatArray:
        """The standard deviation (N,) in the image direction in which it is largest, px."""
        a, b, c = self.covariances[:, 0, 0], self.covariances[:, 0, 1], self.covariances[:, 1, 1]
        return np.asarray(np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b)))

    def figures(self) -> dict[str, float]:
        """Return the figures of the map in px: rms_px and worst_px over the image, and inside_rms_px, inside_worst_px.

        rms_px is the RMS of std_rms, worst_px the largest std_worst; `inside` are those where corners were seen. A
        figure of no pixel is left out.
        """
        found = {}
        parts = {"": np.ones(len(self.covariances), bool), "inside_": self.inside}
        for part, mask in parts.items():
            chosen = np.isfinite(self.std_rms) & (False if mask is None else mask)
            if chosen.any():
                found[f"{part}rms_px"] = float(np.sqrt(np.mean(self.std_rms[chosen] ** 2)))
                found[f"{part}worst_px"] = float(self.std_worst[chosen].max())
        return found


@dataclass(frozen=True, eq=False)
class KnownRegion(Brief):
    """The part of an image in which projections are known: their standard deviation is below limit_px in any direction.

    share: of the image, or of its image circle; of_observed: of the part where corners were seen, 1 where that is not
    known. polygon: (N, 2) px around it, none of whose sides is hidden from its middle; empty if there is no such part.
    """

    limit_px: float
    share: float
    of_observed: float
    polygon: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", readonly(self.polygon, (None, 2), "polygon"))


def known_region(found: ProjectionUncertainty, limit_px: float) -> KnownRegion:
    """Return the part of the image in which a projection is known to `limit_px`, around the middle of the corners, or
    of all pixels that are known where nothing is known there.
    """
    pixels, lit = found.pixels, np.isfinite(found.std_worst)
    std = np.where(lit, found.std_worst, np.inf)
    known, seen = std <= limit_px, lit if found.inside is None else found.inside
    if not known.any():
        return KnownRegion(limit_px, 0.0, 0.0, np.zeros((0, 2)))
    nearest = np.where(
        known, np.linalg.norm(pixels - pixels[seen if seen.any() else known].mean(axis=0), axis=1), np.inf
    )
    middle = pixels[np.argmin(nearest)]
    border = border_pixels(int(found.u[-1]) + 1, int(found.v[-1]) + 1)
    shares = np.linspace(0, 1, _STEPS + 1)
    way = middle + shares[:, None, None] * (border - middle)
    reached = np.logical_and.accumulate(_interpolate(found, std, way) <= limit_px, axis=0)
    polygon = middle + shares[reached.sum(axis=0) - 1, None] * (border - middle)
    inside = in_polygon(pixels, polygon) & known
    return KnownRegion(
        limit_px, float(inside.sum() / lit.sum()), float(inside[seen].mean()) if seen.any() else 1.0, polygon
    )


def _interpolate(found: ProjectionUncertainty, values: Array, pixels: Array) -> Array:
    """Return values of the grid (N,) at pixels (..., 2), linear between those of the grid, large near infinite ones."""
    table = np.minimum(values, 1e9).reshape(len(found.v), len(found.u))
    column, row = (np.interp(pixels[..., i], line, np.arange(len(line))) for i, line in enumerate((found.u, found.v)))
    left, top = (
        np.minimum(place.astype(np.intp), count - 2) for place, count in ((column, len(found.u)), (row, len(found.v)))
    )
    along, down = column - left, row - top
    upper, lower = ((1 - along) * table[y, left] + along * table[y, left + 1] for y in (top, top + 1))
    return np.asarray((1 - down) * upper + down * lower)


def in_polygon(pixels: Array, polygon: Array) -> BoolArray:
    """Return which pixels (N, 2) lie within a polygon (M, 2) or on its sides, to 1e-6 px; none if it is empty."""
    starts, ends = polygon, np.roll(polygon, -1, axis=0)
    sides, apart = ends - starts, pixels[:, None] - starts
    above = (starts[:, 1] > pixels[:, None, 1]) != (ends[:, 1] > pixels[:, None, 1])
    across = sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0]
    crossed = above & ((across < 0) == (sides[:, 1] > 0))
    squares = np.maximum((sides**2).sum(axis=1), 1e-300)
    along = np.clip((apart * sides).sum(axis=2) / squares, 0, 1)
    on_side = (np.linalg.norm(apart - along[..., None] * sides, axis=2) < 1e-6).any(axis=1)
    return np.asarray(on_side | (crossed.sum(axis=1) % 2 == 1))


def with_bias(found: ProjectionUncertainty, bias: Array) -> ProjectionUncertainty:
    """Return the uncertainty with a bias (N, 2) px of its pixels added to it, NaN where none is known."""
    bias = np.nan_to_num(bias)
    return replace(found, covariances=found.covariances + bias[:, :, None] * bias[:, None])


def too_uncertain(found: ProjectionUncertainty, most: float | None) -> tuple[Message, ...]:
    """Return the failure of a camera with a larger uncertainty than `most` (px), none without a limit.

    It is the RMS over the area with corners, or over the whole image where that is not known.
    """
    figures = found.figures()
    reached = figures.get("inside_rms_px", figures["rms_px"])
    if most is None or reached <= most:
        return ()
    text = f"projection uncertainty {reached:.3g} px (limit {most:g} px)"
    return (Message("projection_uncertainty", text, {"uncertainty_px": reached, "limit_px": most}),)


def projection_uncertainty(
    camera: Camera,
    covariance: Array | None = None,
    observed: Array | None = None,
    grid: tuple[int, int] = GRID,
    circle: ImageCircle | None = None,
) -> ProjectionUncertainty:
    """Return how uncertain the projections of directions are that a camera's covariance (K, K) leaves.

    covariance: of the lens parameters, the camera's own if None. observed: pixels (M, 2) of the corners of the
    calibration. grid: columns and rows. circle: the image circle, where there is one. The rotation is the least-squares
    one over the pixels of the grid where corners were seen, see `direction_displacements`.
    Raises InvalidInput where the covariance is not known.
    """
    covariance = camera.covariance if covariance is None else covariance
    width, height = camera.image_size
    u, v = np.linspace(0, width - 1, grid[0]), np.linspace(0, height - 1, grid[1])
    pixels = grid_pixels(u, v)
    inside = None if observed is None else in_hull(pixels, observed)
    found = direction_covariances(camera, covariance, pixels, inside)
    if circle is not None:
        found = np.where(circle.contains(pixels)[:, None, None], found, np.nan)
    return ProjectionUncertainty(u, v, found, inside)
