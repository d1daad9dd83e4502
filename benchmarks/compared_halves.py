"""Verdicts on pairs of calibrations of real sets: halves of one set are one camera, left and right sets are two.

The views of a set are divided at random into two halves, --splits times, and both are calibrated as in split_halves.py.
same, apart, unknown: what the comparison of the two says (`camcal.quality.camera_comparison`; apart: another camera or
a lens that moved). sigmas: median over the splits of the difference in standard deviations (wanted: 1). Of two sets of
a stereo pair: the verdict on the calibrations of all views, and on halves of the one and of the other. Tables that are
missing are made from the images.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/compared_halves.py --detections FOLDER [--splits 6] [--sets NAME …]
"""

import argparse
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
from split_halves import ALL_SETS, FAILURES, MODELS, divisions, make_table, numbered, read_views

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.quality.assess import assess
from camcal.quality.camera_comparison import SAME, UNKNOWN, Calibrated, compare

SETS = (
    *("boofcv-sony", "bumblebee left", "bumblebee right", "chessboard-video", "lifecam charuco", "opencv left"),
    *("opencv right", "sourishg 1 left", "sourishg 1 right", "sourishg 2 left", "sourishg 2 right", "sourishg fish l"),
    *("sourishg fish r", "tumvi", "visp hand-eye"),
)
PAIRS = tuple((name, name.replace("left", "right").replace("fish l", "fish r")) for name in SETS)


def calibrated(name, views, board):
    """Return what a camera file says of a calibration of views, None where it failed."""
    try:
        found = calibrate(views, board, Options(model_named(MODELS[name]), max_rejected=1.0))
    except FAILURES:
        return None
    return Calibrated(name, found.camera, assess(found).region.polygon, views=sum(view.used for view in found.views))


def calibrations(folder, name, splits):
    """Return the calibration of all views of a set, and pairs of those of halves."""
    make_table(folder, name)
    board, views = read_views(folder, name)
    whole = calibrate(views, board, Options(model_named(MODELS[name]), max_rejected=1.0))
    views = numbered(board, views, [view.symmetry for view in whole.views])
    halves = [[calibrated(name, half, board) for half in halves] for halves in divisions(views, splits)]
    return calibrated(name, views, board), halves


def counts(pairs):
    """Return how many pairs are the same camera, told apart, not compared or failed, and the median of sigmas."""
    found = [compare(*pair) for pair in pairs if None not in pair]
    verdicts = Counter(each.verdict for each in found)
    same, unknown = verdicts[SAME], verdicts[UNKNOWN]
    sigmas = [each.total.sigmas for each in found if each.total is not None]
    return same, len(found) - same - unknown, unknown, len(pairs) - len(found), np.median(sigmas)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detections", type=Path, required=True, help="folder of detection tables")
    parser.add_argument("--sets", nargs="+", choices=ALL_SETS, default=list(SETS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=6)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    made = {name: calibrations(arguments.detections, name, arguments.splits) for name in arguments.sets}
    print("| halves of | same | apart | unknown | failed | sigmas |\n|---|---|---|---|---|---|")
    every = [pair for _, halves in made.values() for pair in halves]
    for name, pairs in [*((name, halves) for name, (_, halves) in made.items()), ("all", every)]:
        print(f"| {name} | {' | '.join(map(str, counts(pairs)[:-1]))} | {counts(pairs)[-1]:.2f} |")
    print("\n| two cameras | all views | sigmas | halves: same | apart | unknown |\n|---|---|---|---|---|---|")
    for first, second in PAIRS:
        if first == second or first not in made or second not in made:
            continue
        found = compare(made[first][0], made[second][0])
        flat = ([half for pair in made[name][1] for half in pair] for name in (first, second))
        halves = list(zip(*flat, strict=True))
        same, apart, unknown, *_ = counts(halves)
        print(f"| {first}, {second} | {found.verdict} | {found.total.sigmas:.1f} | {same} | {apart} | {unknown} |")


if __name__ == "__main__":
    main()
