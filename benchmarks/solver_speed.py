"""Time from corners to result against cv2.calibrateCamera, by number of views and of corners.

camcal: lens, poses, board shape, outliers, orientation, covariance. OpenCV: lens and poses of a rigid board.
Noise 0.1 px, opencv5, a board 390 mm wide. One BLAS thread, as under the command line; OpenCV has all its threads.
The two take turns, so that a busy machine disturbs both alike; CPU seconds are those of all threads together. The
memory is the most that the process has had so far.

    python benchmarks/solver_speed.py [--views 20 100 400 1600] [--corners 14x10] [--repeats 7] [--alone]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

SIZE = (1600, 1200)
WIDTH = 0.390  # of the board, m
MODEL = model_named("opencv5")
TRUTH = Camera(MODEL, SIZE, np.array([1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, nargs="+", default=[20, 100, 400, 1600])
    parser.add_argument("--corners", nargs="+", default=["14x10"], help="columns x rows of inner corners")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--alone", action="store_true", help="without OpenCV")
    arguments = parser.parse_args()
    print(
        f"OpenCV {cv2.__version__} with {cv2.getNumThreads()} threads, numpy {np.__version__}; "
        f"medians of {arguments.repeats}, in turn"
    )
    print(
        f"{'corners':>8} {'views':>6} {'camcal s':>9} {'OpenCV s':>9} {'ratio':>6} {'ratio of fastest':>17} "
        f"{'camcal CPU s':>13} {'OpenCV CPU s':>13} {'camcal ms/view':>15} {'MiB':>6}"
    )
    for corners in arguments.corners:
        columns, rows = map(int, corners.split("x"))
        board = Board("chessboard", columns, rows, WIDTH / (columns - 1))
        for count in arguments.views:
            row(board, count, arguments.repeats, alone=arguments.alone)


def row(board: Board, count: int, repeats: int, *, alone: bool) -> None:
    """Print the row of `count` views of a board."""
    rng = np.random.default_rng(count)
    detections, _ = observe(TRUTH, board, views(TRUTH, board, count, rng=rng), rng=rng, noise_px=0.1)
    works = [partial(camcal, board, detections)] + [partial(opencv, board, detections)] * (not alone)
    times = in_turn(works, repeats)
    medians, fastest = np.full((2, 2), np.nan), np.full(2, np.nan)
    medians[: len(works)], fastest[: len(works)] = np.median(times, axis=0), times[:, :, 0].min(axis=0)
    (ours, our_cpu), (theirs, their_cpu) = medians
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{board.count:8d} {count:6d} {ours:9.3f} {theirs:9.3f} {ours / theirs:6.2f} {fastest[0] / fastest[1]:17.2f} "
        f"{our_cpu:13.3f} {their_cpu:13.3f} {1e3 * ours / count:15.3f} {peak:6.0f}",
        flush=True,
    )


def camcal(board: Board, detections: Detections) -> None:
    calibrate(detections.views, board, Options(MODEL))


def opencv(board: Board, detections: Detections) -> None:
    points = board.points().astype(np.float32)
    objects = [points[view.ids] for view in detections.views]
    pixels = [view.pixels.astype(np.float32) for view in detections.views]
    cv2.calibrateCamera(objects, pixels, SIZE, None, None)


def in_turn(works: list[Callable[[], None]], repeats: int) -> np.ndarray:
    """Return wall and CPU seconds (repeats, works, 2) of works that take turns; a round more at first warms up."""
    return np.array([[seconds(work) for work in works] for _ in range(repeats + 1)][1:])


def seconds(work: Callable[[], None]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


if __name__ == "__main__":
    main()
