"""Boards found, wrong corners and time, beside what OpenCV and mrgingham offer: on hard rendered views and real sets.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/detection.py [--quick] [--views N] [--only rendered|real]

A cell is: images whose board was found / images that have one, in brackets how many of them have a corner more than
1 px wrong (rendered views, where the truth is known), then the median time an image in ms on one core, decoding
excluded. "no board": images in which something was found all the same, and the time it takes to say that there is none.
found: camcal's finding alone, before corners are measured; camcal: all of `detect`. SB: findChessboardCornersSB with
its defaults; SB best: NORMALIZE_IMAGE | EXHAUSTIVE | ACCURACY; classic: findChessboardCorners with ADAPTIVE_THRESH |
NORMALIZE_IMAGE, then cornerSubPix in windows of 11 px; ChArUco: cv2.aruco.CharucoDetector. mrgingham is run where it is
installed, its time holds reading a PNG and CLAHE. A board with covered corners counts for camcal when three quarters of
them are found; the others find all or nothing.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from peers.opencv_corners import ACCURATE, classic, refined, sector_based
from real_sets import DATA, SETS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from hard_scenes import SCENES, photographs
from opencv_charuco import found_by_opencv

from camcal.images.files import gray_8bit, load
from camcal.run.paths import find_images
from camcal.targets.board import CHARUCO, Board, parse_board
from camcal.targets.checker.charuco import find_charuco
from camcal.targets.checker.chessboard import find_chessboard
from camcal.targets.detect import detect
from camcal.targets.detection import BoardDetection

CHESSBOARD = parse_board("chessboard:10x10:20mm")
CHARUCO_BOARDS = tuple(parse_board(f"charuco:10x8:20mm:15mm:DICT_4X4_100:{kind}") for kind in ("current", "legacy"))
CHARUCO_SCENES = ("plain", "blur 3 px", "dark, 10 DN", "noise 12 DN", "tilted 60-72 deg", "covered", "gamma 2.2, small")
WRONG_PX = 1.0
LEAST = 0.75  # of the corners of a covered board

Finder = Callable[[np.ndarray, Board], np.ndarray | None]


@dataclass
class Tally:
    """What one way made of a row of images."""

    found: int = 0
    wrong: int = 0
    seconds: tuple[float, ...] = ()

    def add(self, pixels: np.ndarray | None, truth: np.ndarray | None, seconds: float) -> None:
        self.seconds += (seconds,)
        if pixels is not None:
            self.found += 1
            self.wrong += truth is not None and is_wrong(pixels, truth)

    def cell(self) -> str:
        wrong = f" ({self.wrong} wrong)" if self.wrong else ""
        return f"{self.found}{wrong}, {1e3 * np.median(self.seconds):.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="5 views and no exhaustive search")
    parser.add_argument("--only", choices=("rendered", "real"))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}")
    if options.only != "real":
        rendered(options)
    if options.only != "rendered":
        real(options)


def rendered(options: argparse.Namespace) -> None:
    views = 5 if options.quick else options.views
    for boards, scenes in (((CHESSBOARD,), SCENES), (CHARUCO_BOARDS, CHARUCO_SCENES)):
        methods = ways(boards[0], quick=options.quick)
        header(f"{boards[0].words}, {views} views", methods)
        for name in scenes:
            if name in options.scenes:
                images = [
                    (*pair, board)
                    for seed, board in enumerate(boards)
                    for pair in photographs(SCENES[name], board, max(1, views // len(boards)), seed)
                ]
                row(name, images, methods)


def real(options: argparse.Namespace) -> None:
    methods = ways(CHESSBOARD, quick=options.quick)
    methods.pop("mrgingham", None)
    header("real sets", methods)
    for name, (pattern, text) in SETS.items():
        board = parse_board(text)
        images = [(gray_8bit(load(path).pixels), None, board) for path in find_images([DATA / pattern])]
        chosen = methods if board.type != CHARUCO else {**ways(board, quick=True), "ChArUco": charuco_unknown}
        row(f"{name} ({len(images)})", images, chosen)


def header(title: str, methods: dict[str, Finder]) -> None:
    print(f"\n| {title} | " + " | ".join(methods) + " |")
    print("|---" * (len(methods) + 1) + "|")


def row(name: str, images: list, methods: dict[str, Finder]) -> None:
    tallies = {way: Tally() for way in methods}
    for gray, truth, board in images:
        for way, find in methods.items():
            cv2.setRNGSeed(0)
            start = time.process_time() + children()
            pixels = find(gray, board)
            tallies[way].add(pixels, truth, time.process_time() + children() - start)
    print(f"| {name} | " + " | ".join(tally.cell() for tally in tallies.values()) + " |", flush=True)


def children() -> float:
    times = os.times()
    return times.children_user + times.children_system


def is_wrong(pixels: np.ndarray, truth: np.ndarray) -> bool:
    away = np.linalg.norm(pixels[:, None] - truth, axis=2).min(axis=1)
    return bool((away > WRONG_PX).any())


def ways(board: Board, *, quick: bool) -> dict[str, Finder]:
    if board.type == CHARUCO:
        return {"found": partial(camcal, find=find_charuco), "camcal": camcal, "ChArUco": charuco}
    methods: dict[str, Finder] = {
        "found": partial(camcal, find=find_chessboard),
        "camcal": camcal,
        "SB": sector_based,
    }
    if not quick:
        methods["SB best"] = partial(sector_based, flags=ACCURATE)
    methods["classic"] = classic_refined
    if shutil.which("mrgingham"):
        methods["mrgingham"] = mrgingham
    return methods


def camcal(
    gray: np.ndarray, board: Board, find: Callable[[np.ndarray, Board], BoardDetection] = detect
) -> np.ndarray | None:
    detection = find(gray, board)
    enough = 1 if board.type == CHARUCO else LEAST * board.count
    return detection.pixels if len(detection.ids) >= enough else None


def classic_refined(gray: np.ndarray, board: Board) -> np.ndarray | None:
    corners = classic(gray, board)
    return None if corners is None else refined(gray, corners)


def mrgingham(gray: np.ndarray, board: Board) -> np.ndarray | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.png"
        cv2.imwrite(str(path), gray, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        command = ["mrgingham", "--jobs", "1", "--gridn", str(board.columns), str(path)]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    pixels = [(float(x), float(y)) for _, x, y, _ in lines if x != "-"]
    return np.array(pixels) if pixels else None


def charuco(gray: np.ndarray, board: Board) -> np.ndarray | None:
    ids, pixels = found_by_opencv(gray, board)
    return pixels if len(ids) >= 4 else None


def charuco_unknown(gray: np.ndarray, board: Board) -> np.ndarray | None:
    both = (charuco(gray, replace(board, legacy=legacy)) for legacy in (False, True))
    return max(both, key=lambda pixels: 0 if pixels is None else len(pixels))


if __name__ == "__main__":
    main()
