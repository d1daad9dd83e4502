"""Five folds of the real rigs: epipolar error of held-out captures by camcal and by OpenCV, on the same corners.

Every fifth capture is held out in turn; each program calibrates the rig from the others. The table has the RMS of the
epipolar errors (see real_rigs.py) of camcal's corners of the held-out captures, px, over all folds and all pairs of
cameras; the errors count up to 3 px each, so that a wrong corner does not decide.
camcal: lenses, poses and board shape jointly. fixed: with lenses held that each camera's own views give. flat: joint,
    the board as drawn.
cv2: cv2.stereoCalibrate (cv2.fisheye.stereoCalibrate) from camcal's corners, joint as well, the board as drawn; each
    pair of three cameras by itself.
own corners, SB: all of OpenCV, from the corners of findChessboardCorners and cornerSubPix, or of
    findChessboardCornersSB.
/cv2, /own, /SB: camcal's error over these. The geometric means are over the rigs whose cameras exposed together; the
    pairs of the trinocular rig count as its rows say, the rig of three by itself.
moved: what camcal says of the board's motion between the exposures, all captures together, mm.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/rig_sets.py [--rigs NAME …] [--programs NAME …] [--cache FOLDER]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from real_rigs import CACHE, CAMCAL, OPENCV, OPENCV_SB, RIGS, Rig, aligned, captures_of, epipolar_errors
from rig_programs import FLAT, as_rig, camcal_rig, fixed_lenses, opencv_rigs

from camcal.calibrate.rigs.record import Captures
from camcal.cameras.lens import CameraModel
from camcal.errors import CamcalError
from camcal.targets.board import Board

FOLDS = 5
CLIP = 3.0  # px
Program = Callable[[Captures, Board, CameraModel], list[Rig]]


def _camcal(captures: Captures, board: Board, model: CameraModel, **others: object) -> list[Rig]:
    return [as_rig(camcal_rig(captures, board, model, **others))]


def _fixed(captures: Captures, board: Board, model: CameraModel) -> list[Rig]:
    return [as_rig(fixed_lenses(captures, board, model))]


def _opencv(captures: Captures, board: Board, model: CameraModel) -> list[Rig]:
    return opencv_rigs(aligned(captures, board), board, model)


PROGRAMS: dict[str, tuple[str, Program]] = {
    "camcal": (CAMCAL, _camcal),
    "fixed": (CAMCAL, _fixed),
    "flat": (CAMCAL, partial(_camcal, shape=FLAT)),
    "cv2": (CAMCAL, _opencv),
    "own corners": (OPENCV, _opencv),
    "SB": (OPENCV_SB, _opencv),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS), metavar="NAME")
    parser.add_argument("--programs", nargs="+", choices=PROGRAMS, default=list(PROGRAMS), metavar="NAME")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder that keeps the corners")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    print(
        f"{'rig':15} {'captures':>8}  "
        + " ".join(f"{name:>11}" for name in arguments.programs)
        + "   /cv2   /own    /SB"
    )
    rows = {name: row(name, arguments.programs, arguments.cache) for name in arguments.rigs}
    for over in ("cv2", "own corners", "SB"):
        ratios = [
            own["camcal"] / own[over]
            for name, own in rows.items()
            if {"camcal", over} <= set(own) and RIGS[name].simultaneous
        ]
        if ratios:
            mean, shown = np.exp(np.nanmean(np.log(ratios))), " ".join(f"{ratio:.3f}" for ratio in ratios)
            print(f"simultaneous rigs, camcal over {over}: geometric mean {mean:.3f} ({shown})")


def row(name: str, programs: list[str], cache: Path) -> dict[str, float]:
    """Print and return the errors of a rig by programs."""
    rig = RIGS[name]
    truth = captures_of(name, CAMCAL, cache)
    errors = {program: fold_error(name, *PROGRAMS[program], cache) for program in programs}
    figures = [errors.get("camcal", np.nan) / errors.get(other, np.nan) for other in ("cv2", "own corners", "SB")]
    print(
        f"{name:15} {sum(sum(v is not None for v in own) > 1 for own in truth.views):8d}  "
        + " ".join(f"{errors[program]:11.4f}" for program in programs)
        + " "
        + " ".join(f"{figure:6.3f}" for figure in figures)
        + ("" if rig.simultaneous else "  not simultaneous"),
        flush=True,
    )
    return errors


def fold_error(name: str, corners: str, program: Program, cache: Path) -> float:
    """Return the RMS of the epipolar errors of held-out captures, px; NaN where a fold was not calibrated."""
    rig, test = RIGS[name], aligned(captures_of(name, CAMCAL, cache), RIGS[name].target)
    own = captures_of(name, corners, cache)
    squares = []
    for fold in range(FOLDS):
        held_out = [index for index, _ in enumerate(test.names) if index % FOLDS == fold]
        names = {test.names[index] for index in held_out}
        train = own.take([index for index, capture in enumerate(own.names) if capture not in names])
        try:
            found = program(train, rig.target, rig.lens)
        except (CamcalError, cv2.error) as error:
            print(f"# {name}, fold {fold}: {str(error).splitlines()[0][:150]}", file=sys.stderr)
            return np.nan
        errors = [epipolar_errors(each, test.take(held_out)) for each in found]
        squares += [np.minimum(np.abs(each), CLIP) ** 2 for pairs in errors for each in pairs.values()]
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


if __name__ == "__main__":
    main()
