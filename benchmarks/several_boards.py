"""Rigs and several boards on simulated captures of tests/body_scenes.py: errors beside what is stated of them.

A row is of the runs of a scene, each with other cameras, boards and motions: z, the errors of all transforms in their
standard deviations, of cameras, of those that never share a board with the first one, and of boards on their body: RMS
(1 is right; 0.8 to 1.2 wanted) and the largest; NEES/dof, the squared errors normalised by whole covariances, per
degree of freedom; the largest error of a camera's position in mm and of its rotation in degrees; CPU seconds of a run.

two sides: eight cameras, a panel with a board on each side; four cameras see the one, four the other, none both.
cube: four cameras around a cube with a board on each face. distances: two sides with boards printed 0.4 % too large and
0.3 % too small, and three distances with 0.1 mm, one of them between the boards.

--mistakes: two cameras, one on each side of the panel; how often a mistake is named as what it is, and how often
anything is refused where all is right. --rendered: images of four cameras around a cube with an AprilGrid on each face,
with a blur of 0.7 px and a noise of two grey levels, by `camcal rig` from images to the file.

    python benchmarks/several_boards.py [--runs 30] [--scenes NAME …]
    python benchmarks/several_boards.py --mistakes [--runs 30]
    python benchmarks/several_boards.py --rendered [--moments 16]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.measured import KnownDistance, KnownRelation, Measured
from camcal.calibrate.rigs.record import RigCalibration, RigOptions
from camcal.cameras.catalogue import model_named
from camcal.errors import CamcalError
from camcal.formats import boards
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from body_pictures import picture, tagged_faces
from body_scenes import BodyScene, captures_of, cube, transform, two_sides

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


def wrong_scene(case: str, seed: int) -> tuple[BodyScene, Measured]:
    """Return a scene of two cameras, with what is said to be known of it."""
    turns = {"one axis": (0.5, 0.0, 0.0), "one axis, upright": (0.0, 0.5, 0.0)}.get(case, (0.6, 0.6, 0.5))
    scene = two_sides(seed, 20, turns=turns, per_side=1)
    rng = np.random.default_rng([seed, 5])
    if case == "boards move":
        steps = [transform(0.3 * rng.normal(size=3), 0.1 * rng.normal(size=3)) for _ in scene.motions["b"]]
        moved = [own @ step for own, step in zip(scene.motions["b"], steps, strict=True)]
        scene = replace(scene, motions={**scene.motions, "b": moved})
    if "distance" in case:
        scene = replace(scene, printed=PRINTED)
        known = list(distances(scene, 1e-4, rng))
        if "wrong" in case:
            which = int(rng.integers(3))
            known[which] = replace(known[which], metres=known[which].metres + 1e-3 * rng.choice([-1, 1]), words="wrong")
        return scene, Measured(distances=tuple(known))
    if "relation" in case:
        truth = scene.on_body["b"] @ transform(1e-4 / 0.3 * rng.normal(size=3), 1e-4 * rng.normal(size=3))
        if "wrong" in case:
            truth[:3, 3] += 2e-3 * np.linalg.qr(rng.normal(size=(3, 3)))[0][0]
        covariance = np.diag([1e-8] * 3 + [(1e-4 / 0.3) ** 2] * 3)
        return scene, Measured((KnownRelation(0, 1, Pose(truth[:3, :3], truth[:3, 3]), covariance),))
    return scene, Measured()


CASES = {
    "all right": "",
    "distances": "",
    "relation": "",
    "wrong distance": "distance_contradicted",
    "wrong relation": "relation_contradicted",
    "boards move": "boards_not_joined",
    "one axis": "undetermined_motion",
    "one axis, upright": "undetermined_motion",
}


def said_of(case: str, seed: int) -> str:
    """Return the code of what is said of a scene, nothing where it is calibrated."""
    scene, measured = wrong_scene(case, seed)
    captures = captures_of(scene, seed=seed)
    try:
        calibrate_rig(captures, scene.together, RigOptions(dict.fromkeys(captures.cameras, MODEL), measured=measured))
    except CamcalError as error:
        [failure, *_] = getattr(error, "failures", ()) or [None]
        code = "no code" if failure is None else failure.code
        return code if code != "distance_contradicted" or "wrong" in failure.text else "another distance"
    return ""


def mistakes(runs: int) -> None:
    print("case               runs  as wanted  else")
    for case, wanted in CASES.items():
        said = Counter(said_of(case, seed) for seed in range(runs))
        others = ", ".join(f"{code or 'nothing'} {count}" for code, count in said.items() if code != wanted)
        print(f"{case:18s} {runs:4d} {said[wanted]:10d}  {others}", flush=True)


def rendered(moments: int) -> None:
    scene = cube(0, moments, 4, tagged_faces(6))
    with tempfile.TemporaryDirectory() as folder:
        boards.write(Path(folder) / "cube.yaml", scene.together)
        seen = sum(picture(scene, name, moment, Path(folder)) for name in scene.cameras for moment in range(moments))
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        command = [sys.executable, "-m", "camcal", "rig", *(f"{name}={name}" for name in scene.cameras), "--json"]
        command += ["--board", "cube.yaml", "-o", "rig.yaml", "--model", "opencv5", "--jobs", "1"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    found = json.loads(done.stdout)
    errors = []
    for name, own in found["transforms"].items():
        target, source = name.split("_T_")
        what, truth = (
            "boards",
            np.linalg.inv(scene.on_body.get(target, np.eye(4))) @ scene.on_body.get(source, np.eye(4)),
        )
        if target in scene.cameras:
            what, truth = "cameras", scene.relative(target)
        errors.append(error_of(what, Pose(np.array(own["R"]), np.array(own["t"])), np.array(own["covariance"]), truth))
    images, trusted = len(scene.cameras) * moments, "trustworthy" if found["trustworthy"] else "not trustworthy"
    print(f"{images} images, {seen} faces within them, {seconds:.0f} s CPU, {trusted}")
    print("transforms  count  rms z  largest       mm  degrees")
    for what in ("cameras", "boards"):
        own = [each for each in errors if each.what == what]
        z = np.array([each.z for each in own])
        mm, degrees = max(each.mm for each in own), max(each.degrees for each in own)
        print(f"{what:10s} {len(own):6d} {np.sqrt(np.mean(z**2)):6.2f} {np.abs(z).max():8.2f} {mm:8.3f} {degrees:8.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--scenes", nargs="+", default=["two sides", "cube", "distances"])
    parser.add_argument("--mistakes", action="store_true")
    parser.add_argument("--rendered", action="store_true")
    parser.add_argument("--moments", type=int, default=16)
    given = parser.parse_args()
    if given.mistakes:
        mistakes(given.runs)
        return
    if given.rendered:
        rendered(given.moments)
        return
    print("scene      transforms     count  rms z  largest  NEES/dof       mm  degrees    CPU")
    for name in given.scenes:
        rows(name, given.runs)


if __name__ == "__main__":
    main()
