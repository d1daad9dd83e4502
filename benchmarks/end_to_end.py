"""Processor seconds from images to a camera, by stage, beside OpenCV on the same images.

camcal: the whole command `camcal calibrate IMAGES --jobs 1`, a process of its own, whose `timings` are the stages;
start is what remains: Python, imports, reports, the end. Images are decoded in the stages that locate boards and
measure corners. table: the same command on the detections that this leaves, the lens model chosen; given: the model
given. OpenCV, also a process of its own, one thread: decode, find the corners with findChessboardCorners and
cornerSubPix (plain), or findChessboardCornersSB with its exhaustive and accurate flags (accurate), or cv2.aruco's
detector for ChArUco boards, then cv2.calibrateCamera. mrgingham, where it is installed and the board is square, only
finds corners. boards: images in which the board was found, of all. Each figure is the median of some runs, all programs
in turn.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/end_to_end.py [--sets NAME …] [--runs 3]
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence

import cv2
import numpy as np
from peers import opencv_corners
from real_sets import DATA, LIFECAM, PHOTONVISION

from camcal.formats.boards import load_board
from camcal.targets.board import CHARUCO, Board

SETS = {
    "20 of 1280x960": ("chessboard/udacity-gopro-wide/*.jpg", "chessboard:8x6", 20),
    "13 of 1280x720": ("chessboard/boofcv-sony-hx5v-chess/frame*.jpg", "chessboard:6x4:30mm", 13),
    "14 of 640x480": ("chessboard/opencv-left-right/left*.jpg", "chessboard:9x6:25mm", 14),
    "24 of 1024x768": ("multicam/boofcv-trinocular/left/*.jpg", "chessboard:13x9", 24),
    "16 ChArUco": (f"{PHOTONVISION}-05-07_lifecam_1280/*.jpg", LIFECAM, 16),
}
STAGES = ("detecting", "solving briefly", "measuring corners", "choosing the lens model", "solving", "checking")
HEADS = ("start", "locate", "brief", "measure", "choose", "solve", "check")
ENVIRONMENT = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
CAMCAL = (sys.executable, "-c", "from camcal.cli.main import main; main()")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=list(SETS))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--opencv", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.opencv:
        how, board, *files = arguments.opencv
        print(json.dumps(opencv(how, load_board(board), files)))
        return
    print(f"OpenCV {cv2.__version__}; processor seconds, medians of {arguments.runs} runs")
    print(f"{'':16}{'program':>10}{'boards':>8}{'total':>8}" + "".join(f"{head:>9}" for head in HEADS))
    for name in arguments.sets:
        pattern, board, count = SETS[name]
        measured(name, sorted(map(str, DATA.glob(pattern)))[:count], board, arguments.runs)


def measured(name: str, files: Sequence[str], board: str, runs: int) -> None:
    """Print the rows of one set."""
    charuco = load_board(board).type == CHARUCO
    rows: dict[str, list[tuple[str, float, list[float]]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        table, camera = f"{folder}/corners.csv", f"{folder}/camera.yaml"
        own = (*CAMCAL, "calibrate", "--json", "-j", "1", "-o", camera, "--overwrite")
        again = (*own, "--board", board, table)
        commands = {
            "camcal": (*own, "--board", board, "--save-detections", table, *files),
            "table": again,
            "given": (*again, "--model", "opencv5"),
        }
        for how in ("aruco",) if charuco else ("plain", "accurate"):
            commands[how] = (sys.executable, __file__, "--opencv", how, board, *files)
        if not charuco and (program := shutil.which("mrgingham")):
            size = load_board(board)
            if size.columns == size.rows:
                commands["mrgingham"] = (program, "--jobs", "1", "--gridn", str(size.columns), *files)
        for _ in range(runs):
            for program, command in commands.items():
                rows.setdefault(program, []).append(run(program, command, len(files)))
    for program, results in rows.items():
        total = statistics.median(result[1] for result in results)
        stages = [statistics.median(values) for values in zip(*(result[2] for result in results), strict=True)]
        print(
            f"{name if program == 'camcal' else '':16}{program:>10}{results[0][0]:>8}{total:8.2f}"
            + "".join(f"{value:9.2f}" for value in stages),
            flush=True,
        )


def run(program: str, command: Sequence[str], images: int) -> tuple[str, float, list[float]]:
    """Return how many boards a program found, its processor seconds, and those of its stages."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if program == "mrgingham":
        found = {line.split()[0] for line in done.stdout.splitlines() if line[:1] != "#" and line.split()[1] != "-"}
        return f"{len(found)}/{images}", total, []
    data = json.loads(done.stdout)
    if program in {"camcal", "table", "given"}:
        boards = sum(view["points"] > 0 for view in data["views"])
        stages = [data["timings"].get(stage, {}).get("cpu_s", 0.0) for stage in STAGES]
        return f"{boards}/{images}", total, [total - sum(stages), *stages]
    return f"{data['boards']}/{images}", total, []


def opencv(how: str, board: Board, files: Sequence[str]) -> dict[str, float]:
    """Return what OpenCV makes of images: how many boards it found, and the RMS of its calibration."""
    cv2.setNumThreads(1)
    objects, pixels, size = [], [], (0, 0)
    points = board.points().astype(np.float32)
    if how == "aruco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(board.dictionary)))
        squares = (board.columns + 1, board.rows + 1)
        layout = cv2.aruco.CharucoBoard(squares, float(board.spacing), float(board.marker or 0), dictionary)
        layout.setLegacyPattern(bool(board.legacy))
        detector = cv2.aruco.CharucoDetector(layout)
    for file in files:
        gray = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
        assert gray is not None
        size = gray.shape[::-1]
        ids = np.arange(board.count)
        if how == "aruco":
            corners, found = detector.detectBoard(gray)[:2]
            if found is None or len(found) < 6:
                continue
            corners, ids = np.asarray(corners).reshape(-1, 2), np.asarray(found).ravel()
        elif how == "plain":
            start = opencv_corners.classic(gray, board)
            corners = None if start is None else opencv_corners.refined(gray, start)
        else:
            corners = opencv_corners.sector_based(gray, board, opencv_corners.ACCURATE)
        if corners is not None:
            objects.append(points[ids])
            pixels.append(np.asarray(corners, np.float32))
    rms = cv2.calibrateCamera(objects, pixels, size, None, None)[0] if len(pixels) > 2 else float("nan")
    return {"boards": len(pixels), "rms": rms}


if __name__ == "__main__":
    main()
