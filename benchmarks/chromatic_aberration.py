"""Lateral chromatic aberration from raw frames, against the truth: red 0.5 px outside, blue 0.5 px inside of green.

Per seed 20 views of a 9 x 6 board, 1280 x 960, RGGB, 12 bits, photon noise and 4 electrons of read noise, rendered,
written, detected and calibrated by `camcal calibrate --channels`. Errors are distances, in 1/1000 px, between the
estimated and the true displacement of red and of blue against green: over the whole image (RMS), where it is largest
(the four corners of the image, in which no board was seen, are part of it), and at the corner itself beside its
reported standard deviation. pull: the RMS over seeds and colours of that error over that deviation; 1 is right.

    python benchmarks/chromatic_aberration.py [--seeds 4] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from camcal.cameras.model import Camera
from camcal.images.files import save
from camcal.raw.demosaic import demosaic
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_mosaic
from camcal.simulate.mosaics import lenses
from camcal.simulate.options import Sensor
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.simulation.options import RawOptions, SimulateOptions
from camcal.tasks.simulation.simulate import simulate

BOARD, PATTERN, ABERRATION_PX = "chessboard:9x6:40mm", "RGGB", 0.5
NAMES = {"red": "R", "blue": "B"}
DIM = Sensor(gain_dn_per_e=1.0, full_well_e=4000.0)


@dataclass(frozen=True)
class Condition:
    """How frames are taken and read: the sensor, what light red, green and blue get, the blur, and as what images."""

    sensor: Sensor = field(default_factory=Sensor)
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur_px: float = 0.7
    demosaiced: bool = False


CONDITIONS = {
    "15000 e⁻": Condition(),
    "15000 e⁻, light .5/1/.6": Condition(light=(0.5, 1.0, 0.6)),
    "4000 e⁻, light .5/1/.6": Condition(DIM, (0.5, 1.0, 0.6)),
    "15000 e⁻, blur 0.4 px": Condition(blur_px=0.4),
    "15000 e⁻, demosaiced with ri": Condition(demosaiced=True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--jobs", type=int)
    arguments = parser.parse_args()
    print("| frames | RMS | largest | at the corner: RMS error | reported std | pull |\n|---|---:|---:|---:|---:|---:|")
    for name, condition in CONDITIONS.items():
        rows = np.array([row for seed in range(arguments.seeds) for row in run(condition, seed, arguments.jobs)])
        everywhere, largest, corner, std = (1e3 * rows).T
        figures = [rms(everywhere), largest.max(), rms(corner), rms(std)]
        print(f"| {name} | {' | '.join(f'{value:.2f}' for value in figures)} | {rms(corner / std):.2f} |", flush=True)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def run(condition: Condition, seed: int, jobs: int | None) -> Iterator[tuple[float, float, float, float]]:
    """Yield for red and for blue the RMS and the largest error, the error at the corner and its reported deviation."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        raw = RawOptions(PATTERN, condition.sensor, condition.light, ABERRATION_PX)
        options = SimulateOptions(folder / "scene", BOARD, blur=condition.blur_px, seed=seed, jobs=jobs, raw=raw)
        truth = simulate(options).truth.camera
        report = calibrate_folder(folder, condition, jobs)
    green = report.calibration.camera
    for colour, channel in report.channels.items():
        true = lenses(truth, ABERRATION_PX)[NAMES[colour]]
        errors = displacement(green, channel.lens.camera) - displacement(truth, true)
        lengths = np.linalg.norm(errors, axis=1)
        # the corner furthest from the principal point is one aberration away, by definition
        corner = channel.aberration.corner_px - (ABERRATION_PX if colour == "red" else -ABERRATION_PX)
        yield rms(lengths), float(lengths.max()), corner, channel.aberration.corner_std_px


def calibrate_folder(folder: Path, condition: Condition, jobs: int | None) -> CalibrateReport:
    images, reading = folder / "scene" / "images", ImageReadOptions(PATTERN, colours=True)
    if condition.demosaiced:
        for path in sorted(images.glob("*.png")):
            colour = demosaic(read_mosaic(path, PATTERN).values, PATTERN, "ri", white=condition.sensor.white_dn)
            save(folder / "developed" / path.name, colour)
        images, reading = folder / "developed", ImageReadOptions(colours=True)
    return calibrate(CalibrateOptions((str(images),), folder / "camera.yaml", BOARD, jobs=jobs, reading=reading))


def displacement(green: Camera, colour: Camera) -> np.ndarray:
    """Return how far (N, 2) a colour lies from green over a lattice of pixels of the whole image."""
    width, height = green.image_size
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 41), np.linspace(0, height - 1, 31)), axis=-1)
    pixels = pixels.reshape(-1, 2)
    return colour.project(green.unproject(pixels).directions).pixels - pixels


if __name__ == "__main__":
    main()
