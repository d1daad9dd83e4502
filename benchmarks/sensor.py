"""Gain, read noise, full well and dynamic range of simulated sensors, beside what they were made with.

Random sensors: 0.05 to 8 counts per electron, 1 to 20 electrons of read noise (0.4 counts at least), 5 000 to 100 000
electrons of full well, 10 to 16 bits (the white level lets at least a fifth of the full well through), black level 0 to
512. Each is seen as a user would: two frames at each of 12 levels of light, 16 dark frames, 640 x 480, unbalanced
colours and vignetting, and a little PRNU and DSNU.

    python benchmarks/sensor.py [--sensors 24] [--seed 1]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterator
from math import log10

import numpy as np

from camcal.raw.emva import Characterisation, characterise
from camcal.raw.level import Level, measure_level
from camcal.raw.mosaic import Mosaic
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series
from camcal.simulate.options import Sensor

SIZE, LEVELS, DARKS, VIGNETTING = (640, 480), 12, 16, 0.1
LIGHT = (0.5, 1.0, 0.6)
SMALLEST_NOISE_DN = 0.4
FIGURES = {"gain": ("%", 1.0), "read noise": ("%", 3.0), "full well": ("%", 2.0), "dynamic range": (" dB", 0.3)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print("| gain DN/e | read noise e (DN) | full well e | bits | black |", " | ".join(FIGURES), "| ends at |")
    print("|" + "---|" * (6 + len(FIGURES)))
    worst = dict.fromkeys(FIGURES, 0.0)
    begin = time.perf_counter()
    for _ in range(arguments.sensors):
        sensor = random_sensor(rng)
        found = measured(sensor, rng)
        errors = errors_of(found, sensor)
        worst = {name: max(worst[name], abs(error)) for name, error in errors.items()}
        print(row(sensor, found, errors))
    cells = [f"{worst[name]:.2f}{unit} of {limit:g}" for name, (unit, limit) in FIGURES.items()]
    print("| worst | | | | |", " | ".join(cells), "| |")
    print(
        f"\n{arguments.sensors} sensors, {(time.perf_counter() - begin) / arguments.sensors:.1f} s each with rendering"
    )
    failed = [name for name, (_, limit) in FIGURES.items() if worst[name] > limit]
    print("all within their limits" if not failed else f"BEYOND THE LIMIT: {', '.join(failed)}")


def random_sensor(rng: np.random.Generator) -> Sensor:
    """Return a sensor as somebody might build one: the counts have room for the well, the noise for the counts."""
    while True:
        gain, full_well = np.exp(rng.uniform(np.log([0.05, 5e3]), np.log([8, 1e5])))
        read_noise, bits = np.exp(rng.uniform(0, np.log(20))), int(rng.integers(10, 17))
        black = float(rng.integers(0, 513))
        room = (2**bits - 1 - black) / gain
        if gain * read_noise >= SMALLEST_NOISE_DN and room > max(full_well / 5, 50 * read_noise):
            return Sensor(gain, read_noise, full_well, black, bits, prnu=rng.uniform(0, 0.01), dsnu_e=rng.uniform(0, 2))


def measured(sensor: Sensor, rng: np.random.Generator) -> Characterisation:
    raw = RawCamera("RGGB", sensor, LIGHT)
    fixed = FixedPattern.of(sensor, SIZE, rng)
    shots = exposure_series(raw, LEVELS, VIGNETTING)
    flats = [level(raw, shot, 2, fixed, rng) for shot in shots]
    darks = [level(raw, Shot(shot.exposure_s, 0.0), DARKS // 2, fixed, rng) for shot in (shots[0], shots[-1])]
    return characterise(flats, darks)


def level(raw: RawCamera, shot: Shot, count: int, fixed: FixedPattern, rng: np.random.Generator) -> Level:
    def frames() -> Iterator[Mosaic]:
        for _ in range(count):
            values = even_frame(raw, shot, VIGNETTING, fixed=fixed, rng=rng)
            yield Mosaic(values, raw.pattern, np.zeros((2, 2)), raw.sensor.white_dn)

    return measure_level(frames(), shot.exposure_s)


def errors_of(found: Characterisation, sensor: Sensor) -> dict[str, float]:
    """Return the errors in percent, that of the dynamic range in decibels."""
    figures = found.figures
    pairs = [
        (figures.gain_dn_per_e, sensor.gain_dn_per_e),
        (figures.read_noise_e, sensor.read_noise_e),
        (figures.full_well_e, sensor.saturation_e),
    ]
    shares = [100 * (figure.value / true - 1) for figure, true in pairs]
    true_range = 20 * log10(sensor.saturation_e / sensor.read_noise_e)
    return dict(zip(FIGURES, [*shares, figures.dynamic_range_db.value - true_range], strict=True))


def row(sensor: Sensor, found: Characterisation, errors: dict[str, float]) -> str:
    noise_dn = sensor.gain_dn_per_e * sensor.read_noise_e
    limited = ", rounding limits" if found.limited else ""
    truth = (
        f"{sensor.gain_dn_per_e:.4g} | {sensor.read_noise_e:.2f} ({noise_dn:.2f}{limited}) | {sensor.saturation_e:.0f}"
    )
    cells = [f"{errors[name]:+.2f}{unit}" for name, (unit, _) in FIGURES.items()]
    return f"| {truth} | {sensor.bits} | {sensor.black_dn:.0f} | {' | '.join(cells)} | {found.saturation} |"


if __name__ == "__main__":
    main()
