"""Splines on simulated lenses: how far they are from the truth, beside the parametric model that is the right one.

Each lens has a board of 10 x 7 corners in 40 views, tilted by up to 45° and everywhere in the image, with noise of
0.15 px. The corners are made here: by the formulas of their own that stand below, not by those of the package.
error: RMS over a grid within the hull of the corners of the distance in px between the images of the same directions,
    after the rotation that suits best, of the right model ('oracle') and of the spline; the ratio of the two.
within: share of the components of these differences that are less than 1.96 standard deviations, wanted 92 to 97 %.
    '-n': with the covariance of noise alone.
beyond: the same error in the rest of the image, up to its corners or to the outermost ray of the right model.

    python benchmarks/spline_lenses.py [--seeds 3] [--views 40] [--lenses NAME …]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from split_halves import grid_within

from camcal.calibrate.intrinsics import Calibration, Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

SIZE = (1280, 960)
BOARD = Board("chessboard", 11, 8, 0.03)
NOISE_PX = 0.15
FILLED = 0.97  # of the image's half height and width, where a board may reach to
Formula = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Lens:
    """radius: of θ (rad), in units of the focal length. oracle: the right model. shift: decentring, local: of a bump.

    fov_deg: to where the radius grows.
    """

    name: str
    focal: float
    oracle: str
    radius: Formula
    fov_deg: float
    decentred: float = 0.0
    bump_px: float = 0.0


def brown(k1: float, k2: float, k3: float = 0.0, bottom: float = 0.0) -> Formula:
    def radius(theta: np.ndarray) -> np.ndarray:
        t = np.tan(theta)
        return t * (1 + k1 * t**2 + k2 * t**4 + k3 * t**6) / (1 + bottom * t**2)

    return radius


def polynomial(*k: float) -> Formula:
    return lambda theta: theta * (1 + sum(each * theta ** (2 * power + 2) for power, each in enumerate(k)))


def waves(theta: np.ndarray) -> np.ndarray:
    return 0.004 * np.sin(7 * theta)


LENSES = (
    Lens("tele 15", 4800, "opencv4", brown(0.3, 0.0), 20),
    Lens("normal 45", 1500, "opencv5", brown(-0.15, 0.08, -0.02), 60),
    Lens("wide 80", 760, "opencv5", brown(-0.2, 0.05, -0.005), 110),
    Lens("rational 100", 640, "opencv8", brown(0.3, 0.02, 0.0, 0.6), 130),
    Lens("fisheye 120", 560, "kannala_brandt4", polynomial(-0.03, 0.004, -0.0005, 0.0), 140),
    Lens("fisheye 180", 400, "kannala_brandt4", polynomial(-0.02, -0.003, 0.001, -0.0002), 200),
    Lens("decentred 150", 460, "kannala_brandt5t", polynomial(-0.025, 0.002), 170, decentred=0.002),
    Lens("equisolid 170", 430, "kannala_brandt4", lambda theta: 2 * np.sin(theta / 2), 190),
    Lens("stereographic 160", 380, "kannala_brandt4", lambda theta: 2 * np.tan(theta / 2), 180),
    Lens("bump 80", 760, "opencv5", brown(-0.2, 0.05, -0.005), 110, bump_px=1.0),
    Lens("waves 190", 380, "kannala_brandt4", lambda theta: 1.1 * np.sin(theta / 2) + 0.45 * theta + waves(theta), 190),
    Lens("bump 150", 460, "kannala_brandt4", polynomial(-0.025, 0.002), 170, bump_px=1.0),
)


def project(lens: Lens, points: np.ndarray) -> np.ndarray:
    """Return the pixels (N, 2) of points (N, 3), NaN beyond the lens."""
    across = np.linalg.norm(points[:, :2], axis=1)
    theta = np.arctan2(across, points[:, 2])
    scale = np.where(across > 0, lens.radius(theta) / np.where(across > 0, across, 1.0), 0.0)
    x, y = (points[:, :2] * scale[:, None]).T
    square = x * x + y * y
    p1, p2 = lens.decentred, -0.7 * lens.decentred
    x, y = x + 2 * p1 * x * y + p2 * (square + 2 * x * x), y + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    pixels = lens.focal * np.column_stack([x, 1.002 * y]) + [645.3, 471.8]
    if lens.bump_px:  # a lens element with a dent
        apart = (pixels - [400.0, 350.0]) / 180.0
        pixels = pixels + lens.bump_px * apart * np.exp(-0.5 * (apart**2).sum(axis=1, keepdims=True))
    pixels[theta > np.radians(lens.fov_deg / 2)] = np.nan
    return pixels


def views_of(lens: Lens, count: int, rng: np.random.Generator) -> list[BoardDetection]:
    points = BOARD.points()
    middle, extent = points.mean(axis=0), np.ptp(points, axis=0).max()
    found: list[BoardDetection] = []
    while len(found) < count:
        theta = np.radians(lens.fov_deg / 2) * np.sqrt(rng.uniform(0, 1))
        azimuth = rng.uniform(0, 2 * np.pi)
        way = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
        distance = extent * rng.uniform(0.5, 1.1) * lens.focal / 500
        facing = so3.exp(np.cross([0.0, 0.0, 1.0], way) / max(np.sin(theta), 1e-9) * theta)
        axis = rng.normal(size=3) * [1, 1, 0]
        tilt = so3.exp(axis / np.linalg.norm(axis) * np.radians(rng.uniform(5, 45)))
        roll = so3.exp(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))
        in_camera = (points - middle) @ (facing @ tilt @ roll).T + distance * way
        pixels = project(lens, in_camera)
        with np.errstate(invalid="ignore"):
            seen = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=1)
        if seen.sum() < 30:
            continue
        noisy = pixels[seen] + rng.normal(0, NOISE_PX, (int(seen.sum()), 2))
        found.append(BoardDetection(f"view{len(found):03d}", SIZE, np.flatnonzero(seen), noisy))
    return found


def difference(lens: Lens, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much (N, 2) a lens images elsewhere what the camera sees at pixels, after the best rotation, NaN
    where it does not, and the derivatives of pixels by a rotation (N, 2, 3).
    """
    rays = camera.unproject(pixels).directions
    turn = np.eye(3)
    by_turn = camera.project_with_jacobians(rays).d_point @ -so3.hat(rays)
    for _ in range(5):
        apart = project(lens, rays @ turn.T) - pixels
        good = np.isfinite(apart).all(axis=1)
        step = np.linalg.lstsq(by_turn[good].reshape(-1, 3), -apart[good].ravel(), rcond=None)[0]
        turn = so3.exp(step) @ turn
    return apart, by_turn


def judged(lens: Lens, result: Calibration, pixels: np.ndarray) -> tuple[float, float, float]:
    """Return the error, px, and the shares of differences within 1.96 standard deviations, those of noise second."""
    camera = result.camera
    apart, by_turn = difference(lens, camera, pixels)
    rays = camera.unproject(pixels).directions
    by_lens = camera.project_with_jacobians(rays).by_parameters(len(camera.parameters))
    good = np.isfinite(apart).all(axis=1)
    moved, turns = by_lens[good], by_turn[good].reshape(-1, 3)
    flat = moved.reshape(len(turns), -1)
    flat = flat - turns @ np.linalg.lstsq(turns, flat, rcond=None)[0]
    shares = []
    for covariance in (camera.covariance, result.noise_covariance):
        std = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", flat, covariance, flat, optimize=True), 0))
        shares.append(float(np.mean(np.abs(apart[good].ravel()) <= 1.96 * std)))
    return float(np.sqrt((apart[good] ** 2).sum(axis=1).mean())), *shares


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--lenses", nargs="+", default=[lens.name for lens in LENSES], metavar="NAME")
    arguments = parser.parse_args()
    for lens in LENSES:
        if lens.name not in arguments.lenses:
            continue
        rows: dict[str, list[tuple[float, ...]]] = {}
        knots = []
        for seed in range(arguments.seeds):
            views = views_of(lens, arguments.views, np.random.default_rng(seed))
            pixels = grid_within(np.concatenate([view.pixels for view in views]))
            for name in (lens.oracle, "splined"):
                start = time.process_time()
                try:
                    result = calibrate(views, BOARD, Options(model_named(name)))
                except CamcalError as error:
                    print(f"# {lens.name} {seed} {name}: {error}")
                    continue
                seconds = time.process_time() - start
                rows.setdefault(name, []).append((*judged(lens, result, pixels), seconds))
                if name == "splined":
                    knots.append(result.camera.model.configuration["knots"])
        words = []
        means = {}
        for name, found in rows.items():
            errors, within, of_noise, seconds = np.array(found).T
            means[name] = np.sqrt(np.mean(errors**2))
            words.append(
                f"{name} {means[name]:.4f} px, within {100 * np.mean(within):.0f} % ({100 * np.mean(of_noise):.0f} "
                f"% by noise), {np.mean(seconds):.1f} s"
            )
        ratio = means["splined"] / means[lens.oracle] if len(means) == 2 else np.nan
        print(f"{lens.name:18} ratio {ratio:5.2f}; {'; '.join(words)}; knots {knots}", flush=True)


if __name__ == "__main__":
    main()
