"""Rigs and several boards on simulated captures of tests/body_scenes.py: errors beside what is stated of them.

A row is of the runs of a scene, each with other cameras, boards and motions: z, the errors of all transforms in their
standard deviations, of cameras, of those that never share a board with the first one, and of boards on their body: RMS
(1 is right; 0.8 to 1.2 wanted) and the largest; NEES/dof, the squared errors normalised by whole covariances, per
degree of freedom; the largest error of a camera's position in mm and of its rotation in degrees; CPU seconds of a run.

two sides: eight cameras, a panel with a board on each side; four cameras see the one, four the other, none both.
cube: four cameras around a cube with a board on each face. distances: two sides with boards printed 0.4 % too large and
0.3 % too small, and three distances with 0.1 mm, one of them between the boards. --mistakes: what is said of scenes
with something wrong, by how often.

    python benchmarks/several_boards.py [--runs 30] [--scenes NAME …]
    python benchmarks/several_boards.py --mistakes [--runs 20]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.measured import KnownDistance, Measured
from camcal.calibrate.rigs.record import RigCalibration, RigOptions
from camcal.cameras.catalogue import model_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from body_scenes import BodyScene, captures_of, cube, two_sides

MODEL = model_named("opencv5")
ENDS = (("a", 0, "a", 53), ("b", 0, "b", 39), ("a", 0, "b", 39))  # points between which distances are measured
PRINTED = {"a": 1.004, "b": 0.997}


@dataclass(frozen=True)
class Error:
    """Of a transform: z (6,), the normalised squared error, and its error in mm and degrees."""

    what: str
    z: tuple[float, ...]
    squared: float
    mm: float
    degrees: float


def error_of(what: str, found: Pose, covariance: np.ndarray, truth: np.ndarray) -> Error:
    step = np.concatenate([found.translation - truth[:3, 3], so3.log(found.rotation @ truth[:3, :3].T)])
    return Error(
        what,
        tuple(step / np.sqrt(np.diag(covariance))),
        float(step @ np.linalg.solve(covariance, step)),
        1e3 * float(np.linalg.norm(step[:3])),
        float(np.degrees(np.linalg.norm(step[3:]))),
    )


def errors_of(calibration: RigCalibration, scene: BodyScene) -> list[Error]:
    """Return the errors of all transforms."""
    result = []
    for name, pose in calibration.poses.items():
        if name != calibration.first:
            what = "cameras" if name[:-1] == calibration.first[:-1] else "cameras apart"
            result.append(error_of(what, pose, calibration.pose_covariance(name), scene.relative(name)))
    for name, pose in calibration.boards.items():
        target, source = name.split("_T_")
        truth = np.linalg.inv(scene.on_body[target]) @ scene.on_body[source]
        result.append(error_of("boards", pose, calibration.transform_covariance(name), truth))
    return result


def distances(scene: BodyScene, std: float, rng: np.random.Generator) -> tuple[KnownDistance, ...]:
    """Return measured distances of ENDS with errors of a standard deviation, m."""
    names, result = list(scene.boards), []
    starts = dict(zip(names, np.cumsum([0, *(board.count for board in scene.boards.values())]), strict=False))
    for one, first, other, second in ENDS:
        ends = [
            scene.on_body[board][:3, :3] @ scene.points(board)[point] + scene.on_body[board][:3, 3]
            for board, point in ((one, first), (other, second))
        ]
        length = float(np.linalg.norm(ends[0] - ends[1])) + std * rng.normal()
        points = int(starts[one]) + first, int(starts[other]) + second
        result.append(KnownDistance(points, (names.index(one), names.index(other)), length, std, f"{one} to {other}"))
    return tuple(result)


def scene_of(name: str, seed: int) -> tuple[BodyScene, Measured]:
    if name == "cube":
        return cube(seed), Measured()
    scene = two_sides(seed)
    if name != "distances":
        return scene, Measured()
    scene = replace(scene, printed=PRINTED)
    return scene, Measured(distances=distances(scene, 1e-4, np.random.default_rng([seed, 3])))


def run_of(name: str, seed: int) -> tuple[list[Error], float]:
    """Return the errors of a run and its CPU seconds."""
    scene, measured = scene_of(name, seed)
    captures = captures_of(scene, seed=seed)
    began = time.process_time()
    options = RigOptions(dict.fromkeys(captures.cameras, MODEL), measured=measured)
    calibration = calibrate_rig(captures, scene.together, options)
    return errors_of(calibration, scene), time.process_time() - began


def rows(name: str, runs: int) -> None:
    found = [run_of(name, seed) for seed in range(runs)]
    seconds = np.median([own for _, own in found])
    by_what: dict[str, list[Error]] = {}
    for errors, _ in found:
        for each in errors:
            by_what.setdefault(each.what, []).append(each)
    for what, errors in by_what.items():
        z = np.array([each.z for each in errors])
        squared = np.mean([each.squared for each in errors]) / 6
        mm, degrees = max(each.mm for each in errors), max(each.degrees for each in errors)
        line = f"{name:10s} {what:14s} {len(errors):5d} {np.sqrt(np.mean(z**2)):6.2f} {np.abs(z).max():8.2f}"
        print(f"{line} {squared:9.2f} {mm:8.3f} {degrees:8.4f} {seconds:6.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--scenes", nargs="+", default=["two sides", "cube", "distances"])
    given = parser.parse_args()
    print("scene      transforms     count  rms z  largest  NEES/dof       mm  degrees    CPU")
    for name in given.scenes:
        rows(name, given.runs)


if __name__ == "__main__":
    main()
