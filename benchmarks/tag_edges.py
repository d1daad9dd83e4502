"""Sides of tags as camcal, the AprilTag library and cv2.cornerSubPix measure them, one cause of bias after another.

    python benchmarks/tag_edges.py --trials 8

The renderer is this script's own: the tag, its ink spread beyond the edges or not, is sampled 8 x 8 times a pixel, in
linear light, then blurred, spread by a wide weak halo (halation, veiling glare), encoded and given noise. Sides are 20
to 200 px, tilts up to 60°. A figure is the mean error of a tag's perimeter as designed, in % of it, positive where the
black square comes out too large, with its standard error.
"""

import argparse

import cv2
import numpy as np

from camcal.targets.marker_fit import homography
from camcal.targets.markers import detect_markers
from camcal.targets.pattern import family_named

FAMILY = family_named("tag36h11")
SAMPLES = 8  # a pixel, along x and along y
BLACK, PAPER, ROOM = 0.04, 0.85, 0.3  # of the light
SIDES = (20, 40, 80, 200)
FINE = 50  # places of the print in a cell, along its rows and columns


def srgb(light):
    """Return values encoded as sRGB (IEC 61966-2-1)."""
    return np.where(light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def sharpened(values):
    """Return values after the unsharp mask of a camera."""
    return values + 0.5 * (values - cv2.GaussianBlur(values, (0, 0), 1.0))


# blur (px), halo (weight, standard deviations of its Gaussians in px), encoding, sharpening, noise (gray levels), ink
# (how far black reaches beyond all edges, in cells: 1 % of a cell of a tag of 53 mm is 66 µm)
CAUSES = {
    "linear light, blur 0.5 px": {"blur": 0.5},
    "linear light, blur 1.2 px": {"blur": 1.2},
    "sRGB, blur 0.5 px": {"blur": 0.5, "encode": srgb},
    "sRGB, blur 1.2 px": {"blur": 1.2, "encode": srgb},
    "linear light, halo 10 % of 4 px": {"halo": (0.10, (4,))},
    "linear light, halo 10 % of 2, 6 and 18 px": {"halo": (0.10, (2, 6, 18))},
    "sRGB, halo 3 % of 4 px": {"halo": (0.03, (4,)), "encode": srgb},
    "sRGB, halo 10 % of 4 px": {"halo": (0.10, (4,)), "encode": srgb},
    "sRGB, halo 10 % of 2, 6 and 18 px": {"halo": (0.10, (2, 6, 18)), "encode": srgb},
    "sRGB, sharpened": {"encode": srgb, "sharpen": True},
    "sRGB, noise 6": {"encode": srgb, "noise": 6.0},
    "linear light, paper clipped": {"gain": 1.5},
    "sRGB, paper clipped": {"gain": 1.5, "encode": srgb},
    "sRGB, halo 20 % of 4 px": {"halo": (0.20, (4,)), "encode": srgb},
    "sRGB, halo 10 % of 8 px": {"halo": (0.10, (8,)), "encode": srgb},
    "sRGB, ink spread by 2 % of a cell": {"ink": 0.02, "encode": srgb},
    "sRGB, ink spread by 4 % of a cell": {"ink": 0.04, "encode": srgb},
    "sRGB, ink short by 2 % of a cell": {"ink": -0.02, "encode": srgb},
    "sRGB, ink spread by 2 %, halo 10 % of 4 px": {"ink": 0.02, "halo": (0.10, (4,)), "encode": srgb},
    "sRGB, ink spread by 2 %, paper clipped": {"ink": 0.02, "gain": 1.5, "encode": srgb},
}


def render(tag, entries, size, rng, blur=0.7, halo=None, encode=None, sharpen=False, noise=1.5, gain=1.0, ink=0.0):
    """Return the image (H, W) uint8 of a tag that a homography (8,) places."""
    width, height = size
    fine = np.arange(SAMPLES) / SAMPLES + 0.5 / SAMPLES - 0.5
    x = (np.arange(width)[:, None] + fine).ravel()
    y = (np.arange(height)[:, None] + fine).ravel()
    matrix = np.linalg.inv(np.append(entries, 1.0).reshape(3, 3))
    grid_x, grid_y = np.meshgrid(x, y)
    w = matrix[2, 0] * grid_x + matrix[2, 1] * grid_y + matrix[2, 2]
    u = (matrix[0, 0] * grid_x + matrix[0, 1] * grid_y + matrix[0, 2]) / w
    v = (matrix[1, 0] * grid_x + matrix[1, 1] * grid_y + matrix[1, 2]) / w
    drawn = np.pad(FAMILY.printed(range(tag, tag + 1))[0], 2, constant_values=1.0)
    cells, reach = len(drawn) - 4, round(abs(ink) * FINE)
    spread = cv2.erode if ink > 0 else cv2.dilate
    drawn = spread(np.kron(drawn, np.ones((FINE, FINE))), np.ones((2 * reach + 1, 2 * reach + 1)))
    reflectance = np.pad(BLACK + (PAPER - BLACK) * drawn, FINE, constant_values=ROOM)
    column, row = (
        np.clip(np.floor(((place + 1) * cells / 2 + 3) * FINE), 0, len(reflectance) - 1).astype(int) for place in (u, v)
    )
    light = reflectance[row, column].astype(np.float32)
    light = cv2.GaussianBlur(light, (0, 0), blur * SAMPLES, borderType=cv2.BORDER_REPLICATE)
    light = light.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
    if halo:
        weight, widths = halo
        spread = [cv2.GaussianBlur(light, (0, 0), width, borderType=cv2.BORDER_REPLICATE) for width in widths]
        light = (1 - weight) * light + weight * np.mean(spread, axis=0)
    light = np.clip(gain * light, 0, 1)
    values = encode(light) if encode else light
    values = sharpened(values) if sharpen else values
    return np.clip(np.rint(255 * values + rng.normal(0, noise, values.shape)), 0, 255).astype(np.uint8)


def place(rng, side):
    """Return the corners (4, 2) px of a tag from its top-left as printed, and the image's size, for a side in px."""
    tilt, azimuth, roll = np.radians(rng.uniform(0, 60)), *rng.uniform(-np.pi, np.pi, 2)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    rotation = cv2.Rodrigues(tilt * axis)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    distance = 4.0  # sides
    points = square @ rotation.T + [0, 0, distance]
    extent = int(2.2 * side) + 40
    middle = extent / 2 - 0.5 + rng.uniform(-0.5, 0.5, 2)
    return points[:, :2] / points[:, 2:] * distance * side + middle, (extent, extent)


def perimeter(corners):
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum())


def methods():
    """Return functions (gray, camcal's markers) -> {tag: corners (4, 2) px} by their names."""

    def subpix(gray, markers):
        found = {}
        for tag, corners in zip(markers.ids.tolist(), markers.corners, strict=True):
            half = int(np.clip(perimeter(corners) / 4 / 16, 1, 5))
            start = corners.astype(np.float32).reshape(-1, 1, 2)
            stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-4)
            found[tag] = cv2.cornerSubPix(gray, start, (half, half), (-1, -1), stop).reshape(4, 2)
        return found

    ways = {"camcal": lambda _, markers: dict(zip(markers.ids.tolist(), markers.corners, strict=True))}
    try:
        from pupil_apriltags import Detector

        detector = Detector(families=FAMILY.name, quad_decimate=1.0)
        ways["AprilTag"] = lambda gray, _: {
            tag.tag_id: np.array(tag.corners)[::-1] - 0.5 for tag in detector.detect(gray)
        }
    except ImportError:
        pass
    return ways | {"cornerSubPix": subpix}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=24)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    ways = methods()
    print(f"| {FAMILY.name}, {options.trials} tags a cell | {' | '.join(f'{n} {s} px' for n in ways for s in SIDES)} |")
    print("|---" * (1 + len(ways) * len(SIDES)) + "|")
    for cause, light in CAUSES.items():
        cells = {name: [] for name in ways}
        for side in SIDES:
            for name, errors in rendered_errors(ways, side, light, options.trials).items():
                cells[name].append(summary(errors))
        print(f"| {cause} | {' | '.join(cell for name in ways for cell in cells[name])} |", flush=True)


def rendered_errors(ways, side, light, trials):
    """Return the errors of perimeters, in %, by the names of methods."""
    errors = {name: [] for name in ways}
    for trial in range(trials):
        rng = np.random.default_rng([trial, side])
        corners, size = place(rng, side)
        tag = trial % FAMILY.count
        gray = render(tag, homography(corners), size, rng, **light)
        markers = detect_markers(gray, FAMILY.name)
        for name, way in ways.items():
            measured = way(gray, markers).get(tag)
            if measured is not None:
                errors[name].append(100 * (perimeter(measured) / perimeter(corners) - 1))
    return errors


def summary(errors):
    """Return the mean of errors with its standard error."""
    if len(errors) < 2:
        return "-"
    return f"{np.mean(errors):+.2f} ± {np.std(errors) / np.sqrt(len(errors)):.2f}"


if __name__ == "__main__":
    main()
