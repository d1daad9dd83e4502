"""Poses from points of which many are wrong: errors beside those of other solvers, and boards without any outlier.

A pinhole of 800 px, 1280 x 960; noise 1 px, threshold 3 sigma, confidence 0.999; outliers anywhere in the image.
Errors are RMS (rotation / translation) over those of the maximum-likelihood fit to the true inliers alone, on the same
trials, among poses without gross error; gross: NEES/6 > 100 by that fit's covariance, or no pose. ms: median a view.
boards: 9 x 6 corners, 0.3 px, no outlier: how many of the poses are more than 5 deg wrong, or missing.

    python benchmarks/pnp_outliers.py [--trials 150] [--boards 500]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pnp as clean
from peers.pose_solvers import Solver, robust_solvers

from camcal.estimate.pnp import Correspondences, PoseOptions, estimate_poses
from camcal.geometry.pose import Pose

NOISE = 1.0
CELLS = tuple(
    (flat, count, share) for flat in (False, True) for count, share in ((100, 0.0), (100, 0.5), (100, 0.8), (30, 0.8))
)
GROSS = 100.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=150)
    parser.add_argument("--boards", type=int, default=500)
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    cv2.setNumThreads(1)
    solvers = {"camcal": camcal(NOISE), **robust_solvers(clean.CAMERA)}
    for flat, count, share in CELLS:
        trials, references, information = spoilt_trials(arguments.trials, count, share, flat=flat)
        print(
            f"\n{'plane' if flat else '3-D'}, n = {count}, {100 * share:.0f} % outliers".ljust(36)
            + "R/t    gross       ms"
        )
        for name, solve in solvers.items():
            show(name, solve, trials, references, information)
    print(f"\nboards: more than 5 deg wrong or none, of {arguments.boards}")
    solvers["camcal"] = camcal(0.3)
    rng = np.random.default_rng(8)
    boards = [clean.trial(rng, clean.BOARD, 0.3, (0.5, 1.5)) for _ in range(arguments.boards)]
    for name, solve in solvers.items():
        wrong = sum(is_wrong(each, solve(each.view.points, each.view.pixels, 0.9)) for each in boards)
        print(f"{name:24}{wrong:5d}", flush=True)


def camcal(noise: float) -> Solver:
    def solve(points: np.ndarray, pixels: np.ndarray, _: float) -> Pose | None:
        view = Correspondences("view", points, pixels)
        value = estimate_poses(clean.CAMERA, [view], PoseOptions(noise_px=noise, outliers="many"))[0].value
        return None if value is None else value.transform

    return solve


def spoilt_trials(
    count: int, points: int, share: float, *, flat: bool
) -> tuple[list[clean.Trial], np.ndarray, np.ndarray]:
    """Return trials whose first points are wrong, and the references from the right ones."""
    rng = np.random.default_rng(7)
    bad = round(share * points)
    trials, right = [], []
    for each in clean.random_trials(count, points, NOISE, flat=flat, seed=7):
        pixels = each.view.pixels.copy()
        pixels[:bad] = rng.uniform(0, np.array(clean.CAMERA.image_size) - 1.0, (bad, 2))
        trials.append(clean.Trial(Correspondences("view", each.view.points, pixels), each.truth))
        right.append(clean.Trial(each.view.take(np.arange(bad, points)), each.truth))
    return trials, *clean.references(right, NOISE)


def show(
    name: str,
    solve: Callable[..., Pose | None],
    trials: Sequence[clean.Trial],
    references: np.ndarray,
    information: np.ndarray,
) -> None:
    errors, seconds = np.full((len(trials), 6), np.nan), []
    for index, each in enumerate(trials):
        start = time.perf_counter()
        found = solve(each.view.points, each.view.pixels, 3 * NOISE)
        seconds.append(time.perf_counter() - start)
        if found is not None:
            errors[index] = each.error(found)
    print(f"  {name:26}{clean.ratios(errors, references, information)}{1000 * np.median(seconds):9.1f}", flush=True)


def is_wrong(made: clean.Trial, found: Pose | None) -> bool:
    return found is None or bool(np.linalg.norm(made.error(found)[3:]) > np.radians(5))


if __name__ == "__main__":
    main()
