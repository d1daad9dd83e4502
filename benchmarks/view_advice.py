"""Whether the views that `camcal advise` suggests are worth taking, and lower the uncertainty as forecast.

A start is a calibration of 5 to 10 views at random of a camera drawn at random (narrow or wide lens, noise of 0.1 to
0.3 px, one of two boards). Half of the starts have views of camcal's simulation, the others of tests/rig_scenes.py;
--smooth adds errors that are smooth over the board to every view. The three suggested views are taken (with the true
camera: where the estimated one is wrong, they are not quite where they should be), and 20 times three views at random
of the same generator. Of these triples the best is the one with the least expected error, by the normal equations at
the true camera and poses. Every set of views is measured --repeats times with fresh noise, from the start on, and
calibrated; the true error is the RMS difference from the true camera over the image, a rotation left out, over them.

won: starts whose suggested views have at most the expected error of the best of 20 triples; measured: at most its true
error (0.8 wanted). error: geometric means over the starts, px, before, of the median triple (expected over suggested,
times the true error of these), of the best triple, of the suggested views. forecast / error: root mean square over the
starts of the true error in units of the forecast, inverted (0.8 to 1.2 wanted); forecast / stated: median of the ratio
to what the calibrations with the suggested views state.

    python benchmarks/view_advice.py [--starts 50] [--repeats 8] [--smooth 0.1] [--jobs 1]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from functools import partial
from pathlib import Path

import numpy as np

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import direction_displacements, grid_pixels, lens_difference
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.errors import CamcalError
from camcal.geometry.pose import Pose
from camcal.quality.forecast import view_information
from camcal.quality.range_uncertainty import CalibrationBoards
from camcal.quality.view_advice import Known, advise
from camcal.run.fanout import fan_out
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board, Surface

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import Errors, SimulatedRig, _errors, narrow_lens, scene, wide_lens
from rig_scenes import Transform as Place

SIZE = (1280, 960)
BOARDS = Board("chessboard", 9, 6, 0.025), Board("chessboard", 11, 8, 0.02)
PIXELS = grid_pixels(np.linspace(0, SIZE[0] - 1, 21), np.linspace(0, SIZE[1] - 1, 16))
TRIPLES = 20


class Start:
    """A camera and a board, and views of it at random."""

    def __init__(self, seed, smooth):
        rng = np.random.default_rng([seed, 1])
        self.board, self.noise, self.smooth = BOARDS[rng.integers(2)], rng.uniform(0.1, 0.3), smooth
        self.rng, self.seed, wide = rng, seed, rng.random() < 0.3
        self.count = int(rng.integers(5, 11))
        self.scenes = seed % 2 == 1
        if self.scenes:
            lens = wide_lens(rng, SIZE, 420.0) if wide else narrow_lens(rng, SIZE, rng.uniform(900, 1400))
            self.camera = Camera(model_named(lens.model), SIZE, lens.parameters)
            self.rig = SimulatedRig((lens,), (Place.of([0, 0, 0], [0, 0, 0]),), self.board)
        else:
            model = "kannala_brandt4" if wide else "opencv5"
            self.camera = make_camera(model_named(model), SIZE, np.radians(115 if wide else rng.uniform(50, 75)))

    def poses(self, count):
        """Return poses at random."""
        if not self.scenes:
            return views(self.camera, self.board, count, rng=self.rng)
        made = scene(self.rig, count, int(self.rng.integers(1 << 31)))
        return [Pose(own.rotation, own.translation) for own in made.boards]

    def calibrated(self, poses, repeat):
        """Return the calibration of views from poses, measured with fresh noise."""
        rng = np.random.default_rng([self.seed, repeat, 2])
        found = observe(self.camera, self.board, poses, rng=rng, noise_px=self.noise)[0].views
        if self.smooth:
            waves = [_errors(self.board, Errors(0.0, smooth=self.smooth), rng) for _ in found]
            found = [replaced(view, view.pixels + wave[view.ids]) for view, wave in zip(found, waves, strict=True)]
        return calibrate(found, self.board, Options(self.camera.model))

    def error(self, camera):
        """Return the mean squared difference from the truth, px² of a coordinate."""
        apart = lens_difference(self.camera, camera, PIXELS)
        return np.nanmean(np.sum(apart**2, axis=1)) / 2

    def expected(self, poses):
        """Return the expected error (px, RMS of a coordinate) of a calibration of views from poses."""
        exact = observe(self.camera, self.board, poses, rng=np.random.default_rng(0))[0].views
        surface, spread = Surface.flat(self.board), self.camera.model.prior_std(SIZE, self.camera.value("fx"))
        information = view_information(self.camera, surface, Observations.of(exact), poses, self.noise).sum(axis=0)
        covariance = np.linalg.inv(information + np.diag(spread**-2.0))
        moved = direction_displacements(self.camera, PIXELS)
        return np.sqrt(np.nanmean(np.einsum("nik,kl,nil->n", moved, covariance, moved)) / 2)


def replaced(view, pixels):
    return type(view)(view.image, view.size, view.ids, pixels)


def stated(camera):
    """Return the variance (px² of a coordinate) over the image that a calibration states."""
    moved = direction_displacements(camera, PIXELS)
    return np.nanmean(np.einsum("nik,kl,nil->n", moved, camera.covariance, moved)) / 2


def run(repeats, smooth, seed):
    """Return the true errors of a start before, with the best triple, with the suggested views, the expected errors of
    the suggested views and the triples, forecast and stated ones.
    """
    start = Start(seed, smooth)
    for attempt in range(5):
        poses = start.poses(start.count)
        try:
            first = start.calibrated(poses, 0)
            break
        except CamcalError:  # views at random that no calibration can be made from
            if attempt == 4:
                raise
    boards = CalibrationBoards.of(first)
    distances = boards.nearest, boards.farthest
    known = Known(first.camera, first.surface, first.sigma_px, distances, boards.noise_share)
    advice = advise(known)
    triples = [start.poses(3) for _ in range(TRIPLES)]
    suggested = [view.pose for view in advice.views]
    expected = np.array([start.expected([*poses, *further]) for further in (suggested, *triples)])
    best = triples[int(np.argmin(expected[1:]))]
    squares, said = [], []
    for further in ([], best, suggested):
        found = []
        for repeat in range(1, repeats + 1):
            try:
                own = start.calibrated([*poses, *further], repeat).camera
            except CamcalError:
                continue
            found.append(start.error(own))
            if further is suggested:
                said.append(stated(own))
        squares.append(np.mean(found) if found else np.inf)
    return (*np.sqrt(squares), expected, advice.views[-1].std_px, np.sqrt(np.mean(said)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--smooth", type=float, default=0.0, help="px, RMS of errors that are smooth over the board")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.starts)
    found = []
    work = partial(run, arguments.repeats, arguments.smooth)
    for outcome in fan_out(work, seeds, jobs=arguments.jobs, processes=True):
        if outcome.error is not None:
            print(f"# start {outcome.item}: {outcome.error}", file=sys.stderr)
        else:
            found.append((outcome.item, *outcome.value))
    print(
        "| starts | won | measured | error before | median triple | best triple | suggested | forecast / error | "
        "forecast / stated |\n|---|---|---|---|---|---|---|---|---|"
    )
    for name, chosen in (
        ("simulated", [each[1:] for each in found if each[0] % 2 == 0]),
        ("scenes", [each[1:] for each in found if each[0] % 2 == 1]),
        ("all", [each[1:] for each in found]),
    ):
        if chosen:
            print(f"| {len(chosen)} {name} | {row(chosen)} |")


def row(chosen):
    before, best, own, expected, forecast, said = (np.array(column) for column in zip(*chosen, strict=True))
    median = own * np.median(expected[:, 1:], axis=1) / expected[:, 0]
    sizes = [f"{np.exp(np.mean(np.log(each))):.3g} px" for each in (before, median, best, own)]
    won = np.mean(expected[:, 0] <= expected[:, 1:].min(axis=1)), np.mean(own <= best)
    shown = [f"{each:.2f}" for each in (*won, 1 / np.sqrt(np.mean((own / forecast) ** 2)), np.median(forecast / said))]
    return " | ".join([*shown[:2], *sizes, *shown[2:]])


if __name__ == "__main__":
    main()
