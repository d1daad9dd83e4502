"""Poses from clean points: errors beside those of other solvers, and whether what is claimed of them is true.

A pinhole of 800 px, 1280 x 960; everything drawn has a fixed seed. Sections:
errors: RMS errors over those of the maximum-likelihood fit started at the truth, on the same trials (rotation /
    translation), among poses without gross error; gross: NEES/6 > 36 by that fit's covariance, or no pose.
coverage: NEES/6, and how often the 95 % region holds the truth: the noise known; estimated from that one view (F).
    Views whose pose is called ambiguous are left out: their region may stand around the other pose.
lens: NEES/6 with the focal length and principal point uncertain by (f, c) px, with and without propagation.
ambiguity: predicted and observed probability of the wrong one of a tag's two poses, of tags 20, 40 and 80 px wide that
    are tilted by up to 75 deg, in all directions alike.
rig: tags more than 10 deg wrong, by one camera and by two that are 0.5 m apart.
throughput: 1000 views of a 54-point board, all of them at once, over a loop of cv2.solvePnP and cv2.solvePnPRefineLM.
single: CPU time of one view alone, medians: that board with the noise given, 100 points of a plane half of which are
    wrong, and the share of a view in the time of all views at once, beside what OpenCV takes for the board's.

    python benchmarks/pnp.py [--trials 800] [--sections errors coverage …]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median
from typing import TypeVar

import cv2
import numpy as np
from peers.pose_solvers import matrix_of, plain_solvers

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera, Rig
from camcal.estimate.pnp import estimate_poses, estimate_rig_poses
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.packed_correspondences import PackedCorrespondences
from camcal.estimate.poses.pose_quality import region_quantile
from camcal.estimate.poses.problem import PoseProblems
from camcal.estimate.poses.records import AMBIGUOUS, Correspondences, PoseEstimate, PoseOptions
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

CAMERA = Camera(model_named("pinhole"), (1280, 960), np.array([800.0, 800.0, 639.5, 479.5]))
BOARD = np.array([[x - 4, y - 2.5, 0.0] for y in range(6) for x in range(9)]) * 0.03
TAG = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.05
CELLS = (
    (4, False, 0.5), (6, False, 0.5), (6, False, 2.0), (54, False, 0.5), (54, False, 2.0),
    (4, True, 0.5), (6, True, 0.5), (54, True, 0.5),
)  # fmt: skip
COVERED = ((4, False, 0.2), (6, False, 1.0), (54, False, 1.0), (4, True, 0.2), (6, True, 0.2), (54, True, 1.0))
GROSS = 36.0
Item = TypeVar("Item")


@dataclass(frozen=True)
class Trial:
    """A view and the pose it was made with."""

    view: Correspondences
    truth: Pose

    def error(self, found: Pose) -> np.ndarray:
        """Return the step (6,) from the truth to a pose."""
        return np.concatenate([found.translation - self.truth.translation, (found @ self.truth.inverse()).vector()])


def main() -> None:
    sections = {
        "errors": errors, "coverage": coverage, "lens": lens, "ambiguity": ambiguity, "rig": rig,
        "throughput": throughput, "single": single,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=800)
    parser.add_argument("--sections", nargs="*", choices=list(sections), default=list(sections))
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    for name in arguments.sections:
        print(f"\n{name}", flush=True)
        sections[name](arguments.trials)


def random_trials(count: int, points: int, noise: float, *, flat: bool, seed: int = 1) -> list[Trial]:
    """Return views of random points in a cube or square of one metre, 1.5 m to 3 m away, turned at random."""
    rng = np.random.default_rng(seed)
    trials = []
    for _ in range(count):
        places = rng.uniform(-0.5, 0.5, (points, 3)) * [1, 1, 0 if flat else 1]
        trials.append(trial(rng, places, noise, (1.5, 3.0)))
    return trials


def trial(rng: np.random.Generator, points: np.ndarray, noise: float, distance: tuple[float, float]) -> Trial:
    while True:
        place = np.append(rng.normal(0, 0.1 * distance[0], 2), rng.uniform(*distance))
        truth = Pose.from_vector(rng.normal(0, 0.6, 3), place)
        if truth.apply(points)[:, 2].min() > 0.1 * distance[0]:
            break
    pixels = CAMERA.project(truth.apply(points)).pixels + noise * rng.standard_normal((len(points), 2))
    return Trial(Correspondences("view", points, pixels), truth)


def references(trials: Sequence[Trial], noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (T, 6) of the fits started at the truth, and the inverse covariances (T, 6, 6)."""
    views = [each.view for each in trials]
    problems = PoseProblems.of((PackedCorrespondences.of(CAMERA, views, Pose.identity()),))
    minima = problems.minimise(se3.of_poses([each.truth for each in trials]), np.arange(len(trials)))
    found = [Pose(so3.nearest(state[:, :3]), state[:, 3]) for state in minima.states]
    errors = [each.error(pose) for each, pose in zip(trials, found, strict=True)]
    return np.array(errors), minima.models.normal / noise**2


def ratios(errors: np.ndarray, reference: np.ndarray, information: np.ndarray) -> str:
    """Return RMS errors (rotation / translation) over the reference's and the share of gross errors, as text."""
    nees = np.einsum("ti,tij,tj->t", errors, information, errors) / 6
    good = nees <= GROSS  # False for NaN
    if good.mean() < 0.5:
        return f"        - {100 * np.mean(~good):5.1f}%"
    rms = [np.sqrt(np.sum(each[good] ** 2, axis=0)) for each in (errors, reference)]
    turn, place = (np.linalg.norm(rms[0][part]) / np.linalg.norm(rms[1][part]) for part in (slice(3, 6), slice(3)))
    return f"{turn:5.2f}/{place:4.2f}{100 * np.mean(~good):5.1f}%"


def errors(trials: int) -> None:
    solvers = plain_solvers(CAMERA)
    print(
        f"{'':18}" + "".join(f"  {'plane' if flat else '3-D'} n={n} s={noise:g}".ljust(17) for n, flat, noise in CELLS)
    )
    table: dict[str, list[str]] = {name: [] for name in ("camcal", *solvers)}
    for count, flat, noise in CELLS:
        made = random_trials(trials, count, noise, flat=flat)
        reference, information = references(made, noise)
        views = [each.view for each in made]
        poses: dict[str, list[Pose | None]] = {"camcal": [each.transform for each in estimates(CAMERA, made, noise)]}
        for name, solve in solvers.items():
            poses[name] = [solve(view.points, view.pixels, 4 * noise) for view in views]
        for name, each in poses.items():
            nothing = np.full(6, np.nan)
            pairs = zip(made, each, strict=True)
            own = np.array([nothing if pose is None else trial.error(pose) for trial, pose in pairs])
            table[name].append(ratios(own, reference, information))
    for name, row in table.items():
        print(f"{name:18}" + "".join(f"  {cell}".ljust(17) for cell in row), flush=True)


def estimates(
    camera: Camera, trials: Sequence[Trial], noise: float | None, *, together: bool = True
) -> list[PoseEstimate]:
    """Return the estimates of all trials, that of the first again where there is none."""
    options, views = PoseOptions(noise_px=noise), [each.view for each in trials]
    batches = [views] if together else [[view] for view in views]
    found = [outcome.value for batch in batches for outcome in estimate_poses(camera, batch, options)]
    missing = sum(each is None for each in found)
    if missing:
        print(f"{missing} of {len(found)} have no pose")
    return [each or next(filter(None, found)) for each in found]


def coverage(trials: int) -> None:
    print(f"{'':16}{'NEES/6':>8}{'known':>9}{'estimated':>11}")
    for count, flat, noise in COVERED:
        made = random_trials(trials, count, noise, flat=flat, seed=2)
        known = estimates(CAMERA, made, noise)
        sure = np.array([each.p_wrong < AMBIGUOUS for each in known])
        nees = distances(made, known)[sure]
        inside = nees < region_quantile(0.95, None)
        alone = estimates(CAMERA, made, None, together=False)
        own = distances(made, alone)[sure] < region_quantile(0.95, alone[0].degrees_of_freedom)
        name = f"{'plane' if flat else '3-D':6}n={count}"
        print(f"{name:16}{nees.mean() / 6:8.3f}{100 * inside.mean():8.1f}%{100 * own.mean():10.1f}%", flush=True)


def distances(trials: Sequence[Trial], found: Sequence[PoseEstimate], *, noise_only: bool = False) -> np.ndarray:
    """Return the squared Mahalanobis distances (T,) of the errors."""
    errors = np.array([each.error(pose.transform) for each, pose in zip(trials, found, strict=True)])
    covariances = np.array([pose.noise_covariance if noise_only else pose.covariance for pose in found])
    return np.einsum("ti,ti->t", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def lens(trials: int) -> None:
    noise = 0.2
    print(f"{'(f, c) px':12}{'propagated':>12}{'noise alone':>13}")
    for focal, centre in ((0.3, 0.5), (1.0, 1.0)):
        rng = np.random.default_rng(3)
        stds = np.array([focal, focal, centre, centre])
        made = []
        for _ in range(trials):
            each = trial(rng, BOARD, noise, (0.5, 1.0))
            true_lens = replace(CAMERA, parameters=CAMERA.parameters + stds * rng.standard_normal(4))
            shift = true_lens.project(each.truth.apply(BOARD)).pixels - CAMERA.project(each.truth.apply(BOARD)).pixels
            made.append(replace(each, view=replace(each.view, pixels=each.view.pixels + shift)))
        found = estimates(replace(CAMERA, covariance=np.diag(stds**2)), made, noise)
        both = [distances(made, found, noise_only=alone).mean() / 6 for alone in (False, True)]
        print(f"({focal:g}, {centre:g})".ljust(12) + "{:12.3f}{:13.1f}".format(*both), flush=True)


def ambiguity(trials: int) -> None:
    rng = np.random.default_rng(4)
    cosines = rng.uniform(np.cos(np.radians(75)), 1, (3, 4 * trials))  # normals in all directions alike
    made = [
        tag_trial(rng, size, tilt)
        for size, tilts in zip((80, 40, 20), np.arccos(cosines), strict=True)
        for tilt in tilts
    ]
    found = estimates(CAMERA, made, 0.3)
    predicted, wrong = [], []
    for each, pose in zip(made, found, strict=True):
        if pose.alternative is None:
            continue
        angles = [np.linalg.norm(each.error(p)[3:]) for p in (pose.transform, pose.alternative.transform)]
        apart = np.linalg.norm((pose.transform @ pose.alternative.transform.inverse()).vector())
        if apart > np.radians(10):
            predicted.append(pose.p_wrong)
            wrong.append(angles[0] > angles[1])
    shares, hits = np.array(predicted), np.array(wrong)
    edges = [0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5001]
    rows = [(shares >= low) & (shares < high) for low, high in pairwise(edges)]
    print("predicted " + " ".join(f"{shares[row].mean():.3f}" for row in rows))
    print("observed  " + " ".join(f"{hits[row].mean():.3f}" for row in rows))
    print("pairs     " + " ".join(f"{row.sum():5d}" for row in rows))
    kept, failed = 100 * rows[0].mean(), 100 * hits[rows[0]].mean()
    print(f"P(wrong) < 0.01: {kept:.0f} % of the pairs, {failed:.2f} % of these wrong", flush=True)


def tag_trial(rng: np.random.Generator, size_px: float, tilt_rad: float) -> Trial:
    about = rng.uniform(0, 2 * np.pi)
    tilt = tilt_rad * np.array([np.cos(about), np.sin(about), 0.0])
    spin = Pose.from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]), np.zeros(3))
    truth = Pose.from_vector(tilt, np.append(rng.normal(0, 0.05, 2), 0.1 * 800 / size_px)) @ spin
    pixels = CAMERA.project(truth.apply(TAG)).pixels + 0.3 * rng.standard_normal((4, 2))
    return Trial(Correspondences("tag", TAG, pixels), truth)


def rig(trials: int) -> None:
    eyes = {name: Pose(np.eye(3), np.array([x, 0.0, 0.0])) for name, x in (("left", -0.25), ("right", 0.25))}
    both, options = Rig(dict.fromkeys(eyes, CAMERA), eyes), PoseOptions(noise_px=0.3)
    print(f"{'distance':10}{'one camera':>12}{'two cameras':>13}{'RMS/bound R, t':>18}")
    for far in (1.0, 2.0, 3.0):
        rng = np.random.default_rng(5)
        places = [np.append(rng.normal(0, 0.05, 2), far) for _ in range(trials)]
        truths = [Pose.from_vector(rng.normal(0, 0.5, 3), place) for place in places]
        made = {name: [seen_by(rng, name, eye, truth) for truth in truths] for name, eye in eyes.items()}
        alone = estimates(CAMERA, made["left"], 0.3)
        joint = estimate_rig_poses(both, [[a.view, b.view] for a, b in zip(*made.values(), strict=True)], options)
        steps = [each.error(pose.transform)[3:] for each, pose in zip(made["left"], alone, strict=True)]
        trials_of_rig = [replace(each, truth=truth) for each, truth in zip(made["left"], truths, strict=True)]
        found = [outcome.value for outcome in joint]
        errors = np.array([each.error(pose.transform) for each, pose in zip(trials_of_rig, found, strict=True)])
        flipped = [np.linalg.norm(turns, axis=1) > np.radians(10) for turns in (np.array(steps), errors[:, 3:])]
        squares = [errors[~flipped[1]] ** 2, np.array([np.diag(pose.covariance) for pose in found])[~flipped[1]]]
        ratios = [np.sqrt(squares[0][:, part].sum() / squares[1][:, part].sum()) for part in (slice(3, 6), slice(3))]
        shares = [100 * each.mean() for each in flipped]
        row = "{:11.1f}%{:12.1f}%{:12.2f}{:6.2f}".format(*shares, *ratios)
        print(f"{far:g} m".ljust(10) + row, flush=True)


def seen_by(rng: np.random.Generator, name: str, eye: Pose, rig_T_tag: Pose) -> Trial:
    camera_T_tag = eye.inverse() @ rig_T_tag
    pixels = CAMERA.project(camera_T_tag.apply(TAG)).pixels + 0.3 * rng.standard_normal((4, 2))
    return Trial(Correspondences("tag", TAG, pixels, camera=name), camera_T_tag)


def throughput(trials: int) -> None:
    rng = np.random.default_rng(6)
    views = [trial(rng, BOARD, 0.3, (0.5, 1.0)).view for _ in range(1000)]
    matrix = matrix_of(CAMERA)
    own, peer = [], []
    cv2.setNumThreads(1)
    for _ in range(7 if trials >= 100 else 2):
        start = time.perf_counter()
        estimate_poses(CAMERA, views)
        middle = time.perf_counter()
        for view in views:
            _, vector, place = cv2.solvePnP(view.points, view.pixels, matrix, None)
            cv2.solvePnPRefineLM(view.points, view.pixels, matrix, None, vector, place)
        own.append(middle - start)
        peer.append(time.perf_counter() - middle)
    print(f"camcal {1000 * median(own):.0f} ms, OpenCV {1000 * median(peer):.0f} ms (medians)")
    print(f"ratio of medians {median(own) / median(peer):.2f}, of the fastest {min(own) / min(peer):.2f}")


def single(trials: int) -> None:
    rng = np.random.default_rng(7)
    count = min(trials, 100)
    boards = [trial(rng, BOARD, 0.3, (0.5, 1.0)).view for _ in range(count)]
    known, wrong = PoseOptions(noise_px=0.3), PoseOptions(noise_px=0.5, outliers="many")
    spoilt = []
    for each in random_trials(count, 100, 0.5, flat=True, seed=7):
        pixels = each.view.pixels.copy()
        pixels[:50] = rng.uniform([0, 0], CAMERA.image_size, (50, 2))
        spoilt.append(replace(each.view, pixels=pixels))
    matrix = matrix_of(CAMERA)
    cv2.setNumThreads(1)

    def plain(view: Correspondences) -> None:
        _, vector, place = cv2.solvePnP(view.points, view.pixels, matrix, None)
        cv2.solvePnPRefineLM(view.points, view.pixels, matrix, None, vector, place)

    together = cpu_ms(lambda views: estimate_poses(CAMERA, views, known), [boards] * 5) / count
    print(f"board {cpu_ms(lambda view: estimate_poses(CAMERA, [view], known), boards):.2f} ms", end="")
    print(f" (OpenCV {cpu_ms(plain, boards):.2f}, of all at once {together:.2f})", end="")
    print(f", half wrong {cpu_ms(lambda view: estimate_poses(CAMERA, [view], wrong), spoilt):.2f} ms", flush=True)


def cpu_ms(work: Callable[[Item], object], items: Sequence[Item]) -> float:
    """Return the median CPU time, ms, of work on an item; the first is done once before."""
    work(items[0])
    times = []
    for item in items:
        start = time.process_time()
        work(item)
        times.append(time.process_time() - start)
    return 1000 * median(times)


if __name__ == "__main__":
    main()
