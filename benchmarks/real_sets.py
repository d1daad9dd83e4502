"""Every chessboard and ChArUco set of the real test images through one command, without a hint but the board.

Per row: images with a board / images, the model that was taken, RMS and noise in px, fx with its standard deviation,
views used, corners rejected, the board's bend peak to peak (mm, or thousandths of a square where its size is unknown),
seconds from images to camera file, whether the result is called trustworthy. Beside it OpenCV with the same model on
the very same corners: cv2.calibrateCamera (rational for opencv8) or cv2.fisheye.calibrate for kannala_brandt4.
A star after the bend: every corner of the board was freed. Rows below a set repeat it from its detections with
another --model; `smooth` has the free corners switched off.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/real_sets.py [--sets NAME …]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from camcal.errors import CamcalError
from camcal.formats import detections
from camcal.targets.detection import Detections
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.options import CalibrateOptions

DATA = Path(os.environ.get("CAMCAL_TEST_DATA", "../shared/data"))
PHOTONVISION = "charuco/photonvision-2024"
LIFECAM = "charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000"
SETS = {
    "boofcv-sony": ("chessboard/boofcv-sony-hx5v-chess/frame*.jpg", "chessboard:6x4:30mm"),
    "bouguet": ("chessboard/bouguet-caltech/Image*.tif", "chessboard:12x13:30mm"),
    "opencv left": ("chessboard/opencv-left-right/left*.jpg", "chessboard:9x6:25mm"),
    "opencv right": ("chessboard/opencv-left-right/right*.jpg", "chessboard:9x6:25mm"),
    "lifecam phone": ("chessboard/photonvision-lifecam-2024-01-02_lifecam_1280/*.png", "chessboard:10x10"),
    "udacity-gopro": ("chessboard/udacity-gopro-wide/*.jpg", "chessboard:8x6"),
    "lifecam charuco": (f"{PHOTONVISION}-05-07_lifecam_1280/*.jpg", LIFECAM),
    "lifecam legacy": (f"{PHOTONVISION}-06-19_lifecam_1280_Old_Pattern/*.jpg", LIFECAM),
    "theta fisheye": ("fisheye/boofcv-theta-chess/*.jpg", "chessboard:6x4"),
    "ocamcalib fish2": ("fisheye/ocamcalib-fish2/Fisheye2_*.jpg", "chessboard:8x6:117mm"),
    "sourishg fish l": ("fisheye/sourishg-fisheye-stereo/imgs/left*.jpg", "chessboard:9x6:24.23mm"),
    "sourishg fish r": ("fisheye/sourishg-fisheye-stereo/imgs/right*.jpg", "chessboard:9x6:24.23mm"),
    "trinocular left": ("multicam/boofcv-trinocular/left/*.jpg", "chessboard:13x9"),
    "trinocular mid": ("multicam/boofcv-trinocular/middle/*.jpg", "chessboard:13x9"),
    "trinocular right": ("multicam/boofcv-trinocular/right/*.jpg", "chessboard:13x9"),
    "bumblebee left": ("stereo_rig/boofcv-bumblebee2-chess/left*.jpg", "chessboard:6x4:30mm"),
    "bumblebee right": ("stereo_rig/boofcv-bumblebee2-chess/right*.jpg", "chessboard:6x4:30mm"),
    "sourishg 1 left": ("stereo_rig/sourishg-stereo/calib_imgs/1/left*.jpg", "chessboard:9x6:24.23mm"),
    "sourishg 1 right": ("stereo_rig/sourishg-stereo/calib_imgs/1/right*.jpg", "chessboard:9x6:24.23mm"),
    "sourishg 2 left": ("stereo_rig/sourishg-stereo/calib_imgs/2/left*.jpg", "chessboard:9x6:24.23mm"),
    "sourishg 2 right": ("stereo_rig/sourishg-stereo/calib_imgs/2/right*.jpg", "chessboard:9x6:24.23mm"),
    "visp hand-eye": ("pnp/visp-handeye-chessboard/franka_image-*.png", "chessboard:9x6:23.6mm"),
}
AGAIN = {
    "udacity-gopro": (("opencv8 smooth", "opencv8", False), ("opencv8 free", "opencv8", True)),
}


@dataclass(frozen=True)
class Row:
    """One calibration: its name in the table, what it was made from, and what came of it."""

    name: str
    found: Detections | None
    report: CalibrateReport | CamcalError
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    print(
        f"{'set':17} {'found':>7} {'model':16} {'RMS':>6} {'noise':>6} {'fx':>9} {'± std':>7} {'views':>5} "
        f"{'rej.':>5} {'bend ± std':>16} {'s':>6} {'ok':>3} | {'cv2 RMS':>8} {'cv2 fx':>9}"
    )
    for name in arguments.sets:
        with tempfile.TemporaryDirectory() as folder:
            for row in rows(name, Path(folder)):
                show(row)


def rows(name: str, folder: Path) -> list[Row]:
    """Return the rows of one set: from its images, then from its detections with other options."""
    pattern, board = SETS[name]
    table = folder / "detections.csv"
    images = CalibrateOptions((str(DATA / pattern),), folder / "camera.yaml", board, save_detections=table)
    result = [timed(name, images, table)]
    for label, model, free in AGAIN.get(name, ()):
        again = CalibrateOptions((str(table),), folder / "again.yaml", model=model, free_corners=free)
        result.append(timed(f"  {label}", again, table))
    return result


def timed(name: str, options: CalibrateOptions, table: Path) -> Row:
    start = time.perf_counter()
    try:
        report: CalibrateReport | CamcalError = calibrate(options)
    except CamcalError as error:
        report = error
    seconds = time.perf_counter() - start
    return Row(name, detections.read(table) if table.exists() else None, report, seconds)


def show(row: Row) -> None:
    found = f"{sum(view.found for view in row.found.views)}/{len(row.found.views)}" if row.found else "-"
    if isinstance(row.report, CamcalError):
        print(f"{row.name:17} {found:>7} exit {row.report.exit_code}: {row.report}", flush=True)
        return
    result = row.report.calibration
    camera, surface = result.camera, result.surface
    bend = f"{1e3 * surface.deflection:7.3f} ± {1e3 * surface.deflection_std:5.3f}" if surface.deflection else "flat"
    bend += "*" if surface.offsets is not None else " "
    theirs = opencv(row.found, camera.model.name)
    print(
        f"{row.name:17} {found:>7} {camera.model.name:16} {result.rms_px:6.3f} {result.sigma_px:6.3f} "
        f"{camera.value('fx'):9.3f} {camera.std('fx'):7.3f} {len(result.used):5d} {len(result.rejected):5d} "
        f"{bend:>16} {row.seconds:6.2f} {'yes' if row.report.assessment.trustworthy else 'NO':>3} | {theirs}",
        flush=True,
    )


def opencv(found: Detections, model: str) -> str:
    """Return RMS and fx of OpenCV with the same model on the corners that camcal started from."""
    board = found.board.points().astype(np.float32)
    size = max((view.size for view in found.views), key=[view.size for view in found.views].count)
    views = [view for view in found.views if len(view.ids) >= 6 and view.size == size]
    objects = [board[view.ids][None] for view in views]
    pixels = [view.pixels.astype(np.float32)[None] for view in views]
    try:
        if model == "kannala_brandt4":
            names = cv2 if hasattr(cv2, "CALIB_FIX_SKEW") else cv2.fisheye  # OpenCV 5 moved them
            flags = names.CALIB_RECOMPUTE_EXTRINSIC | names.CALIB_FIX_SKEW
            rms, matrix, *_ = cv2.fisheye.calibrate(objects, pixels, size, None, None, flags=flags)
        else:
            flags = cv2.CALIB_RATIONAL_MODEL if model == "opencv8" else 0
            rms, matrix, *_ = cv2.calibrateCamera(objects, pixels, size, None, None, flags=flags)
    except cv2.error as error:
        return f"failed: {str(error).splitlines()[0][:60]}"
    return f"{rms:8.3f} {matrix[0, 0]:9.3f}"


if __name__ == "__main__":
    main()
