"""Every lens model: the time of a million points, and calibrations of simulated boards with the right model.

speed: CPU time of one thread to project a million points, with and without derivatives, and to find their rays, over
    that of cv2.projectPoints (five coefficients) for the same points.
calibration: a hand-held 9 × 6 board in front of a lens of 60° and of 190° (150° where a model ends at 90° from its
    axis, 120° for ptlens; a telecentric lens sees 50 mm, of an 11 × 8 board), noise of 0.15 px. 'ratio': the largest
    error of the map from the ordinary start over that from the truth; 'covered': true parameters within their 95 %
    intervals; 'map z': RMS of the map's error over its stated standard deviation. The board is held flat.

    python benchmarks/lens_models.py [--parts speed calibration] [--seeds 20] [--views 40] [--models NAME …]
"""

import argparse
import os
import time
from collections.abc import Callable, Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import MODELS
from camcal.cameras.directions import lens_difference
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board

PARTS = ("speed", "calibration")
LENSES = [
    name for name, model in MODELS.items() if not model.is_view and name not in ("pinhole", "splined_stereographic")
]
COUNT = 1_000_000
SIZE, NOISE = (1280, 960), 0.15
BOARD = Board("chessboard", 9, 6, 0.040)
SMALL = Board("chessboard", 11, 8, 0.004)
FIELDS = (60, 190)
WIDEST = {"fov": 150, "division": 150, "orthographic": 150, "ptlens": 120}
GRID = np.stack(np.meshgrid(np.linspace(60, 1220, 12), np.linspace(60, 900, 9)), axis=-1).reshape(-1, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--models", nargs="+", choices=LENSES, default=LENSES, metavar="NAME")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--views", type=int, default=40)
    arguments = parser.parse_args()
    if "speed" in arguments.parts:
        print_speed(arguments.models)
    if "calibration" in arguments.parts:
        print_calibrations(arguments.models, arguments.seeds, arguments.views)


def fastest(call: Callable[[], object]) -> float:
    """The least CPU time (s) of five calls."""
    times = []
    for _ in range(5):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def print_speed(names: Sequence[str]) -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    theta, azimuth = rng.uniform(0, 0.8, COUNT), rng.uniform(0, 2 * np.pi, COUNT)
    points = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    matrix, rest = np.array([[500, 0, 640], [0, 500, 480], [0, 0, 1.0]]), np.zeros(3)
    usual = fastest(lambda: cv2.projectPoints(points, rest, rest, matrix, np.array([-0.2, 0.05, 0.001, 0.001, 0.01])))
    print("| lens model | pixels | with derivatives | rays |\n|---|---|---|---|")
    for name in names:
        camera = make_camera(MODELS[name], SIZE, np.radians(100))  # of a telecentric one that is 1.5 m
        pixels = camera.project(points).pixels
        times = [
            fastest(lambda camera=camera: camera.project(points)),
            fastest(lambda camera=camera: camera.project_with_jacobians(points)),
            fastest(lambda camera=camera, pixels=pixels: camera.unproject(pixels)),
        ]
        print(f"| {name} | " + " | ".join(f"{each / usual:.2f}" for each in times) + " |", flush=True)


def print_calibrations(names: Sequence[str], seeds: int, count: int) -> None:
    print("| lens model | field | ratio | covered | map z | failures |\n|---|---|---|---|---|---|")
    for name in names:
        for degrees in FIELDS if MODELS[name].is_central else FIELDS[:1]:
            field = min(degrees, WIDEST.get(name, 110 if name.startswith("opencv") else degrees))
            found = [calibrated(name, field, count, seed) for seed in range(seeds)]
            there = [each for each in found if each is not None]
            covered = np.mean(np.concatenate([each[1] for each in there]))
            largest, spread = max(each[0] for each in there), np.sqrt(np.mean([each[2] for each in there]))
            row = f"{largest:.3f} | {100 * covered:.1f} % | {spread:.2f} | {seeds - len(there)}"
            width = f"{field}°" if MODELS[name].is_central else "50 mm"
            print(f"| {name} | {width} | {row} |", flush=True)


def pose_across(board: Board, rng: np.random.Generator) -> Pose:
    """A pose in front of a lens with parallel rays, tilted by up to 40°."""
    lean, azimuth = np.radians(40) * (0.1 + 0.9 * rng.random()), rng.uniform(0, 2 * np.pi)
    turn = so3.exp(np.array([0.0, 0.0, rng.normal(0, 0.5)]))
    rotation = so3.exp(lean * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])) @ turn
    place = np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.008, 0.008), rng.uniform(0.1, 5)])
    return Pose(rotation, place - rotation @ np.array([*board.extent, 0.0]) / 2)


def calibrated(name: str, degrees: int, count: int, seed: int) -> tuple[float, np.ndarray, float] | None:
    """The ratio of errors, which parameters are within their intervals, and the mean square of the map's z."""
    model, board, rng = MODELS[name], BOARD, np.random.default_rng(seed)
    if model.is_central:
        truth = make_camera(model, SIZE, np.radians(degrees))
        poses = views(truth, board, count, rng=rng)
    else:
        board = SMALL
        truth = Camera(model, SIZE, [25000.0, 25060.0, 650.0, 470.0, 60.0, -3000.0])
        poses = [pose_across(board, rng) for _ in range(count)]
    seen = observe(truth, board, poses, rng=np.random.default_rng(1000 + seed), noise_px=NOISE)[0].views
    pixels = np.concatenate([view.pixels for view in seen])[::11]
    errors, cameras = [], []
    for guess in (None, truth):
        try:
            options = Options(model, guess=guess, shape=ShapeOptions(smooth=False))
            cameras.append(calibrate(seen, board, options).camera)
        except CamcalError:
            return None
        errors.append(np.sqrt(np.nanmean((lens_difference(truth, cameras[-1], pixels) ** 2).sum(axis=1))))
    std = np.sqrt(cameras[0].covariance.diagonal())
    free = std > 0
    within = np.abs((cameras[0].parameters - truth.parameters)[free]) < 1.96 * std[free]
    apart = (lens_difference(truth, cameras[0], GRID) ** 2).sum(axis=1) / 2
    return errors[0] / errors[1], within, float(np.nanmean(apart / cameras[0].projection_std(GRID) ** 2))


if __name__ == "__main__":
    main()
