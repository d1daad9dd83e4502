"""Demosaicing by minimized-Laplacian residual interpolation, written after the paper, for an RGGB mosaic.

Source: Kiku, Monno, Tanaka, Okutomi, Minimized-Laplacian Residual Interpolation for Color Image Demosaicking, SPIE
Digital Photography X, 2014.
"""

import cv2
import numpy as np

WHITE = 255.0
FLATTEST = 1e-5 * WHITE**2  # mean squared second difference that is counted at least
SPREAD = 1.4  # pixels, standard deviation of the one-sided means of colour differences
ROW_MEANS = np.array([[0.5, 0, 0.5]])
ROW_CURVE = np.array([[-1.0, 0, 2, 0, -1]])
LAPLACIAN = ROW_CURVE * np.array([[0], [0], [1.0], [0], [0]]) + ROW_CURVE.T * np.array([[0, 0, 1.0, 0, 0]])
MEANS_OF_FOUR = np.array([[0.25, 0.5, 0.25], [0.5, 1, 0.5], [0.25, 0.5, 0.25]])


def mlri(mosaic: np.ndarray) -> np.ndarray:
    """Return red, green, blue (H, W, 3) of a mosaic, 0 to 255 both."""
    mosaic = mosaic.astype(float)
    red, blue = np.zeros_like(mosaic), np.zeros_like(mosaic)
    red[::2, ::2] = blue[1::2, 1::2] = 1
    green = full_green(mosaic, red, blue)
    return np.stack([tentative_and_residual(green, mosaic, mask, LAPLACIAN, 5, MEANS_OF_FOUR) if mask is not None
                     else green for mask in (red, None, blue)], -1)  # fmt: skip


def full_green(mosaic: np.ndarray, red: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """Return green by the colour differences on four sides, weighted by their gradients there."""
    total = weight = np.zeros_like(mosaic)
    taps = np.exp(-(np.arange(5) ** 2) / 2 / SPREAD**2)
    one_sided = np.concatenate([np.zeros(4), taps / taps.sum()])[np.newaxis]
    for vertical in (False, True):
        difference = difference_along(mosaic, red, blue, vertical=vertical)
        gradient = filtered(np.abs(filtered(difference, turned(np.array([[1.0, 0, -1]]), vertical))), np.ones((3, 3)))
        for flip in (1, -1):
            beside = filtered(gradient, turned(np.array([[0, 0, 1.0]])[:, ::flip], vertical))
            importance = 1 / (beside**2 + 0.01)
            total = total + importance * filtered(difference, turned(one_sided[:, ::flip], vertical))
            weight = weight + importance
    return np.clip(mosaic + (red + blue) * total / weight, 0, WHITE)


def difference_along(mosaic: np.ndarray, red: np.ndarray, blue: np.ndarray, *, vertical: bool) -> np.ndarray:
    """Return green minus red or blue everywhere, by neighbours in rows or in columns."""
    means, curve = turned(ROW_MEANS, vertical), turned(ROW_CURVE, vertical)
    linear, green = filtered(mosaic, means), 1 - red - blue
    result = np.zeros_like(mosaic)
    for other in (red, blue):
        line = other.any(axis=0 if vertical else 1, keepdims=True)
        own_green = green * line
        of_green = tentative_and_residual(mosaic * other + linear * own_green, mosaic, own_green, curve, 3, means)
        of_other = tentative_and_residual(mosaic * own_green + linear * other, mosaic, other, curve, 3, means)
        result += (of_green - mosaic) * other + (mosaic - of_other) * own_green
    return result


def tentative_and_residual(
    guide: np.ndarray, samples: np.ndarray, mask: np.ndarray, curvature: np.ndarray, radius: int, means: np.ndarray
) -> np.ndarray:
    """Return samples, known where the mask is 1, as a local line of the guide and the interpolated rest."""
    count = np.maximum(boxed(mask, radius), 1)
    guide_curve, curve = (filtered(image * mask, curvature) * mask for image in (guide, samples))
    slope = boxed(guide_curve * curve, radius) / np.maximum(boxed(guide_curve**2, radius), FLATTEST * count)
    offset = (boxed(samples * mask, radius) - slope * boxed(guide * mask, radius)) / count
    pixels = boxed(np.ones_like(mask), radius)
    tentative = np.clip((boxed(slope, radius) * guide + boxed(offset, radius)) / pixels, 0, WHITE)
    return np.clip(tentative + filtered((samples - tentative) * mask, means), 0, WHITE)


def turned(row: np.ndarray, vertical: bool) -> np.ndarray:
    return np.ascontiguousarray(row.T if vertical else row)


def filtered(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    return cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_CONSTANT)


def boxed(image: np.ndarray, radius: int) -> np.ndarray:
    size = (2 * radius + 1,) * 2
    return cv2.boxFilter(image, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
