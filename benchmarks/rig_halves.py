"""Halves of the real rigs: how far two calibrations differ, and what was predicted.

The captures of a rig are divided at random into two halves, --splits times, and each is calibrated by itself. A row:
baseline, rotation: RMS over the splits of the difference of the lengths of camera_T_first's translation, mm, and of the
    angle between the rotations, degrees; /claimed: over what the two covariances lead one to expect (0.6 to 1.6
    wanted). translation: the same of the whole vector. Rows of three cameras have a camera in brackets.
without: the differences where camcal takes the cameras for simultaneous (motion=False), and the ratio of the baseline's
    with the motion to that (0.6 at most wanted where they are not simultaneous, about 1 where they are).
cv2: the baseline's difference by cv2.stereoCalibrate, or cv2.fisheye's, from the corners of the same halves, and
    camcal's over it (1.05 at most wanted). Of three cameras these are the pairs with the first one.
between/within: the medians of the epipolar errors of the captures, RMS over captures, over the RMS of the errors about
    these medians, by cv2.stereoCalibrate from all captures: above 1 something differs between captures. Of rigs of
    three cameras the greatest pair's.
moved: camcal's statement about all captures, the median motion of the board between the exposures, mm.
Halves of fewer than 6 captures are in the table, but not in the summary.

Then: how far another lens model that predicts about alike moves the baselines, in their standard deviations (within 2
wanted); whether the three pairs of the trinocular rig close (second_T_third and so on, composed, against the pair's
own, in standard deviations: all six numbers, and their χ²), and whether the rig in one solve agrees with each, under
two lens models; and the length of the baseline against the published one.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/rig_halves.py [--rigs NAME …] [--splits 20] [--without 20] [--seed 0]
        [--cache FOLDER]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from real_rigs import CACHE, CAMCAL, RIGS, aligned, captures_of, common_pixels, epipolar_errors
from rig_programs import camcal_rig, opencv_rigs

from camcal.calibrate.rigs.record import Captures, RigCalibration
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import CameraModel
from camcal.errors import CamcalError
from camcal.geometry.pose import Pose, compose_jacobians

LEAST_HALF = 6
OTHER_MODEL = {"opencv5": "kannala_brandt4", "kannala_brandt4": "kannala_brandt5t"}
MODELS_OF_CLOSURE = ("opencv5", "opencv14")
PAIRS = {"l-m": ("left", "middle"), "l-r": ("left", "right"), "m-r": ("middle", "right")}


@dataclass
class Differences:
    """Squares of the differences between halves, and of those predicted, by split: of the baseline's length, of the
    translation and of the rotation; m and rad.
    """

    observed: list[tuple[float, float, float]] = field(default_factory=list)
    predicted: list[tuple[float, float, float]] = field(default_factory=list)

    def add(self, first: RigCalibration, second: RigCalibration, camera: str) -> None:
        pose, other = first.poses[camera], second.poses[camera]
        lengths = np.linalg.norm(pose.translation), np.linalg.norm(other.translation)
        shift = pose.translation - other.translation
        turn = Pose(pose.rotation @ other.rotation.T, np.zeros(3)).vector()
        self.observed.append(((lengths[0] - lengths[1]) ** 2, float(shift @ shift), float(turn @ turn)))
        variances = np.zeros(3)
        for result, length in ((first, lengths[0]), (second, lengths[1])):
            covariance, along = result.pose_covariance(camera), result.poses[camera].translation / length
            variances += [
                along @ covariance[:3, :3] @ along,
                *(np.trace(covariance[i : i + 3, i : i + 3]) for i in (0, 3)),
            ]
        self.predicted.append(tuple(variances))

    @property
    def rms(self) -> np.ndarray:
        """Root mean squares (3,) of the observed differences."""
        return np.sqrt(np.mean(self.observed, axis=0))

    @property
    def ratios(self) -> np.ndarray:
        """Observed over predicted (3,)."""
        return np.sqrt(np.sum(self.observed, axis=0) / np.sum(self.predicted, axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--without", type=int, default=20, help="splits that are solved without motion as well")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder that keeps the corners")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; {arguments.splits} splits, seed {arguments.seed}")
    print(
        f"{'rig':22} {'half':>4} {'failed':>6} {'baseline':>8} {'/claimed':>8} {'translation':>11} {'/claimed':>8} "
        f"{'rotation':>8} {'/claimed':>8}  {'cv2':>8} {'/cv2':>5}  "
        f"{'without':>8} {'ratio':>6} {'between/within':>14} {'moved':>6} {'s':>5}"
    )
    ratios = [row(name, arguments) for name in arguments.rigs]
    shown = np.concatenate([own for own in ratios if own is not None] or [np.zeros((0, 3))])
    if len(shown):
        for index, what in ((0, "baseline"), (1, "translation"), (2, "rotation")):
            own = shown[:, index]
            print(f"{what} over claimed: median {np.median(own):.2f} ({own.min():.2f} to {own.max():.2f})")
    for name in arguments.rigs:
        other_model(name, arguments.cache)
    if "trinocular" in arguments.rigs:
        for model in map(model_named, MODELS_OF_CLOSURE):
            closure(model, arguments.cache)
    for name in arguments.rigs:
        published(name, arguments.cache)


def row(name: str, arguments: argparse.Namespace) -> np.ndarray | None:
    """Print the rows of a rig and return its ratios (cameras, 3), None where halves are too small."""
    rig, captures = RIGS[name], shared(captures_of(name, CAMCAL, arguments.cache))
    rng = np.random.default_rng(arguments.seed)
    found: dict[bool | None, dict[str, Differences]] = {
        motion: {camera: Differences() for camera in rig.cameras[1:]} for motion in (None, False)
    }
    failed, seconds, of_cv2 = 0, [], []
    for split in range(arguments.splits):
        order = rng.permutation(len(captures))
        halves = [captures.take(np.sort(part)) for part in np.split(order, [len(captures) // 2])]
        start = time.process_time()
        results = solved(name, halves, None)
        seconds.append((time.process_time() - start) / 2)
        failed += results is None
        of_cv2.append(np.subtract(*(opencv_baselines(name, half) for half in halves)))
        without = results if split < arguments.without else None
        if without is not None and any(result.motion for result in without):
            without = solved(name, halves, False)
            failed += without is None
        for motion, both in ((None, results), (False, without)):
            for camera, own in found[motion].items() if both is not None else ():
                own.add(*both, camera)
    whole = camcal_rig(captures, rig.target, rig.lens, max_rejected=1.0)
    moved = f"{1e3 * whole.motion.median:6.2f}" if whole.motion else f"{'-':>6}"
    for camera, peer in zip(rig.cameras[1:], np.sqrt(np.nanmean(np.square(of_cv2), axis=0)), strict=True):
        own, without = found[None][camera], found[False][camera]
        both = np.sqrt(np.mean(own.observed[: arguments.without], axis=0))[0] if without.observed else np.nan
        alone = without.rms[0] if without.observed else np.nan
        label = f"{name} ({camera})" if len(rig.cameras) > 2 else name
        (length, shift, turn), claimed = own.rms, own.ratios
        print(
            f"{label:22} {len(captures) // 2:4d} {failed:6d} {1e3 * length:8.3f} {claimed[0]:8.2f} {1e3 * shift:11.3f} "
            f"{claimed[1]:8.2f} {np.degrees(turn):8.4f} {claimed[2]:8.2f}  "
            f"{1e3 * peer:8.3f} {length / peer:5.2f}  {1e3 * alone:8.3f} "
            f"{both / alone:6.2f} {between_within(name, arguments.cache):14.2f} {moved} "
            f"{np.median(seconds):5.1f}",
            flush=True,
        )
    large = len(captures) // 2 >= LEAST_HALF
    return np.array([own.ratios for own in found[None].values()]) if large else None


def solved(name: str, halves: list[Captures], motion: bool | None) -> list[RigCalibration] | None:
    """Return the calibrations of halves, None if one gives none."""
    rig = RIGS[name]
    try:
        results = [camcal_rig(half, rig.target, rig.lens, motion=motion, max_rejected=1.0) for half in halves]
    except CamcalError as error:
        print(f"# {name}: {error}", file=sys.stderr)
        return None
    if reasons := [why for result in results for why in result.unlinked.values()]:
        print(f"# {name}: {reasons[0]}", file=sys.stderr)
        return None
    return results


def opencv_baselines(name: str, half: Captures) -> np.ndarray:
    """Return the lengths (n - 1,) of the baselines from the first camera by OpenCV, NaN where it fails."""
    rig = RIGS[name]
    try:
        pairs = opencv_rigs(aligned(half, rig.target), rig.target, rig.lens)[: len(rig.cameras) - 1]
    except (cv2.error, CamcalError) as error:
        print(f"# {name}: cv2: {error}".splitlines()[0], file=sys.stderr)
        return np.full(len(rig.cameras) - 1, np.nan)
    return np.array([float(np.linalg.norm(list(pair.poses.values())[1].translation)) for pair in pairs])


def shared(captures: Captures) -> Captures:
    """Return the captures that two cameras at least saw."""
    return captures.take([g for g, row in enumerate(captures.views) if sum(view is not None for view in row) > 1])


def between_within(name: str, cache: Path) -> float:
    """Return how much the epipolar errors differ between captures, over how much within them."""
    rig, captures = RIGS[name], aligned(captures_of(name, CAMCAL, cache), RIGS[name].target)
    ratios = []
    for pair in opencv_rigs(captures, rig.target, rig.lens):
        a, b = (captures.cameras.index(camera) for camera in pair.cameras)
        both = [g for g, row in enumerate(captures.views) if len(common_pixels(row[a], row[b])[0])]
        errors = [epipolar_errors(pair, captures.take([g]))[captures.cameras[a], captures.cameras[b]] for g in both]
        medians = np.array([np.nanmedian(own) for own in errors])
        left = np.concatenate([own - median for own, median in zip(errors, medians, strict=True)])
        ratios.append(np.sqrt(np.mean(medians**2)) / np.sqrt(np.nanmean(left**2)))
    return max(ratios)


def other_model(name: str, cache: Path) -> None:
    """Print the baselines by the rig's lens model and by another one that predicts about alike."""
    rig, captures = RIGS[name], shared(captures_of(name, CAMCAL, cache))
    models = rig.lens, model_named(OTHER_MODEL[rig.lens.name])
    others = dict.fromkeys(captures.cameras, models[1])
    first = camcal_rig(captures, rig.target, models[0], max_rejected=1.0, others=others)
    second = camcal_rig(captures, rig.target, models[1], max_rejected=1.0)
    for camera in rig.cameras[1:]:
        (length, std), (other, _) = baseline(first, camera), baseline(second, camera)
        print(
            f"{name} ({camera}): {1e3 * length:.3f} ± {1e3 * std:.3f} mm by {models[0].name}, {1e3 * other:.3f} by "
            f"{models[1].name}: {(other - length) / std:+.1f} σ",
            flush=True,
        )


def baseline(result: RigCalibration, camera: str) -> tuple[float, float]:
    """Return the length of a camera's baseline and its standard deviation, m."""
    length = float(np.linalg.norm(result.poses[camera].translation))
    along = result.poses[camera].translation / length
    return length, float(np.sqrt(along @ result.pose_covariance(camera)[:3, :3] @ along))


def closure(model: CameraModel, cache: Path) -> None:
    """Print whether the pairs of the trinocular rig close, and agree with the rig in one solve, under a lens model."""
    rig, captures = RIGS["trinocular"], captures_of("trinocular", CAMCAL, cache)
    pairs = {}
    for name, cameras in PAIRS.items():
        index = [captures.cameras.index(camera) for camera in cameras]
        own = Captures(cameras, captures.names, tuple(tuple(row[i] for i in index) for row in captures.views))
        result = camcal_rig(own, rig.target, model)
        pairs[name] = result.poses[cameras[1]], result.pose_covariance(cameras[1])
    (m_T_l, first), (r_T_l, direct), (r_T_m, second) = pairs["l-m"], pairs["l-r"], pairs["m-r"]
    jacobians = compose_jacobians(r_T_m, m_T_l)
    composed = sum(jacobian @ own @ jacobian.T for jacobian, own in zip(jacobians, (second, first), strict=True))
    compared(f"{model.name}, right over middle against right", r_T_m @ m_T_l, r_T_l, composed + direct)
    joint = camcal_rig(captures, rig.target, model)
    own_m_T_r = joint.poses["right"] @ joint.poses["middle"].inverse()
    joint_pairs = {"l-m": joint.poses["middle"], "l-r": joint.poses["right"], "m-r": own_m_T_r}
    for name, pose in joint_pairs.items():
        compared(f"{model.name}, one solve against {name}", pose, *pairs[name])


def compared(words: str, pose: Pose, other: Pose, covariance: np.ndarray) -> None:
    """Print the difference of two poses in the standard deviations of a covariance (6, 6) of one or both."""
    turn = Pose(pose.rotation @ other.rotation.T, np.zeros(3)).vector()
    step = np.append(pose.translation - other.translation, turn)
    scores = step / np.sqrt(np.diag(covariance))
    square = float(step @ np.linalg.solve(covariance, step))
    print(
        f"{words:45} {np.round(1e3 * step[:3], 3)} mm, {np.round(np.degrees(step[3:]), 4)} deg; "
        f"σ: {np.round(scores, 2)}, χ²(6) {square:.1f}"
    )


def published(name: str, cache: Path) -> None:
    """Print the length of the baseline beside the one that came with the images, where there is one."""
    rig = RIGS[name]
    if rig.baseline is None:
        return
    result = camcal_rig(captures_of(name, CAMCAL, cache), rig.target, rig.lens)
    length, std = baseline(result, rig.cameras[1])
    print(
        f"{name}: baseline {1e3 * length:.3f} ± {1e3 * std:.3f} mm, published {1e3 * rig.baseline:.3f}: "
        f"{(length - rig.baseline) / std:+.1f} σ"
    )


if __name__ == "__main__":
    main()
