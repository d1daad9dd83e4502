"""Many cameras of many corners through `camcal run` on a Dask cluster of this machine, as in a factory each night.

Each camera has a lens, poses and noise of its own. Of every 25 cameras one saw the board in one place only, and cannot
be calibrated, and one has corners that are off by most of a pixel, and an uncertainty above the limit. `camcal run`
calibrates all of them on a Dask cluster of worker processes; then every camera is calibrated alone by
`camcal calibrate`, and the files are compared: all but the lines that say when, and from which call. MB: the greatest
proportional set size of all processes of the command together.

    python benchmarks/many_cameras.py [--cameras 100] [--corners 100000] [--workers 4] [--folder FOLDER]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from subprocess import DEVNULL, CompletedProcess

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from long_batch import COMMAND, greatest_memory, same

from camcal.formats import detections
from camcal.formats.detections import Detections
from camcal.run.process import available_cores
from camcal.targets.board import Board

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import Errors, SimulatedRig, Transform, narrow_lens, observed, scene

BOARD = Board("chessboard", 24, 17, 0.02)
SIZE = (2592, 1944)
NOISE = 0.1  # px
HERE, BENT = Transform.of([0, 0, 0], [0, 0, 0]), (3e-4, -2e-4)
EVERY, ONE_PLACE, LOOSE = 25, 7, 19  # of so many cameras, those that are shown the board badly
UNSTEADY = 0.7  # px
LIMIT, SHOWN = "0.05", 10  # px of the uncertainty; lines of the summary
PIPELINE = f"""\
lists:
  camera: cameras/*.csv

steps:
  calibrate:
    command: calibrate
    foreach: camera
    arguments: cameras/$(camera).csv
    max-uncertainty: {LIMIT}
    output: out/$(camera).yaml
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--corners", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--folder", type=Path, help="where the temporary folder goes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        return measure(Path(name), arguments)


def measure(folder: Path, arguments: argparse.Namespace) -> int:
    paths = [folder / "cameras" / f"camera_{number:03d}.csv" for number in range(arguments.cameras)]
    for number, path in enumerate(paths):
        make(path, number, arguments.corners)
    (folder / "night.yaml").write_text(PIPELINE)
    print(f"{available_cores()} cores; {arguments.cameras} cameras of {arguments.corners} corners")
    words = ["run", "night.yaml", "--scheduler", "dask://local", "--jobs", str(arguments.workers)]
    seconds, ended, memory = watched(folder, words)
    print(f"camcal run, {arguments.workers} workers: exit {ended.returncode}, {seconds:.0f} s, {memory / 1e6:.0f} MB")
    seconds, ended, _ = watched(folder, words)
    print(f"once more: exit {ended.returncode}, {seconds:.0f} s")
    lines = ended.stdout.splitlines()
    print("\n".join([line for line in lines if line.startswith("  calibrate[")][:SHOWN] + lines[-1:]))
    start = time.monotonic()
    with ThreadPoolExecutor(available_cores()) as pool:
        codes = list(pool.map(alone, paths))
    print(f"camcal calibrate, {available_cores()} at a time: {time.monotonic() - start:.0f} s, exits {Counter(codes)}")
    pairs = [[folder / run / f"{path.stem}.yaml" for run in ("out", "alone")] for path in paths]
    written = [pair for pair in pairs if pair[0].exists() or pair[1].exists()]
    different = [pair for pair in written if not same(*pair)]
    print(f"{len(written)} cameras written, {len(different)} differ from those of the single run")
    return int(bool(different))


def make(path: Path, camera: int, corners: int) -> None:
    """Write the corners that a camera has detected, as many views as it takes."""
    rng = np.random.default_rng(camera)
    rig = SimulatedRig((narrow_lens(rng, SIZE, rng.uniform(1800, 2600)),), (HERE,), BOARD, BENT)
    shown = scene(rig, corners // 250, camera, fill=(0.5, 0.9))
    if camera % EVERY == ONE_PLACE:
        shown = replace(shown, boards=shown.boards[:1] * len(shown.boards))
    errors = Errors(NOISE, smooth=UNSTEADY if camera % EVERY == LOOSE else 0.0)
    views = [view for view in observed(shown, errors, camera).of(0) if view is not None]
    enough = int(np.searchsorted(np.cumsum([len(view.ids) for view in views]), corners)) + 1
    detections.write(path, Detections(BOARD, tuple(views[:enough])))


def watched(folder: Path, words: list[str]) -> tuple[float, CompletedProcess[str], int]:
    """Return the seconds of a command, how it ended, and the greatest memory in bytes."""
    start = time.monotonic()
    with (folder / "stdout").open("w+") as stdout:
        process = subprocess.Popen(
            [*COMMAND, *words], cwd=folder, stdout=stdout, stderr=DEVNULL, start_new_session=True
        )
        memory = greatest_memory(process)
        stdout.seek(0)
        ended = CompletedProcess(words, process.returncode, stdout.read())
    return time.monotonic() - start, ended, memory


def alone(path: Path) -> int:
    """Return the exit code of a calibration of one camera, in a folder of its own."""
    folder = path.parents[1]
    words = ["calibrate", f"cameras/{path.name}", "--max-uncertainty", LIMIT, "-o", f"alone/{path.stem}.yaml"]
    return subprocess.run([*COMMAND, *words], cwd=folder, capture_output=True, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
