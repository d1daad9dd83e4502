"""The thin lens: focus, magnification, exposure, and the effect of blur on measurements.

Lengths are metres, pixels where a name says so. Distances in front of the lens count from its front principal plane,
which in most lenses lies within a few centimetres of the front glass. An infinite distance is math.inf.
Source: Ray, Applied Photographic Optics, 3rd ed., 2002, ch. 5 and 22.

Sensor formats by name. The "inch" of a format refers to camera tubes, not to the sensor size.
"""

import math
import re
from collections.abc import Mapping
from math import hypot
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import nearest

AIRY_PIXELS = 2.0  # an Airy disc wider than that blurs the finest pattern of pixels to half its contrast or less
_FIRST_ZERO = 3.8317059702  # of the Bessel function J1, where the Airy pattern is dark for the first time
_GAUSSIAN = 0.42  # standard deviation of the Gaussian nearest to the Airy pattern, over wavelength and f-number
_PIXEL_VARIANCE = 1 / 12  # px², of a pixel's own square


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


def depth_of_field(focal: float, f_number: float, circle: float, focus: float) -> tuple[float, float]:
    """Return the nearest and farthest distance (m) around `focus` whose blur disc is no larger than the circle.

    Without the approximation of small apertures, near = s (H - f)/(H + s - 2 f), far = s (H - f)/(H - s), or infinity
    from s = H on.
    """
    _require_real(focal, focus)
    reach = hyperfocal(focal, f_number, circle)
    near = (reach - focal) / (1 + (reach - 2 * focal) / focus)
    far = (reach - focal) / (reach / focus - 1) if focus < reach else math.inf
    return near, far


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


def effective_f_number(f_number: float, magnification: float) -> float:
    """Return N (1 + m), the f-number that light on the sensor has at close focus, for a lens with equal pupils."""
    return f_number * (1 + magnification)


def bellows_stops(magnification: float) -> float:
    """Return the stops of light that close focus costs, 2 log2(1 + m)."""
    return 2 * math.log2(1 + magnification)


def exposure_value(f_number: float, exposure: float) -> float:
    """Return log2(N²/t), which is EV at ISO 100, for an exposure in seconds. Source: ISO 2720."""
    return math.log2(f_number**2 / exposure)


def stops_between(exposure: float, other: float) -> float:
    """Return by how many stops an exposure time lets in more light than another."""
    return math.log2(exposure / other)


def airy_diameter(wavelength: float, f_number: float) -> float:
    """Return the diameter (m) of the first dark ring around the image of a point, 2.44 λ N, N the effective one.

    Source: Goodman, Introduction to Fourier Optics, 3rd ed., eq. 4-31.
    """
    return 2 * _FIRST_ZERO / math.pi * wavelength * f_number


def airy_sigma(wavelength: float, f_number: float) -> float:
    """Return the standard deviation (m) of the Gaussian nearest to the image of a point.

    Source: Zhang, Zerubia & Olivo-Marin, Applied Optics 46, 2007: 0.21 λ over the numerical aperture 1/(2 N).
    """
    return _GAUSSIAN * wavelength * f_number


def widest_sharp_f_number(wavelength: float, pitch: float) -> float:
    """Return the effective f-number at which the Airy disc is two pixels wide: beyond it the lens limits the image."""
    return AIRY_PIXELS * pitch / airy_diameter(wavelength, 1.0)


def diffraction_contrast(wavelength: float, f_number: float, pitch: float) -> float:
    """Return the contrast (0 to 1) that a perfect lens keeps at the finest pattern of pixels, half a cycle a pixel.

    Source: Goodman, eq. 6-32, the incoherent transfer function of a circular pupil with cut-off 1/(λ N).
    """
    share = wavelength * f_number / (2 * pitch)
    if share >= 1:
        return 0.0
    return 2 / math.pi * (math.acos(share) - share * math.sqrt(1 - share**2))


def motion_blur(speed: float, exposure: float, pixel: float) -> float:
    """Return by how many pixels an image moves while the shutter is open.

    speed: across the line of sight, m/s. exposure: s. pixel: size of a pixel on the object, m.
    """
    return speed * exposure / pixel


def longest_exposure(speed: float, blur_px: float, pixel: float) -> float:
    """Return the exposure (s) during which the image moves by `blur_px`; see `motion_blur`."""
    return blur_px * pixel / speed


def depth_error(depth: float, focal_px: float, baseline: float, disparity_error: float) -> float:
    """Return the standard deviation (m) of a depth from rectified disparity, z² σ_d / (f b), σ_d in pixels.

    Source: Hartley & Zisserman, ch. 12; the derivative of z = f b / d.
    """
    return depth**2 * disparity_error / (focal_px * baseline)


def edge_spread(airy_sigma_px: float, defocus_px: float, motion_px: float) -> float:
    """Return the standard deviation (px) of the blur of an edge: pixel, diffraction, defocus disc and motion.

    airy_sigma_px: of diffraction, see `airy_sigma`. defocus_px: diameter of the blur disc, whose variance along
    one axis is d²/16. motion_px: length of the motion, variance b²/12. Independent blurs add their variances.
    """
    return math.sqrt(_PIXEL_VARIANCE + airy_sigma_px**2 + defocus_px**2 / 16 + motion_px**2 / 12)


def edge_noise_factor(spread: float, best: float) -> float:
    """Return how much more an edge's place scatters at a blur of `spread` px than at `best` px.

    The variance of an edge's place is noise² / ∫ I'² dx, and ∫ I'² of a Gaussian edge is contrast² / (2 √π spread):
    the scatter grows with the root of the spread. Source: the Cramér-Rao bound, Kay, Estimation Theory, ch. 3.
    """
    return math.sqrt(spread / best)


_INCH_SMALL_MM, _INCH_LARGE_MM = 18.0, 16.0  # of diagonal, for sensors up to half an inch and above
_HALF_INCH = 0.5
_LARGEST_INCH = 2.0
_ASPECT = 4 / 3  # of a format that is known by its inches alone


@dataclass(frozen=True)
class SensorFormat:
    """A format by its name, with the usual width and height of its sensors."""

    name: str
    width_mm: float
    height_mm: float

    @property
    def diagonal_mm(self) -> float:
        """The diagonal, mm."""
        return hypot(self.width_mm, self.height_mm)


# Sizes from the data sheets of common sensors; makers differ by a few percent.
_SIZES = {
    '1/4"': (3.6, 2.7),
    '1/3.6"': (4.0, 3.0),
    '1/3.2"': (4.54, 3.42),
    '1/3"': (4.8, 3.6),
    '1/2.9"': (4.96, 3.72),
    '1/2.8"': (5.57, 3.13),
    '1/2.7"': (5.37, 4.04),
    '1/2.5"': (5.76, 4.29),
    '1/2.3"': (6.17, 4.55),
    '1/2"': (6.4, 4.8),
    '1/1.8"': (7.18, 5.32),
    '1/1.7"': (7.6, 5.7),
    '2/3"': (8.8, 6.6),
    '1/1.2"': (10.67, 8.0),
    '1"': (13.2, 8.8),
    '1.1"': (14.2, 10.4),
    "4/3": (17.3, 13.0),
    "APS-C": (23.5, 15.6),
    "APS-C Canon": (22.3, 14.9),
    "APS-H": (28.7, 19.0),
    "full frame": (36.0, 24.0),
    "44x33": (43.8, 32.9),
}
FORMATS: Mapping[str, SensorFormat] = MappingProxyType(
    {name: SensorFormat(name, *size) for name, size in _SIZES.items()}
)

_OTHER_NAMES = {'4/3"': "4/3", "four thirds": "4/3", "micro four thirds": "4/3", "35mm": "full frame"}
_INCHES = re.compile(r'(?:([0-9]+)/)?([0-9]+(?:\.[0-9]+)?) ?(?:"|″|in|inch|-type)?')


def sensor_format(text: str) -> SensorFormat:
    """Return the format of a name such as 1/2.8, 2/3", APS-C or full frame, whatever the case.

    Fractions of an inch that are not in the list have the diagonal of the rule: 18 mm an inch up to 1/2", 16 mm above.
    Raises InvalidInput, with the nearest name, for anything else.
    """
    plain = " ".join(text.lower().replace("_", " ").split())
    names = {name.lower(): name for name in (*FORMATS, *_OTHER_NAMES)}
    inches = _INCHES.fullmatch(plain)
    for known in (plain, _fraction(inches) if inches else plain):
        if known in names:
            return FORMATS[_OTHER_NAMES.get(names[known], names[known])]
    if inches and 0 < (size := _in_inches(inches)) <= _LARGEST_INCH:
        diagonal = size * (_INCH_SMALL_MM if size <= _HALF_INCH else _INCH_LARGE_MM)
        height = diagonal / hypot(_ASPECT, 1)
        return SensorFormat(_fraction(inches), _ASPECT * height, height)
    near = nearest(plain, names)
    advice = f". Did you mean '{names[near]}'?" if near else f"; known: {', '.join(FORMATS)}"
    raise InvalidInput(f"sensor format {text!r} is unknown{advice}")


def smallest_format(width: float) -> SensorFormat | None:
    """Return the smallest format of the list that is at least `width` (m) wide, None if there is none."""
    wide = [known for known in FORMATS.values() if known.width_mm >= 1e3 * width]
    return min(wide, key=lambda known: known.diagonal_mm, default=None)


def pixel_pitch(sensor: SensorFormat, image_size: tuple[int, int]) -> float:
    """Return the distance of pixels (m) if an image of `image_size` (width, height) fills the format's diagonal."""
    return sensor.diagonal_mm / 1e3 / hypot(*image_size)


def literal_mm(sensor: SensorFormat) -> float | None:
    """Return what the inch in a format's name would be in mm, None for a name without one. No sensor has it."""
    inches = _INCHES.fullmatch(sensor.name) if sensor.name.endswith('"') else None
    return None if inches is None else round(25.4 * _in_inches(inches), 2)


def _fraction(inches: re.Match[str]) -> str:
    """Return inches as the list writes them."""
    over, number = inches.groups()
    return f'{over}/{float(number):g}"' if over else f'{float(number):g}"'


def _in_inches(inches: re.Match[str]) -> float:
    over, number = inches.groups()
    if float(number) == 0:
        return 0.0
    return float(over) / float(number) if over else float(number)
