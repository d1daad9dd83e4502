"""Point clouds from disparity maps, by camcal and by others: seconds and memory.

The first table is from a map of 12 MP and its colour image in memory to a binary PLY file, flushed to disk by camcal
and not by the others. The others are of works on 1.4 MP: points that stand alone, normals, one point per voxel. Medians
of several runs, the least beside them, and the time of all processors, which a busy machine disturbs less. Memory is
the peak of the process less what it held before, on Linux.

The maps are a generated scene (waves, steps, 10 % without a match, 1 % wrong, noise of 0.1 px) or, with --map and
--image, those of a real pair enlarged to the same sizes.

    python benchmarks/clouds.py [--peer-python PYTHON] [--map MAP --image IMAGE] [--size 4000x3000] [--repeats 5]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import statistics
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from peers.cloud_peers import measured

from camcal.formats import disparity, pointclouds
from camcal.images.files import load
from camcal.run.process import over_threads
from camcal.stereo.cloud import CloudMaker, normals, one_per_voxel
from camcal.stereo.depth import Frame, StereoImage, row_blocks
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.selection import Selection, has_neighbours, select
from camcal.tasks.stereo.cloud import in_order_on_threads

PEERS = Path(__file__).parent / "peers" / "cloud_peers.py"
SMALL = 1282, 1110
VOXEL_PIXELS, RADIUS_PIXELS = 4, 3  # sides and radii, as what so many pixels see at the median depth
FILE_PEERS = ("NumPy as in textbooks", "OpenCV reprojectImageTo3D", "Open3D tensor", "Open3D legacy")
TABLES = {
    "points that stand alone": ("Open3D statistical, 20 neighbours", "Open3D radius, 6 neighbours"),
    "normals": ("Open3D, 30 neighbours",),
    "one point per voxel": ("Open3D",),
}

Measure = Callable[[str], dict[str, Any]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", help="interpreter for peers/cloud_peers.py; without it camcal is alone")
    parser.add_argument("--map", type=Path)
    parser.add_argument("--image", type=Path)
    parser.add_argument("--size", default="4000x3000")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    if (arguments.map is None) != (arguments.image is None):
        parser.error("--map and --image go together")
    large = tuple(int(number) for number in arguments.size.split("x"))
    print(versions(arguments.peer_python))
    with tempfile.TemporaryDirectory() as folder:
        image = stereo_image(large, arguments.map, arguments.image)
        ask = peers(arguments.peer_python, Path(folder), image, arguments.repeats)
        table(f"{large[0]}x{large[1]} to PLY", files(image, Path(folder), arguments.repeats), ask, FILE_PEERS)
        image = stereo_image(SMALL, arguments.map, arguments.image)
        ask = peers(arguments.peer_python, Path(folder), image, arguments.repeats)
        for title, works in ours(image).items():
            rows = ((name, measured(work, arguments.repeats)) for name, work in works.items())
            table(f"{SMALL[0]}x{SMALL[1]}: {title}", rows, ask, TABLES[title])


def versions(interpreter: str | None) -> str:
    own = {"OpenCV": cv2.__version__, "numpy": np.__version__}
    if interpreter is None:
        return f"camcal with {own}"
    answer = subprocess.run([interpreter, PEERS, "versions", ".", "1"], capture_output=True, check=True, text=True)
    return f"camcal with {own}, others with {json.loads(answer.stdout)}"


def table(title: str, rows: Iterator[tuple[str, dict[str, Any]]], ask: Measure | None, others: tuple[str, ...]) -> None:
    print(f"\n| {title} | median ms | least ms | processor ms | extra MB | points |\n|---|---|---|---|---|---|")
    for name, result in rows:
        show(f"camcal, {name}", result)
    for name in others if ask else ():
        show(name, ask(name))


def show(name: str, result: dict[str, Any]) -> None:
    milliseconds = [1e3 * seconds for seconds in result["seconds"]]
    extra = "" if result["extra_mb"] is None else f"{result['extra_mb']:.0f}"
    median, least = statistics.median(milliseconds), min(milliseconds)
    processor = 1e3 * statistics.median(result["processor"])
    print(f"| {name} | {median:.0f} | {least:.0f} | {processor:.0f} | {extra} | {result['points']} |", flush=True)


def files(image: StereoImage, folder: Path, repeats: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the rows of camcal's ways from a map to a file."""
    for jobs in (1, 2):
        threads = f"{jobs} thread{'s' * (jobs > 1)}"
        for outliers in ("none", "organised"):
            work = partial(write, image, folder / "ours.ply", outliers, jobs)
            yield f"outliers {outliers}, {threads}", measured(work, repeats)


def write(image: StereoImage, path: Path, outliers: str, jobs: int) -> int:
    with over_threads(jobs) as each:
        kept = select(image, Selection(outliers=outliers), Frame(), each).kept
    stream = CloudMaker(image, kept).stream(in_order=in_order_on_threads(jobs))
    pointclouds.write(path, stream)
    return stream.count


def ours(image: StereoImage) -> dict[str, dict[str, Callable[[], int]]]:
    """Return camcal's works by table; blocks of rows are those of the commands."""
    found = np.concatenate(list(CloudMaker(image, kept_of(image, "none")).stream().blocks))
    points = np.stack([found[name] for name in "xyz"], axis=1)
    scene = scene_of(image)
    return {
        "points that stand alone": {
            "by disparity": lambda: int(kept_of(image, "organised").sum()),
            "by radius": lambda: int(has_neighbours(points, scene["radius"]).sum()),
        },
        "normals": {
            "planes in disparity": lambda: sum(normals(image, r)[0].size for r in row_blocks(image.shape, 1 << 17))
        },
        "one point per voxel": {"means": lambda: len(one_per_voxel(found, scene["voxel"]))},
    }


def kept_of(image: StereoImage, outliers: str) -> np.ndarray:
    return select(image, Selection(outliers=outliers), Frame()).kept


def stereo_image(size: tuple[int, ...], map_path: Path | None, image_path: Path | None) -> StereoImage:
    width, height = size
    if map_path and image_path:
        values, pixels = disparity.read(map_path).matched(), load(image_path).pixels
        scale = width / values.shape[1]
        values = cv2.resize(values, size, interpolation=cv2.INTER_NEAREST) * np.float32(scale)
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)
        pixels = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    else:
        values, pixels = generated(size)
    return StereoImage(values, StereoGeometry(width, width, width / 2, height / 2, 0.2), pixels=pixels)


def generated(size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    width, height = size
    v, u = np.mgrid[:height, :width].astype(np.float32) / width
    values = width / 40 * (1 + 0.3 * np.sin(9 * u) * np.cos(7 * v) + 0.4 * (np.sin(25 * u + 5 * v) > 0.6))
    values = (values + rng.normal(0, 0.1, values.shape)).astype(np.float32)
    holes = cv2.resize(rng.random((height // 20, width // 20)), size, interpolation=cv2.INTER_NEAREST) < 0.1
    values[rng.random(values.shape) < 0.01] *= 1.5
    values[holes] = np.nan
    return values, rng.integers(0, 256, (height, width, 3), np.uint8)


def scene_of(image: StereoImage) -> dict[str, float]:
    geometry = image.geometry
    footprint = float(np.nanmedian(image.depth(slice(0, image.shape[0])))) / geometry.fx
    return {
        "fx": geometry.fx,
        "cx": geometry.cx,
        "cy": geometry.cy,
        "baseline": geometry.baseline,
        "voxel": VOXEL_PIXELS * footprint,
        "radius": RADIUS_PIXELS * footprint,
    }


def peers(interpreter: str | None, folder: Path, image: StereoImage, repeats: int) -> Measure | None:
    """Return a function that measures a work of the other environment on this image, each in a process of its own."""
    if interpreter is None:
        return None
    found = np.concatenate(list(CloudMaker(image, kept_of(image, "none")).stream().blocks))
    np.save(folder / "disparity.npy", image.disparity)
    np.save(folder / "image.npy", image.pixels)
    np.save(folder / "points.npy", np.stack([found[name] for name in "xyz"], axis=1))
    np.save(folder / "colours.npy", np.stack([found[name] for name in ("red", "green", "blue")], axis=1))
    (folder / "scene.json").write_text(json.dumps(scene_of(image)))

    def ask(name: str) -> dict[str, Any]:
        command = [interpreter, PEERS, name, folder, str(repeats)]
        answer = subprocess.run(command, capture_output=True, check=True, text=True)
        return json.loads(answer.stdout.splitlines()[-1])

    return ask


if __name__ == "__main__":
    main()
