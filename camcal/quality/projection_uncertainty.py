"""Uncertainty of projected directions due to the calibration.

A camera's own axes are a choice of its calibration: a rotation of all directions changes what the parameters are, not
what the camera measures. The rotation that best undoes a change of the parameters is therefore taken out.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, readonly
from camcal.cameras.directions import direction_displacements, in_hull
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.messages import Message

GRID = (31, 23)


@dataclass(frozen=True, eq=False)
class ProjectionUncertainty:
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
    if covariance is None:
        raise InvalidInput("the projection uncertainty needs the covariance of the camera, which is not known")
    width, height = camera.image_size
    u, v = np.linspace(0, width - 1, grid[0]), np.linspace(0, height - 1, grid[1])
    pixels = grid_pixels(u, v)
    inside = None if observed is None else in_hull(pixels, observed)
    displacements = direction_displacements(camera, pixels, inside)
    if circle is not None:
        displacements = np.where(circle.contains(pixels)[:, None, None], displacements, np.nan)
    return ProjectionUncertainty(u, v, displacements @ covariance @ displacements.transpose(0, 2, 1), inside)


def grid_pixels(u: Array, v: Array) -> Array:
    """Return the pixels (N, 2) of a grid of columns u and rows v, row by row."""
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
