"""Mistakes in the captures of a rig: how often they are named, and how often something is where nothing is wrong.

Rigs, boards and errors are those of rig_scenes.py: two to four cameras, 12 to 24 captures, noise of 0.05 to 0.3 px,
bent boards, some views missing. A row: mistakes of 20 that are named (a message, or the refusal, has a code or words of
the mistake), that say where (the capture or the camera besides), with any failure or refusal, with any message; and
what was said, by how often. Of clean rigs any failure, refusal or message of a mistake is a false alarm; with them go
rigs with what is no mistake: correlated errors, motion between the exposures, symmetric boards numbered at random.

    python benchmarks/rig_faults.py [--seeds 20] [--clean 50] [--faults NAME …] [--first 0] [--jobs 1]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from rig_programs import camcal_rig

from camcal.calibrate.rigs.record import Captures
from camcal.cameras.catalogue import model_named
from camcal.errors import CamcalError
from camcal.run.fanout import fan_out
from camcal.targets.board import Board

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import (
    Errors,
    Scene,
    SimulatedRig,
    Transform,
    another_pattern,
    exchanged,
    mirrored,
    observed,
    random_rig,
    scene,
    sides_exchanged,
    slipped,
    unrelated,
)


@dataclass(frozen=True, eq=False)
class Given:
    """What a mistake is made of: a scene, errors, its captures, the camera and the capture it is made in, a seed."""

    scene: Scene
    errors: Errors
    captures: Captures
    camera: int
    capture: int
    seed: int

    @property
    def rig(self) -> SimulatedRig:
        return self.scene.rig

    @property
    def board(self) -> Board:
        return self.rig.board

    def again(self, **changes: object) -> Captures:
        """Return the captures of a changed scene with the same errors."""
        return observed(replace(self.scene, **changes), self.errors, self.seed)


Made = tuple[Captures, tuple[str, ...]]  # captures, and the names one of which says where


def _camera(given: Given) -> str:
    return given.rig.cameras[given.camera]


def _at(given: Given, *captures: int) -> tuple[str, ...]:
    return tuple(given.captures.names[index] for index in captures)


def slip(given: Given) -> Made:
    return slipped(given.captures, given.camera), (_camera(given),)


def late_slip(given: Given) -> Made:
    """Return captures of which one image was not written, in the middle half of them."""
    count = len(given.captures)
    start = count // 4 + given.capture % (count // 2)
    return slipped(given.captures, given.camera, start), (_camera(given), *_at(given, start))


def swapped_images(given: Given) -> Made:
    other = (given.capture + 3) % len(given.captures)
    return exchanged(given.captures, given.camera, given.capture, other), _at(given, given.capture, other)


def swapped_sides(given: Given) -> Made:
    return sides_exchanged(given.captures, [given.capture], (0, given.camera)), _at(given, given.capture)


def swapped_folders(given: Given) -> Made:
    """Return captures whose first two cameras have each other's images."""
    everything = range(len(given.captures))
    return sides_exchanged(given.captures, everything, (0, 1)), ("left", "right")


def mirrored_image(given: Given) -> Made:
    return mirrored(given.captures, given.camera, given.board, [given.capture]), _at(given, given.capture)


def mirrored_camera(given: Given) -> Made:
    return mirrored(given.captures, given.camera, given.board), (_camera(given),)


def larger_squares(given: Given) -> Made:
    return given.again(other=(given.camera, 1.2)), (_camera(given),)


def slightly_larger_squares(given: Given) -> Made:
    return given.again(other=(given.camera, 1.04)), (_camera(given),)


def other_board(given: Given) -> Made:
    return another_pattern(given.captures, given.camera, replace(given.board, columns=given.board.columns - 2)), (
        _camera(given),
    )


def other_session(given: Given) -> Made:
    others = observed(scene(given.rig, len(given.captures), given.seed + 1000), given.errors, given.seed)
    return unrelated(given.captures, given.camera, others), (_camera(given),)


def rig_changed(given: Given, turn: float, share: float) -> Made:
    """Return captures of a rig whose camera has been turned (rad) and moved (share of its distance) from one on."""
    rng = np.random.default_rng([given.seed, 99])
    old = given.rig.poses[given.camera]
    length = float(np.linalg.norm(old.translation))
    axis, way = (own / np.linalg.norm(own) for own in rng.normal(size=(2, 3)))
    poses = list(given.rig.poses)
    poses[given.camera] = Transform.of(turn * axis, share * length * way) @ old
    middle = len(given.captures) // 2
    return given.again(later=(middle, tuple(poses))), (_camera(given), *_at(given, middle - 1, middle, middle + 1))


def clean(given: Given) -> Made:
    return given.captures, ()


FAULTS: dict[str, Callable[[Given], Made]] = {
    "slipped by one": slip,
    "slipped from one on": late_slip,
    "images of two captures swapped": swapped_images,
    "cameras of one capture swapped": swapped_sides,
    "left and right swapped": swapped_folders,
    "one image mirrored": mirrored_image,
    "a camera mirrored": mirrored_camera,
    "squares 20 % larger": larger_squares,
    "squares 4 % larger": slightly_larger_squares,
    "another pattern": other_board,
    "another session": other_session,
    "turned by 1°, moved 5 %": partial(rig_changed, turn=np.radians(1), share=0.05),
    "turned by 0.3°": partial(rig_changed, turn=np.radians(0.3), share=0.0),
}
# codes, or words of a refusal, that name a mistake
NAMES: dict[str, tuple[str, ...]] = {
    "slipped by one": ("shifted_captures",),
    "slipped from one on": ("shifted_captures",),
    "images of two captures swapped": ("exchanged_images",),
    "cameras of one capture swapped": ("swapped_views",),
    "left and right swapped": ("left_right_swapped",),
    "one image mirrored": ("mirrored_images",),
    "a camera mirrored": ("mirrored_images",),
    "squares 20 % larger": ("boards_of_two_sizes",),
    "squares 4 % larger": ("boards_of_two_sizes",),
    "another pattern": ("its images show",),
    "another session": ("do not belong together",),
    "turned by 1°, moved 5 %": ("rig_changed",),
    "turned by 0.3°": ("rig_changed",),
}
CLEAN: dict[str, Callable[[Errors], Errors]] = {
    "clean": lambda errors: errors,
    "correlated errors": partial(replace, smooth=0.1),
    "motion 0.3 mm": partial(replace, motion=3e-4),
    "numbered at random": partial(replace, turned=True),
}


def given(seed: int, change: Callable[[Errors], Errors], *, symmetric: bool = False) -> Given:
    rng = np.random.default_rng([seed, 5])
    rig = random_rig(seed, symmetric=symmetric)
    captures = int(rng.integers(12, 25))
    errors = change(Errors(float(0.05 * 6 ** rng.random()), hidden=float(rng.choice([0.0, 0.1])), stated=seed % 3 > 0))
    own = scene(rig, captures, seed)
    found = observed(own, errors, seed)
    common = [
        [g for g, row in enumerate(found.views) if row[0] is not None and row[camera] is not None]
        for camera in range(1, len(rig.lenses))
    ]
    best = max(map(len, common))
    camera = int(rng.choice([1 + index for index, both in enumerate(common) if 2 * len(both) >= best]))
    return Given(own, errors, found, camera, int(rng.choice(common[camera - 1][1:-1])), seed)


@dataclass(frozen=True)
class Said:
    """What was said of captures: codes of warnings and failures, words of all; whether it failed or was refused."""

    codes: tuple[str, ...]
    words: str
    failed: bool

    def names(self, fault: str, where: tuple[str, ...] = ("",)) -> bool:
        named = any(name in self.codes or name in self.words for name in NAMES.get(fault, ()))
        return named and any(own in self.words for own in where)


def said_of(captures: Captures, rig: SimulatedRig) -> Said:
    try:
        result = camcal_rig(captures, rig.board, model_named(rig.lenses[0].model))
    except CamcalError as error:
        codes = tuple(own.code for own in error.failures) or (type(error).__name__,)
        return Said(codes, str(error), failed=True)
    except (ArithmeticError, ValueError, IndexError) as error:
        return Said((f"crash: {type(error).__name__}",), str(error), failed=True)
    messages = (*result.warnings, *result.failures)
    words = " | ".join([*map(str, messages), *(f"{name}: {why}" for name, why in result.unlinked.items())])
    unlinked = ("unlinked",) * bool(result.unlinked)
    return Said(tuple(own.code for own in messages) + unlinked, words, failed=bool(result.failures))


def of_fault(fault: str, seed: int) -> tuple[Said, tuple[str, ...]]:
    own = given(seed, CLEAN["clean"])
    captures, where = FAULTS[fault](own)
    return said_of(captures, own.rig), where


def of_clean(kind: str, seed: int) -> Said:
    own = given(seed, CLEAN[kind], symmetric=kind == "numbered at random")
    return said_of(own.captures, own.rig)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--clean", type=int, default=50)
    parser.add_argument("--faults", nargs="*", choices=FAULTS, default=list(FAULTS), metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--words", action="store_true", help="print all messages")
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; seeds from {arguments.first}")
    print(f"{'mistake':32} {'sets':>4} {'named':>5} {'where':>5} {'failed':>6} {'any':>4}  said")
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    for fault in arguments.faults:
        found = results(partial(of_fault, fault), seeds, arguments.jobs)
        named = sum(said.names(fault) for said, _ in found)
        placed = sum(said.names(fault, where) for said, where in found)
        print(f"{fault:32} {len(found):4d} {named:5d} {placed:5d} {summary([said for said, _ in found])}", flush=True)
        if arguments.words:
            print(*(f"    {seed}: {said.words or '-'}" for seed, (said, _) in zip(seeds, found, strict=True)), sep="\n")
    clean_seeds = range(arguments.first + 10_000, arguments.first + 10_000 + arguments.clean)
    for kind in CLEAN if arguments.clean else ():
        found = results(partial(of_clean, kind), clean_seeds, arguments.jobs)
        alarms = sum(said.failed or any(said.names(fault) for fault in FAULTS) for said in found)
        print(f"{kind:32} {len(found):4d} false alarms {alarms:d}; {summary(found)}", flush=True)
        if arguments.words:
            print(
                *(f"    {seed}: {said.words or '-'}" for seed, said in zip(clean_seeds, found, strict=True)), sep="\n"
            )


def results(function: Callable, seeds: range, jobs: int) -> list:
    found = []
    for outcome in fan_out(function, seeds, jobs=jobs, processes=True):
        if outcome.error is not None:
            raise outcome.error
        found.append(outcome.value)
    return found


def summary(found: list[Said]) -> str:
    codes = Counter(code for said in found for code in set(said.codes))
    words = ", ".join(f"{code} {count}" for code, count in codes.most_common(6))
    return f"{sum(said.failed for said in found):6d} {sum(bool(said.codes) for said in found):4d}  {words}"


if __name__ == "__main__":
    main()
