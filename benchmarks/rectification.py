"""Rectification of random pairs beside cv2.stereoRectify, rows of rendered pairs, and the rate of remapping.

Pairs have lenses of 5° to 200°; the judge is in rectified_rigs.py and shares no formula with camcal. A pair is right if
its images are neither empty, turned nor mirrored and hold 85 % of the points that both cameras see at several
distances. OpenCV is called with alpha = 1 and with its default (of fisheye: balance 1 and 0), and the better result
counts.

    python benchmarks/rectification.py [rigs] [--rigs 2000] [--seed 1]
    python benchmarks/rectification.py rows
    python benchmarks/rectification.py speed [--repeats 15]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time
from collections import Counter

import cv2
import numpy as np
from rectified_rigs import FISHEYE, KINDS, Image, Lens, RandomRig, Rectified, RigVerdict, judge, random_rigs

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError
from camcal.geometry.pose import Pose
from camcal.stereo.rectify.plan import plan_rectification
from camcal.stereo.rectify.record import Rectification

COLUMNS = ("right", "refused", "reason said", "kept < 85 %", "empty", "turned", "mirrored", "negative focal length")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", choices=("rigs", "rows", "speed"), default="rigs")
    parser.add_argument("--rigs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--list", action="store_true", help="print every pair that is not right")
    arguments = parser.parse_args()
    if arguments.table == "rigs":
        print_rigs(arguments.rigs, arguments.seed, listed=arguments.list)


def print_rigs(count: int, seed: int, *, listed: bool) -> None:
    programs = {"camcal": of_camcal, "OpenCV": of_opencv}
    results = {name: {kind: Counter() for kind in KINDS} for name in programs}
    kept, taken = [], []
    for number, rig in enumerate(random_rigs(count, seed)):
        for name, program in programs.items():
            started = time.process_time()
            outcome, verdict = program(rig, number)
            if name == "camcal":
                taken.append(time.process_time() - started)
                kept += [verdict.kept] if verdict else []
            results[name][rig.kind][outcome] += 1
            if listed and name == "camcal" and outcome != "right":
                fields = [round(np.degrees(2 * lens.half_field / 1.04)) for lens in rig.lenses]
                print(number, rig.kind, fields, outcome, verdict and round(verdict.kept, 3), flush=True)
    for name, kinds in results.items():
        print(f"\n| {name} | n | {' | '.join(COLUMNS)} |")
        print("|---" * (len(COLUMNS) + 2) + "|")
        for kind, counts in kinds.items():
            print(f"| {kind} | {counts.total()} | {' | '.join(str(counts[each]) for each in COLUMNS)} |")
        others = sum((counts for counts in kinds.values()), Counter())
        print("others:", {key: value for key, value in others.items() if key not in COLUMNS})
    print(
        f"\ncamcal: median kept {np.median(kept):.3f}, 1 % {np.quantile(kept, 0.01):.3f}; "
        f"{1e3 * statistics.median(taken):.0f} ms of processor per pair, with the judge"
    )


def of_camcal(rig: RandomRig, seed: int) -> tuple[str, RigVerdict | None]:
    names = ("first", "second")
    cameras = {name: camera_of(lens) for name, lens in zip(names, rig.lenses, strict=True)}
    circles = {name: circle_of(lens) for name, lens in zip(names, rig.lenses, strict=True)}
    try:
        plan = plan_rectification(cameras, Pose(rig.rotation, rig.translation), circles=circles)
    except CamcalError:
        return "refused", None
    verdict = judge(rig, rectified(plan, names), seed)
    said = any(warning.code == "field_not_kept" for warning in plan.warnings)
    return _outcome(verdict, said=said), verdict


def _outcome(verdict: RigVerdict, *, said: bool = False) -> str:
    if verdict.is_right:
        return "right"
    if verdict.problems:
        return verdict.problems[0]
    return "reason said" if said else "kept < 85 %"


def camera_of(lens: Lens) -> Camera:
    return Camera(model_named(lens.model), lens.size, np.array([*lens.core, *lens.coefficients]))


def circle_of(lens: Lens) -> ImageCircle | None:
    return None if lens.circle_radius is None else ImageCircle(lens.size, lens.core[2:], lens.circle_radius)


def rectified(plan: Rectification, names: tuple[str, str]) -> Rectified:
    """Return a plan as the judge takes it, by the formulas of its documentation."""
    along = "xy".index(plan.axis)
    sides = {
        plan.left: (plan.rect_R_left, plan.left_centre),
        plan.right: (plan.rect_R_right, plan.right_centre),
    }

    def image(name: str) -> Image:
        rotation, centre = sides[name]

        def pixels(points):
            length, across, forward = points[:, along], points[:, 1 - along], points[:, 2]
            rho, angle = np.hypot(across, forward), np.arctan2(across, forward)
            if plan.projection == "pinhole":
                front = np.where(forward > 0, forward, np.nan)
                place = length / front, across / front
            else:
                place = (length / rho if plan.projection == "cylindrical" else np.arctan2(length, rho)), angle
            return plan.focal * np.column_stack(place[:: -1 if along else 1]) + centre

        def rays(where):
            place = (where - centre) / plan.focal
            length, across = place[:, along], place[:, 1 - along]
            found = np.empty((len(where), 3))
            if plan.projection == "pinhole":
                found[:, along], found[:, 1 - along], found[:, 2] = length, across, 1
                return found
            off = np.arctan(length) if plan.projection == "cylindrical" else length
            found[:, along] = np.sin(off)
            found[:, 1 - along], found[:, 2] = np.cos(off) * np.sin(across), np.cos(off) * np.cos(across)
            return found

        return Image(plan.size, rotation, pixels, rays)

    return Rectified((image(names[0]), image(names[1])), (plan.focal,), along)


def of_opencv(rig: RandomRig, seed: int) -> tuple[str, RigVerdict | None]:
    kinds = {lens.model for lens in rig.lenses}
    if len(kinds) > 1 or rig.lenses[0].size != rig.lenses[1].size:
        return "not supported", None
    tries = _fisheye(rig) if FISHEYE in kinds else _pinhole(rig)
    found = [(judge(rig, each, seed)) for each in tries]
    best = max(found, key=lambda verdict: (verdict.is_right, not verdict.problems, verdict.kept))
    return _outcome(best), best


def _pinhole(rig: RandomRig) -> list[Rectified]:
    first, second = rig.lenses
    found = []
    for alpha in (1, -1):
        r1, r2, p1, p2, *_ = cv2.stereoRectify(
            first.matrix, np.array(first.coefficients), second.matrix, np.array(second.coefficients), first.size,
            rig.rotation, rig.translation[:, None], alpha=alpha,
        )  # fmt: skip
        found.append(_of_projections(first.size, (r1, r2), (p1, p2)))
    return found


def _fisheye(rig: RandomRig) -> list[Rectified]:
    first, second = rig.lenses
    found = []
    for balance in (1, 0):
        r1, r2, p1, p2, *_ = cv2.fisheye.stereoRectify(
            first.matrix, np.array(first.coefficients), second.matrix, np.array(second.coefficients), first.size,
            rig.rotation, rig.translation[:, None], flags=1024, balance=balance,
        )  # fmt: skip
        found.append(_of_projections(first.size, (r1, r2), (p1, p2)))
    return found


def _of_projections(size, rotations, projections) -> Rectified:
    images = tuple(_pinhole_image(size, *each) for each in zip(rotations, projections, strict=True))
    focals = tuple(float(matrix[axis, axis]) for matrix in projections for axis in (0, 1))
    return Rectified(images, focals, int(projections[1][1, 3] != 0))


def _pinhole_image(size, rotation, projection) -> Image:
    matrix = projection[:, :3]

    def pixels(points):
        front = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        return (points @ matrix.T)[:, :2] / front[:, None]

    def rays(where):
        return np.column_stack([where, np.ones(len(where))]) @ np.linalg.inv(matrix).T

    return Image(size, rotation, pixels, rays)


if __name__ == "__main__":
    main()
