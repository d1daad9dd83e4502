"""Time from corners to result against cv2.calibrateCamera, by number of views.

camcal: lens, poses, board shape, outliers, orientation, covariance. OpenCV: lens and poses of a rigid board.
140 corners a view, noise 0.1 px, opencv5. Run with OPENBLAS_NUM_THREADS=1, as the command line does.

    python benchmarks/solver_speed.py [--views 20 100 400 1600] [--repeats 5]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time
from collections.abc import Callable

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
PARAMETERS = [1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, nargs="+", default=[20, 100, 400, 1600])
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    model = model_named("opencv5")
    camera = Camera(model, SIZE, np.array(PARAMETERS))
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; medians of {arguments.repeats}, in turn")
    print(f"{'views':>6} {'camcal s':>9} {'OpenCV s':>9} {'ratio':>6} {'camcal ms/view':>15}")
    for count in arguments.views:
        rng = np.random.default_rng(count)
        detections, _ = observe(camera, BOARD, views(camera, BOARD, count, rng=rng), rng=rng, noise_px=0.1)
        ours, theirs = [], []
        for _ in range(arguments.repeats):
            ours.append(seconds(lambda: calibrate(detections.views, BOARD, Options(model))))
            theirs.append(seconds(lambda: opencv(detections)))
        a, b = statistics.median(ours), statistics.median(theirs)
        print(f"{count:6d} {a:9.3f} {b:9.3f} {a / b:6.2f} {1e3 * a / count:15.3f}", flush=True)


def opencv(detections: Detections) -> None:
    points = BOARD.points().astype(np.float32)
    objects = [points[view.ids] for view in detections.views]
    pixels = [view.pixels.astype(np.float32) for view in detections.views]
    cv2.calibrateCamera(objects, pixels, SIZE, None, None)


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
