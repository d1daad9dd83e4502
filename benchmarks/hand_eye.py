"""Hand and eye of a simulated robot: error, intervals and the robot's own noise, beside OpenCV's closed forms.

A chessboard in 20 views of an opencv5 lens that is known to its standard deviations, corners with a noise of 0.1 px,
and poses of the hand with noise of position and rotation. The bound is the error under the noise as it is. --opencv
PYTHON: a Python whose OpenCV has calibrateHandEye, which gets the poses of the board that camcal found. --mistakes: how
often mistakes in lists of poses are named, and in how many lists without any.
"""

import argparse
import json
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, estimate_known, prior_of
from camcal.calibrate.robot.estimator import estimate_robot
from camcal.calibrate.robot.problem import OWN, Poses, RobotPoses, RobotProblem, closed_form
from camcal.calibrate.robot.reading import (
    Reading,
    duplicates,
    fits_better,
    moved_from,
    read_robot,
    shift_of,
    undetermined_axis,
)
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.formats.pose_text import form_named
from camcal.formats.robot_poses import RobotRows
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import linearise
from camcal.solve.steps import factorise
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.handeye_poses import candidates_of

BOARD, SIZE = Board("chessboard", 9, 6, 0.025), (1280, 960)
LENS = np.array([1100.0, 1101.0, 640.0, 478.0, -0.2, 0.08, 5e-4, -3e-4, 0.0])
STD = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 2e-3, 1e-4, 1e-4, 1e-6])
CARRIER = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.05, -0.02, 0.08]))
WORLD = Pose.from_vector(np.array([0.02, 3.1, 0.03]), np.array([0.6, 0.1, 0.02]))
NOISE = ((0.0, 0.0), (1e-4, 0.02), (5e-4, 0.05), (2e-3, 0.1))  # m and degrees
METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
BY_OPENCV = """
import json, sys
import cv2
import numpy as np
data = np.load(sys.argv[1])
back = [-r.T @ t for r, t in zip(data["camera_r"], data["camera_t"])]
found = {}
for name in sys.argv[2:]:
    r, t = cv2.calibrateHandEye(list(data["robot_r"]), list(data["robot_t"]), list(data["camera_r"]),
                                list(data["camera_t"]), method=getattr(cv2, "CALIB_HAND_EYE_" + name))
    found[name] = np.ravel(t).tolist()
print(json.dumps(found))
"""


def stacked(poses):
    return Poses(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


def board_pose(rng):
    middle, distance = BOARD.points().mean(axis=0), rng.uniform(0.3, 0.7)
    turn = so3.exp(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-2, 2)]))
    return Pose(turn, np.array([*rng.uniform(-0.1, 0.1, 2) * distance, distance]) - turn @ middle)


def robot_pose(camera_T_board, in_hand):
    found = WORLD @ camera_T_board.inverse() @ CARRIER.inverse()
    return found if in_hand else found.inverse()


def noisy(pose, shift, turn, rng):
    return Pose(pose.rotation @ so3.exp(rng.normal(0, turn, 3)), pose.translation + rng.normal(0, shift, 3))


def scene(rng, count, in_hand, shift, turn):
    camera, points, views, robot = Camera(model_named("opencv5"), SIZE, LENS), BOARD.points(), [], []
    while len(views) < count:
        pose = board_pose(rng)
        seen = camera.project(points @ pose.rotation.T + pose.translation)
        if seen.valid.all() and (seen.pixels > 5).all() and (seen.pixels < np.array(SIZE) - 5).all():
            pixels = seen.pixels + rng.normal(0, 0.1, seen.pixels.shape)
            views.append(BoardDetection(f"{len(views)}.png", SIZE, np.arange(len(points)), pixels))
            robot.append(noisy(robot_pose(pose, in_hand), shift, turn, rng))
    return views, stacked(robot)


def errors(fixed):
    found = [Pose(*each) for each in zip(fixed.rotations, fixed.translations, strict=True)]
    pairs = zip(found, (CARRIER, WORLD), strict=True)
    return np.concatenate(
        [np.r_[own.translation - true.translation, so3.log(own.rotation @ true.rotation.T)] for own, true in pairs]
    )


def one(rng, in_hand, shift, turn, opencv):
    views, robot = scene(rng, 20, in_hand, shift, turn)
    lens = Camera(model_named("opencv5"), SIZE, LENS + STD * rng.normal(size=9), np.diag(STD**2))
    start = time.process_time()
    known = KnownCamera(lens, 0.05, Observations.of(views), np.arange(len(views)))
    rig, _ = estimate_known([known], [Pose.identity()], KnownBoard(Surface.flat(BOARD)), {0: prior_of(known)})
    poses = RobotPoses(robot, np.arange(len(views)), in_hand, (1.0, 1.0), np.ones(len(views)))
    camera = Poses(rig.state.rotations, rig.state.translations)
    found = estimate_robot(rig.problem, rig.state, poses, closed_form(poses.world_T_carrier, camera))
    spent = time.process_time() - start
    true = replace(poses, sigmas=(max(shift, 1e-7), max(turn, 1e-7)))
    bound = factorise(linearise(RobotProblem(found.problem.rig, true), found.state)).shared_covariance()[-OWN:, -OWN:]
    result = {"error": errors(found.state.fixed), "std": np.sqrt(np.diag(found.covariance)), "sigmas": found.sigmas,
              "bound": np.diag(bound), "s": spent}  # fmt: skip
    return result | ({"opencv": by_opencv(opencv, poses.world_T_carrier, camera)} if opencv else {})


def by_opencv(python, robot, camera):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.npz"
        np.savez(path, robot_r=robot.rotations, robot_t=robot.translations, camera_r=camera.rotations,
                 camera_t=camera.translations)  # fmt: skip
        done = subprocess.run([python, "-c", BY_OPENCV, path, *METHODS], capture_output=True, text=True, check=True)
    return {name: np.linalg.norm(np.array(t) - CARRIER.translation) for name, t in json.loads(done.stdout).items()}


def show_errors(count, opencv):
    head = ["camera", "noise mm, deg", "error mm", "/ bound", "95 % intervals", "noise found / true", "CPU s"]
    head += [f"OpenCV {name} mm" for name in METHODS] if opencv else []
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for in_hand in (True, False):
        for shift, degrees in NOISE:
            rng, turn = np.random.default_rng(5), np.radians(degrees)
            all_of = [one(rng, in_hand, shift, turn, opencv) for _ in range(count)]
            error, std, bound = (np.array([each[key] for each in all_of]) for key in ("error", "std", "bound"))
            rms = np.sqrt(np.mean(np.sum(error[:, :3] ** 2, axis=1)))
            ratio = rms / np.sqrt(np.mean(np.sum(bound[:, :3], axis=1)))
            noise = np.sqrt(np.mean(np.square([each["sigmas"] for each in all_of]), axis=0))
            told = f"{noise[0] / shift:.2f}, {noise[1] / turn:.2f}" if shift else f"{1e6 * noise[0]:.1f} um"
            row = ["in hand" if in_hand else "fixed", f"{1e3 * shift:g}, {degrees:g}", f"{1e3 * rms:.3f}",
                   f"{ratio:.2f}", f"{100 * np.mean(np.abs(error / std) < 1.96):.1f} %", told,
                   f"{np.median([each['s'] for each in all_of]):.2f}"]  # fmt: skip
            if opencv:
                row += [
                    f"{1e3 * np.sqrt(np.mean([each['opencv'][name] ** 2 for each in all_of])):.3f}" for name in METHODS
                ]
            print(f"| {' | '.join(row)} |", flush=True)


FORMS = ("ros", "quat:wxyz", "colmap", "euler:ZYX:deg", "euler:XYZ:deg", "euler:xyz:rad", "rvec", "euler:ZYZ:deg")
UNITS = (1.0, 1e-2, 1e-3)


def show_mistakes(count):
    rng, named, total = np.random.default_rng(3), Counter(), Counter()

    def note(what, right):
        named[what] += bool(right)
        total[what] += 1

    for _ in range(count):
        lists_of_poses(rng, note)
    print("| list of poses | named |\n|---|---|")
    for what in total:
        print(f"| {what} | {named[what]} of {total[what]} |")


def lists_of_poses(rng, note):
    number, in_hand, inverted = int(rng.integers(8, 30)), bool(rng.integers(2)), bool(rng.integers(2))
    shift, turn = rng.choice([0, 1e-4, 5e-4, 2e-3]), np.radians(rng.choice([0, 0.02, 0.05, 0.1, 0.2]))
    form, unit = str(rng.choice(FORMS)), float(rng.choice(UNITS))
    seen = [board_pose(rng) for _ in range(number)]
    robot = [noisy(robot_pose(pose, in_hand), shift, turn, rng) for pose in seen]
    camera = stacked([noisy(pose, 5e-5, 5e-5, rng) for pose in seen])
    given = [pose.inverse() if inverted else pose for pose in robot]
    numbers = np.array([form_named(form).numbers(Pose(pose.rotation, pose.translation / unit)) for pose in given])
    every = candidates_of(RobotRows(numbers).forms(), numbers)
    best = read_robot(every, camera, UNITS, (False, True), in_hand)[0]
    true = stacked(robot)
    apart = (
        np.abs(best.poses.translations - true.translations).max() + np.abs(best.poses.rotations - true.rotations).max()
    )
    note("form, direction and unit are told", apart < 1e-6)
    alarms = shift_of(every, camera), moved_from(best.fit), undetermined_axis(best.poses), duplicates(best.poses)
    note("nothing is wrong: false alarms", any(each is not None and np.any(each) for each in alarms))
    said = candidates_of((form_named(form),), numbers)
    wrong = read_robot(said, camera, (unit,), (not inverted,), in_hand)[0]
    note("said to be of the other direction", fits_better(wrong.fit, best.fit))
    for places in (1, -1):
        moved = candidates_of(RobotRows(numbers).forms(), numbers[np.roll(np.arange(number), places)])
        note("shifted by one", shift_of(moved, camera) == places)
    if form.startswith("euler"):
        other = "euler:XYZ:deg" if form == "euler:ZYX:deg" else "euler:ZYX:deg"
        wrong = read_robot(candidates_of((form_named(other),), numbers), camera, UNITS, (False, True), in_hand)[0]
        note("said to have Euler angles in another order or unit", fits_better(wrong.fit, best.fit))
    away, first = Pose.from_vector(np.array([0.02, 0.01, 0.0]), np.array([0.0, 0.0, 0.05])), int(0.7 * number)
    late = [away @ pose if in_hand else pose @ away for pose in robot[first:]]
    if number >= 12:
        slipped = stacked(robot[:first] + late)
        fit = closed_form(slipped if in_hand else slipped.inverse(), camera)
        note("board moved by 50 mm after 70 %", moved_from(Reading("", False, 1.0, slipped, fit).fit) == first)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--opencv")
    parser.add_argument("--mistakes", action="store_true")
    options = parser.parse_args()
    show_mistakes(options.count) if options.mistakes else show_errors(options.count, options.opencv)


if __name__ == "__main__":
    main()
