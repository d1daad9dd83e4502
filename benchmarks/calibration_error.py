"""How far calibrations from rendered photographs are from the truth: camcal's and OpenCV's corners, and both solvers.

Every set is a number of photographs of a chessboard (1280 x 960, blur 0.7 px, noise 2 DN, uneven light) through a lens
with 12 % distortion. A row: RMS error of the corners per axis, 1/1000 px, and NEES / 2 where covariances are claimed;
RMS distance over the whole image by which the calibrated lens misplaces rays (a rotation taken out), 1/1000 px. Medians
over the sets. "refined": corners refined with the calibrated lens.

    python benchmarks/calibration_error.py [--sets 6] [--views 19] [--gamma 1.0]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from peers.opencv_corners import SECTOR_BASED, refined, sector_based
from projection_error import projection_errors

from camcal import opencv
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.images.files import save
from camcal.progress import SILENT
from camcal.raw.options import AS_IMAGES
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import Board
from camcal.targets.detect import detect
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.images_again import refine_corners

SIZE, BOARD = (1280, 960), Board("chessboard", 9, 6, 0.04)
LENS = Camera(model_named("opencv5"), SIZE, np.array([960.0, 964, 645, 472, -0.12, 0.06, 5e-4, -3e-4, 0.01]))
HOW = Options(LENS.model, shape=ShapeOptions(smooth=False, offsets=False))
ROWS = (
    "camcal, initial", "camcal, refined", "SB, camcal's solver", "SB accurate, camcal's solver",
    "cornerSubPix, camcal's solver", "SB accurate, calibrateCamera", "cornerSubPix, calibrateCamera",
)  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--sets", type=int, default=6)
    parser.add_argument("--views", type=int, default=19)
    parser.add_argument("--gamma", type=float, default=1.0)
    options = parser.parse_args()
    results = [one_set(seed, options.views, options.gamma) for seed in range(options.sets)]
    print("| corners, solver | corners 1/1000 px | NEES / 2 | lens 1/1000 px |")
    print("|---|---|---|---|")
    for name in ROWS:
        figures = np.array([result[name] for result in results])
        corner, nees, lens = np.median(figures, axis=0)
        print(f"| {name} | {1e3 * corner:.1f} | {'' if np.isnan(nees) else f'{nees:.2f}'} | {1e3 * lens:.1f} |")


def one_set(seed: int, count: int, gamma: float) -> dict[str, tuple[float, float, float]]:
    """Return for every row the corners' error, NEES / 2 and the lens's error."""
    rng = np.random.default_rng(seed)
    poses = views(LENS, BOARD, count, rng=rng)
    images = [render(LENS, BOARD, pose, rng=rng, exposure=Exposure(gamma=gamma)) for pose in poses]
    truth = [LENS.project(pose.apply(BOARD.points())).pixels for pose in poses]
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        names = [str(Path(folder) / f"{index}.png") for index in range(count)]
        for name, image in zip(names, images, strict=True):
            save(Path(name), image)
        first = [seen(name, image) for name, image in zip(names, images, strict=True)]
        calibration = calibrate(first, BOARD, HOW)
        second = refine_corners(calibration, first, (), AS_IMAGES, 1, SILENT).views
    result["camcal, initial"] = judged(first, truth)
    result["camcal, refined"] = judged(second, truth)
    peers = {"SB": [], "SB accurate": [], "cornerSubPix": []}
    for name, image, corners in zip(names, images, truth, strict=True):
        for way, pixels in opencv_corners(image, corners).items():
            peers[way].append(BoardDetection(name, SIZE, np.arange(BOARD.count), pixels))
    for way, found in peers.items():
        result[f"{way}, camcal's solver"] = judged(found, truth)
        result[f"{way}, calibrateCamera"] = judged(found, truth, solver="OpenCV")
    return result


def seen(name: str, image: np.ndarray) -> BoardDetection:
    """Return what camcal sees in an image."""
    detection = detect(image, BOARD)
    return BoardDetection(name, SIZE, detection.ids, detection.pixels, detection.covariance)


def opencv_corners(image: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    """Return OpenCV's corners (N, 2) in the order of the true ones, by way."""
    result = {}
    with opencv.repeatable(0):
        for way, flags in SECTOR_BASED.items():
            corners = sector_based(image, BOARD, flags)
            if corners is not None:
                result[way] = _ordered(corners, truth)
        if "SB" in result:
            result["cornerSubPix"] = refined(image, result["SB"])
    return result


def _ordered(pixels: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return pixels[np.linalg.norm(pixels[None] - truth[:, None], axis=2).argmin(axis=1)]


def judged(
    found: Sequence[BoardDetection], truth: Sequence[np.ndarray], solver: str = "camcal"
) -> tuple[float, float, float]:
    """Return the corners' error, NEES / 2 and the lens's error."""
    by_image = {Path(view.image).stem: view for view in found}
    off = np.concatenate([view.pixels - truth[int(stem)][view.ids] for stem, view in by_image.items()])
    nees = float("nan")
    if all(view.covariance is not None for view in found):
        covariance = np.concatenate([view.covariance for view in found])
        nees = float(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off).mean() / 2)
    errors = projection_errors(LENS, solved(found, solver))[1]
    return float(np.sqrt((off**2).mean())), nees, float(np.sqrt(np.nanmean(errors**2)))


def solved(found: Sequence[BoardDetection], solver: str) -> Camera:
    """Return the camera that a solver makes of the views."""
    if solver == "camcal":
        return calibrate(found, BOARD, HOW).camera
    points = [BOARD.points()[view.ids].astype(np.float32) for view in found]
    pixels = [view.pixels.astype(np.float32) for view in found]
    _, matrix, distortion, *_ = cv2.calibrateCamera(points, pixels, SIZE, None, None)
    values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(distortion)[:5]]
    return replace(LENS, parameters=np.array(values))


if __name__ == "__main__":
    main()
