"""Checks of calibrations by new images: false alarms, drifts that are found, other cameras, and mounts.

real: the views of a set are divided at random, --splits times; one half is calibrated and checked by 1, 3 and all views
of the other half: as it is (same), with the focal lengths of the file larger by three standard deviations (at least
0.5 %) and the principal point moved by 3 px (moved), and by views of the other camera of the pair where there is one
(other). What counts is the verdict "drifted".

simulated: cameras and boards of tests/rig_scenes.py, which projects with OpenCV. Calibrations of 10, 20 and 40 views,
checked by 1, 3 and 10 new ones: still (false alarms), and with the smallest drift of the focal length that the check
has stated for such views (found; wanted 0.85 to 0.97). Then pairs of cameras.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/checked_cameras.py --detections FOLDER [--splits 8] [--sets NAME …]
    python benchmarks/checked_cameras.py --simulated [--seeds 12]
"""

import argparse
import sys
import time
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from split_halves import ALL_SETS, FAILURES, MODELS, divisions, make_table, numbered, read_views

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from rig_scenes import Errors, Lens, SimulatedRig, Transform, observed, scene

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.known_cameras import KnownBoard
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import RigOptions
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import direction_displacements
from camcal.quality.assess import assess
from camcal.quality.camera_check import DRIFTED, CheckedCamera, check_lens, check_place
from camcal.targets.board import Board

SETS = tuple(name for name in ALL_SETS if name in MODELS)
COUNTS = (1, 3, None)


def calibrated(views, board, model):
    """Return what a check takes from the calibration of views, None where that failed."""
    try:
        found = calibrate(views, board, Options(model, max_rejected=1.0))
    except FAILURES:
        return None
    region = assess(found).region.polygon
    used = sum(view.used for view in found.views)
    return CheckedCamera(found.camera, found.sigma_px, region, used), KnownBoard(found.surface, used)


def moved(own):
    """Return a camera whose file is wrong: focal lengths by three standard deviations, the principal point by 3 px."""
    camera = own.camera
    parameters = camera.parameters.copy()
    for place, name in enumerate(camera.model.parameter_names):
        if name in ("fx", "fy"):
            parameters[place] *= 1 + max(3 * (camera.std(name) or 0) / parameters[place], 0.005)
        if name == "cx":
            parameters[place] += 3
    return replace(own, camera=replace(camera, parameters=parameters))


def partner(name):
    """Return the set of the other camera of a stereo pair, None where there is none."""
    for here, there in (("left", "right"), ("right", "left"), ("fish l", "fish r"), ("fish r", "fish l")):
        if name.endswith(here):
            other = name.removesuffix(here) + there
            return other if other in SETS else None
    return None


def some(views, count, rng):
    chosen = rng.choice(len(views), min(count or len(views), len(views)), replace=False)
    return [views[index] for index in chosen]


def real(folder, names, splits):
    """Print the shares of drifted by set and in all, and what a check costs."""
    total, costs = defaultdict(list), []
    print("| drifted, % | same: 1 | 3 | all | moved: 1 | 3 | all | other: 1 | 3 | all | divisions |")
    print("|" + "---|" * 11)
    for name in names:
        found = defaultdict(list)
        make_table(folder, name)
        board, views = read_views(folder, name)
        model = model_named(MODELS[name])
        try:
            whole = calibrate(views, board, Options(model, max_rejected=1.0))
        except FAILURES:
            continue
        views = numbered(board, views, [view.symmetry for view in whole.views])
        rng, others = np.random.default_rng(5), []
        if partner(name) is not None:
            make_table(folder, partner(name))
            others = [view for view in read_views(folder, partner(name))[1] if len(view.ids) >= 4]
        for first, second in divisions(views, splits):
            made = calibrated(first, board, model)
            if made is None:
                continue
            own, shape = made
            cases = {"same": (own, second), "moved": (moved(own), second), "other": (own, others)}
            for count in COUNTS:
                for case, (camera, new) in cases.items():
                    if not new:
                        continue
                    start = time.process_time()
                    verdict = check_lens(camera, some(new, count, rng), shape).verdict
                    costs.append(time.process_time() - start)
                    found[case, count].append(verdict)
                    total[case, count].append(verdict)
        print_row(name, found)
    print_row("all", total)
    same = [verdict for (case, _), own in total.items() if case == "same" for verdict in own]
    share = np.mean([each == DRIFTED for each in same])
    print(f"\nDrifted of {len(same)} checks of the same camera: {100 * share:.1f} %.")
    for (case, count), own in total.items():
        if count is None:
            print(f"All images, {case}: {', '.join(f'{words} {number}' for words, number in Counter(own).items())}.")
    print(f"CPU of a check: median {np.median(costs):.2f} s, largest {max(costs):.2f} s")


def print_row(name, found):
    """Print the share of drifted for every case and number of images, in percent."""
    cells = []
    for case in ("same", "moved", "other"):
        for count in COUNTS:
            own = found[case, count]
            cells.append(f"{100 * np.mean([each == DRIFTED for each in own]):.0f}" if own else "")
    print(f"| {name} | {' | '.join(cells)} | {len(found['same', 1])} |", flush=True)


LENSES = {
    "pinhole": [900.0, 902.0, 642.0, 477.0, 0, 0, 0, 0, 0],
    "opencv5": [900.0, 902.0, 642.0, 477.0, -0.12, 0.06, 5e-4, -3e-4, 0.01],
    "opencv8": [900.0, 902.0, 642.0, 477.0, -0.12, 0.06, 5e-4, -3e-4, 0.01],
    "kannala_brandt4": [420.0, 421.0, 642.0, 477.0, 0.02, -0.01, 0.004, -0.001],
}
BOARD = Board("chessboard", 9, 6, 0.03)
APART = Transform.of([0.01, -0.03, 0.005], [-0.12, 0.002, 0.004])


def rig_of(model, focal=1.0, place=APART):
    """Return a pair of cameras of a model, the focal length of the first one times `focal`."""
    kind = "kannala_brandt4" if model == "kannala_brandt4" else "opencv5"
    reach = np.radians(75 if kind == "kannala_brandt4" else 50)
    first, second = np.array(LENSES[model], float), np.array(LENSES[model], float)
    first[:2] *= focal
    second[2:4] += (4, -6)
    lenses = [Lens(kind, (1280, 960), values, reach) for values in (first, second)]
    return SimulatedRig(tuple(lenses), (Transform(np.eye(3), np.zeros(3)), place), BOARD)


def captured(rig, count, seed, noise):
    return observed(scene(rig, count, seed), Errors(noise), seed)


def seen(rig, count, seed, noise):
    """Return views of the first camera, some of which show a part of the board."""
    one = replace(rig, lenses=rig.lenses[:1], poses=rig.poses[:1])
    return [view for view in captured(one, count, seed, noise).of(0) if view is not None]


def simulated(seeds):
    """Print the shares of drifted by model, noise, views of the calibration and new images."""
    print("| model | noise, px | views | new images | drifted, % | stated drift found, % | that is, px |")
    print("|" + "---|" * 7)
    for model in LENSES:
        for noise in (0.05, 0.3):
            for views in (10, 20, 40):
                rows = defaultdict(list)
                for seed in range(seeds):
                    made = calibrated(seen(rig_of(model), views, 100 + seed, noise), BOARD, model_named(model))
                    if made is None:
                        continue
                    own, shape = made
                    for new in (1, 3, 10):
                        still = check_lens(own, seen(rig_of(model), new, 1000 + seed, noise), shape)
                        if still.drift is None:
                            continue
                        share = smallest(own, still.drift)
                        other = seen(rig_of(model, 1 + share), new, 1000 + seed, noise)
                        found = check_lens(own, other, shape, 0.0).drift
                        rows[new].append((still.verdict == DRIFTED, found.chance < 1e-3, still.drift.smallest_px))
                for new, own in rows.items():
                    alarms, power, px = np.array(own, float).T
                    cells = model, noise, views, new, f"{100 * alarms.mean():.0f}", f"{100 * power.mean():.0f}"
                    print(f"| {' | '.join(map(str, cells))} | {np.median(px):.2f} |", flush=True)


def smallest(own, drift):
    """Return the relative change of the focal length that moves projections by as much as is stated."""
    by_focal = direction_displacements(own.camera, drift.pixels[drift.inside])[:, :, :2] @ own.camera.parameters[:2]
    return drift.smallest_px / float(np.sqrt(np.nanmean(np.sum(by_focal**2, axis=1))))


def mounts(seeds):
    """Print the verdicts on a pair that stands as it did, and on one of which a camera was turned or the board is not
    as long as stated.
    """
    turned = Transform(cv2.Rodrigues(np.array([0, np.radians(0.3), 0]))[0] @ APART.rotation, APART.translation)
    wider = Transform(APART.rotation, 1.03 * APART.translation)
    print("\n| pair, 6 new captures | noise, px | verdicts |")
    print("|" + "---|" * 3)
    for noise in (0.05, 0.3):
        for words, rig in (
            ("as it was", rig_of("opencv5")),
            ("turned by 0.3°", rig_of("opencv5", place=turned)),
            ("3 % wider", rig_of("opencv5", place=wider)),
        ):
            counts = Counter()
            for seed in range(seeds):
                counts[one_mount(rig, seed, noise)] += 1
            said = ", ".join(f"{verdict} {number}" for verdict, number in counts.items())
            print(f"| {words} | {noise:g} | {said} |", flush=True)


def one_mount(rig, seed, noise):
    found = calibrate_rig(captured(rig_of("opencv5"), 20, 300 + seed, noise), BOARD, RigOptions(MODELS_OF_PAIR))
    names = list(found.calibrations)
    pair = [CheckedCamera(each.camera, each.sigma_px, np.zeros((0, 2)), 20) for each in found.calibrations.values()]
    captures = captured(rig, 12, 2000 + seed, noise)
    rows = [row for row in captures.views if None not in row and all(len(view.ids) >= 20 for view in row)][:6]
    shape = KnownBoard(found.calibrations[names[0]].surface, 20)
    result = check_place(tuple(pair), rows, list(found.poses.values())[1], found.covariance, shape)
    return f"{result.verdict} {result.cause}".strip()


MODELS_OF_PAIR = dict.fromkeys(("left", "right"), model_named("opencv5"))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--detections", type=Path)
    parser.add_argument("--sets", nargs="*", default=SETS)
    parser.add_argument("--splits", type=int, default=8)
    parser.add_argument("--simulated", action="store_true")
    parser.add_argument("--seeds", type=int, default=12)
    arguments = parser.parse_args()
    if arguments.simulated:
        simulated(arguments.seeds)
        mounts(arguments.seeds)
    else:
        arguments.detections.mkdir(parents=True, exist_ok=True)
        real(arguments.detections, arguments.sets, arguments.splits)


if __name__ == "__main__":
    main()
