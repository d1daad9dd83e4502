"""Demosaicing at edges of saturated colours and in noise, camcal's beside others': decibels, and a measure of dots.

Stripes and discs of two colours each, all pairs of the corners of the gamut (black, white, red, …) and of colours
between them, at several angles, sharp (of one pixel's width) and blurred; and the images of folders. All are 8 bits,
sampled as RGGB, as they are and with noise of 5, 10 and 20 of 255, rounded and cut off at 0 and 255.
CPSNR: decibels over all three channels, the mean of the images. Zipper: RMS of what a 3 x 3 binomial filter takes from
the error, within two pixels of edges of the truth (a step of 20 between neighbours), of 255. MLRI is ours after the
paper, see peers/.

    python benchmarks/demosaic_edges.py PYTHON [FOLDER …] [--draw PICTURE.png]

PYTHON is the interpreter for peers/demosaic_peers.py.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from demosaic import BORDER, MENON, ONE_THREAD, Bench, compare, mosaic_of, peers_of

ALGORITHMS = ("ri", MENON, "paper MLRI", "cv2 VNG")
NOISE = (0, 5, 10, 20)
SIZE, PERIOD, FINE = 72, 30, 8  # pixels of an image and of a stripe and its gap; samples a pixel to draw them
CORNERS = {letter: np.array(colour, float) for letter, colour in zip(
    "KBGRCMYW", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)], strict=True
)}  # fmt: skip
BETWEEN = {letter: np.array(colour) for letter, colour in zip(
    "optvg", [(0, 0.5, 1), (1, 0, 0.6), (0.7, 0.8, 0), (0.9, 0.2, 0.4), (0.4, 0.9, 0.1)], strict=True
)}  # fmt: skip
STEP, NEAR = 20, 2
BINOMIAL = np.array([1, 2, 1], np.float32) / 4
DRAWN = (("RC", 50), ("BR", 25), ("GM", 70), ("KM", 50), ("KW", 25))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer_python")
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--draw", type=Path, help="picture of some edges: the truth, then each algorithm")
    arguments = parser.parse_args()
    scenes = synthetic() | {folder.name: photographs(folder) for folder in arguments.folders}
    with tempfile.TemporaryDirectory() as folder, peers_of(arguments.peer_python, ONE_THREAD) as ask:
        bench = Bench(Path(folder), ask)
        print(f"{'CPSNR dB, zipper':20}", *(f"{name:>18}" for name in ALGORITHMS))
        for name, images in scenes.items():
            for noise in NOISE:
                print(f"{name:14} {noise:5}", *(f"{score:>18}" for score in row(bench, images, noise)))
        if arguments.draw:
            cv2.imwrite(str(arguments.draw), drawn(bench))


def row(bench: Bench, images: list[np.ndarray], noise: float) -> Iterator[str]:
    """Yield decibels and zipper of every algorithm."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ALGORITHMS}
    for number, image in enumerate(images):
        bench.put(noisy(mosaic_of(image), noise, number))
        for name in ALGORITHMS:
            colour = bench.colour(name).astype(np.float32)
            found[name].append((compare(colour, image, structure=False).decibels, zipper(colour, image)))
    for scores in found.values():
        decibels, dots = np.mean(scores, axis=0)
        yield f"{decibels:.2f} {dots:6.2f}"


def noisy(mosaic: np.ndarray, noise: float, seed: int) -> np.ndarray:
    error = np.random.default_rng(seed).normal(0, noise, mosaic.shape) if noise else 0
    return np.clip(np.rint(mosaic + error), 0, 255).astype(np.uint8)


def zipper(seen: np.ndarray, truth: np.ndarray) -> float:
    inside = slice(BORDER, -BORDER), slice(BORDER, -BORDER)
    error = seen - truth
    dots = error - cv2.sepFilter2D(error, -1, BINOMIAL, BINOMIAL)
    neighbours = np.ones((3, 3), np.uint8)
    steps = (cv2.dilate(truth, neighbours).astype(int) - cv2.erode(truth, neighbours)).max(axis=-1) > STEP
    band = cv2.dilate(steps.astype(np.uint8), np.ones((2 * NEAR + 1,) * 2, np.uint8)).astype(bool)[inside]
    return float(np.sqrt(np.mean(dots[inside][band] ** 2))) if band.any() else 0.0


def photographs(folder: Path) -> list[np.ndarray]:
    images = (cv2.imread(str(path)) for path in sorted(folder.iterdir()) if path.suffix in {".png", ".jpg", ".tif"})
    return [image[: len(image) // 2 * 2, : image.shape[1] // 2 * 2] for image in images if image is not None]


def synthetic() -> dict[str, list[np.ndarray]]:
    """Return images of two colours by what is drawn in them."""
    stripes = [striped(angle, offset=0.37) for angle in (10, 25, 50, 70, 120, 150)]
    soft = [cv2.GaussianBlur(share, (0, 0), 0.6) for share in (striped(angle, 0.11) for angle in (25, 50, 70, 120))]
    return {
        "edges": coloured(stripes, CORNERS),
        "blurred edges": coloured(soft, CORNERS),
        "discs": coloured([discs(seed) for seed in (1, 2)], CORNERS),
        "other colours": coloured([striped(angle, 0) for angle in (20, 65, 140)], BETWEEN | CORNERS),
    }


def coloured(shares: list[np.ndarray], colours: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Return images of every pair of colours."""
    return [two_colours(share, *pair) for share in shares for pair in combinations(colours.values(), 2)]


def two_colours(share: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    share = share[..., np.newaxis]
    return np.rint(255 * (share * one + (1 - share) * other)).astype(np.uint8)


def striped(degrees: float, offset: float) -> np.ndarray:
    x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return covered(lambda columns, rows: (columns * x + rows * y + offset) % PERIOD < PERIOD / 2)


def discs(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    places = [(*rng.uniform(10, SIZE - 10, 2), rng.uniform(4, 14)) for _ in range(4)]
    return covered(lambda x, y: np.any([np.hypot(x - a, y - b) < radius for a, b, radius in places], axis=0))


def covered(inside: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the share of every pixel that is inside."""
    rows, columns = (np.indices((SIZE * FINE,) * 2) + 0.5) / FINE - 0.5
    return inside(columns, rows).reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))


def drawn(bench: Bench) -> np.ndarray:
    lines = []
    for (one, other), angle in DRAWN:
        image = two_colours(striped(angle, 0.37), CORNERS[one], CORNERS[other])[:48, :48]
        bench.put(mosaic_of(image))
        line = np.hstack([image, *(np.clip(bench.colour(name), 0, 255).astype(np.uint8) for name in ALGORITHMS)])
        lines.append(cv2.resize(line, None, fx=5, fy=5, interpolation=cv2.INTER_NEAREST))
    return np.vstack(lines)


if __name__ == "__main__":
    main()
