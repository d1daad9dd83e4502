"""Which image of a raw frame corners are best found in: camcal's own detector on everything a mosaic can be made into.

Boards rendered through a lens, RGGB, 12 bits, blur of 0.7 px. Every number is the RMS distance of the corners from the
truth in 1/1000 px, over all corners of all boards. Columns: red, green and blue samples see the same light; the same
with the noise of photons (8000 electrons at full scale) and reading (4 electrons); red and blue see 0.5 and 0.6 of
green's light, as raw frames do, with noise; red lies 0.5 px outside and blue 0.5 px inside of green at the corner of
the image, without noise. The monochrome sensor of the last column sees green alone.

    python benchmarks/raw_corners.py [--boards 12] [--blur 0.7] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.images.files import gray_8bit
from camcal.raw.demosaic import demosaic
from camcal.raw.develop import balance_in_place, linearise
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import agreeing_gains, detection_image_of
from camcal.run.fanout import fan_out
from camcal.simulate.mosaics import filter_mosaic, lenses
from camcal.simulate.render import Exposure, evenly_lit, light
from camcal.simulate.scene import views
from camcal.targets.board import Board
from camcal.targets.detect import detect
from camcal.targets.detection import MaskedImage

SIZE, PATTERN, BLACK, WHITE = (1280, 960), "RGGB", 64.0, 4095.0
BOARD = Board("chessboard", 9, 6, 0.04)
LENS = Camera(model_named("opencv5"), SIZE, np.array([960.0, 964, 645, 472, -0.12, 0.06, 5e-4, -3e-4, 0.01]))
WELL_E, READ_E = 8000.0, 4.0
CODES = {"bilinear": cv2.COLOR_BayerRGGB2GRAY, "VNG": cv2.COLOR_BayerBG2BGR_VNG, "EA": cv2.COLOR_BayerBG2BGR_EA}


@dataclass(frozen=True)
class Condition:
    """The light on red, green and blue, whether there is noise, and the lateral chromatic aberration in pixels."""

    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    noisy: bool = False
    aberration_px: float = 0.0


CONDITIONS = {
    "balanced": Condition(),
    "balanced, noise": Condition(noisy=True),
    "light .5/1/.6, noise": Condition((0.5, 1.0, 0.6), noisy=True),
    "aberration ± 0.5 px": Condition(aberration_px=0.5),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boards", type=int, default=12)
    parser.add_argument("--blur", type=float, default=0.7, help="standard deviation of the lens blur, px")
    parser.add_argument("--jobs", type=int)
    arguments = parser.parse_args()
    works = [(name, number) for name in CONDITIONS for number in range(arguments.boards)]
    run = partial(corner_errors, arguments.boards, arguments.blur)
    outcomes = [outcome.value for outcome in fan_out(run, works, jobs=arguments.jobs, processes=True)]
    print(f"| input to the detector | {' | '.join(CONDITIONS)} |\n|---|{'---:|' * len(CONDITIONS)}")
    for row in WAYS:
        cells = []
        for name in CONDITIONS:
            squared = [errors[row] for (condition, _), errors in zip(works, outcomes, strict=True) if condition == name]
            cells.append(f"{1e3 * np.sqrt(np.mean(np.concatenate(squared))):.1f}")
        print(f"| {row} | {' | '.join(cells)} |")


def corner_errors(boards: int, blur: float, work: tuple[str, int]) -> dict[str, np.ndarray]:
    """Return the squared distances (N,) of every way's corners from the truth, of one board in one condition."""
    condition, number = CONDITIONS[work[0]], work[1]
    pose = views(LENS, BOARD, boards, rng=np.random.default_rng(1))[number]
    truth = LENS.project(pose.apply(BOARD.points())).pixels
    exposure = Exposure(blur_px=blur)
    shade = light(SIZE, exposure, 0.3 + number)
    cameras = lenses(LENS, condition.aberration_px)
    seen = {camera: evenly_lit(camera, BOARD, pose, exposure) * shade for camera in set(cameras.values())}
    brightness = {colour: seen[camera] for colour, camera in cameras.items()}
    weights = dict(zip("RGB", condition.light, strict=True))
    mosaic = filter_mosaic(PATTERN, {colour: weights[colour] * image for colour, image in brightness.items()})
    rng = np.random.default_rng([number, condition.noisy])
    frames = [
        Mosaic(counts(image, condition.noisy, rng), PATTERN, np.full((2, 2), BLACK), WHITE)
        for image in (mosaic, brightness["G"])
    ]
    return {name: np.sum((way(*frames) - truth) ** 2, axis=1) for name, way in WAYS.items()}


def counts(brightness: np.ndarray, noisy: bool, rng: np.random.Generator) -> np.ndarray:
    """Return what the sensor reads of a brightness (H, W) in shares of full scale."""
    electrons = brightness * WELL_E
    if noisy:
        electrons = rng.poisson(electrons) + READ_E * rng.standard_normal(electrons.shape)
    return np.clip(np.rint(BLACK + electrons * (WHITE - BLACK) / WELL_E), 0, WHITE).astype(np.uint16)


def corners(gray: np.ndarray, samples: MaskedImage | None = None) -> np.ndarray:
    """Return all corners (N, 2) of the board in an image."""
    detection = detect(gray, BOARD, samples=samples)
    if len(detection.ids) != BOARD.count:
        raise SystemExit(f"{len(detection.ids)} of {BOARD.count} corners found")
    return detection.pixels


def read_as(algorithm: str) -> Callable[[Mosaic, Mosaic], np.ndarray]:
    """Return the way that `camcal detect --algorithm` goes."""

    def find(mosaic: Mosaic, _mono: Mosaic) -> np.ndarray:
        image = detection_image_of(mosaic, ImageReadOptions(algorithm=algorithm))
        return corners(image.gray, image.samples)

    return find


def developed(algorithm: str) -> Callable[[Mosaic, Mosaic], np.ndarray]:
    """Return the way over a demosaicing filter of camcal, balanced first, to a gray or a green image."""

    def find(mosaic: Mosaic, _mono: Mosaic) -> np.ndarray:
        pixels = demosaic(balanced(mosaic), PATTERN, algorithm)
        return corners(gray_8bit(pixels))

    return find


def half(mosaic: Mosaic, _mono: Mosaic) -> np.ndarray:
    return 2 * corners(gray_8bit(demosaic(balanced(mosaic), PATTERN, "half")[:, :, 1])) + 0.5


def peer(code: int) -> Callable[[Mosaic, Mosaic], np.ndarray]:
    """Return the way over OpenCV's demosaicing of 8 bits, balanced first; its border of two pixels is its own."""

    def find(mosaic: Mosaic, _mono: Mosaic) -> np.ndarray:
        values = np.rint(255 * np.clip(balanced(mosaic), 0, 1)).astype(np.uint8)
        colour = cv2.demosaicing(values, code)
        return corners(colour if colour.ndim == 2 else cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY))

    return find


def balanced(mosaic: Mosaic) -> np.ndarray:
    values = linearise(mosaic)
    balance_in_place(values, PATTERN, agreeing_gains(values, PATTERN))
    return values


WAYS: Mapping[str, Callable[[Mosaic, Mosaic], np.ndarray]] = {
    "monochrome sensor": lambda _mosaic, mono: corners(gray_8bit(mono.values)),
    "camcal gray": read_as("gray"),
    "camcal green": read_as("green"),
    "green, gaps filled": developed("green"),
    "half-size green": half,
    "ri → gray": developed("ri"),
    **{f"OpenCV {name} → gray": peer(code) for name, code in CODES.items()},
}


if __name__ == "__main__":
    main()
