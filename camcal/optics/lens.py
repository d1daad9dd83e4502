"""The thin lens: where the image is sharp, how large it is, and which distances are sharp enough.

Lengths are metres. Distances in front of the lens count from its front principal plane, which in most lenses lies
within a few centimetres of the front glass. An infinite distance is math.inf.
Source: Ray, Applied Photographic Optics, 3rd ed., 2002, ch. 5 and 22.
"""

import math
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput


@dataclass(frozen=True)
class DepthOfField:
    """The nearest and farthest distance (m) whose blur disc is no larger than the circle of confusion."""

    near: float
    far: float

    @property
    def total(self) -> float:
        """How deep it is, m; infinite where infinity is sharp."""
        return self.far - self.near


def principal_distance(focal: float, focus: float) -> float:
    """Return v (m), from the rear principal plane to the sharp image of what is at `focus`: 1/f = 1/s + 1/v.

    It is what a calibration measures (fx times the pixel pitch), longer than the focal length at close focus.
    Raises InvalidInput if the distance is not beyond the focal length: there is no real image then.
    """
    _require_real(focal, focus)
    return focal / (1 - focal / focus)


def magnification(focal: float, focus: float) -> float:
    """Return the size of the image over that of the object in focus, m = f / (s - f); see `principal_distance`."""
    _require_real(focal, focus)
    return focal / (focus - focal)


def focal_length(distance: float, focus: float) -> float:
    """Return f (m) of a lens whose principal distance is `distance` when focused at `focus`."""
    return distance / (1 + distance / focus)


def hyperfocal(focal: float, f_number: float, circle: float) -> float:
    """Return the nearest focus (m) at which infinity is sharp, H = f²/(N c) + f, for a circle of confusion c (m)."""
    return focal**2 / (f_number * circle) + focal


def depth_of_field(focal: float, f_number: float, circle: float, focus: float) -> DepthOfField:
    """Return what is sharp around `focus`, without the approximation of small apertures.

    near = s (H - f)/(H + s - 2 f), far = s (H - f)/(H - s), or infinity from s = H on.
    """
    _require_real(focal, focus)
    reach = hyperfocal(focal, f_number, circle)
    near = (reach - focal) / (1 + (reach - 2 * focal) / focus)
    far = (reach - focal) / (reach / focus - 1) if focus < reach else math.inf
    return DepthOfField(near, far)


def blur_disc(focal: float, f_number: float, focus: float, distance: Array | float) -> Array:
    """Return the diameter (m, on the sensor) of the image of points at `distance` (any shape, m), lens at `focus`.

    f²/N · |1/d - 1/s| / (1 - f/s), by similar triangles behind an aperture of diameter f/N.
    """
    _require_real(focal, focus)
    defocus = np.abs(1 / np.asarray(distance, dtype=float) - 1 / focus)
    return np.asarray(focal**2 / f_number / (1 - focal / focus) * defocus)


def field_angle(length: float, distance: float) -> float:
    """Return the angle (rad) that a sensor side of `length` sees at a principal distance, its middle on the axis."""
    return 2 * math.atan2(length / 2, distance)


def focal_for_width(sensor: float, focus: float, width: float) -> float:
    """Return the focal length (m) that images `width` at `focus` on a sensor side, f = s m/(1 + m)."""
    return focus * sensor / (width + sensor)


def focus_for_width(focal: float, sensor: float, width: float) -> float:
    """Return the working distance (m) at which a sensor side sees `width`, s = f (1 + 1/m)."""
    return focal * (1 + width / sensor)


def sensor_for_width(focal: float, focus: float, width: float) -> float:
    """Return the length (m) of the sensor side that sees `width` at `focus`, m times the width."""
    return magnification(focal, focus) * width


def _require_real(focal: float, focus: float) -> None:
    if not focus > focal:
        raise InvalidInput(
            f"a lens of {1e3 * focal:g} mm makes no image of what is {1e3 * focus:g} mm away: "
            "focus beyond its focal length"
        )
