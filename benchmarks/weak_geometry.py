"""Near-parallel views: the error of the camera where the board is hardly tilted, few views, print errors, motion.

Simulated corners of corner_error_scenes.py, noise 0.08 px, the board within 5°, 10° or 15° of the image plane about
both axes. The error of a camera is the RMS of the rotation-compensated projection at infinity within the hull of the
corners, px, of at most 100; a row has its RMS over the seeds.
flat: camcal's solver with the board as drawn and without errors within views. camcal: what camcal does by itself.
/flat: camcal / flat, and in brackets the ratio of the medians (wanted: 1.15 at most where there are neither print
errors nor motion, 1 at most where there are). cv2: cv2.calibrateCamera.
observed/claimed: camcal's error over what its covariance leads one to expect.
printed: 0.2 % longer along x, sheared by 0.1 %, bowed by 0.1 % of its side. rolling: a rolling shutter, by how far a
corner moves while the image is read.

    python benchmarks/weak_geometry.py [--seeds 40] [--first-seed 0] [--views 8 16] [--tilts 5 10 15] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from corner_error_scenes import Scenario, Scene, rolling_shutter, scene
from projection_error import projection_errors
from scipy.spatial import Delaunay
from within_view_errors import opencv

from camcal.calibrate.fit import ShapeOptions, fit_briefly, fit_plain
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.directions import direction_displacements
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.errors import CamcalError
from camcal.run.fanout import fan_out
from camcal.targets.board import Board

CAMERAS = ("opencv5-1600x1200", "opencv5-640x480")
MOST = 100.0  # px


def printed(board: Board, _: np.random.Generator) -> np.ndarray:
    """Return a board with what printers and glue do to it."""
    points = board.points()
    x, y = (2 * points[:, :2] / board.extent - 1).T
    points[:, 2] = 1e-3 * max(board.extent) * (1 - x**2 + 0.5 * (1 - y**2))
    points[:, 0] += 2e-3 * points[:, 0] + 1e-3 * points[:, 1]
    return points


SCENARIOS = {
    "clean": Scenario(),
    "printed": Scenario(board=printed),
    **{f"rolling {px:g} px": Scenario(image=partial(rolling_shutter, shear=px)) for px in (0.5, 1.0, 2.0)},
    "printed, rolling 1 px": Scenario(board=printed, image=partial(rolling_shutter, shear=1.0)),
}


@dataclass(frozen=True)
class Item:
    """What makes a scene; tilt in degrees."""

    scenario: str
    tilt: float
    views: int
    seed: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--views", type=int, nargs="+", default=[8, 16])
    parser.add_argument("--tilts", type=float, nargs="+", default=[5.0, 10.0, 15.0])
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS), metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; seeds {seeds.start} to {seeds.stop - 1}")
    print(f"{'scenario':22} {'tilt':>4} views failed     cv2    flat  camcal        /flat  observed/claimed")
    for name in arguments.scenarios:
        for tilt in arguments.tilts:
            for views in arguments.views:
                items = [Item(name, tilt, views, seed) for seed in seeds]
                found = [outcome.value for outcome in fan_out(errors, items, jobs=arguments.jobs, processes=True)]
                print_row(f"{name:22} {tilt:3.0f}° {views:5d}", np.array(found))


def errors(item: Item) -> tuple[float, float, float, float]:
    """Return the errors of cv2, flat and camcal, px, NaN where they fail, and the error that camcal claims."""
    data = scene(SCENARIOS[item.scenario], item.views, item.seed, CAMERAS, tilt=np.radians(item.tilt))
    hull = Delaunay(np.concatenate([view.pixels for view in data.views]))
    other = opencv(data)
    peer = np.nan if other is None or other.camera is None else error(data, other.camera, hull)
    model, size, seen = data.truth.model, data.truth.image_size, Observations.of(data.views)
    drawn, held = ShapeOptions(smooth=False, offsets=False), np.full(len(model.parameter_names), np.nan)
    try:
        flat, _ = fit_plain(*fit_briefly(model, data.board, seen, size, held, None, drawn), drawn)
        own = calibrate(data.views, data.board, Options(model)).camera
    except CamcalError:
        return peer, np.nan, np.nan, np.nan
    return peer, error(data, Camera(model, size, flat.state.parameters), hull), error(data, own, hull), claim(own, hull)


def error(data: Scene, camera: Camera, hull: Delaunay) -> float:
    pixels, distances = projection_errors(data.truth, camera)
    inside = np.nan_to_num(distances[hull.find_simplex(pixels) >= 0], nan=MOST)
    return float(np.sqrt(np.mean(np.minimum(inside, MOST) ** 2)))


def claim(camera: Camera, hull: Delaunay) -> float:
    axes = [np.linspace(0, length - 1, count) for length, count in zip(camera.image_size, (41, 31), strict=True)]
    pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    moved = direction_displacements(camera, pixels[hull.find_simplex(pixels) >= 0])
    moved = moved[np.isfinite(moved).all(axis=(1, 2))]
    return float(np.sqrt(np.einsum("nik,kl,nil->", moved, camera.covariance, moved) / len(moved)))


def print_row(words: str, found: np.ndarray) -> None:
    good = found[np.isfinite(found).all(axis=1)]
    cv, flat, own, claimed = np.sqrt(np.mean(good**2, axis=0))
    medians = np.median(good, axis=0)
    ratio = f"{own / flat:6.2f} ({medians[2] / medians[1]:4.2f})"
    print(
        f"{words} {len(found) - len(good):6d} {cv:7.3f} {flat:7.3f} {own:7.3f} {ratio} {own / claimed:17.2f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
