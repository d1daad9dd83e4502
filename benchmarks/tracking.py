"""Tracking a tag or a board in simulated video: single poses, an average, a plain filter, and what `camcal track` does.

Four scenes of 240 frames at 30 a second, 10 % of the frames dropped: a tag of 100 mm that is 80 pixels wide at first
and goes away to 31, with a motion that is what the filter takes it for; the same with 5 % of the frames gone wrong; a
tag of 53 pixels that sways, and a board of 35 points that sways, both with 5 % gone wrong. Every figure is the root
mean square over all runs, rotation in degrees and translation in mm, of the frames that a method gives a pose for. NIS
is of one degree of freedom, NEES the median of it; both are 1 if the uncertainty is right.

Run: python benchmarks/tracking.py [--runs 8]
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import motion

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseEstimate, PoseOptions
from camcal.estimate.poses.states import steps_from
from camcal.estimate.tracking.measurements import PoseMeasurements
from camcal.estimate.tracking.motion import FreeMotion, MotionState
from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import Track, TrackOptions, track_poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, Trajectory

STAMPS = np.arange(240) / 30
NOISE_PX = 0.3
TILT = 0.6  # rad
CAMERA = Camera(model_named("pinhole"), (1280, 960), np.array([800.0, 800.0, 639.5, 479.5]))
TAG = np.array([[-0.05, 0.05, 0.0], [0.05, 0.05, 0.0], [0.05, -0.05, 0.0], [-0.05, -0.05, 0.0]])
BOARD = np.array([[0.03 * (column - 3), 0.03 * (row - 2), 0.0] for row in range(5) for column in range(7)])
DENSITIES = 0.02, 0.5
EMA = 0.4
FARTHER = 1.6  # m in the whole time

Places = tuple[Array, Array]  # rotations (N, 3, 3) and translations (N, 3), NaN where there is none


@dataclass(frozen=True)
class Scene:
    """An object, how far away it is (m), whether it sways or drifts away, and the share of frames gone wrong."""

    name: str
    points: Array
    distance: float
    sways: bool
    outliers: float

    def make(self, run: int) -> tuple[Trajectory, list[PoseEstimate | None]]:
        """Return the truth and the single poses of a run."""
        rng = np.random.default_rng([len(self.name), run])
        about = rng.uniform(0, 2 * np.pi)
        facing = so3.exp(TILT * np.array([np.cos(about), np.sin(about), 0.0])) @ so3.about_x(np.pi)
        middle = Pose(facing, np.array([0.0, 0.0, self.distance]))
        moved = (
            motion.swaying(STAMPS, middle, 0.1, 0.3, rng)
            if self.sways
            else leaving(motion.drifting(STAMPS, middle, DENSITIES, rng))
        )
        seen = motion.seen(CAMERA, self.points, moved, NOISE_PX, rng, dropped=0.1, outliers=self.outliers)
        views = [
            Correspondences(str(index), self.points, pixels) for index, pixels in enumerate(seen) if pixels is not None
        ]
        found = {one.item.image: one.value for one in estimate_poses(CAMERA, views, PoseOptions(noise_px=NOISE_PX))}
        return moved, [found.get(str(index)) for index in range(len(STAMPS))]


def leaving(moved: Trajectory) -> Trajectory:
    """Return a motion with a constant velocity away from the camera added."""
    away = moved.translations + moved.stamps[:, None] / moved.stamps[-1] * [0.0, 0.0, FARTHER]
    return replace(moved, translations=away)


SCENES = (
    Scene("80 px tag", TAG, 1.0, sways=False, outliers=0.0),
    Scene("80 px tag, 5 % wrong", TAG, 1.0, sways=False, outliers=0.05),
    Scene("53 px tag sways, 5 % wrong", TAG, 1.5, sways=True, outliers=0.05),
    Scene("board sways, 5 % wrong", BOARD, 1.0, sways=True, outliers=0.05),
)


def single(estimates: Sequence[PoseEstimate | None]) -> Places:
    rotations, translations = np.full((len(estimates), 3, 3), np.nan), np.full((len(estimates), 3), np.nan)
    for index, estimate in enumerate(estimates):
        if estimate is not None:
            rotations[index], translations[index] = estimate.transform.rotation, estimate.transform.translation
    return rotations, translations


def averaged(estimates: Sequence[PoseEstimate | None]) -> Places:
    """Return the exponential moving average of single poses, which stands still in dropped frames."""
    rotations, translations = single(estimates)
    for index in range(1, len(estimates)):
        if np.isnan(translations[index, 0]) or np.isnan(translations[index - 1, 0]):
            kept = index - 1 if np.isnan(translations[index, 0]) else index
            rotations[index], translations[index] = rotations[kept], translations[kept]
            continue
        turn = so3.log(rotations[index] @ rotations[index - 1].T)
        rotations[index] = so3.exp(EMA * turn) @ rotations[index - 1]
        translations[index] = EMA * translations[index] + (1 - EMA) * translations[index - 1]
    return rotations, translations


def ungated(estimates: Sequence[PoseEstimate | None], noise: ProcessNoise) -> Places:
    """Return the poses of a filter that takes the best candidate of every frame, whatever it is."""
    seen = PoseMeasurements.of(STAMPS, estimates)
    motion = FreeMotion((noise.translation, noise.rotation), noise.fading)
    first = int(np.argmax(seen.present))
    state = MotionState(seen.rotations[first, 0], seen.translations[first, 0], np.zeros((motion.order, 6)))
    spread = np.diag(motion.unknown(float(np.linalg.norm(state.translations))))
    spread[:6, :6] = seen.covariances[first, 0]
    rotations, translations = np.full((len(seen), 3, 3), np.nan), np.full((len(seen), 3), np.nan)
    for index in range(first + 1, len(seen)):
        dt = np.array(STAMPS[index] - STAMPS[index - 1])
        state, growth = motion.forecast(state, dt)
        spread = growth @ spread @ growth.T + motion.covariance(dt)
        if seen.present[index]:
            step, _ = steps_from(
                seen.rotations[index, 0], seen.translations[index, 0], state.rotations, state.translations
            )
            gain = spread[:, :6] @ np.linalg.inv(spread[:6, :6] + seen.covariances[index, 0])
            state, spread = state.moved(gain @ step), spread - gain @ spread[:6]
        rotations[index], translations[index] = state.rotations, state.translations
    return rotations, translations


def errors(truth: Trajectory, places: Places) -> Array:
    """Return the steps (M, 6) from the truth to the poses that there are."""
    there = np.isfinite(places[1][:, 0])
    turns = so3.log(places[0][there] @ truth.rotations[there].swapaxes(-1, -2))
    return np.concatenate([places[1][there] - truth.translations[there], turns], axis=1)


def rms(steps: Sequence[Array]) -> str:
    every = np.concatenate(steps)
    turn, shift = (np.sqrt(np.mean(np.sum(every[:, part] ** 2, axis=1))) for part in (slice(3, 6), slice(3)))
    return f"{np.degrees(turn):.3g} / {1e3 * shift:.3g}"


def median_nees(track: Track, steps: Array) -> float:
    covariances = track.covariances[track.posed]
    return float(np.median(np.einsum("ni,nij,nj->n", steps, np.linalg.inv(covariances), steps))) / 6


def run_scene(scene: Scene, runs: int) -> list[str]:
    """Return the cells of a scene's column."""
    methods: dict[str, list[Array]] = {name: [] for name in METHODS}
    figures = []
    for run in range(runs):
        truth, estimates = scene.make(run)
        begun = time.process_time()
        smooth = track_poses(STAMPS, estimates, TrackOptions(fill=True))
        tuned = time.process_time()
        causal = track_poses(STAMPS, estimates, TrackOptions(smooth.noise, lag=0, fill=True))
        took = tuned - begun, time.process_time() - tuned
        found = (
            single(estimates),
            averaged(estimates),
            ungated(estimates, smooth.noise),
            (causal.rotations, causal.translations),
            (smooth.rotations, smooth.translations),
        )
        for name, places in zip(METHODS, found, strict=True):
            methods[name].append(errors(truth, places))
        nis = smooth.consistency.mean_nis if smooth.consistency else np.nan
        wrong = smooth.count("rejected")
        densities = smooth.noise.densities
        figures.append(
            [nis, median_nees(smooth, methods[METHODS[4]][-1]), wrong, smooth.segments.max() + 1, *densities, *took]
        )
    mean = np.mean(figures, axis=0)
    cells = [rms(steps) for steps in methods.values()]
    cells += [f"{mean[0]:.2f}, {mean[1]:.2f}", f"{mean[2]:.1f}, {mean[3]:.1f}", f"{mean[4]:.2g}, {mean[5]:.2g}"]
    return [*cells, f"{mean[6]:.2f}, {mean[7]:.2f}"]


METHODS = ("single frames", f"average, a = {EMA}", "filter, no gate, best candidate", "track --causal", "track")
ROWS = (*METHODS, "NIS, NEES", "left out, pieces", "densities found", "CPU seconds: tuned, not tuned")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=8)
    runs = parser.parse_args().runs
    columns = [run_scene(scene, runs) for scene in SCENES]
    widths = [max(map(len, (scene.name, *cells))) for scene, cells in zip(SCENES, columns, strict=True)]
    print(" " * 31, *(scene.name.rjust(width) for scene, width in zip(SCENES, widths, strict=True)), sep="  ")
    for index, row in enumerate(ROWS):
        print(
            row.ljust(31), *(cells[index].rjust(width) for cells, width in zip(columns, widths, strict=True)), sep="  "
        )


if __name__ == "__main__":
    main()
