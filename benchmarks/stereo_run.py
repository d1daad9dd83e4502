"""`stereo run` beside the sum of its parts, its memory, and the distances of rendered scenes.

    python benchmarks/stereo_run.py parts LEFT RIGHT BOARD [--pairs 6] [--repeats 3]
    python benchmarks/stereo_run.py memory [--pixels 12]
    python benchmarks/stereo_run.py scenes [--height 480]

parts: LEFT and RIGHT are globs of images of a board. memory: one pair of so many megapixels. scenes: what two lenses
see of a room with a ball (tests/room_scene.py); the cloud is compared with where its pixels look.
"""

import argparse
import os
import sys
import tempfile

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from glob import glob
from itertools import product
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import room_scene

from camcal.formats import disparity_sidecar, pointclouds

COMMAND = (sys.executable, "-c", "from camcal.cli.main import app; app()")
BANDS = ((0, 30), (30, 60), (60, 80), (80, 100))  # degrees from the optical axis


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = parser.add_subparsers(dest="table", required=True)
    parts = tables.add_parser("parts")
    parts.add_argument("left")
    parts.add_argument("right")
    parts.add_argument("board")
    parts.add_argument("--pairs", type=int, default=6)
    parts.add_argument("--repeats", type=int, default=3)
    tables.add_parser("memory").add_argument("--pixels", type=float, default=12.0)
    tables.add_parser("scenes").add_argument("--height", type=int, default=480)
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.table == "parts":
            print_parts(folder, arguments)
        elif arguments.table == "memory":
            print_memory(folder, arguments.pixels)
        else:
            print_scenes(folder, arguments.height)


def print_parts(folder: Path, arguments: argparse.Namespace) -> None:
    called("stereo", "calibrate", arguments.left, arguments.right, "-b", arguments.board, "-o", folder / "rig.yaml")
    for side in ("left", "right"):
        (folder / side).mkdir()
        for index, path in enumerate(sorted(glob(getattr(arguments, side)))[: arguments.pairs]):  # noqa: PTH207
            shutil.copy(path, folder / side / f"{index:02d}{Path(path).suffix}")
    whole, separate = [], []
    for _ in range(arguments.repeats):
        pair = folder / "left", folder / "right"
        whole.append(cost([("stereo", "run", folder / "rig.yaml", *pair, "-o", folder / "run", "--force")]))
        separate.append(cost(steps(folder, arguments.pairs)))
    print(f"{arguments.pairs} pairs, medians of {arguments.repeats}; s")
    print(f"{'':10} {'CPU':>8} {'wall':>8}")
    medians = [np.median(each, axis=0) for each in (whole, separate)]
    for name, (cpu, wall) in zip(("run", "its parts"), medians, strict=True):
        print(f"{name:10} {cpu:8.2f} {wall:8.2f}")
    print(f"{'ratio':10} {medians[0][0] / medians[1][0]:8.2f} {medians[0][1] / medians[1][1]:8.2f}")


def steps(folder: Path, pairs: int) -> Iterator[Sequence[object]]:
    """Yield the commands that together do what `stereo run` does."""
    rows = folder / "rows"
    yield "stereo", "rectify", folder / "rig.yaml", folder / "left", folder / "right", "-o", rows
    sides = rows / "left", rows / "right"
    yield "stereo", "check", *sides
    yield "stereo", "disparity", *sides, rows / "rectified.yaml", "-o", folder / "maps", "--force"
    yield "stereo", "cloud", folder / "maps", "-o", folder / "clouds"
    for index in range(pairs):
        yield "view", folder / "clouds" / f"{index:02d}.ply", "-o", folder / f"{index:02d}.html"


def cost(commands: Iterator[Sequence[object]] | list[Sequence[object]]) -> tuple[float, float]:
    """Return the seconds of the processor and of the clock that commands take one after another."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    for command in commands:
        called(*command)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - started


def called(*arguments: object) -> None:
    words = [*COMMAND, *map(str, arguments), "--quiet"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 6, 7):
        raise RuntimeError(f"{' '.join(map(str, arguments))}: {done.stderr}")


def print_memory(folder: Path, megapixels: float) -> None:
    height = round(np.sqrt(megapixels * 0.75e6))
    width = round(height * 4 / 3)
    rig = room_scene.RoomRig(folder, "pinhole", room_scene.BESIDE, scale=width / room_scene.SIZE[0], coarse=8)
    called("stereo", "run", rig.file, rig.left, rig.right, "-o", folder / "run")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024**2
    print(f"{width}x{height}: {peak:.2f} GB at the peak")


def print_scenes(folder: Path, height: int) -> None:
    bands = ", ".join("{}–{}°".format(*band) for band in BANDS)
    print("relative error of distances, %: median, 68 % and 95 % of its size")
    print(f"{'across':>6} {'view':12} {'axis':4} {'points':>8} {'median':>6} {'68 %':>6} {'95 %':>6}  68 % at {bands}")
    for kind, (axis, pose) in product(room_scene.LENSES, (("x", room_scene.BESIDE), ("y", room_scene.BELOW))):
        own = folder / f"{kind}-{axis}"
        own.mkdir()
        rig = room_scene.RoomRig(own, kind, pose, scale=height / room_scene.SIZE[1])
        called("stereo", "run", rig.file, rig.left, rig.right, "-o", own / "run")
        cloud = pointclouds.read(own / "run" / "clouds" / "left.ply")
        geometry = disparity_sidecar.read(own / "run" / "disparity" / "left.tiff").geometry
        error, angle = compared(cloud.vertices, rig)
        by_angle = [np.abs(error[(angle >= low) & (angle < high)]) for low, high in BANDS]
        shown = [f"{100 * np.quantile(each, 0.68):.2f}" if len(each) > 500 else "-" for each in by_angle]
        size = np.abs(error)
        figures = np.median(error), np.quantile(size, 0.68), np.quantile(size, 0.95)
        numbers = " ".join(f"{100 * each:6.2f}" for each in figures)
        seen = f"{np.degrees(2 * rig.widest):.0f}"
        print(f"{seen:>6} {geometry.projection:12} {axis:4} {len(error):8} {numbers}  {' '.join(shown)}")


def compared(vertices: np.ndarray, rig: room_scene.RoomRig) -> tuple[np.ndarray, np.ndarray]:
    """Return relative errors of the distances of points, and their angles from the optical axis, degrees."""
    points = np.column_stack([vertices[name] for name in "xyz"]).astype(float)
    columns, rows = np.rint(rig.camera.project(points).pixels).astype(int).T
    height, width = rig.points.shape[:2]
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    points = points[inside]
    distance = np.linalg.norm(points, axis=1)
    error = distance / np.linalg.norm(rig.points[rows[inside], columns[inside]], axis=1) - 1
    return error, np.degrees(np.arccos(points[:, 2] / distance))


if __name__ == "__main__":
    main()
