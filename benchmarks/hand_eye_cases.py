"""Hand and eye of poses of the board, in cases that go wrong: clocks, outliers, encoders, hands that turn too little.

Poses of a camera with noise of 0.1 mm and 0.02° and of a six-axis arm go through files to `camcal handeye
--camera-poses`. Errors are those of the camera's place on the hand, RMS; *as read*: against what 100 exact poses of the
camera say of an arm whose joints read wrong all the time, whose hand is not where it says. --opencv PYTHON: a Python
whose OpenCV has calibrateHandEye, which gets the same pairs, as does --visp PROGRAM (peers/visp_hand_eye.cpp). --clean:
how often anything is wrong in lists with no mistake, of poses, of images of a rig and of moving hands; --named: how
often mistakes are named.
"""

import argparse
import subprocess
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from hand_eye import BOARD, CARRIER, LENS, METHODS, SIZE, STD, WORLD, board_pose, by_opencv, noisy, robot_pose, stacked

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.formats import detections, native
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile, Transform
from camcal.formats.pose_text import form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe
from camcal.targets.detection import Detections
from camcal.tasks.calibration.check_options import HandEyeOptions
from camcal.tasks.calibration.handeye import handeye

CAMERA_NOISE = (1e-4, np.radians(0.02))
ROBOT_NOISE = (3e-4, np.radians(0.03))
FORMS = ("ros", "quat:wxyz", "euler:ZYX:deg", "euler:xyz:rad", "rvec", "matrix")
# of an arm with a reach of 0.9 m: a (m), alpha (rad), d (m) of every joint
ARM = ((0, np.pi / 2, 0.15), (-0.43, 0, 0), (-0.39, 0, 0), (0, np.pi / 2, 0.13), (0, -np.pi / 2, 0.1), (0, 0, 0.1))
ELBOW = np.array([0.3, -1.4, 1.6, -1.8, -1.5, 0.2])  # rad, about which joints turn
LATE = 0.08  # s


def arm(joints):
    """The pose base_T_hand of an arm with these joint angles (6,)."""
    found = Pose.identity()
    for (a, alpha, d), angle in zip(ARM, joints, strict=True):
        turn = so3.exp(np.array([0, 0, angle]))
        found = found @ Pose(turn @ so3.exp(np.array([alpha, 0, 0])), turn @ np.array([a, 0, 0]) + [0, 0, d])
    return found


def seen_from(hand):
    return CARRIER.inverse() @ hand.inverse() @ WORLD


def moving(time):
    """Where the arm is at a time (s)."""
    return arm(ELBOW + 0.4 * np.sin(np.array([0.5, 0.6, 0.8, 0.9, 1.1, 1.3]) * time + np.arange(6)))


def still(rng, count, spread=0.5, only=None):
    """Poses of the arm: all of its joints turned, or the last one only."""
    turned = rng.uniform(-spread, spread, (count, 6))
    if only is not None:
        turned[:, [joint for joint in range(6) if joint not in only]] = 0
    return [arm(ELBOW + each) for each in turned]


def noises(poses, noise, rng):
    return [noisy(pose, *noise, rng) for pose in poses]


def clean(rng, noise=ROBOT_NOISE):
    hand = still(rng, 20)
    return noises(hand, noise, rng), noises(map(seen_from, hand), CAMERA_NOISE, rng)


def exact(rng):
    return clean(rng, (0.0, 0.0))


def coarse(rng):
    return clean(rng, (2e-3, np.radians(0.1)))


def outliers(rng):
    robot, camera = clean(rng)
    for place in rng.choice(20, 3, replace=False):
        robot[place] = noisy(robot[place], 0.02, np.radians(2), rng)
    return robot, camera


def encoders(rng):
    """Joints whose zeros are off by 0.02°, read with a noise of 0.005°."""
    joints, zeros = ELBOW + rng.uniform(-0.5, 0.5, (20, 6)), rng.normal(0, np.radians(0.02), 6)
    read = joints + zeros + rng.normal(0, np.radians(0.005), joints.shape)
    return list(map(arm, read)), noises(map(seen_from, map(arm, joints)), CAMERA_NOISE, rng), {"zeros": zeros}


def as_read(rng):
    """The same, and exact pairs of many poses: what such an arm makes of the place of the camera."""
    robot, camera, more = encoders(rng)
    joints = ELBOW + rng.uniform(-0.5, 0.5, (100, 6))
    return robot, camera, {"exact": (list(map(arm, joints + more["zeros"])), [*map(seen_from, map(arm, joints))])}


def one_axis(rng):
    hand = still(rng, 20, only=(5,))
    return noises(hand, ROBOT_NOISE, rng), noises(map(seen_from, hand), CAMERA_NOISE, rng)


def no_turn(rng):
    hand = [Pose(arm(ELBOW).rotation, arm(ELBOW).translation + rng.normal(0, 0.1, 3)) for _ in range(20)]
    return noises(hand, ROBOT_NOISE, rng), noises(map(seen_from, hand), CAMERA_NOISE, rng)


def late(rng):
    """A video and the poses of a moving arm, by clocks that differ; the pairs of the same stamps besides."""
    times, stamps = 2 + np.sort(rng.choice(780, 60, replace=False)) / 30, np.arange(0, 30, 0.02)
    camera = noises((seen_from(moving(time)) for time in times), CAMERA_NOISE, rng)
    robot = noises(map(moving, stamps), ROBOT_NOISE, rng)
    pairs = [robot[int(np.argmin(np.abs(stamps + LATE - time)))] for time in times]
    return (robot, stamps + LATE), (camera, times), {"pairs": pairs}


CASES = {"clean": clean, "exact robot": exact, "2 mm and 0.1°": coarse, "3 of 20 poses off": outliers,
         "encoders": encoders, "encoders, as read": as_read,
         "poses 0.08 s late": late, "one axis": one_axis, "no turn": no_turn}  # fmt: skip


def write(path, poses, form="ros", unit=1.0, stamps=None):
    rows = [form_named(form).numbers(Pose(pose.rotation, pose.translation / unit)) for pose in poses]
    if stamps is not None:
        for row, stamp in zip(rows, stamps, strict=True):
            row[0] = stamp
    path.write_text("\n".join(" ".join(map(repr, np.asarray(row).tolist())) for row in rows) + "\n")


def solved(folder, robot, camera, **options):
    """The report of camcal, or the error that ended it."""
    for name, poses in (("robot", robot), ("camera", camera)):
        listed, stamps = poses if isinstance(poses, tuple) else (poses, None)
        write(folder / f"{name}.txt", listed, "ros" if stamps is None else "tum", stamps=stamps)
    given = HandEyeOptions(robot=folder / "robot.txt", camera_poses=folder / "camera.txt", output=folder / "hand.yaml")
    return ended(replace(given, **options))


def ended(options):
    try:
        return handeye(replace(options, overwrite=True))
    except CamcalError as error:
        return error


def apart(report, truth):
    found = next(iter(report.transforms.values()))
    off = found.pose.translation - truth.translation, so3.log(found.pose.rotation @ truth.rotation.T)
    return np.concatenate(off), np.sqrt(np.diag(found.covariance))


def by_visp(program, robot, camera):
    """How far from its place on the hand ViSP finds the camera, m."""
    pairs = [own.matrix().ravel() for pair in zip(robot, camera, strict=True) for own in pair]
    text = f"{len(robot)}\n" + "\n".join(" ".join(map(repr, row.tolist())) for row in pairs)
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.linalg.norm(np.array(done.stdout.split()[-3:], float) - CARRIER.translation)


def show_cases(count, opencv, visp):
    head = ["case", "refused", "error mm", "95 % intervals", "of rotation", "said"]
    peers = ([f"OpenCV {name}" for name in METHODS] if opencv else []) + (["ViSP"] if visp else [])
    head += [f"{name} mm" for name in peers]
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    with tempfile.TemporaryDirectory() as folder:
        for name, case in CASES.items():
            rng, errors, inside, said, others = np.random.default_rng(11), [], [], Counter(), []
            for _ in range(count):
                robot, camera, *rest = case(rng)
                more, truth = dict(*rest), CARRIER
                if "exact" in more:
                    truth = next(iter(solved(Path(folder), *more["exact"]).transforms.values())).pose
                report = solved(Path(folder), robot, camera)
                if isinstance(report, CamcalError):
                    said[str(report).partition("hand ")[2].partition(":")[0][:40]] += 1
                else:
                    off, std = apart(report, truth)
                    errors.append(off)
                    inside.append(np.abs(off / std) < 1.96)
                    said.update(each.code for each in report.warnings)
                if "exact" in more:
                    continue
                listed, seen = more.get("pairs", robot), camera[0] if isinstance(camera, tuple) else camera
                found = list(by_opencv(opencv, stacked(listed), stacked(seen)).values()) if opencv else []
                others.append([*found, *([by_visp(visp, listed, seen)] if visp else [])])
            row = [name, f"{count - len(errors)}", *figures(errors, inside)]
            row.append(", ".join(f"{what} {times}" for what, times in said.items()))
            row += (
                [f"{1e3 * own:.3f}" for own in np.sqrt(np.mean(np.square(others), axis=0))]
                if others
                else [""] * len(peers)
            )
            print(f"| {' | '.join(row)} |", flush=True)


def figures(errors, inside):
    if not errors:
        return "", "", ""
    places = 1e3 * np.sqrt(np.mean(np.sum(np.square(errors)[:, :3], axis=1)))
    turned, moved = (f"{100 * np.mean(np.array(inside)[:, part]):.1f} %" for part in (slice(3, 6), slice(3)))
    return f"{places:.3f}", moved, turned


def rig_files(folder, rng):
    """Corners of a rig on a hand, and the poses of the robot."""
    lens = Camera(model_named("opencv5"), SIZE, LENS, np.diag(STD**2))
    entry = CameraEntry(lens, noise=CalibrationNoise(0.1))
    across = Pose.from_vector(np.array([0, -0.1, 0]), np.array([-0.08, 0, 0]))
    native.write(folder / "rig.yaml", CameraFile({"left": entry, "right": entry}, {"right_T_left": Transform(across)}))
    exact, views = [], []
    while len(exact) < 15:
        pose = board_pose(rng)
        both = [observe(lens, BOARD, [own], noise_px=0.1, rng=rng)[0].views[0] for own in (pose, across @ pose)]
        if all(len(view.ids) == BOARD.count for view in both):
            named = zip(("left", "right"), both, strict=True)
            views += [replace(view, camera=name, image=f"{name}{len(exact):02}.png") for name, view in named]
            exact.append(pose)
    detections.write(folder / "seen.csv", Detections(BOARD, tuple(views)))
    write(folder / "robot.txt", noises((robot_pose(pose, True) for pose in exact), ROBOT_NOISE, rng))
    return HandEyeOptions(str(folder / "rig.yaml"), (str(folder / "seen.csv"),), folder / "robot.txt",
                          output=folder / "hand.yaml")  # fmt: skip


def show_clean(count, rigs, seed):
    rng = np.random.default_rng(seed)
    print("| lists without a mistake | wrong or warned of |\n|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lists = {
            "poses of the board, six forms, three units": (count, lambda: in_some_form(folder, rng)),
            "a video and a moving arm": (rigs, lambda: video(folder, rng)),
            "images of a rig": (rigs, lambda: ended(rig_files(folder, rng))),
        }
        for what, (times, make) in lists.items():
            reports = [make() for _ in range(times)]
            wrong = [each for each in reports if isinstance(each, CamcalError) or each.warnings]
            codes = Counter(str(each) if isinstance(each, CamcalError) else each.warnings[0].code for each in wrong)
            shown = "".join(f"; {code} {number}" for code, number in codes.items())
            print(f"| {what} | {len(wrong)} of {times}{shown} |", flush=True)


def video(folder, rng):
    (robot, stamps), camera, *_ = late(rng)
    return solved(folder, (robot, stamps - LATE), camera)


def as_they_are(robot, camera):
    return robot, camera


def in_some_form(folder, rng, change=as_they_are, **options):
    """The report of poses in some form; change: what is wrong with them."""
    noise = float(rng.choice([0, 1e-4, 5e-4, 2e-3])), np.radians(rng.choice([0, 0.02, 0.1]))
    hand = still(rng, int(rng.integers(9, 30)), spread=0.6)
    robot, camera = noises(hand, noise, rng), noises(map(seen_from, hand), CAMERA_NOISE, rng)
    robot, camera = change(robot, camera)
    inverted, form, unit = bool(rng.integers(2)), str(rng.choice(FORMS)), float(rng.choice([1.0, 1e-2, 1e-3]))
    write(folder / "robot.txt", [pose.inverse() if inverted else pose for pose in robot], form, unit)
    write(folder / "camera.txt", camera, str(rng.choice(FORMS)))
    options = {name: value(inverted, form, unit) for name, value in options.items()}
    return ended(HandEyeOptions(robot=folder / "robot.txt", camera_poses=folder / "camera.txt",
                                output=folder / "hand.yaml", **options))  # fmt: skip


def shifted(robot, camera):
    return robot[1:], camera[:-1]


def slipped(robot, camera):
    first = int(0.6 * len(robot))
    away = Pose.from_vector(np.array([0.02, 0.01, 0]), np.array([0, 0, 0.05]))
    return robot, camera[:first] + [pose @ away for pose in camera[first:]]


def repeated(robot, camera):
    return robot[:-1] + robot[:1], camera[:-1] + camera[:1]


MISTAKES = {
    "shifted by one": ("shifted by 1", shifted, {}),
    "said to be of the other direction": (
        "--robot-frames",
        as_they_are,
        {"robot_frames": lambda inverted, *_: "base_T_hand" if inverted else "hand_T_base"},
    ),
    "said to be in another unit": (
        "--robot-unit",
        as_they_are,
        {"robot_unit": lambda *own: "m" if own[2] < 1 else "mm"},
    ),
    "the board moved by 50 mm after 60 %": ("has been moved", slipped, {}),
    "a pose repeated": ("repeated", repeated, {}),
}


def show_named(count):
    rng = np.random.default_rng(13)
    print("| mistake in poses | named |\n|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for what, (words, change, options) in MISTAKES.items():
            named = 0
            for _ in range(count):
                found = in_some_form(Path(name), rng, change, **options)
                text = str(found) if isinstance(found, CamcalError) else "".join(each.text for each in found.warnings)
                named += words in text
            print(f"| {what} | {named} of {count} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--rigs", type=int, default=40)
    parser.add_argument("--opencv")
    parser.add_argument("--visp", metavar="PROGRAM")
    parser.add_argument("--seed", type=int, default=12, help="of --clean")
    parser.add_argument("--clean", action="store_true")
    parser.add_argument("--named", action="store_true")
    options = parser.parse_args()
    if options.clean or options.named:
        show_clean(options.count, options.rigs, options.seed) if options.clean else show_named(options.count)
    else:
        show_cases(options.count, options.opencv, options.visp)


if __name__ == "__main__":
    main()
