"""Whether what a refusal or a distrust advises helps: bad sets of views, what is said of them, and what comes of it.

Every kind of bad set is simulated with several seeds and calibrated as `camcal calibrate` does. What the message (exit
4) or the reasons of the verdict advise is then done in the simulation: more views, tilted or in the corners of the
image; leaving out the images that are named; the lens models that are proposed; the right board; each group by itself.
Per kind: sets, how many were trusted as they were, what was said of the others (codes of criteria, "refused" with the
first words), the remedy that was named, and how many are trusted after it, with fx within 1 % of the truth; and what a
refusal or distrust costs: CPU time over that of a calibration from as many good views, the median and the largest.

    python benchmarks/remedies.py [--seeds 8] [--only KIND]
"""

import argparse
import os
import re
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, Options
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.calibrate import name_groups
from camcal.tasks.calibration.model_selection import select, solve_given

SIZE, NOISE = (1600, 1200), 0.1
BOARD = Board("chessboard", 9, 6, 0.030)
WRONG_FX = 0.01
ROUNDS = 4  # of following advice


def lens(focal: float = 1200.0, model: str = "opencv5", centre: tuple[float, float] = (805.0, 590.0)) -> Camera:
    coefficients = {
        "opencv5": [-0.12, 0.06, 5e-4, -3e-4, 0.01],
        "kannala_brandt4": [0.02, -0.01, 0.004, -0.001],
    }[model]
    return Camera(model_named(model), SIZE, np.array([focal, 1.0025 * focal, *centre, *coefficients]))


LENS, OTHER = lens(), lens(1240.0, centre=(790.0, 612.0))
TELE, WIDE = lens(2300.0, centre=(790.0, 612.0)), lens(520.0, "kannala_brandt4")


@dataclass(frozen=True)
class Set:
    """Views as they were taken, what `camcal calibrate` is told of them, and the truth.

    camera: of the views that are added. cameras: of the views, where there are several. sharp: views with better
    corners. max_rejected: as of the command.
    """

    views: tuple[BoardDetection, ...]
    camera: Camera = LENS
    board: Board = BOARD
    model: str | None = None
    max_rejected: float = 0.1
    right_board: Board = BOARD
    sharp: tuple[BoardDetection, ...] = ()
    cameras: tuple[Camera, ...] = ()


def shots(
    camera: Camera, count: int, seed: int, folder: str = "a", noise: float = NOISE, **how
) -> list[BoardDetection]:
    """Views of the board as a careful person takes them, unless told otherwise."""
    rng = np.random.default_rng(seed)
    poses = how.pop("poses", None) or views(camera, BOARD, count, rng=rng, **how)
    found, _ = observe(camera, BOARD, poses, rng=rng, noise_px=noise, outliers=how.pop("outliers", 0.0))
    return [replace(view, image=f"{folder}/{view.image}") for view in found.views]


def wrong_corners(seed: int, share: float) -> Set:
    rng = np.random.default_rng(seed)
    poses = views(LENS, BOARD, 15, rng=rng)
    found, _ = observe(LENS, BOARD, poses, rng=rng, noise_px=NOISE, outliers=share, outlier_px=20.0)
    return Set(
        tuple(replace(view, image=f"a/{view.image}") for view in found.views), sharp=tuple(shots(LENS, 15, seed))
    )


def parallel(seed: int, tilt_deg: float, count: int) -> list[BoardDetection]:
    """Views of a board that is tilted against the image plane by so much at most, all over the image."""
    rng = np.random.default_rng(seed)
    centre, poses = np.array([*BOARD.extent, 0.0]) / 2, []
    for pose in views(LENS, BOARD, count, rng=rng, max_tilt=0.1):
        turn = so3.exp(np.array([*np.radians(rng.uniform(-tilt_deg, tilt_deg, 2) / np.sqrt(2)), rng.normal(0, 0.2)]))
        poses.append(Pose(turn, pose.rotation @ centre + pose.translation - turn @ centre))
    return shots(LENS, count, seed, poses=poses)


def far(seed: int, count: int, tilt_deg: float) -> list[BoardDetection]:
    """Views of a board that is far away in the middle of the image."""
    rng = np.random.default_rng(seed)
    poses = []
    for pose in views(LENS, BOARD, count, rng=rng, max_tilt=np.radians(tilt_deg)):
        shift = pose.rotation @ (np.array([*BOARD.extent, 0.0]) / 2)
        aim = np.array([*rng.uniform(-0.05, 0.05, 2), 1.0])
        poses.append(Pose(pose.rotation, 2.5 * aim - shift))
    return shots(LENS, count, seed, poses=poses)


def shuffled(seed: int, wrong: int) -> Set:
    rng, seen = np.random.default_rng(seed), shots(LENS, 15, seed)
    for index in rng.choice(15, wrong, replace=False):
        seen[index] = replace(seen[index], ids=rng.permutation(seen[index].ids))
    return Set(tuple(seen))


def two(seed: int, other: Camera, first: int, second: int, folders: str = "ab") -> Set:
    mixed = shots(LENS, first, seed, folders[0]) + shots(other, second, seed + 500, folders[1])
    return Set(tuple(mixed), cameras=(LENS,) * first + (other,) * second)


def wide(seed: int, model: str) -> Set:
    return Set(tuple(shots(WIDE, 18, seed)), WIDE, model=model)


def numbered_for(seed: int, board: Board) -> Set:
    return Set(tuple(shots(LENS, 15, seed)), board=board)


def blurred(seed: int, count: int, noise: float) -> Set:
    return Set(tuple(shots(LENS, count, seed, noise=noise)), sharp=tuple(shots(LENS, count, seed)))


KINDS: dict[str, Callable[[int], Set]] = {
    "2 views": lambda seed: Set(tuple(shots(LENS, 2, seed))),
    "a view 6 times": lambda seed: Set(tuple(replace(shots(LENS, 1, seed)[0], image=f"a/{n}.png") for n in range(6))),
    "3 views, hardly tilted": lambda seed: Set(tuple(parallel(seed, 12, 3))),
    "4 views, blurred": lambda seed: blurred(seed, 4, 0.6),
    "never tilted": lambda seed: Set(tuple(parallel(seed, 0.5, 12))),
    "tilted by 6 degrees": lambda seed: Set(tuple(parallel(seed, 6, 8))),
    "far, in the middle": lambda seed: Set(tuple(far(seed, 8, 25))),
    "far, 14 coefficients": lambda seed: Set(tuple(far(seed, 6, 25)), model="opencv14"),
    "board transposed": lambda seed: numbered_for(seed, BOARD.transposed()),
    "board of 10x6": lambda seed: numbered_for(seed, replace(BOARD, columns=10)),
    "ids shuffled in 3 of 15": lambda seed: shuffled(seed, 3),
    "ids shuffled in 7 of 15": lambda seed: shuffled(seed, 7),
    "two cameras, alike, 8+8": lambda seed: two(seed, OTHER, 8, 8),
    "two cameras, alike, 14+4": lambda seed: two(seed, OTHER, 14, 4),
    "two cameras, unlike, 9+8": lambda seed: two(seed, TELE, 9, 8),
    "two cameras, unlike, 14+4": lambda seed: two(seed, TELE, 14, 4),
    "wide lens as pinhole": lambda seed: wide(seed, "pinhole"),
    "wide lens as opencv4": lambda seed: wide(seed, "opencv4"),
    "wide lens as opencv5": lambda seed: wide(seed, "opencv5"),
    "15 % wrong corners": lambda seed: wrong_corners(seed, 0.15),
    "5 views, blurred by 2 px": lambda seed: blurred(seed, 5, 2.0),
}


@dataclass(frozen=True)
class Outcome:
    """What came of a calibration: the codes of failures or how it was refused, all that was said, CPU seconds."""

    calibration: Calibration | None
    codes: tuple[str, ...]
    said: str
    seconds: float = 0.0

    @property
    def trusted(self) -> bool:
        return self.calibration is not None and not self.codes


def outcome(given: Set) -> Outcome:
    """Calibrate as `camcal calibrate` does."""
    names = name_groups([view.image for view in given.views])
    how = Options(model_named(given.model or DEFAULT_MODEL), (), None, ShapeOptions(), given.max_rejected, names)
    start = time.process_time()
    try:
        selection = (select if given.model is None else solve_given)(given.views, given.board, how)
    except CamcalError as error:
        words = f"refused: {_kind(error.message)}"
        return Outcome(None, (words,), error.message, time.process_time() - start)
    found, assessment = selection.calibration, selection.assessment
    codes = tuple(own.code for own in assessment.failures)
    return Outcome(found, codes, "; ".join(own.text for own in assessment.messages), time.process_time() - start)


def cost(given: Set, first: Outcome, seed: int) -> float:
    """Return the time of an outcome over that of a calibration from as many good views, with the model that is given if
    that suits the lens.
    """
    count = max(len({view.image for view in given.views}), 3)
    good = Set(tuple(shots(given.camera, count, seed + 2000)), given.camera)
    usual = outcome(good)
    likewise = outcome(replace(good, model=given.model)) if given.model else usual
    return first.seconds / (likewise if likewise.trusted else usual).seconds


def _kind(message: str) -> str:
    """Return of a refusal which one it is."""
    kinds = (
        "usable view",
        "same tilt",
        "undetermined",
        "two cameras",
        "do not fit the others",
        "board is not",
        "most corners fit",
        "errors are smooth",
        "errors are random",
        "no start",
        "settle",
    )
    return next((kind for kind in kinds if kind in message), message[:30])


def remedy(given: Set, seed: int, said: str) -> tuple[str, Sequence[Set]]:
    """Return what a message advises, in a word, and the sets that following it leads to: the first that applies."""
    images = re.findall(r"\w+/view\d+\.png|\w+/\d+\.png", said)
    if "calibrate each group separately" in said:
        groups = name_groups([view.image for view in given.views])
        if not groups:  # views of one camera: what is named is wrong
            return "each group", []
        first = tuple(view for view in given.views if view.image in groups[0])
        rest = tuple(view for view in given.views if view.image not in groups[0])
        cameras = {view.image[0]: camera for view, camera in zip(given.views, given.cameras, strict=True)}
        parts = [replace(given, views=group, camera=cameras[group[0].image[0]], cameras=()) for group in (first, rest)]
        return "each group", parts
    if "leave out" in said:
        named = set(images)
        return "leave out", [replace(given, views=tuple(view for view in given.views if view.image not in named))]
    said = said.replace("if the lens is telecentric, use --model telecentric", "")  # which none of these is
    if "use --model" in said:
        (model,) = re.findall(r"--model \(?(\w+)", said)[:1]
        return "model", [replace(given, model=model)]
    if "check columns, rows" in said:
        return "board", [replace(given, board=given.right_board)]
    if "camcal detect --draw" in said and given.sharp:
        return "corners", [replace(given, views=given.sharp)]
    if re.search(r"(add|take) (more |\w+ )?(views|images)|tilted", said):
        return "more views", [replace(given, views=given.views + tuple(shots(given.camera, 15, seed + 1000, "c")))]
    if "sharper" in said:
        return "sharper", [replace(given, views=given.sharp or given.views)]
    return "none", []


def followed(given: Set, first: Outcome, seed: int) -> tuple[list[str], list[Outcome]]:
    """Return what was advised in turn, and what came of it in the end; several sets where groups were told apart."""
    steps, waiting, ends = [], [(given, first)], []
    for _ in range(ROUNDS):
        following: list[tuple[Set, Outcome]] = []
        for own, result in waiting:
            word, sets = remedy(own, seed, result.said)
            steps.append(word)
            results = [(each, outcome(each)) for each in sets]
            ends += [end for _, end in results if end.trusted]
            following += [(each, end) for each, end in results if not end.trusted]
        waiting = following
        if not waiting:
            break
    return steps, ends + [end for _, end in waiting] if ends or waiting else [first]


def close(end: Outcome) -> bool:
    """Return whether a trusted result is near one of the true lenses."""
    assert end.calibration is not None
    fx = end.calibration.camera.value("fx")
    return any(abs(fx / camera.value("fx") - 1) < WRONG_FX for camera in (LENS, OTHER, TELE, WIDE))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--only", help="kinds whose name holds this")
    arguments = parser.parse_args()
    total: Counter[str] = Counter()
    all_costs: list[float] = []
    for kind, made in KINDS.items():
        if arguments.only and arguments.only not in kind:
            continue
        codes: Counter[str] = Counter()
        words: Counter[str] = Counter()
        counts: Counter[str] = Counter()
        costs: list[float] = []
        for seed in range(arguments.seeds):
            given = made(seed)
            first = outcome(given)
            if first.trusted:
                counts["trusted"] += 1
                counts["trusted wrongly"] += not close(first)
                continue
            codes.update(first.codes)
            costs.append(cost(given, first, seed))
            steps, ends = followed(given, first, seed)
            words[", ".join(steps)] += 1
            counts["bad"] += 1
            counts["after"] += bool(ends) and all(end.trusted and close(end) for end in ends)
            for end in ends:
                if not end.trusted:
                    print("   ", seed, steps, end.codes, end.said[:300])
        total.update(counts)
        all_costs += costs
        said = ", ".join(f"{code} {number}" for code, number in codes.most_common())
        steps_of = "; ".join(f"{word} {number}" for word, number in words.most_common())
        print(
            f"{kind:26} {arguments.seeds} sets, {counts['trusted']} trusted ({counts['trusted wrongly']} wrongly); "
            f"{said} -> {steps_of}: {counts['after']} of {counts['bad']} trusted; "
            f"cost {np.median(costs or [0]):.2f} ({max(costs, default=0):.2f})",
            flush=True,
        )
    print(
        f"all: {total['after']} of {total['bad']} refusals and distrusts trusted after what was advised; "
        f"cost {np.median(all_costs):.2f} ({max(all_costs):.2f}), {np.mean(np.array(all_costs) <= 1.5):.0%} up to 1.5"
    )


if __name__ == "__main__":
    main()
