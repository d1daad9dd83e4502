"""Images per second of `camcal undistort` against decode, remap and encode alone, and of two jobs against one.

JPEG images with the spectrum and the noise of photographs, large and small, in a temporary folder. camcal: the whole
command, from listing the folder to writing the camera file. Alone: nothing but the three steps on all cores, once with
OpenCV's functions and once with camcal's own, maps made before; OpenCV has one thread for each. "of alone" is camcal's
rate against the faster of these two. All take turns, each going first every other time, and ratios are of one round
each, medians of all, so that a busy machine disturbs all alike.

    python benchmarks/batch_speed.py [--images 32] [--small 1500] [--repeats 5] [--folder FOLDER]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import local

import cv2
from undistort import CAMERA, SIZE, photograph

from camcal.cameras.model import Camera, resized
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import load, save
from camcal.images.image import Image, Scratch
from camcal.images.options import ViewOptions
from camcal.images.remap import Maps, build_maps
from camcal.images.views import make_view
from camcal.run.process import available_cores, one_opencv_thread
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

SMALL = (640, 480)
DIFFERENT = 8  # images; the others are the same again under other names
KEEP = ViewOptions(keep_k=True)
QUALITY = 95
WIDTHS = (18, 9, 9, 8, 8, 8, 11)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=32)
    parser.add_argument("--small", type=int, default=1500)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="where the temporary folder goes")
    arguments = parser.parse_args()
    print(
        f"OpenCV {cv2.__version__}, {available_cores()} cores; images per second, medians of {arguments.repeats} rounds"
    )
    heads = zip(("images", "cv2 alone", "own alone", "camcal", "-j 1", "of alone", "-j 2 / -j 1"), WIDTHS, strict=True)
    print(" ".join(f"{head:>{width}}" for head, width in heads))
    for size, count in ((SIZE, arguments.images), (SMALL, arguments.small)):
        with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
            print(row(Batch.made(Path(name), size, count), arguments.repeats))


def row(batch: "Batch", repeats: int) -> str:
    works: dict[str, Callable[[], None]] = {
        "cv2": batch.by_opencv,
        "own": batch.by_own_steps,
        "camcal": partial(batch.by_camcal, None),
        "one": partial(batch.by_camcal, 1),
        "two": partial(batch.by_camcal, 2),
    }
    taken: dict[str, list[float]] = {name: [] for name in works}
    for number in range(repeats + 1):
        for name in sorted(works, reverse=bool(number % 2)):
            start = time.perf_counter()
            works[name]()
            taken[name].append(time.perf_counter() - start)
    rounds = [dict(zip(taken, seconds, strict=True)) for seconds in zip(*taken.values(), strict=True)][1:]
    rate = {name: len(batch.sources) / statistics.median(each[name] for each in rounds) for name in works}
    share = statistics.median(min(each["cv2"], each["own"]) / each["camcal"] for each in rounds)
    gain = statistics.median(each["one"] / each["two"] for each in rounds)
    images = f"{len(batch.sources)} of {batch.camera.image_size[0]}x{batch.camera.image_size[1]}"
    cells = [images, *(f"{rate[name]:.1f}" for name in ("cv2", "own", "camcal", "one"))]
    cells += [f"{100 * share:.0f} %", f"{gain:.2f}"]
    return " ".join(f"{cell:>{width}}" for cell, width in zip(cells, WIDTHS, strict=True))


@dataclass(frozen=True, eq=False)
class Batch:
    """Images in a folder and their camera, with the maps that draw them."""

    folder: Path
    sources: list[Path]
    camera: Camera
    maps: Maps

    @classmethod
    def made(cls, folder: Path, size: tuple[int, int], count: int) -> "Batch":
        camera = resized(CAMERA, size)
        sources = [folder / "in" / f"{number:05d}.jpg" for number in range(count)]
        for number, path in enumerate(sources):
            if number < DIFFERENT:
                save(path, cv2.resize(photograph(number), size, interpolation=cv2.INTER_AREA))
            else:
                path.write_bytes(sources[number % DIFFERENT].read_bytes())
        for name in ("cv2", "own"):
            (folder / name).mkdir()
        native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(camera)}))
        return cls(folder, sources, camera, build_maps(camera, make_view(camera, KEEP)))

    def by_camcal(self, jobs: int | None) -> None:
        options = UndistortOptions(
            str(self.folder / "camera.yaml"),
            self.folder / "camcal",
            (str(self.folder / "in"),),
            view=KEEP,
            quality=QUALITY,
            jobs=jobs,
        )
        undistort(options)

    def by_opencv(self) -> None:
        def draw(path: Path) -> None:
            picture = cv2.remap(cv2.imread(str(path)), self.maps.x, self.maps.y, cv2.INTER_LINEAR)
            cv2.imwrite(str(self.folder / "cv2" / path.name), picture, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))

        on_all_cores(draw, self.sources)

    def by_own_steps(self) -> None:
        own = local()

        def draw(path: Path) -> None:
            scratch = own.__dict__.setdefault("scratch", Scratch())
            picture = self.maps.apply(load(path, scratch).pixels, scratch=scratch)
            save(self.folder / "own" / path.name, Image(picture), quality=QUALITY)

        on_all_cores(draw, self.sources)


def on_all_cores(work: Callable[[Path], None], paths: Iterable[Path]) -> None:
    with one_opencv_thread(), ThreadPoolExecutor(available_cores()) as pool:
        for _ in pool.map(work, paths):
            pass


if __name__ == "__main__":
    main()
