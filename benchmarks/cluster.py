"""Images per second of `undistort` on this machine's pool and on a Dask cluster of as many workers, alternately.

python benchmarks/cluster.py [--images 200] [--runs 3] [--jobs 2]: rates from the first to the last image of a run, so
that the time until processes have started does not count; outputs are compared byte for byte.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save
from camcal.progress import Silent
from camcal.run.options import BatchOptions
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

SIZE = (1920, 1080)
LENS = Camera(model_named("opencv5"), SIZE, np.array([1400.0, 1400, 959.5, 539.5, -0.25, 0.06, 0, 0, 0]))


class Clock(Silent):
    def __init__(self) -> None:
        self.times: list[float] = []

    def advance(self, count: int = 1) -> None:  # noqa: ARG002
        self.times.append(time.monotonic())

    @property
    def rate(self) -> float:
        return (len(self.times) - 1) / (self.times[-1] - self.times[0])


def make_images(folder: Path, count: int) -> None:
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (SIZE[1] // 8, SIZE[0] // 8, 3), dtype=np.uint8)
    pixels = np.kron(coarse, np.ones((8, 8, 1), np.uint8))
    for number in range(count):
        save(folder / f"{number:05d}.jpg", np.roll(pixels, 7 * number, axis=1))


def rate(folder: Path, jobs: int, scheduler: str | None) -> float:
    clock = Clock()
    options = UndistortOptions(
        camera=str(folder / "lens.yaml"),
        inputs=(str(folder / "photos"),),
        output=folder / ("pool" if scheduler is None else "dask"),
        jobs=jobs,
        batch=BatchOptions(scheduler=scheduler),
    )
    undistort(options, clock)
    return clock.rate


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        native.write(folder / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
        make_images(folder / "photos", given.images)
        ratios = []
        for _ in range(given.runs):
            pool, dask = (rate(folder, given.jobs, scheduler) for scheduler in (None, "dask://local"))
            ratios.append(dask / pool)
            print(f"pool {pool:5.1f} images/s   dask {dask:5.1f} images/s   ratio {ratios[-1]:.2f}")
        for path in (folder / "pool").glob("*.jpg"):
            assert path.read_bytes() == (folder / "dask" / path.name).read_bytes()
        print(f"median ratio {statistics.median(ratios):.2f}, {given.images} images of {SIZE[0]}x{SIZE[1]}, same bytes")


if __name__ == "__main__":
    main()
