"""Rows of real pairs, moved by known amounts: how exactly are they measured, and what does it take?

The right image is drawn with its rows off by up to 1.2 px, 0.6 px of it across the width and over the height, six times
a pair, without and with noise of 5 counts in both images. Error: RMS over the image, px, of the trend measured less the
one put in and the one that all features find in the pair as it is; the median of six, mean over the pairs. ms/MP: of
the fastest run a pair, beyond the coarse map, which is made anyway.

    python benchmarks/row_offsets.py FOLDER…
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from pathlib import Path

import cv2
import numpy as np
from stereo_pairs import Pair, pairs_in

from camcal.stereo.alignment import Residual, quick_residual, vertical_residual
from camcal.stereo.coarse import coarse_map

TIMES = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    cv2.setNumThreads(1)
    pairs = [pair for folder in parser.parse_args().folders for pair in pairs_in(folder, 0.0)]
    print(f"{'pair':32}{'size':>12}{'error':>9}{'noisy':>9}{'ms/MP':>8}")
    rows = []
    for pair in pairs:
        clean, taken = error_and_time(pair, 0.0)
        rows.append((clean, error_and_time(pair, 5.0)[0], taken))
        height, width = pair.left.shape[:2]
        print(pair.name.ljust(32) + f"{width}x{height}".rjust(12) + "{:9.3f}{:9.3f}{:8.1f}".format(*rows[-1]))
    print("mean".ljust(44) + "{:9.3f}{:9.3f}{:8.1f}".format(*np.mean(rows, axis=0)))


def error_and_time(pair: Pair, noise: float) -> tuple[float, float]:
    """Return the median error, px, and the fastest time, ms/MP."""
    left, right = (
        cv2.cvtColor(each, cv2.COLOR_BGR2GRAY) if each.ndim == 3 else each for each in (pair.left, pair.right)
    )
    coarse, as_it_is = coarse_map(left, right).disparities, trend(vertical_residual(left, right))
    rng, errors, fastest = np.random.default_rng(3), [], np.inf
    for _ in range(TIMES):
        rows = rng.uniform(-1, 1, 3) * [1.2, 0.6, 0.6]
        images = [noisy(each, noise, rng) for each in (left, moved(right, rows))]
        start = time.process_time()
        residual = quick_residual(*images, coarse)
        fastest = min(fastest, time.process_time() - start)
        off = trend(residual) - rows - as_it_is
        errors.append(np.sqrt(off @ (off * [1, 1 / 12, 1 / 12])))
    return float(np.median(errors)), 1e9 * fastest / left.size


def trend(residual: Residual) -> np.ndarray:
    found = residual.trend
    return np.array([found.centre.value, found.tilt.value, found.scale.value])


def moved(image: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return an image whose rows are lower by a plane: at the centre, and from edge to edge."""
    height, width = image.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    down = rows[0] + rows[1] * (x / (width - 1) - 0.5) + rows[2] * (y / (height - 1) - 0.5)
    return cv2.remap(image, x, (y - down).astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def noisy(image: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.rint(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8) if noise else image


if __name__ == "__main__":
    main()
