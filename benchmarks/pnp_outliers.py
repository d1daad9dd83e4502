"""Poses from points of which many are wrong: errors beside those of other solvers, and boards without any outlier.

A pinhole of 800 px, 1280 x 960; noise 1 px, threshold 3 sigma, confidence 0.999; outliers anywhere in the image.
Errors are RMS (rotation / translation) over those of the maximum-likelihood fit to the true inliers alone, on the same
trials, among poses without gross error; gross: NEES/6 > 100 by that fit's covariance, or no pose. ms: median a view.
boards: 9 x 6 corners, 0.3 px, no outlier: how many of the poses are more than 5 deg wrong, or missing.
regions: how often the 95 % region holds the truth, views of one cell estimated together with the noise known or
    estimated, of all of them and of those that are not called ambiguous; gross errors; views that lost a right point.

    python benchmarks/pnp_outliers.py [--sections solvers boards regions] [--trials 150] [--boards 500] [--regions 4000]
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

from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.pose_quality import region_quantile
from camcal.estimate.poses.records import AMBIGUOUS, Correspondences, PoseEstimate, PoseOptions
from camcal.geometry.pose import Pose

NOISE = 1.0
CELLS = tuple(
    (flat, count, share) for flat in (False, True) for count, share in ((100, 0.0), (100, 0.5), (100, 0.8), (30, 0.8))
)
REGIONS = tuple(
    (flat, count, share)
    for count in (4, 6, 12, 30, 100)
    for share in (0.0, 0.3, 0.5, 0.8)
    for flat in (False, True)
    if share == 0 or count - round(share * count) >= 6
)
GROSS = 100.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sections = ("solvers", "boards", "regions")
    parser.add_argument("--sections", nargs="+", choices=sections, default=sections)
    parser.add_argument("--trials", type=int, default=150)
    parser.add_argument("--boards", type=int, default=500)
    parser.add_argument("--regions", type=int, default=4000)
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    cv2.setNumThreads(1)
    if "solvers" in arguments.sections:
        beside_solvers(arguments.trials)
    if "boards" in arguments.sections:
        clean_boards(arguments.boards)
    if "regions" in arguments.sections:
        regions(arguments.regions)


def beside_solvers(count: int) -> None:
    solvers = {"camcal": camcal(NOISE), **robust_solvers(clean.CAMERA)}
    for flat, points, share in CELLS:
        trials, references, information = spoilt_trials(count, points, share, flat=flat)
        title = f"{'plane' if flat else '3-D'}, n = {points}, {100 * share:.0f} % outliers"
        print("\n" + title.ljust(35) + "R/t    gross       ms")
        for name, solve in solvers.items():
            show(name, solve, trials, references, information)


def clean_boards(count: int) -> None:
    print(f"\nboards: more than 5 deg wrong or none, of {count}")
    solvers = {"camcal": camcal(0.3), **robust_solvers(clean.CAMERA)}
    rng = np.random.default_rng(8)
    boards = [clean.trial(rng, clean.BOARD, 0.3, (0.5, 1.5)) for _ in range(count)]
    for name, solve in solvers.items():
        wrong = sum(is_wrong(each, solve(each.view.points, each.view.pixels, 0.9)) for each in boards)
        print(f"{name:24}{wrong:5d}", flush=True)


def regions(count: int) -> None:
    print(f"\n{'regions':28}known    est. | not ambiguous: known  est. |  gross   lost")
    for flat, points, share in REGIONS:
        trials, _, information = spoilt_trials(count, points, share, flat=flat)
        bad, row = round(share * points), []
        for noise in (NOISE, None):
            views, options = [each.view for each in trials], PoseOptions(noise_px=noise, outliers="many")
            found = [outcome.value for outcome in estimate_poses(clean.CAMERA, views, options)]
            row.append(np.array([_judged(*each, bad) for each in zip(trials, found, information, strict=True)]))
        inside = [100 * each[:, 0].mean() for each in row]
        clear = [100 * each[each[:, 1] <= AMBIGUOUS, 0].mean() for each in row]
        gross, lost = 100 * row[0][:, 2:].mean(axis=0)
        title = f"{'plane' if flat else '3-D'}, n = {points}, {100 * share:.0f} %"
        print(
            f"{title:25}{inside[0]:8.1f}{inside[1]:8.1f} |{clear[0]:21.1f}{clear[1]:6.1f} |{gross:7.2f}{lost:7.2f}",
            flush=True,
        )


def _judged(
    made: clean.Trial, found: PoseEstimate | None, information: np.ndarray, bad: int
) -> tuple[bool, float, bool, bool]:
    """Return whether the region holds the truth, the probability of another pose, and of gross errors and points lost
    whether there are any.
    """
    if found is None:
        return False, 0.0, True, True
    error = made.error(found.transform)
    inside = error @ np.linalg.solve(found.covariance, error) <= region_quantile(0.95, found.degrees_of_freedom)
    gross = error @ information @ error / 6 > GROSS
    return bool(inside), found.p_wrong, bool(gross), not found.inliers[bad:].all()


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
