"""Outputs of commands on real sets, as figures that a change of the program is compared with.

Every set is a few commands in an empty folder; what they write is read again: each number of a YAML or JSON file by its
path, and each column of a point cloud. Numbers in lists count together: how many they are, and the root of the sum of
their squares. A line is a set, a path, a count and that root, or the number itself where it is one.

The figures are compared with those that golden_outputs.txt keeps, which --write writes: every set with its largest
relative difference; the exit is 1 where one is beyond --limit, or another figure or number of them is there. Another
machine or other libraries round differently, which a selection among nearly equal points makes larger.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/golden_outputs.py [--sets NAME …] [--write]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from camcal.cli.main import app
from camcal.formats import pointclouds

DATA = Path(os.environ.get("CAMCAL_TEST_DATA", "../shared/data")).resolve()
KEPT = Path(__file__).with_suffix(".txt")
LIMIT = 1e-9
OMITTED = ("provenance", "camcal", "schema", "version")  # of files: what names the program and not what it found
SHEET = "chessboard:6x4:30mm"
VIDEO = DATA / "pnp" / "boofcv-chessboard-video"
TAGS = DATA / "pnp" / "visp-apriltag" / "AprilTag.pgm"
PATH = DATA / "pnp" / "evo-trajectories" / "freiburg1_xyz-rgbdslam_drift.txt"
TAG_LENS = "--camera-matrix 615.167,615.168,312.189,243.437"
LENS = "--camera-matrix 529.034,528.798,316.677,226.931 --distortion 0.0559,-0.166,0,0"

Set = tuple[tuple[str, ...], str]  # commands, and the file of the last one that is read


def camera(images: str, board: str) -> Set:
    return (f"calibrate {DATA}/{images} --board {board} -o camera.yaml",), "camera.yaml"


def rig(folder: str, board: str) -> Set:
    left, right = (f"{DATA}/{folder}/{side}*.jpg" for side in ("left", "right"))
    return (f"stereo calibrate {left} {right} --board {board} -o rig.yaml",), "rig.yaml"


def cloud(folder: str, names: tuple[str, str], camera: str) -> Set:
    """Return the commands that match a rectified pair and make a cloud with a camera."""
    left, right = (f"{DATA}/stereo_gt/{folder}/{name}.png" for name in names)
    match = f"stereo disparity {left} {right} --quality balanced -o disparity.tiff"
    return (match, f"stereo cloud disparity.tiff {left} {camera} -o cloud.ply"), "cloud.ply"


OLD_PAIR, OLD_CAMERA = ("im2", "im6"), "--fx 935 --cx 220 --cy 180 --baseline 0.16"
SETS: dict[str, Set] = {
    "camera of a webcam": camera("chessboard/opencv-left-right/left*.jpg", "chessboard:9x6:25mm"),
    "camera of Bouguet": camera("chessboard/bouguet-caltech/Image*.tif", "chessboard:12x13:30mm"),
    "camera of a compact": camera("chessboard/boofcv-sony-hx5v-chess/frame*.jpg", "chessboard:6x4:30mm"),
    "camera of a ChArUco board": camera(
        "charuco/photonvision-2024-05-07_lifecam_1280/*.jpg", "charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000"
    ),
    "camera of 360 degrees": camera("fisheye/boofcv-theta-chess/*.jpg", "chessboard:6x4"),
    "fisheye of a robot": camera("fisheye/ocamcalib-fish2/Fisheye2_*.jpg", "chessboard:8x6:117mm"),
    "fisheye of a pair": camera("fisheye/sourishg-fisheye-stereo/imgs/left*.jpg", "chessboard:9x6:24.23mm"),
    "camera on an arm": camera("pnp/visp-handeye-chessboard/franka_image-*.png", "chessboard:9x6:23.6mm"),
    "camera of an AprilGrid": camera("aprilgrid/tumvi-1024/*[0-9tp].png", "aprilgrid:6x6:88mm:0.3"),
    "camera of circles": camera("other_targets/boofcv-circle-regular/*.jpg", "circles:8x10:25mm:15mm"),
    "rig of two webcams": rig("chessboard/opencv-left-right", "chessboard:9x6:25mm"),
    "rig in one housing": rig("stereo_rig/boofcv-bumblebee2-chess", "chessboard:6x4:30mm"),
    "rig of wide lenses": rig("stereo_rig/sourishg-stereo/calib_imgs/2", "chessboard:9x6:24.23mm"),
    "poses of tags": ((f"pnp {TAG_LENS} {TAGS} --tags tag36h11:53mm -o poses.yaml",), "poses.yaml"),
    "poses of a board": ((f"pnp {LENS} {VIDEO}/image0*.jpg --board {SHEET} -o poses.yaml",), "poses.yaml"),
    "track of a board": (
        (f"track {LENS} {VIDEO}/movie.mjpeg --board {SHEET} --fps 30 -o track.json",),
        "track.json",
    ),
    "smooth path": ((f"smooth {PATH} -o path.json",), "path.json"),
    "cloud of flat sheets": cloud("middlebury2001-venus", OLD_PAIR, OLD_CAMERA),
    "cloud of cones": cloud("middlebury2003-cones", OLD_PAIR, OLD_CAMERA),
    "cloud of a bear": cloud("middlebury2003-teddy", OLD_PAIR, OLD_CAMERA),
    "cloud of a motorcycle": cloud(
        "middlebury2014-motorcycleQ", ("im0", "im1"), f"{DATA}/stereo_gt/middlebury2014-motorcycleQ/calib.txt"
    ),
}


def numbers_in(data: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of plain data with their paths, in which places in lists do not stand."""
    if isinstance(data, dict):
        for key, item in data.items():
            if key not in OMITTED:
                yield from numbers_in(item, f"{path}.{key}" if path else str(key))
    elif isinstance(data, list):
        for item in data:
            yield from numbers_in(item, path)
    elif isinstance(data, int | float):
        yield path, float(data)


def figures_of(path: Path) -> dict[str, tuple[int, float]]:
    """Return the figures of a file by their paths in it: how many numbers, and their root sum of squares."""
    if path.suffix == ".ply":
        vertices = pointclouds.read(path).vertices
        columns = {name: np.asarray(vertices[name], float) for name in vertices.dtype.names}
    else:
        columns = {}
        read = json.loads if path.suffix == ".json" else yaml.safe_load
        for name, number in numbers_in(read(path.read_text(encoding="utf-8"))):
            columns.setdefault(name, []).append(number)
    return {
        name: (len(some), float(some[0] if len(some) == 1 else np.linalg.norm(some))) for name, some in columns.items()
    }


def lines_of(name: str) -> list[str]:
    """Return the figures of a set, one a line; a command that fails ends the program."""
    commands, output = SETS[name]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for command in commands:
            try:
                app([*command.split(), "--quiet"])
            except SystemExit as leaving:
                if leaving.code:
                    raise
        figures = figures_of(Path(output))
    return [f"{name} | {path} | {count} | {value:.15g}" for path, (count, value) in figures.items()]


def row(name: str, lines: list[str], earlier: list[str]) -> tuple[float, str]:
    """Return the largest relative difference between the figures of a set and earlier ones, and the row that says it;
    infinite where there are other figures, or another number of them.
    """
    now, before = (
        {line.rpartition(" | ")[0]: float(line.rpartition(" | ")[2]) for line in some if line.startswith(f"{name} | ")}
        for some in (lines, earlier)
    )
    for line in sorted(now.keys() ^ before.keys()):
        print(f"{'new' if line in now else 'gone'}: {line}", file=sys.stderr)
    differences = {
        line: abs(now[line] - before[line]) / max(abs(now[line]), abs(before[line]), 1e-300)
        for line in now.keys() & before.keys()
    }
    worst = max(differences, key=lambda line: differences[line], default="")
    largest = np.inf if now.keys() != before.keys() else differences[worst]
    return largest, f"| {name} | {len(now)} | {largest:.1e} | {worst.split(' | ')[1] if worst and largest else ''} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS), metavar="NAME")
    parser.add_argument("--write", action="store_true", help="keep the figures instead, of these sets")
    parser.add_argument("--limit", type=float, default=LIMIT, help="relative difference that is none")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    earlier = KEPT.read_text(encoding="utf-8").splitlines() if KEPT.exists() else []
    if arguments.write:
        kept = {name: [line for line in earlier if line.startswith(f"{name} | ")] for name in SETS}
        kept |= {name: lines_of(name) for name in arguments.sets}
        KEPT.write_text("".join(f"{line}\n" for lines in kept.values() for line in lines), encoding="utf-8")
        return
    print("| set | figures | largest relative difference | of |\n|---|---|---|---|")
    worst = 0.0
    for name in arguments.sets:
        largest, said = row(name, lines_of(name), earlier)
        worst = max(worst, largest)
        print(said, flush=True)
    sys.exit(int(worst > arguments.limit))


if __name__ == "__main__":
    main()
