"""Corners of ChArUco boards and of a square chessboard beside those of OpenCV's and mrgingham's own detectors.

Boards of 10 x 8 squares (current and legacy pattern) and a chessboard of 10 x 10 corners, rendered at 1280 x 960
through a lens with 12 % distortion, blur and noise as given. Per way: corners found, mean error along x and y (bias),
and RMS per axis, 1/1000 px; for camcal NEES / 2. mrgingham is run where it is installed.

    python benchmarks/charuco_corners.py [--views 8]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from opencv_charuco import found_by_opencv

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.images.files import save
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import CHARUCO, Board, parse_board
from camcal.targets.detect import detect

SIZE = (1280, 960)
LENS = Camera(model_named("opencv5"), SIZE, np.array([960.0, 964, 645, 472, -0.12, 0.06, 5e-4, -3e-4, 0.01]))
BOARDS = (
    "charuco:10x8:30mm:22mm:DICT_5X5_100:current",
    "charuco:10x8:30mm:22mm:DICT_5X5_100:legacy",
    "chessboard:10x10:30mm",
)
EXPOSURES = {
    "blur 0.7, noise 2": Exposure(),
    "blur 1.5, noise 2": Exposure(blur_px=1.5),
    "noise 0": Exposure(noise_dn=0),
}
NEAREST_PX = 3.0  # the corner that a detector without ids means


def main() -> None:
    """Print a row for every board and exposure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--views", type=int, default=8)
    options = parser.parse_args()
    print("| board | conditions | way | corners | bias x, y 1/1000 px | RMS 1/1000 px | NEES / 2 |")
    print("|---|---|---|---|---|---|---|")
    for text in BOARDS:
        for name, exposure in EXPOSURES.items():
            rows(parse_board(text), text, name, exposure, options.views)


def rows(board: Board, text: str, name: str, exposure: Exposure, count: int) -> None:
    """Print what every way makes of one board under one exposure."""
    rng = np.random.default_rng(7)
    errors: dict[str, list[Array]] = {}
    nees: list[Array] = []
    for pose in views(LENS, board, count, rng=rng):
        image = render(LENS, board, pose, rng=rng, exposure=exposure)
        truth = LENS.project(pose.apply(board.points())).pixels
        seen = detect(image, board)
        turns = (seen.pixels - truth[turn[seen.ids]] for turn in board.symmetries())
        off = min(turns, key=lambda errors: np.abs(errors).max())
        errors.setdefault("camcal", []).append(off)
        if seen.covariance is not None:
            nees.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(seen.covariance), off) / 2)
        if board.type == CHARUCO:
            ids, pixels = found_by_opencv(image, board)
            errors.setdefault("OpenCV", []).append(pixels - truth[ids])
        elif shutil.which("mrgingham"):
            errors.setdefault("mrgingham", []).append(nearest(mrgingham(image), truth))
    for way, parts in errors.items():
        off = np.concatenate(parts)
        bias = ", ".join(f"{1e3 * value:.1f}" for value in off.mean(axis=0))
        honest = f"{np.concatenate(nees).mean():.2f}" if way == "camcal" else ""
        rms = f"{1e3 * np.sqrt((off**2).mean()):.1f}"
        print(
            f"| {text} | {name} | {way} | {len(off)} of {count * board.count} | {bias} | {rms} | {honest} |", flush=True
        )


def mrgingham(image: Array) -> Array:
    """Return the corners (N, 2) that mrgingham finds."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "board.png"
        save(path, image)
        answer = subprocess.run(
            ["mrgingham", "--jobs", "1", "--gridn", "10", str(path)], capture_output=True, text=True, check=False
        )
    lines = [line.split() for line in answer.stdout.splitlines() if not line.startswith("#")]
    return np.array([line[1:3] for line in lines if line[1] != "-"], dtype=float).reshape(-1, 2)


def nearest(pixels: Array, truth: Array) -> Array:
    """Return how far pixels (N, 2) are from the true corners next to them, (N, 2)."""
    off = pixels[:, None] - truth[None]
    best = np.linalg.norm(off, axis=2).argmin(axis=1)
    chosen = off[np.arange(len(pixels)), best]
    return chosen[np.linalg.norm(chosen, axis=1) < NEAREST_PX]


if __name__ == "__main__":
    main()
