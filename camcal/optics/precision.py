"""What blur and disparity noise do to measurements. Lengths in metres, pixels where a name says so."""

import math

_PIXEL_VARIANCE = 1 / 12  # px², of a pixel's own square


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

    airy_sigma_px: of diffraction, see `light.airy_sigma`. defocus_px: diameter of the blur disc, whose variance along
    one axis is d²/16. motion_px: length of the motion, variance b²/12. Independent blurs add their variances.
    """
    return math.sqrt(_PIXEL_VARIANCE + airy_sigma_px**2 + defocus_px**2 / 16 + motion_px**2 / 12)


def edge_noise_factor(spread: float, best: float) -> float:
    """Return how much more an edge's place scatters at a blur of `spread` px than at `best` px.

    The variance of an edge's place is noise² / ∫ I'² dx, and ∫ I'² of a Gaussian edge is contrast² / (2 √π spread):
    the scatter grows with the root of the spread. Source: the Cramér-Rao bound, Kay, Estimation Theory, ch. 3.
    """
    return math.sqrt(spread / best)
