"""Images per second against the plain loop of cv2.imread, cv2.undistort and cv2.imwrite, and the cost of the first map.

JPEG images of 12 MP with the spectrum and the noise of photographs, in a temporary folder. camcal: the whole command,
from reading the camera file to writing the new one, with --keep-k, so that both draw the same picture. OpenCV has all
its threads. The two take turns, each going first every other time, so that a busy machine disturbs both alike.

    python benchmarks/undistort.py [--images 24] [--repeats 5] [--folder FOLDER]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import load, save
from camcal.images.image import Scratch
from camcal.images.options import ViewOptions
from camcal.images.remap import build_maps
from camcal.images.views import make_view
from camcal.run.process import available_cores
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

SIZE = (4000, 3000)
CAMERA = Camera(
    model_named("opencv5"), SIZE, np.array([3000.0, 3004.0, 1990.5, 1505.2, -0.28, 0.08, 1e-4, 2e-4, -0.01])
)
KEEP = ViewOptions(keep_k=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=24)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="where the temporary folder goes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        run(Path(name), arguments.images, arguments.repeats)


def run(folder: Path, count: int, repeats: int) -> None:
    sources = [folder / "in" / f"{number:03d}.jpg" for number in range(count)]
    for number, path in enumerate(sources):
        save(path, photograph(number))
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(CAMERA)}))
    works = {"cv2 loop": lambda: plain_loop(sources, folder / "cv2"), "camcal": lambda: camcal(folder)}
    rounds = [in_turn(works, reverse=bool(number % 2)) for number in range(repeats + 1)][1:]
    ratio = statistics.median(each["cv2 loop"].wall / each["camcal"].wall for each in rounds)
    megabytes = statistics.mean(path.stat().st_size for path in sources) / 1e6
    print(
        f"OpenCV {cv2.__version__} with {cv2.getNumThreads()} threads, camcal on {available_cores()} cores; "
        f"{count} images of {SIZE[0]}x{SIZE[1]}, {megabytes:.1f} MB each; medians of {repeats}, in turn"
    )
    print(f"{'':14} {'images/s':>9} {'ms/image':>9} {'ms of processor/image':>22}")
    per_image = {}
    for name in works:
        wall, processor = (statistics.median(each) / count for each in zip(*(r[name] for r in rounds), strict=True))
        print(f"{name:14} {1 / wall:9.2f} {1e3 * wall:9.1f} {1e3 * processor:22.1f}")
        per_image[name] = wall
    print(f"{'ratio':14} {ratio:9.2f}   (largest grey-level difference of two pixels {difference(folder):d})")
    print_parts(sources[0], folder, 1e3 * per_image["camcal"])


def plain_loop(sources: list[Path], folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    fx, fy, cx, cy, *distortion = CAMERA.parameters.tolist()
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    for path in sources:
        cv2.imwrite(str(folder / path.name), cv2.undistort(cv2.imread(str(path)), matrix, np.array(distortion)))


def camcal(folder: Path) -> None:
    undistort(UndistortOptions(str(folder / "camera.yaml"), folder / "camcal", (str(folder / "in"),), view=KEEP))


def difference(folder: Path) -> int:
    """Return how far apart the two are on the first image, between their decoded pixels."""
    one, other = (load(folder / name / "000.jpg").pixels for name in ("cv2", "camcal"))
    return int(cv2.absdiff(one, other).max())


def print_parts(source: Path, folder: Path, per_image: float) -> None:
    """Print what the steps take of one core, least of five, and the first map in images."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    view = make_view(CAMERA, KEEP)
    maps, picture, scratch = build_maps(CAMERA, view), load(source).pixels, Scratch()
    steps: dict[str, Callable[[], object]] = {
        "decode": lambda: load(source, scratch),
        "remap": lambda: maps.apply(picture, scratch=scratch),
        "encode, write": lambda: save(folder / "one.jpg", picture),
        "first map": lambda: build_maps(CAMERA, make_view(CAMERA, KEEP)),
        "… with a crop": lambda: build_maps(CAMERA, make_view(CAMERA, ViewOptions(alpha=0))),
    }
    print("of one core, least of 5:")
    for name, step in steps.items():
        taken = 1e3 * min(taken_by(step).processor for _ in range(5))
        images = f"   ({taken / per_image:.2f} images of camcal above)" if "map" in name or "crop" in name else ""
        print(f"{name:14} {'':9} {taken:9.1f}{images}")
    cv2.setNumThreads(threads)


class Taken(NamedTuple):
    """Seconds of the clock, and of all cores together."""

    wall: float
    processor: float


def in_turn(works: dict[str, Callable[[], object]], *, reverse: bool) -> dict[str, Taken]:
    return {name: taken_by(works[name]) for name in sorted(works, reverse=reverse)}


def taken_by(work: Callable[[], object]) -> Taken:
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return Taken(time.perf_counter() - wall, time.process_time() - processor)


def photograph(seed: int) -> np.ndarray:
    """Return an image whose amplitude falls with frequency as that of photographs does, with the noise of a sensor."""
    rng = np.random.default_rng(seed)
    image = np.zeros((*SIZE[::-1], 3), np.float32)
    for level in range(2, 12):
        cells = rng.standard_normal((3 * 2**level // 4, 2**level, 3)).astype(np.float32)
        cells[:, :, 1:] = 0.7 * cells[:, :, :1] + 0.3 * cells[:, :, 1:]  # colours go together
        image += cv2.resize(cells, SIZE, interpolation=cv2.INTER_CUBIC) * 0.55 ** (level - 2)
    noise = 3 * rng.standard_normal(image.shape, dtype=np.float32)
    return np.clip(image * (45 / image.std()) + 120 + noise, 0, 255).astype(np.uint8)


if __name__ == "__main__":
    main()
