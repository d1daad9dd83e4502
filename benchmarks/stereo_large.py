"""Disparity of a large pair beside another version of camcal: seconds of the processor, and memory at its peak.

The pair is a generated slanted scene, enlarged four times to 12.6 megapixels. Both versions work in a process of their
own, in turns, with the range of the truth; shown are medians of the repeats, and bad-2 of what they find.

    python benchmarks/stereo_large.py BASE [--repeats 3] [--seed 7] [--quality best]

BASE: a folder with another version's package camcal.
"""

import argparse
import json
import os
import sys
import tempfile

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from base_program import answer_of

import camcal
from camcal.stereo.matching.match import MatchOptions, match  # where earlier versions have both

SMALL = 1024, 768
TIMES = 4  # larger
BAD = 2.0  # px
PARTS = "left", "right", "truth", "visible", "count"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--quality", default="best")
    arguments = parser.parse_args()
    folders = {"base": arguments.base.resolve(), "this": Path(camcal.__file__).parents[1]}
    answers: dict[str, list[Mapping[str, float]]] = {name: [] for name in folders}
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        write_enlarged(file.name, arguments.seed)
        request = json.dumps({"pair": file.name, "quality": arguments.quality})
        for _ in range(arguments.repeats):
            for name, folder in folders.items():
                answers[name].append(answer_of(Path(__file__), folder, request))
    width, height = (TIMES * side for side in SMALL)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}, {width}x{height}, {arguments.quality}")
    medians = {
        name: {key: float(np.median([each[key] for each in given])) for key in given[0]}
        for name, given in answers.items()
    }
    print(f"{'':8}", *(f"{key:>10}" for key in medians["this"]))
    for name, figures in medians.items():
        print(f"{name:8}", *(f"{value:10.2f}" for value in figures.values()))
    print(f"{'ratio':8}", *(f"{value / medians['base'][key]:10.2f}" for key, value in medians["this"].items()))


def work() -> None:
    """Answer requests, a line each, with what one match took and found."""
    print(Path(camcal.__file__).parents[1], flush=True)
    cv2.setNumThreads(1)
    for line in sys.stdin:
        request = json.loads(line)
        with np.load(request["pair"]) as pair:
            left, right, truth, visible, count = (pair[name] for name in PARTS)
        options = MatchOptions(quality=request["quality"], search=(0, int(count) - 1), fill="all")
        Path("/proc/self/clear_refs").write_text("5")  # forget the peak so far (Linux)
        begin = time.process_time()
        values = match(left, right, options).values
        taken = time.process_time() - begin
        bad = ~(np.abs(values - truth) <= BAD)
        shares = {"bad2 nocc": 100 * float(bad[visible].mean()), "bad2 all": 100 * float(bad.mean())}
        print(json.dumps({"CPU s": taken, "peak GB": peak()} | shares), flush=True)


def write_enlarged(path: str, seed: int) -> None:
    from slanted_scenes import slanted_scene  # needs this version of camcal

    small = slanted_scene(seed, SMALL)
    size = tuple(TIMES * side for side in SMALL)
    left, right = (
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_CUBIC)
        for image in (small.left, small.right)
    )
    truth = TIMES * cv2.resize(small.truth, size, interpolation=cv2.INTER_NEAREST)
    visible = cv2.resize(small.visible.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    np.savez(path, **dict(zip(PARTS, (left, right, truth, visible, TIMES * small.count), strict=True)))


def peak() -> float:
    """Return the most memory that this process has taken, with Python, libraries and images, GB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e9


if __name__ == "__main__":
    work() if "--worker" in sys.argv else main()
