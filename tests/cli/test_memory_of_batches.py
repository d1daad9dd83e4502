"""Memory that commands take for many images: it grows by a few kilobytes of records for each, never by its pixels.

What Python and numpy allocate is counted, in this process. Not shown here: memory of worker processes, each of which
has one item in flight, and of libraries below numpy.
"""

import gc
import os
import tracemalloc
from pathlib import Path

import pytest

from camcal.cli.main import app

BOARD = "chessboard:9x6:25mm"
USUAL = 2, 4  # items
LONG = 4, 8  # of a command whose records are almost as long as they may be
THREADED = 6, 30  # what threads hold of their images at once by chance is less than the records of these may take
PER_ITEM = 40_000  # bytes; the smallest image here has 76 800 pixels
TRIES = 3  # threads hold more or less of their images at once, by chance

pytestmark = pytest.mark.slow

COMMANDS = {
    "demosaic": "demosaic {raw} -o {out} --pattern RGGB",
    "undistort": "undistort {scene}/rig.yaml#left {left} -o {out}",
    "undistort in threads": "undistort {scene}/rig.yaml#left {left} -o {out} --jobs 2",
    "detect": "detect {board} -o {out}/corners.csv --board chessboard:9x6:25mm",
    "detect --draw": "detect {board} -o {out}/corners.csv --board chessboard:9x6:25mm --draw {out}",
    "pnp": "pnp {once}/truth.yaml {board} -o {out}/poses.yaml --board chessboard:9x6:25mm",
    "stereo rectify": "stereo rectify {scene}/rig.yaml {left} {right} -o {out}",
    "stereo check": "stereo check {left} {right}",
    "stereo disparity": "stereo disparity {left} {right} {scene}/rig.yaml -o {out} --quality fast --vis",
    "stereo cloud": "stereo cloud {maps} {left} {scene}/rig.yaml -o {out}",
    "stereo eval": "stereo eval {maps} {maps} -o {out}",
    "stereo run": "stereo run {scene}/rig.yaml {left} {right} -o {out} --quality fast",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with a rectified pair and its rig, a photograph of a board with its camera, and a raw frame."""
    folder = tmp_path_factory.mktemp("made")
    call("simulate", "--stereo", "-o", folder / "scene", "--size", "320x240")
    call("simulate", BOARD, "-o", folder / "once", "--size", "640x480", "--views", 1)
    call("simulate", BOARD, "-o", folder / "raw", "--size", "640x480", "--views", 1, "--raw", "RGGB")
    return folder


def call(*words: object) -> None:
    with pytest.raises(SystemExit) as ended:
        app([*map(str, words), "--quiet"])
    assert not ended.value.code, words


def repeated(made: Path, folder: Path, count: int) -> dict[str, Path]:
    """Return folders with so many copies of every file."""
    sources = {
        "left": made / "scene/left/000.png",
        "right": made / "scene/right/000.png",
        "maps": made / "scene/disparity/000.pfm",
        "board": made / "once/images/view0000.png",
        "raw": made / "raw/images/view0000.png",
    }
    for name, source in sources.items():
        (folder / name).mkdir(parents=True)
        for number in range(count):
            os.link(source, folder / name / f"{number:04d}{source.suffix}")
    return {name: folder / name for name in sources} | {"scene": made / "scene", "once": made / "once"}


def run(command: str, places: dict[str, Path], output: Path) -> None:
    words = command.format(**places, out=output).split()
    call(*words, *(() if "--jobs" in words else ("--jobs", 1)))


def peak_of(command: str, places: dict[str, Path], output: Path) -> int:
    """Return the most bytes that a command held at once."""
    gc.freeze()  # what earlier tests left: the more there is, the longer figures wait for the collector
    gc.collect()
    tracemalloc.start()
    try:
        run(command, places, output)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS.keys())
def test_memory_does_not_grow_by_the_pixels_of_the_images(made, tmp_path, command):
    counts = THREADED if "--jobs 2" in command else LONG if "stereo eval" in command else USUAL
    one, few, many = (repeated(made, tmp_path / str(count), count) for count in (1, *counts))
    run(command, one, tmp_path / "first")  # what is imported and kept by then
    limit, grown = PER_ITEM * (counts[1] - counts[0]), []
    # with threads, and with figures that wait for the collector, a peak may be higher by chance
    while not grown or (grown[-1] >= limit and len(grown) < TRIES):
        number = len(grown)
        peak = peak_of(command, many, tmp_path / f"many{number}")
        grown.append(peak - peak_of(command, few, tmp_path / f"few{number}"))
    assert min(grown) < limit


def test_figures_of_maps_are_drawn_one_after_another(made, tmp_path):
    few, many = (repeated(made, tmp_path / str(count), count) for count in (1, 2))
    command = "stereo eval {maps} {maps} --figures {out}"
    run(command, few, tmp_path / "first")
    grown = peak_of(command, many, tmp_path / "many") - peak_of(command, few, tmp_path / "few")
    assert grown < 320 * 240 * 4  # the map of a pair, of which each of its figures would keep its own copy
    assert len(list((tmp_path / "many").glob("*.png"))) == 6
