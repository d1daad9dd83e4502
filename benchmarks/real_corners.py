"""Real chessboard sets calibrated from camcal's corners and OpenCV's, on the images in which all of them found it.

Every row: images found by camcal, by findChessboardCornersSB and by its EXHAUSTIVE | ACCURACY form, of how many; RMS
of camcal's own calibration (one lens model, smooth board shape, corners alike) from camcal's corners, SB's, SB
accurate's, and those of cornerSubPix (half-window 5 px, from SB's); for the same four, the RMS by which calibrations
from odd and from even images differ within the radius that corners reach (a rotation of the camera taken out). px; -
where a half does not hold a calibration.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/real_corners.py [--sets NAME …] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from peers.opencv_corners import SECTOR_BASED, refined, sector_based
from projection_error import rms_inside_and_outside
from real_sets import DATA, SETS

from camcal import opencv
from camcal.arrays import Array
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.errors import CamcalError
from camcal.images.files import gray_8bit, load
from camcal.run.fanout import fan_out
from camcal.run.paths import find_images
from camcal.targets.board import Board, parse_board
from camcal.targets.detect import detect
from camcal.targets.detection import BoardDetection

WAYS = ("camcal", *SECTOR_BASED, "cornerSubPix")
HALF_WINDOW = 5
WIDE = ("fisheye",)
NEAREST = 0.5  # of a step, by which the same corner may differ between two ways


@dataclass(frozen=True, eq=False)
class ImageDetections:
    """The corners of an image in every way that found them, numbered as camcal numbers them; which ways found it."""

    views: Mapping[str, BoardDetection]
    found: frozenset[str]


def main() -> None:
    """Print a row for every set."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--sets", nargs="*", default=[name for name, (_, board) in SETS.items() if "chess" in board])
    parser.add_argument("--jobs", type=int, default=None)
    options = parser.parse_args()
    print("| set | found: camcal / SB / SB accurate of | RMS: " + " / ".join(WAYS) + " | halves differ: the same |")
    print("|---|---|---|---|")
    for name in options.sets:
        print(row(name, options.jobs), flush=True)


def row(name: str, jobs: int | None) -> str:
    """Return the row of a set."""
    pattern, text = SETS[name]
    board, images = parse_board(text), find_images([DATA / pattern])
    outcomes = fan_out(partial(look, board=board), images, jobs=jobs, processes=True)
    seen = [outcome.value for outcome in outcomes if outcome.value is not None]
    counts = " / ".join(str(sum(way in item.found for item in seen)) for way in WAYS[:3])
    common = [item for item in seen if set(WAYS) <= item.views.keys()]
    model = "kannala_brandt4" if pattern.startswith(WIDE) else "opencv5"
    rms, halves = [], []
    for way in WAYS:
        views = [item.views[way] for item in common]
        whole = solved(views, board, model)
        rms.append("-" if whole is None else f"{whole.rms_px:.3f}")
        halves.append(difference(solved(views[::2], board, model), solved(views[1::2], board, model)))
    return f"| {name} | {counts} of {len(images)} | {' / '.join(rms)} | {' / '.join(halves)} |"


def look(path: Path, board: Board) -> ImageDetections:
    """Return what an image shows in every way."""
    gray = gray_8bit(load(path).pixels)
    detection = detect(gray, board)
    starts: dict[str, Array] = {}
    with opencv.repeatable(0):
        for way, flags in SECTOR_BASED.items():
            corners = sector_based(gray, board, flags)
            if corners is not None:
                starts[way] = corners
        if "SB" in starts:
            starts["cornerSubPix"] = refined(gray, starts["SB"], HALF_WINDOW)
    found = frozenset(starts) | ({"camcal"} if detection.found else frozenset())
    if not detection.found:
        return ImageDetections({}, found)
    shape = (gray.shape[1], gray.shape[0])
    views = {"camcal": BoardDetection(path.name, shape, detection.ids, detection.pixels)}
    for way, pixels in starts.items():
        ids, places = matched(detection.ids, detection.pixels, pixels)
        views[way] = BoardDetection(path.name, shape, ids, places)
    common = set.intersection(*(set(view.ids.tolist()) for view in views.values()))
    return ImageDetections({way: only(view, common) for way, view in views.items()}, found)


def matched(ids: Array, known: Array, pixels: Array) -> tuple[Array, Array]:
    """Return pixels (M, 2) with the ids (M,) of the known corners (N, 2) that they lie at."""
    away = np.linalg.norm(pixels[None] - known[:, None], axis=2)
    step = np.sort(np.linalg.norm(known[None] - known[:, None], axis=2), axis=1)[:, 1].min()
    nearest = away.argmin(axis=1)
    near = away.min(axis=1) < NEAREST * step
    return ids[near], pixels[nearest[near]]


def only(view: BoardDetection, ids: set[int]) -> BoardDetection:
    """Return a view with some of its corners."""
    kept = np.isin(view.ids, list(ids))
    return BoardDetection(view.image, view.size, view.ids[kept], view.pixels[kept])


def solved(views: Sequence[BoardDetection], board: Board, model: str) -> Calibration | None:
    """Return the calibration from views, None if they do not hold one."""
    how = Options(model_named(model), shape=ShapeOptions(offsets=False), max_rejected=1.0)
    try:
        return calibrate(views, board, how)
    except CamcalError:
        return None


def difference(one: Calibration | None, other: Calibration | None) -> str:
    """Return the RMS distance of two calibrations over the part of the image that holds corners."""
    if one is None or other is None:
        return "-"
    seen = np.concatenate([one.pixels, other.pixels])
    return f"{rms_inside_and_outside(one.camera, other.camera, seen)[1]:.2f}"


if __name__ == "__main__":
    main()
