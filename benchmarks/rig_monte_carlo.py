"""Whether the covariances of a rig are true: the same captures measured again and again with fresh errors.

The captures are those of rig_scenes.py: poses and rig stay as they are, errors of corners and motions of the board are
drawn for each run. Per row of the table:
NEES/dof: the mean over the runs of the squared error of all transforms camera_T_first (six numbers each), normalised by
    the reported covariance, per degree of freedom; 1 is right, with its 99 % interval under a right covariance beside.
std ratio: reported over empirical standard deviation, root mean squares over the runs, pooled as the geometric mean
    over the numbers of all cameras: of the baselines' lengths, of the translations and of the rotations (0.95 to 1.05
    wanted). bias: the largest mean error of one of these numbers in its standard deviation of the mean.
coverage: how often the truth lies within 1.96 reported standard deviations of a number.

Runs can be made in pieces: --save writes what the seeds gave, --read prints the table of all pieces in a folder.

    python benchmarks/rig_monte_carlo.py [--runs 1000] [--first-seed 0] [--cases NAME …] [--jobs 1] [--save FOLDER]
    python benchmarks/rig_monte_carlo.py --read FOLDER
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
from rig_programs import camcal_rig
from scipy.stats import chi2

from camcal.cameras.catalogue import model_named
from camcal.geometry import rotation as so3
from camcal.run.fanout import fan_out
from camcal.targets.board import Board

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import Errors, Scene, SimulatedRig, Transform, narrow_lens, observed, scene, wide_lens

BOARD = Board("chessboard", 9, 6, 0.025)
_SIZE = (1280, 960)


@dataclass(frozen=True)
class CaseOf:
    """A rig with captures, and the errors of a run."""

    scene: Scene
    errors: Errors


def _stereo(count: int = 20, bow: tuple[float, float] = (0.0, 0.0)) -> Scene:
    rng = np.random.default_rng(1)
    lenses = tuple(narrow_lens(rng, _SIZE, focal) for focal in (1150.0, 1165.0))
    poses = (Transform.of([0, 0, 0], [0, 0, 0]), Transform.of([0.01, -0.03, 0.005], [-0.12, 0.002, 0.004]))
    return scene(SimulatedRig(lenses, poses, BOARD, bow), count, 1)


def _three() -> Scene:
    rng = np.random.default_rng(2)
    lenses = tuple(narrow_lens(rng, _SIZE, focal) for focal in (1150.0, 1300.0, 900.0))
    poses = tuple(Transform.of([0, 0.25 * index, 0.02 * index], [-0.11 * index, 0, 0.02 * index]) for index in range(3))
    return scene(SimulatedRig(lenses, poses, BOARD, (4e-4, -2e-4)), 20, 2)


def _wide() -> Scene:
    rng = np.random.default_rng(3)
    lenses = tuple(wide_lens(rng, _SIZE, focal) for focal in (400.0, 405.0))
    poses = (Transform.of([0, 0, 0], [0, 0, 0]), Transform.of([0.02, 0.04, -0.01], [-0.10, 0.001, -0.003]))
    return scene(SimulatedRig(lenses, poses, BOARD), 20, 3)


@cache
def case(name: str) -> CaseOf:
    return {
        "stereo": lambda: CaseOf(_stereo(), Errors(0.1)),
        "stereo, 8 captures": lambda: CaseOf(_stereo(8), Errors(0.1)),
        "three cameras, bent board": lambda: CaseOf(_three(), Errors(0.1)),
        "wide lenses": lambda: CaseOf(_wide(), Errors(0.1)),
        "correlated errors": lambda: CaseOf(_stereo(), Errors(0.07, smooth=0.07)),
        "motion 0.3 mm": lambda: CaseOf(_stereo(), Errors(0.1, motion=3e-4)),
    }[name]()


CASES = (
    "stereo",
    "stereo, 8 captures",
    "three cameras, bent board",
    "wide lenses",
    "correlated errors",
    "motion 0.3 mm",
)


@dataclass(frozen=True, eq=False)
class Run:
    """One measurement: errors (6 N,) of the transforms of N cameras, the reported covariance, errors (N,) of the
    baselines' lengths with their reported standard deviations; what was said.
    """

    errors: np.ndarray
    covariance: np.ndarray
    lengths: np.ndarray
    length_stds: np.ndarray
    said: tuple[str, ...]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--save", type=Path, help="folder for what these runs give")
    parser.add_argument("--read", type=Path, help="print the table of all runs in a folder")
    arguments = parser.parse_args()
    if arguments.read:
        table({name: _read(arguments.read, name) for name in arguments.cases})
        return
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    found = {}
    for name in arguments.cases:
        outcomes = list(fan_out(partial(run, name), seeds, jobs=arguments.jobs, processes=True))
        for outcome in outcomes:
            if outcome.error is not None:
                print(f"# {name}, seed {outcome.item}: {outcome.error}", file=sys.stderr)
        found[name] = [outcome.value for outcome in outcomes if outcome.value is not None]
        if arguments.save:
            _save(arguments.save, name, arguments.first_seed, found[name])
    table(found)


def run(name: str, seed: int) -> Run:
    own = case(name)
    rig = own.scene.rig
    result = camcal_rig(observed(own.scene, own.errors, seed), rig.board, model_named(rig.lenses[0].model))
    errors, lengths, stds = [], [], []
    for camera, truth in list(zip(rig.cameras, rig.poses, strict=True))[1:]:
        pose, covariance = result.poses[camera], result.pose_covariance(camera)
        turn = so3.log(pose.rotation @ truth.rotation.T)
        errors.append(np.append(pose.translation - truth.translation, turn))
        length = np.linalg.norm(pose.translation)
        along = pose.translation / length
        lengths.append(length - np.linalg.norm(truth.translation))
        stds.append(np.sqrt(along @ covariance[:3, :3] @ along))
    names = [name for name in result.names if "_T_" in name]
    said = tuple(message.code for message in (*result.warnings, *result.failures)) + ("motion",) * bool(result.motion)
    covariance = result.covariance_of(tuple(names))
    return Run(np.concatenate(errors), covariance, np.array(lengths), np.array(stds), said)


def _save(folder: Path, name: str, first: int, runs: Sequence[Run]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {key: np.stack([getattr(own, key) for own in runs]) for key in ("errors", "covariance", "lengths")}
    stds, said = np.stack([own.length_stds for own in runs]), np.array([" ".join(own.said) for own in runs])
    np.savez(folder / f"{CASES.index(name)}-{first:06d}.npz", **arrays, length_stds=stds, said=said)


def _read(folder: Path, name: str) -> list[Run]:
    runs = []
    for path in sorted(folder.glob(f"{CASES.index(name)}-*.npz")):
        with np.load(path) as file:
            keys = ("errors", "covariance", "lengths", "length_stds")
            runs += [
                Run(*values, said=tuple(said.split()))
                for *values, said in zip(*(file[key] for key in keys), file["said"].tolist(), strict=True)
            ]
    return runs


def table(found: dict[str, list[Run]]) -> None:
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    print(
        f"{'case':26} {'runs':>5} {'NEES/dof':>9} {'99 % interval':>15} | {'baseline':>8} {'translation':>11} "
        f"{'rotation':>8} {'bias':>5} {'coverage':>9} | said"
    )
    for name, runs in found.items():
        if len(runs) > 1:
            print(f"{name:26} {words_of(runs)}", flush=True)


def words_of(runs: Sequence[Run]) -> str:
    errors, covariances = (np.stack([getattr(own, key) for own in runs]) for key in ("errors", "covariance"))
    lengths, length_stds = (np.stack([getattr(own, key) for own in runs]) for key in ("lengths", "length_stds"))
    dof = errors.shape[1]
    nees = np.einsum("ri,ri->r", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]).mean() / dof
    low, high = chi2.ppf([0.005, 0.995], dof * len(runs)) / (dof * len(runs))
    stds = np.sqrt(np.einsum("rii->ri", covariances))
    shift = np.arange(dof) % 6 < 3
    pooled = [
        ratio_of(own_stds, own)
        for own_stds, own in (
            (length_stds, lengths),
            (stds[:, shift], errors[:, shift]),
            (stds[:, ~shift], errors[:, ~shift]),
        )
    ]
    bias = np.abs(errors.mean(axis=0) / errors.std(axis=0, ddof=1)).max() * np.sqrt(len(runs))
    coverage = (np.abs(errors) < 1.96 * stds).mean()
    said = Counter(code for own in runs for code in own.said)
    return (
        f"{len(runs):5d} {nees:9.4f} {low:7.4f} {high:7.4f} | {pooled[0]:8.3f} {pooled[1]:11.3f} {pooled[2]:8.3f} "
        f"{bias:5.1f} {100 * coverage:7.2f} % | {', '.join(f'{code} {count}' for code, count in said.most_common(4))}"
    )


def ratio_of(stds: np.ndarray, errors: np.ndarray) -> float:
    """Return the reported over the empirical standard deviation, the geometric mean over the numbers."""
    return float(np.exp(np.log(np.sqrt((stds**2).mean(axis=0)) / errors.std(axis=0, ddof=1)).mean()))


if __name__ == "__main__":
    main()
