"""Bent and stretched boards: full-frame projection error beside the peers and beside an oracle.

390 x 270 mm board of 14 x 10 corners, 40 views, noise 0.15 px, opencv5. The error is the RMS over the full frame of
the rotation-compensated projection at infinity; each case's figure is the RMS over its seeds. The oracle has the true
model, starts at the truth and sees clean points in place of outliers; it estimates lens, poses and the amplitudes of
the true deformation. mrcal and lensboy run in the interpreters given, where they are installed; their seconds include
the start of a process.

    python benchmarks/board_shape.py [--seeds 40] [--slow-seeds 5] [--mrcal /usr/bin/python3] [--lensboy PYTHON]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from projection_error import rms_inside_and_outside

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.geometry.pose import Pose
from camcal.simulate import render
from camcal.simulate.scene import observe, views
from camcal.solve.least_squares import minimise
from camcal.targets.board import Board
from camcal.targets.detection import Detections

SIZE, NOISE, VIEWS = (1600, 1200), 0.15, 40
BOARD = Board("chessboard", 14, 10, 0.030)
MODEL = model_named("opencv5")
TRUTH = Camera(MODEL, SIZE, np.array([1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]))
PEERS = Path(__file__).parent / "peers"


@dataclass(frozen=True)
class Case:
    """A board, the share of outliers, the shape terms that hold its truth, and the limit of camcal / oracle."""

    shape: render.Shape
    terms: tuple[str, ...]
    limit: float = 1.10
    outliers: float = 0.0


CASES = {
    "flat": Case(render.FLAT, (), 1.08),
    "bow 0.2/0.1 mm": Case(render.bow(2e-4, 1e-4), ("P2(x)", "P2(y)")),
    "bow 1/0.5 mm, 1 % outliers": Case(render.bow(1e-3, 5e-4), ("P2(x)", "P2(y)"), outliers=0.01),
    "twist 0.5 mm": Case(render.twist(5e-4), ("xy",)),
    "cubic 0.5 mm": Case(render.cubic(5e-4), ("P3(x)",), 1.25),
    "stretch 0.3 %": Case(render.stretch(0.003), ("x/y scale",), 1.25),
}


@dataclass(frozen=True)
class Data:
    """What is seen, the same without outliers, and what the oracle knows."""

    seen: Detections
    clean: Detections
    poses: list[Pose]
    terms: tuple[str, ...]

    @property
    def pixels(self) -> np.ndarray:
        return np.concatenate([view.pixels for view in self.seen.views])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--slow-seeds", type=int, default=5, help="seeds of calibrateCameraRO, mrcal and lensboy")
    parser.add_argument("--mrcal", help="interpreter that has mrcal")
    parser.add_argument("--lensboy", help="interpreter that has lensboy")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments = parser.parse_args()
    fast = {"oracle": oracle, "camcal": camcal, "camcal --flat-board": camcal_flat, "calibrateCamera": opencv}
    slow = {"calibrateCameraRO": opencv_ro}
    for name in ("mrcal", "lensboy"):
        if interpreter := getattr(arguments, name):
            slow[name] = partial(peer, name, interpreter)
    seeds = dict.fromkeys(fast, arguments.seeds) | dict.fromkeys(slow, min(arguments.slow_seeds, arguments.seeds))
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; RMS of the errors in px, median of the seconds")
    print(
        f"{'case':27} {'method':19} {'seeds':>5} {'all':>7} {'inside':>7} {'outside':>7} {'/oracle':>8} {'±':>6} "
        f"{'limit':>6} {'s':>6}"
    )
    for name in arguments.cases:
        run_case(name, fast | slow, seeds)


def run_case(name: str, methods: dict[str, Callable[[Data], Camera]], seeds: dict[str, int]) -> None:
    rows: dict[str, list[list[float]]] = {method: [] for method in methods}
    for seed in range(max(seeds.values())):
        data = data_of(seed, CASES[name])
        for method, solve in methods.items():
            if seed < seeds[method]:
                rows[method].append(figures(solve, data))
    oracles = np.array(rows["oracle"])
    for method, row in rows.items():
        if not row:
            continue
        table = np.array(row)
        ratio, spread = ratio_of_rms(table[:, 0], oracles[: len(table), 0])
        limit = f"{CASES[name].limit:.2f}" if method == "camcal" else ""
        errors = " ".join(f"{error:7.3f}" for error in np.sqrt(np.nanmean(table[:, :3] ** 2, axis=0)))
        print(
            f"{name:27} {method:19} {len(table):5d} {errors} {ratio:8.3f} {spread:6.3f} {limit:>6} "
            f"{np.median(table[:, 3]):6.2f}",
            flush=True,
        )


def figures(solve: Callable[[Data], Camera], data: Data) -> list[float]:
    """Return the errors over the full frame, inside and outside, and the seconds of a solve."""
    start = time.perf_counter()
    estimate = solve(data)
    seconds = time.perf_counter() - start
    return [*rms_inside_and_outside(TRUTH, estimate, data.pixels), seconds]


def ratio_of_rms(errors: np.ndarray, oracles: np.ndarray) -> tuple[float, float]:
    """Return the ratio of the RMS errors over the seeds and its standard deviation by resampling the seeds."""
    draws = np.random.default_rng(0).integers(0, len(errors), (2000, len(errors)))
    resampled = np.sqrt((errors[draws] ** 2).sum(axis=1) / (oracles[draws] ** 2).sum(axis=1))
    return float(np.sqrt((errors**2).sum() / (oracles**2).sum())), float(resampled.std())


def data_of(seed: int, case: Case) -> Data:
    poses = views(TRUTH, BOARD, VIEWS, rng=np.random.default_rng(seed))
    seen, clean = (
        observe(
            TRUTH,
            BOARD,
            poses,
            rng=np.random.default_rng([seed, 1]),
            noise_px=NOISE,
            shape=case.shape,
            outliers=outliers,
        )[0]
        for outliers in (case.outliers, 0.0)
    )
    return Data(seen, clean, poses, case.terms)


def oracle(data: Data) -> Camera:
    state = State(
        TRUTH.parameters,
        np.stack([pose.rotation for pose in data.poses]),
        np.stack([pose.translation for pose in data.poses]),
        np.zeros(len(data.terms)),
        np.zeros((BOARD.count, 3)),
    )
    free = np.arange(len(TRUTH.parameters))
    problem = BoardProblem(MODEL, BOARD, Observations.of(data.clean.views), free, data.terms, sigma=NOISE)
    return Camera(MODEL, SIZE, minimise(problem, state).state.parameters)


def camcal(data: Data) -> Camera:
    return calibrate(data.seen.views, BOARD, Options(MODEL)).camera


def camcal_flat(data: Data) -> Camera:
    return calibrate(data.seen.views, BOARD, Options(MODEL, shape=ShapeOptions(smooth=False))).camera


def opencv(data: Data) -> Camera:
    _, matrix, distortion, *_ = cv2.calibrateCamera(*opencv_points(data), SIZE, None, None)
    return from_opencv(matrix, distortion)


def opencv_ro(data: Data) -> Camera:
    objects, pixels = opencv_points(data)
    whole = [i for i, points in enumerate(objects) if len(points) == BOARD.count]  # it takes no partial views
    _, matrix, distortion, *_ = cv2.calibrateCameraRO(
        [objects[i] for i in whole], [pixels[i] for i in whole], SIZE, BOARD.columns - 1, None, None
    )
    return from_opencv(matrix, distortion)


def opencv_points(data: Data) -> tuple[list[np.ndarray], list[np.ndarray]]:
    points = BOARD.points().astype(np.float32)
    return [points[view.ids] for view in data.seen.views], [view.pixels.astype(np.float32) for view in data.seen.views]


def from_opencv(matrix: np.ndarray, distortion: np.ndarray) -> Camera:
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return Camera(MODEL, SIZE, np.array([*core, *distortion.ravel()[:5]]))


def peer(name: str, interpreter: str, data: Data) -> Camera:
    """Return the camera that a peer's script prints as the last line; see peers/."""
    table = np.full((len(data.seen.views), BOARD.count, 2), np.nan)
    for index, view in enumerate(data.seen.views):
        table[index, view.ids] = view.pixels
    shape = (BOARD.columns, BOARD.rows)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "data.npz"
        np.savez(file, pixels=table, points=BOARD.points(), size=SIZE, focal=TRUTH.value("fx"), shape=shape)
        command = [interpreter, PEERS / f"{name}_solve.py", folder]
        result = subprocess.run(command, check=True, capture_output=True, text=True)
    return Camera(MODEL, SIZE, np.array(json.loads(result.stdout.splitlines()[-1])))


if __name__ == "__main__":
    main()
