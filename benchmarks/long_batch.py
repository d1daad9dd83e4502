"""`camcal undistort` over a long folder of small images, killed twice and resumed: memory, rate, and what is lost.

JPEG images with the spectrum and the noise of photographs, of which a few differ and the others are the same again
under other names. The command is killed with all its processes (SIGKILL) when a third and two thirds of the images are
written, and resumed each time; then it is run once more on what is complete, and once without a stop into another
folder, whose bytes are compared.

memory: the greatest proportional set size of all processes of the command together, MB. first, last: images per second
of the first and the last thousand images that the run wrote, by the times of the files.

    python benchmarks/long_batch.py [--images 100000] [--size 320x240] [--jobs N] [--folder FOLDER]
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
from undistort import CAMERA, photograph

from camcal.cameras.model import resized
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save
from camcal.run.process import available_cores

DIFFERENT = 8
THOUSAND = 1000
COMMAND = (sys.executable, "-c", "from camcal.cli.main import main; main()")
_EVERY = 0.5  # s


@dataclass(frozen=True)
class Ended:
    """How a run ended: its exit code, seconds, greatest memory in bytes, and the times its images were written at."""

    code: int
    seconds: float
    memory: int
    times: list[float]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=100_000)
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(320, 240))
    parser.add_argument("--jobs", type=int, default=available_cores())
    parser.add_argument("--folder", type=Path, help="where the temporary folder goes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        return measure(Path(name), arguments)


def measure(folder: Path, arguments: argparse.Namespace) -> int:
    count, (width, height) = arguments.images, arguments.size
    make(folder, count, arguments.size)
    print(f"OpenCV {cv2.__version__}, {available_cores()} cores; {count} images of {width}x{height}")
    print(f"{'run':26} {'exit':>4} {'written':>8} {'s':>7} {'images/s':>8} {'first':>7} {'last':>7} {'memory':>7}")

    def run(label: str, output: str, until: int | None = None, *, resume: bool = True) -> None:
        words = ["undistort", "camera.yaml", "in", "-o", output, "--jobs", str(arguments.jobs)]
        ended = watched(folder, [*words, *(["--resume"] if resume else [])], folder / output, until)
        written = len(ended.times)
        first, last = rates(ended.times)
        print(
            f"{label:26} {ended.code:4d} {written:8d} {ended.seconds:7.1f} {written / ended.seconds:8.1f} "
            f"{first:7.1f} {last:7.1f} {ended.memory / 1e6:7.0f}",
            flush=True,
        )

    run("killed at a third", "out", count // 3, resume=False)
    run("resumed, killed at 2/3", "out", 2 * count // 3)
    run("resumed", "out")
    run("resumed, nothing to do", "out")
    run("without a stop", "whole", resume=False)
    wrong = differing(folder / "out", folder / "whole")
    left = [path.name for path in (folder / "out").iterdir() if path.name.startswith(".camcal.part")]
    print(f"{len(list((folder / 'out').glob('*.jpg')))} images, {len(wrong)} differ, {len(left)} unfinished files left")
    return int(bool(wrong or left))


def make(folder: Path, count: int, size: tuple[int, int]) -> None:
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(resized(CAMERA, size))}))
    inputs = folder / "in"
    for number in range(DIFFERENT):
        save(inputs / f"{number:06d}.jpg", cv2.resize(photograph(number), size, interpolation=cv2.INTER_AREA))
    contents = [(inputs / f"{number:06d}.jpg").read_bytes() for number in range(DIFFERENT)]
    for number in range(DIFFERENT, count):
        (inputs / f"{number:06d}.jpg").write_bytes(contents[number % DIFFERENT])


def watched(folder: Path, words: list[str], output: Path, until: int | None) -> Ended:
    """Return how a command ended that is killed, with its processes, when so many images are there."""
    start, began = time.monotonic(), time.time()
    process = subprocess.Popen(
        [*COMMAND, *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )

    def kill_if_due() -> None:
        if until is not None and output.is_dir() and sum(1 for _ in os.scandir(output)) >= until:
            os.killpg(process.pid, signal.SIGKILL)

    memory = greatest_memory(process, kill_if_due)
    seconds = time.monotonic() - start
    times = sorted(each.stat().st_mtime for each in os.scandir(output) if each.name.endswith(".jpg"))
    return Ended(process.returncode, seconds, memory, [each for each in times if each >= began])


def greatest_memory(process: subprocess.Popen, meanwhile: Callable[[], None] = lambda: None) -> int:
    """Return the greatest proportional set size, bytes, of the group that a process leads until it ends."""
    memory = 0
    while process.poll() is None:
        memory = max(memory, memory_of_group(process.pid))
        meanwhile()
        time.sleep(_EVERY)
    return memory


def memory_of_group(group: int) -> int:
    """Return the proportional set size, bytes, of all processes of a group."""
    total = 0
    for status in Path("/proc").glob("[0-9]*"):
        try:
            if os.getpgid(int(status.name)) == group:
                lines = (status / "smaps_rollup").read_text().splitlines()
                total += sum(int(line.split()[1]) << 10 for line in lines if line.startswith("Pss:"))
        except OSError:  # it has ended
            continue
    return total


def rates(times: list[float]) -> tuple[float, float]:
    """Return the images per second of the first and of the last thousand, NaN where there are fewer than both."""
    if len(times) < 2 * THOUSAND:
        return float("nan"), float("nan")
    return THOUSAND / (times[THOUSAND] - times[0]), THOUSAND / (times[-1] - times[-1 - THOUSAND])


def differing(folder: Path, other: Path) -> list[str]:
    """Return the names of files that only one folder has, or that differ."""
    names = {path.name for each in (folder, other) for path in each.glob("*.*") if not path.name.startswith(".")}
    return [name for name in sorted(names) if not same(folder / name, other / name)]


def same(one: Path, other: Path) -> bool:
    return one.is_file() and other.is_file() and content(one) == content(other)


def content(path: Path) -> bytes:
    """Return the bytes of a file, of a camera file without what names the run: when, and from which call."""
    if path.suffix != ".yaml":
        return path.read_bytes()
    return path.read_bytes().partition(b"provenance:")[0]


if __name__ == "__main__":
    sys.exit(main())
