"""Time from corners to result against cv2.calibrateCamera, by number of views.

camcal: lens, poses, board shape, outliers, orientation, covariance. OpenCV: lens and poses of a rigid board.
140 corners a view, noise 0.1 px, opencv5. One BLAS thread, as under the command line; OpenCV has all its threads.
The two take turns, so that a busy machine disturbs both alike; CPU seconds are those of all threads together.

    python benchmarks/solver_speed.py [--views 20 100 400 1600] [--repeats 7]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.observe import observe
from camcal.simulate.scene import views
from camcal.targets.board import Board, Detections

SIZE = (1600, 1200)
BOARD = Board("chessboard", 14, 10, 0.030)
MODEL = model_named("opencv5")
TRUTH = Camera(MODEL, SIZE, np.array([1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, nargs="+", default=[20, 100, 400, 1600])
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    print(
        f"OpenCV {cv2.__version__} with {cv2.getNumThreads()} threads, numpy {np.__version__}; "
        f"medians of {arguments.repeats}, in turn"
    )
    print(
        f"{'views':>6} {'camcal s':>9} {'OpenCV s':>9} {'ratio':>6} {'ratio of fastest':>17} {'camcal CPU s':>13} "
        f"{'OpenCV CPU s':>13} {'camcal ms/view':>15}"
    )
    for count in arguments.views:
        rng = np.random.default_rng(count)
        detections, _ = observe(TRUTH, BOARD, views(TRUTH, BOARD, count, rng=rng), rng=rng, noise_px=0.1)
        times = in_turn([partial(camcal, detections), partial(opencv, detections)], arguments.repeats)
        (ours, our_cpu), (theirs, their_cpu) = np.median(times, axis=0)
        fastest = times[:, :, 0].min(axis=0)
        print(
            f"{count:6d} {ours:9.3f} {theirs:9.3f} {ours / theirs:6.2f} {fastest[0] / fastest[1]:17.2f} "
            f"{our_cpu:13.3f} {their_cpu:13.3f} {1e3 * ours / count:15.3f}",
            flush=True,
        )


def camcal(detections: Detections) -> None:
    calibrate(detections.views, BOARD, Options(MODEL))


def opencv(detections: Detections) -> None:
    points = BOARD.points().astype(np.float32)
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
