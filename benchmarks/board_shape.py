"""Bent and stretched boards: full-frame projection error beside the peers and beside an oracle.

390 x 270 mm board of 14 x 10 corners, 40 views, noise 0.15 px, opencv5. The error is the RMS over the full frame of
the rotation-compensated projection at infinity; each case's figure is the RMS over its seeds. The oracle has the true
model, starts at the truth and sees clean points in place of outliers; it estimates lens, poses and the amplitudes of
the true deformation. mrcal and lensboy run in the interpreters given, where they are installed.

    python benchmarks/board_shape.py [--seeds 40] [--mrcal /usr/bin/python3] [--lensboy PYTHON]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from projection_error import rms_inside_and_outside

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, Observations, State
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate import shapes
from camcal.simulate.observe import observe
from camcal.simulate.scene import views
from camcal.solve.least_squares import minimise
from camcal.targets.board import Board

SIZE, NOISE, VIEWS = (1600, 1200), 0.15, 40
BOARD = Board("chessboard", 14, 10, 0.030)
MODEL = model_named("opencv5")
TRUTH = Camera(MODEL, SIZE, np.array([1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]))
CASES = {
    "flat": (shapes.FLAT, 0.0, ()),
    "bow 0.2/0.1 mm": (shapes.bow(2e-4, 1e-4), 0.0, ("P2(x)", "P2(y)")),
    "bow 1/0.5 mm, 1 % outliers": (shapes.bow(1e-3, 5e-4), 0.01, ("P2(x)", "P2(y)")),
    "twist 0.5 mm": (shapes.twist(5e-4), 0.0, ("xy",)),
    "cubic 0.5 mm": (shapes.cubic(5e-4), 0.0, ("P3(x)",)),
    "stretch 0.3 %": (shapes.stretch(0.003), 0.0, ("x/y scale",)),
}
LIMITS = {"flat": 1.08, "cubic 0.5 mm": 1.25, "stretch 0.3 %": 1.25}
PEERS = Path(__file__).parent / "peers"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--slow-seeds", type=int, default=3, help="seeds of calibrateCameraRO, mrcal and lensboy")
    parser.add_argument("--mrcal", help="interpreter that has mrcal")
    parser.add_argument("--lensboy", help="interpreter that has lensboy")
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}; {arguments.seeds} seeds ({arguments.slow_seeds} for the slow peers)")
    print(f"{'case':28} {'method':22} {'all':>7} {'inside':>7} {'outside':>7} {'/oracle':>8} {'limit':>6} {'s':>6}")
    for name, case in CASES.items():
        run_case(name, case, arguments)


def run_case(name: str, case: tuple, arguments: argparse.Namespace) -> None:
    methods = {"oracle": oracle, "camcal": camcal, "camcal --flat-board": camcal_flat, "calibrateCamera": opencv}
    slow = {"calibrateCameraRO": opencv_ro}
    if arguments.mrcal:
        slow["mrcal"] = lambda *data: peer("mrcal", arguments.mrcal, *data)
    if arguments.lensboy:
        slow["lensboy"] = lambda *data: peer("lensboy", arguments.lensboy, *data)
    rows = {method: [] for method in (*methods, *slow)}
    for seed in range(arguments.seeds):
        data = data_of(seed, case)
        for method, solve in (methods | (slow if seed < arguments.slow_seeds else {})).items():
            start = time.perf_counter()
            estimate = solve(*data)
            seconds = time.perf_counter() - start
            seen = np.concatenate([view.pixels for view in data[0].views])
            rows[method].append([*rms_inside_and_outside(TRUTH, estimate, seen), seconds])
    oracles = np.array(rows["oracle"])
    for method, figures in rows.items():
        if not figures:
            continue
        table = np.array(figures)
        rms = np.sqrt(np.nanmean(table[:, :3] ** 2, axis=0))
        ratio = rms[0] / np.sqrt(np.mean(oracles[: len(table), 0] ** 2))
        limit = f"{LIMITS.get(name, 1.10):.2f}" if method == "camcal" else ""
        print(
            f"{name:28} {method:22} {rms[0]:7.3f} {rms[1]:7.3f} {rms[2]:7.3f} {ratio:8.3f} {limit:>6} "
            f"{np.median(table[:, 3]):6.2f}",
            flush=True,
        )


def data_of(seed: int, case: tuple) -> tuple:
    shape, outliers, terms = case
    poses = views(TRUTH, BOARD, VIEWS, rng=np.random.default_rng(seed))
    seen, _ = observe(
        TRUTH, BOARD, poses, rng=np.random.default_rng([seed, 1]), noise_px=NOISE, shape=shape, outliers=outliers
    )
    clean, _ = observe(TRUTH, BOARD, poses, rng=np.random.default_rng([seed, 1]), noise_px=NOISE, shape=shape)
    return seen, clean, poses, terms


def oracle(seen, clean, poses, terms) -> Camera:
    state = State(
        TRUTH.parameters,
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation for pose in poses]),
        np.zeros(len(terms)),
        np.zeros((BOARD.count, 3)),
    )
    free = np.arange(len(TRUTH.parameters))
    problem = BoardProblem(MODEL, BOARD, Observations.of(clean.views), free, terms, sigma=NOISE)
    return Camera(MODEL, SIZE, minimise(problem, state).state.parameters)


def camcal(seen, clean, poses, terms) -> Camera:
    return calibrate(seen.views, BOARD, Options(MODEL)).camera


def camcal_flat(seen, clean, poses, terms) -> Camera:
    return calibrate(seen.views, BOARD, Options(MODEL, shape=ShapeOptions(smooth=False))).camera


def opencv(seen, clean, poses, terms) -> Camera:
    _, matrix, distortion, *_ = cv2.calibrateCamera(*opencv_points(seen), SIZE, None, None)
    return from_opencv(matrix, distortion)


def opencv_ro(seen, clean, poses, terms) -> Camera:
    objects, pixels = opencv_points(seen)
    whole = [i for i, points in enumerate(objects) if len(points) == BOARD.count]
    _, matrix, distortion, *_ = cv2.calibrateCameraRO(
        [objects[i] for i in whole], [pixels[i] for i in whole], SIZE, BOARD.columns - 1, None, None
    )
    return from_opencv(matrix, distortion)


def opencv_points(seen) -> tuple[list[np.ndarray], list[np.ndarray]]:
    points = BOARD.points().astype(np.float32)
    return [points[view.ids] for view in seen.views], [view.pixels.astype(np.float32) for view in seen.views]


def from_opencv(matrix: np.ndarray, distortion: np.ndarray) -> Camera:
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return Camera(MODEL, SIZE, np.array([*core, *distortion.ravel()[:5]]))


def peer(name: str, interpreter: str, seen, clean, poses, terms) -> Camera:
    with tempfile.TemporaryDirectory() as folder:
        table = np.full((len(seen.views), BOARD.count, 2), np.nan)
        for index, view in enumerate(seen.views):
            table[index, view.ids] = view.pixels
        np.savez(
            Path(folder) / "data.npz", pixels=table, points=BOARD.points(), size=SIZE, focal=1200.0, shape=(14, 10)
        )
        result = subprocess.run(
            [interpreter, PEERS / f"{name}_solve.py", folder], check=True, capture_output=True, text=True
        )
        return Camera(MODEL, SIZE, np.array(json.loads(result.stdout.splitlines()[-1])))


if __name__ == "__main__":
    main()
