"""Time offsets, clock rates and readout times by the motion of a board, against simulated truth (timed_scenes.py).

A board moved by hand (a sum of sinusoids, no spline) before two cameras of 30 frames per second whose clocks are up to
30 frames and 50 ppm apart, corners with noise of 0.1 px, 5 % of the frames missing. Per row of the table: RMS and
largest error, of offsets in frames, of readout times in percent, the RMS of the reported standard deviations, and how
often the truth lies within 1.96 of them.

    python benchmarks/moving_board_times.py [--runs 110] [--first-seed 0] [--frames 200] [--readout MS] [--speed 30]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from pathlib import Path

import numpy as np

from camcal.calibrate.intrinsics import Options, compare_models
from camcal.calibrate.timing.calibrate import TimedCamera, time_cameras

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from timed_scenes import BOARD, LENS, Clocked, by_hand

FPS = 30.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=110)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--readout", type=float, default=0.0, help="of the left camera, ms; 0 for global shutters")
    parser.add_argument("--speed", type=float, default=30.0, help="of the board, degrees per second")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    found = [run(seed, arguments.frames, 1e-3 * arguments.readout, arguments.speed) for seed in seeds]
    print(f"{'':30} {'runs':>5} {'RMS':>9} {'largest':>9} {'claimed':>9} {'within 1.96 std':>16}")
    for name in found[0]:
        errors, stds = np.array([own[name] for own in found]).T
        inside = np.mean(np.abs(errors) < 1.96 * stds)
        rms, largest, claimed = np.sqrt(np.mean(errors**2)), np.abs(errors).max(), np.sqrt(np.mean(stds**2))
        print(f"{name:30} {len(errors):5} {rms:9.2g} {largest:9.2g} {claimed:9.2g} {100 * inside:14.1f} %")


def run(seed: int, frames: int, readout: float, speed: float) -> dict[str, tuple[float, float]]:
    """Return errors and standard deviations."""
    rng = np.random.default_rng(seed)
    offset, rate = rng.uniform(-30, 30) / FPS, rng.uniform(-50e-6, 50e-6)
    motion = by_hand(rng, speed, speed / 200)
    right = {"turn": (0.02, -0.2, 0.01), "place": (0.02, 0.01, 0.05), "offset": offset, "rate": rate}
    both = {"left": Clocked(readout=readout), "right": Clocked(readout=0.8 * readout, **right)}
    cameras = {}
    for name, camera in both.items():
        views = camera.views(motion, frames, rng, 0.1, dropped=0.05, name=name)
        [lens] = compare_models(views, BOARD, Options(LENS.model), [LENS.model])
        cameras[name] = TimedCamera(lens.calibration, views, as_designed=True)
    times = time_cameras(cameras, offsets=True, shutter=readout > 0).cameras
    own = times["right"]
    result = {
        "offset, frames": (FPS * (own.offset - offset - rate * own.reference), FPS * own.offset_std),
        "rate, ppm": (1e6 * (own.rate - rate), 1e6 * own.rate_std),
    }
    if readout:
        apart = (both["right"].readout - readout) / 2
        error = own.middle_offset - offset - rate * own.reference - apart
        result["offset of middle rows, frames"] = FPS * error, FPS * own.middle_offset_std
    for name, camera in both.items() if readout else ():
        share = 100 / camera.readout
        error = times[name].readout - camera.readout
        result[f"readout of {name}, %"] = (share * error, share * times[name].readout_std)
    return result


if __name__ == "__main__":
    main()
