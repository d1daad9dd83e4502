"""How far the poses of a camera's own calibration images are from what corner detection and camera file say of them.

Every chessboard and ChArUco set of the real test images is calibrated, and `camcal pnp` finds the poses of the very
same corners. Per row: noise of the calibration and the part of it that is model error (px), the a-posteriori scale with
corner detection alone and with the model error of the camera file (wanted near 1), and the points that are left out.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/own_poses.py [--sets NAME …]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from real_sets import DATA, SETS

from camcal.formats import native
from camcal.formats.poses.record import Poses
from camcal.report import track_words
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.poses.pnp import PnpOptions, pnp


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    print(f"{'set':17}{'noise':>7}{'model':>7}{'detection alone':>17}{'with model':>12}{'left out':>12}")
    for name in arguments.sets:
        with tempfile.TemporaryDirectory() as folder:
            show(name, Path(folder))


def show(name: str, folder: Path) -> None:
    pattern, board = SETS[name]
    table, camera, bare = (folder / name for name in ("detections.csv", "camera.yaml", "bare.yaml"))
    found = calibrate(CalibrateOptions((str(DATA / pattern),), camera, board, save_detections=table)).calibration
    file = native.read(camera)
    entries = {key: replace(entry, noise=None) for key, entry in file.cameras.items()}
    native.write(bare, replace(file, cameras=entries))
    alone, known = (pnp(PnpOptions(str(path), inputs=(str(table),))).poses for path in (bare, camera))
    records = known.estimates.values()
    out, points = sum(len(each.outliers) for each in records), sum(each.n_points for each in records)
    error = found.model_error_px or 0.0
    row = f"{name:17}{found.sigma_px:7.3f}{error:7.3f}{scale(alone):17.2f}{scale(known):12.2f}{f'{out}/{points}':>12}"
    print(row + ("  said" if "a-posteriori" in track_words.noise(known) else ""), flush=True)


def scale(poses: Poses) -> float:
    return float("nan") if poses.noise.scale is None else poses.noise.scale


if __name__ == "__main__":
    main()
