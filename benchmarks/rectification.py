"""Rectification of random pairs beside cv2.stereoRectify, rows of rendered pairs, and the rate of remapping.

rigs: pairs have lenses of 5° to 200°; the judge is in rectified_rigs.py and shares no formula with camcal. A pair is
right if its images are neither empty, turned nor mirrored and hold 85 % of the points that both cameras see at several
distances. OpenCV is called with alpha = 1 and with its default (of fisheye: balance 1 and 0), and the better result
counts.
orientations: pairs with any roll and baseline. Said: that less than 85 % is kept, that axes meet or pass each other
next to the cameras, or that images are rotated.
rows: both images are rendered by formulas of their own (a solid texture on a tilted plane, or on a sphere around the
cameras), rectified, and matched in two dimensions by OpenCV's optical flow.
speed: 12 MP colour images through the maps of a pair, and through cv2.remap with the same maps.

    python benchmarks/rectification.py [rigs] [--rigs 2000] [--seed 1]
    python benchmarks/rectification.py orientations [--rigs 450] [--seed 1 2 3]
    python benchmarks/rectification.py rows [--folder FOLDER]
    python benchmarks/rectification.py speed [--repeats 15]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
from rectified_rigs import (
    BROWN,
    FISHEYE,
    KEPT,
    KINDS,
    ORIENTATIONS,
    Image,
    Lens,
    RandomRig,
    Rectified,
    RigVerdict,
    judge,
    median_turn,
    random_rigs,
    rigs_of_any_orientation,
)

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError
from camcal.geometry.pose import Pose
from camcal.images.image import Scratch
from camcal.stereo.rectify.plan import build_pair_maps, plan_rectification
from camcal.stereo.rectify.record import Rectification

COLUMNS = ("right", "refused", "reason said", "kept < 85 %", "empty", "turned", "mirrored", "negative focal length")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", choices=("rigs", "orientations", "rows", "speed"), default="rigs")
    parser.add_argument("--rigs", type=int, default=2000)
    parser.add_argument("--seed", type=int, nargs="+", default=[1])
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--folder", type=Path, help="where rows writes its pairs")
    parser.add_argument("--list", action="store_true", help="print every pair that is not right")
    arguments = parser.parse_args()
    if arguments.table == "rigs":
        print_rigs(arguments.rigs, arguments.seed[0], listed=arguments.list)
    elif arguments.table == "orientations":
        print_orientations(arguments.rigs, arguments.seed)
    elif arguments.table == "rows":
        print_rows(arguments.folder)
    else:
        print_speed(arguments.repeats)


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


def print_orientations(count: int, seeds: list[int]) -> None:
    columns = ("whole", "refused", "part lost, said", "part lost, not said", "turned > 60°", "of them said", "other")
    results = {kind: Counter() for kind in ORIENTATIONS}
    for number, rig in enumerate(each for seed in seeds for each in rigs_of_any_orientation(count, seed)):
        plan = plan_of(rig)
        if plan is None:
            results[rig.kind]["refused"] += 1
            continue
        found = rectified(plan, NAMES)
        verdict, said = judge(rig, found, number), {warning.code for warning in plan.warnings}
        if verdict.is_right:
            outcome = "whole"
        elif verdict.problems and verdict.problems != ("turned",):
            outcome = "other"
        else:
            warned = said & {"field_not_kept", "converging_cameras"}
            outcome = "whole" if verdict.kept >= KEPT else f"part lost, {'said' if warned else 'not said'}"
        results[rig.kind][outcome] += 1
        if max(median_turn(*each) for each in zip(rig.lenses, found.images, strict=True)) > 60:
            results[rig.kind]["turned > 60°"] += 1
            results[rig.kind]["of them said"] += "rotated_images" in said
        if outcome in ("other", "part lost, not said"):
            print(number, rig.kind, outcome, verdict.problems, round(verdict.kept, 3), sorted(said), flush=True)
    print(f"| {count * len(seeds) // len(ORIENTATIONS)} pairs each | {' | '.join(columns)} |")
    print("|---" * (len(columns) + 1) + "|")
    for kind, counts in results.items():
        print(f"| {kind} | {' | '.join(str(counts[each]) for each in columns)} |")


NAMES = ("first", "second")


def plan_of(rig: RandomRig) -> Rectification | None:
    """Return how camcal rectifies a rig, None where it refuses to."""
    cameras = {name: camera_of(lens) for name, lens in zip(NAMES, rig.lenses, strict=True)}
    circles = {name: circle_of(lens) for name, lens in zip(NAMES, rig.lenses, strict=True)}
    try:
        return plan_rectification(cameras, Pose(rig.rotation, rig.translation), circles=circles)
    except CamcalError:
        return None


def of_camcal(rig: RandomRig, seed: int) -> tuple[str, RigVerdict | None]:
    plan = plan_of(rig)
    if plan is None:
        return "refused", None
    verdict = judge(rig, rectified(plan, NAMES), seed)
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


def print_rows(folder: Path | None) -> None:
    """Print by how much rows (columns) of rectified rendered pairs differ."""
    size = (960, 720)
    narrow = Lens(BROWN, size, (800.0, 801.0, 476.0, 362.0), (-0.15, 0.03, 5e-4, -3e-4, 0.0), np.radians(40))
    other = Lens(BROWN, size, (806.0, 806.0, 484.0, 357.0), (-0.14, 0.02, -3e-4, 4e-4, 0.0), np.radians(40))
    wide = Lens(FISHEYE, size, (560.0, 560.0, 478.0, 361.0), (-0.02, 0.002, 0.0, 0.0), np.radians(62))
    fish = Lens(FISHEYE, size, (300.0, 300.0, 481.0, 358.0), (-0.01, 0.001, 0.0, 0.0), np.radians(110))
    turn = cv2.Rodrigues(np.radians([1.0, 2.0, -1.5]))[0]
    toed = cv2.Rodrigues(np.radians([0.5, 12.0, 1.0]))[0]
    beside, above = np.array([-0.12, 0.003, 0.004]), np.array([0.002, -0.12, 0.003])
    pairs = {
        "pinhole, 65°": (RandomRig("", (narrow, other), turn, turn @ beside), PLANE),
        "pinhole, above each other": (RandomRig("", (narrow, other), turn, turn @ above), PLANE),
        "pinhole, toed-in by 12°": (RandomRig("", (narrow, other), toed, toed @ np.array([-0.25, 0.0, -0.03])), PLANE),
        "fisheye, 120°": (RandomRig("", (wide, wide), turn, turn @ beside), SPHERE),
        "fisheye, 180°": (RandomRig("", (fish, fish), turn, turn @ beside), SPHERE),
        "fisheye, 180°, above each other": (RandomRig("", (fish, fish), turn, turn @ above), SPHERE),
        "fisheye 180° beside pinhole 65°": (RandomRig("", (fish, narrow), turn, turn @ beside), SPHERE),
    }
    print("| pair | projection | size | points | median | RMS | largest median of 4 x 4 parts |")
    print("|---" * 7 + "|")
    for name, (rig, surface) in pairs.items():
        plan, apart, where, images = rows_of(rig, surface)
        cells = (where / np.array(plan.size) * 4).astype(int).clip(0, 3) @ [1, 4]
        medians = [np.median(apart[cells == cell]) for cell in range(16) if (cells == cell).sum() > 20]
        print(
            f"| {name} | {plan.projection} {plan.axis} | {plan.size[0]}x{plan.size[1]} | {len(apart)} | "
            f"{np.median(apart):+.4f} | {np.sqrt(np.mean(apart**2)):.4f} | {max(medians, key=abs):+.4f} |",
            flush=True,
        )
        if folder is not None:
            folder.mkdir(exist_ok=True)
            cv2.imwrite(str(folder / f"{name}.png"), np.concatenate(images, axis=1 - "xy".index(plan.axis)))


PLANE, SPHERE = "plane", "sphere"


def rows_of(rig: RandomRig, surface: str, points: int = 3000):
    """Return a plan, the differences (N,) px across its axis of matched points, where, and the two images."""
    names = ("first", "second")
    cameras = {name: camera_of(lens) for name, lens in zip(names, rig.lenses, strict=True)}
    plan = plan_rectification(cameras, Pose(rig.rotation, rig.translation))
    maps = build_pair_maps(cameras, plan)
    pictures = [rendered(rig, side, surface) for side in (0, 1)]
    images = maps.apply(*pictures[:: -1 if plan.swapped else 1])
    found = rectified(plan, names)
    order = (1, 0) if plan.swapped else (0, 1)
    rng = np.random.default_rng(5)
    pixels = rng.uniform(0.03, 0.97, (points, 2)) * np.array(plan.size)
    poses = [(np.eye(3), np.zeros(3)), (rig.rotation, rig.translation)]
    turn, shift = poses[order[0]]
    rays = found.images[order[0]].rays(pixels) @ found.images[order[0]].rotation
    first = met(-turn.T @ shift, rays @ turn, surface)
    turn, shift = poses[order[1]]
    guess = found.images[order[1]].pixels((first @ turn.T + shift) @ found.images[order[1]].rotation.T)
    valid = [cv2.erode(mask.astype(np.uint8), np.ones((41, 41))) > 0 for mask in maps.valid]
    good = np.isfinite(guess).all(axis=1)
    for mask, where in zip(valid, (pixels, np.where(good[:, None], guess, -1)), strict=True):
        at = np.rint(where).astype(int)
        inside = ((at >= 0) & (at < np.array(plan.size))).all(axis=1)
        good &= inside
        good[inside] &= mask[at[inside, 1], at[inside, 0]]
    start, end = pixels[good].astype(np.float32)[:, None], guess[good].astype(np.float32)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    flow, status, _ = cv2.calcOpticalFlowPyrLK(
        images.left, images.right, start, end.copy(), winSize=(25, 25), maxLevel=0, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    known = (status[:, 0] > 0) & (np.abs(flow - end).max(axis=(1, 2)) < 2)
    across = 1 - "xy".index(plan.axis)
    return plan, (flow - start)[known, 0, across], start[known, 0], images


def rendered(rig: RandomRig, side: int, surface: str) -> np.ndarray:
    """Return the image of a solid texture on a surface, four rays to a pixel."""
    lens = rig.lenses[side]
    turn, shift = (np.eye(3), np.zeros(3)) if side == 0 else (rig.rotation, rig.translation)
    width, height = lens.size
    grid = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.column_stack([axis.ravel() for axis in grid]).astype(float)
    light = 0
    for step in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        light = light + texture(met(-turn.T @ shift, lens.rays(pixels + step) @ turn, surface))
    image = np.clip(128 + 22 * light.reshape(height, width) / 4, 0, 255)
    return np.rint(np.nan_to_num(image)).astype(np.uint8)


def met(centre: np.ndarray, rays: np.ndarray, surface: str) -> np.ndarray:
    """Return where rays (N, 3) from a place meet a tilted plane 1.2 m away, or a sphere of 1.5 m; NaN where nowhere."""
    if surface == PLANE:
        normal = np.array([0.25, -0.15, 1.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (1.2 - normal @ centre) / (rays @ normal)
        return centre + np.where(distance > 0, distance, np.nan)[:, None] * rays
    middle = np.array([0.1, 0.05, 0.2])
    along = rays @ (centre - middle)
    return centre + (np.sqrt(along**2 + 1.5**2 - np.sum((centre - middle) ** 2)) - along)[:, None] * rays


def texture(points: np.ndarray) -> np.ndarray:
    """Return a sum of waves (N,) of 12 mm to 60 mm in all directions of space."""
    rng = np.random.default_rng(9)
    total = np.zeros(len(points))
    for length in np.geomspace(0.02, 0.08, 24):
        direction = rng.standard_normal(3)
        total += np.sin(points @ (direction / np.linalg.norm(direction)) * 2 * np.pi / length + rng.uniform(0, 6.28))
    return total / 2


def print_speed(repeats: int) -> None:
    """Print the rate of remapping a pair beside cv2.remap with the same maps, by all threads and by one."""
    size = (4000, 3000)
    lens = Lens(BROWN, size, (3000.0, 3004.0, 1990.5, 1505.2), (-0.2, 0.06, 1e-4, 2e-4, -0.01), np.radians(50))
    turn = cv2.Rodrigues(np.radians([0.3, 1.0, -0.5]))[0]
    cameras = {"left": camera_of(lens), "right": camera_of(lens)}
    plan = plan_rectification(cameras, Pose(turn, turn @ np.array([-0.12, 0.001, 0.002])))
    maps = build_pair_maps(cameras, plan)
    rng = np.random.default_rng(1)
    picture = cv2.resize(rng.integers(0, 256, (300, 400, 3), np.uint8), size, interpolation=cv2.INTER_CUBIC)
    scratch, target = Scratch(), np.empty((*plan.size[::-1], 3), np.uint8)
    print(
        f"OpenCV {cv2.__version__}; {size[0]}x{size[1]} to {plan.size[0]}x{plan.size[1]}, colour; medians of {repeats}"
    )
    for threads in (cv2.getNumThreads(), 1):
        cv2.setNumThreads(threads)
        works = {
            "cv2.remap": lambda: cv2.remap(picture, maps.left.x, maps.left.y, cv2.INTER_LINEAR, target),
            "camcal": lambda: maps.left.apply(picture, scratch=scratch),
        }
        rounds = []
        for number in range(repeats + 1):
            rounds.append({})
            for name in sorted(works, reverse=bool(number % 2)):
                started = time.perf_counter()
                works[name]()
                rounds[-1][name] = time.perf_counter() - started
        medians = {name: 1e3 * statistics.median(each[name] for each in rounds[1:]) for name in works}
        ratio = statistics.median(each["cv2.remap"] / each["camcal"] for each in rounds[1:])
        print(f"{threads} threads: " + ", ".join(f"{name} {value:.1f} ms" for name, value in medians.items())
              + f"; rate of camcal {ratio:.2f} x")  # fmt: skip


if __name__ == "__main__":
    main()
