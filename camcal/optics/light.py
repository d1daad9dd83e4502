"""How bright and how sharp light lets an image be: f-numbers, exposure values, diffraction. SI units."""

import math

AIRY_PIXELS = 2.0  # an Airy disc wider than that blurs the finest pattern of pixels to half its contrast or less

_FIRST_ZERO = 3.8317059702  # of the Bessel function J1, where the Airy pattern is dark for the first time
_GAUSSIAN = 0.42  # standard deviation of the Gaussian nearest to the Airy pattern, over wavelength and f-number


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
