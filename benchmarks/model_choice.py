"""The lens model that `calibrate` chooses, against the best one in hindsight.

real: views of real sets are divided at random into halves, and into eight views and the rest. The lens model is chosen
    from one part; with every candidate the board and lens of that part then predict the other part's corners (see
    held-out in split_halves.py). 'ratio' is the held-out RMS with the chosen model over that with the best one; 'worst'
    is the largest of a set, 'flips' are parts whose choice is not that of most.
simulated: lenses of 40° to 200° across, whose radial profiles mix the classic projections (perspective, stereographic,
    equidistant, equisolid, orthographic) and are none of the candidates, with decentred elements; 10 or 20 views of a
    hand-held board, noise of 0.1 px. 'ratio' is the RMS error of the map, over the part of the image that corners
    cover, over that of the best candidate.
jitter: the choice from corners moved by 0.001 px, 8 times: how many choices differ from the first.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/model_choice.py [--parts real simulated jitter] [--detections FOLDER]
        [--sets NAME …] [--splits 2] [--seeds 60] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from corner_error_scenes import BOARDS, Setting, held_by_hand
from projection_error import projection_errors
from real_sets import SETS
from scipy.spatial import Delaunay
from split_halves import CLIP, MODELS, held_out, make_table, numbered, read_views, table_of

from camcal.calibrate.intrinsics import Calibration, Options, calibrate, compare_models
from camcal.calibrate.jackknife import chosen
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.errors import CamcalError
from camcal.run.fanout import fan_out
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.model_selection import select

COMPARED = ("opencv5", "kannala_brandt4", "kannala_brandt5t", "opencv8")
PARTS = ("real", "simulated", "jitter")
KINDS = ("half of 8 views or more", "smaller half", "eight views")
EIGHT, LEAST_LEFT = 8, 4  # views to choose from, and to predict
LISTED = 1.1  # larger ratios are listed
JITTER, JITTERS = 0.001, 8  # px
SIZE, NOISE = (1280, 960), 0.1
DEFAULT = Options(model_named(DEFAULT_MODEL))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--detections", type=Path, default=Path("detections"))
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(MODELS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    if "simulated" in arguments.parts:
        print_simulated(range(arguments.seeds), arguments.jobs)
    for name in arguments.sets:
        if not table_of(arguments.detections, name).exists():
            make_table(arguments.detections, name)
    if "real" in arguments.parts:
        print_real(arguments.detections, arguments.sets, arguments.splits, arguments.jobs)
    if "jitter" in arguments.parts:
        print_jitter(arguments.detections, arguments.sets, arguments.jobs)


# real sets


@dataclass(frozen=True)
class Choice:
    """A choice: kind of division, the model, held-out RMS px by model (inf where it fails), and why it was refused."""

    kind: str
    model: str
    errors: dict[str, float]
    failure: str = ""

    @property
    def ratio(self) -> float:
        return self.errors.get(self.model, np.inf) / min(self.errors.values())


def print_real(folder: Path, names: Sequence[str], splits: int, jobs: int) -> None:
    print(f"{'set':17} {'parts':>5} {'mean':>6} {'worst':>6} {'flips':>5}  chosen", flush=True)
    every: list[Choice] = []
    for outcome in fan_out(partial(choices, folder, splits), names, jobs=jobs, processes=True):
        if outcome.error is not None:
            raise outcome.error
        found: list[Choice] = outcome.value
        if not found:
            continue
        every += found
        ratios, models = [own.ratio for own in found], Counter(own.model or "refused" for own in found)
        flips = len(found) - models.most_common(1)[0][1]
        said = ", ".join(f"{name} {count}" for name, count in models.most_common())
        print(
            f"{outcome.item:17} {len(found):5d} {np.mean(ratios):6.3f} {np.max(ratios):6.3f} {flips:5d}  {said}",
            flush=True,
        )
        for own in found:
            if own.failure:
                print(f"    {own.kind}, refused: {own.failure}")
            elif own.ratio > LISTED:
                print(f"    {own.kind}, {own.model}: " + ", ".join(f"{n} {e:.3f} px" for n, e in own.errors.items()))
    for kind in KINDS:
        ratios = [own.ratio for own in every if own.kind == kind]
        done = [ratio for ratio in ratios if np.isfinite(ratio)]
        if done:
            print(f"{kind}: {len(ratios)} choices, mean {np.mean(done):.3f}, worst {np.max(ratios):.3f}")


def choices(folder: Path, splits: int, name: str) -> list[Choice]:
    """Return the choices from parts of one set."""
    board, views = read_views(folder, name)
    whole = calibrate(views, board, replace(DEFAULT, model=model_named(MODELS[name]), max_rejected=1.0))
    views = numbered(board, views, [view.symmetry for view in whole.views])
    rng, result = np.random.default_rng(1), []
    for _ in range(splits):
        order = rng.permutation(len(views))
        divisions = []
        if len(views) >= 2 * LEAST_LEFT:
            middle = len(views) // 2
            kind = KINDS[0] if middle >= EIGHT else KINDS[1]
            divisions += [(kind, order[:middle], order[middle:]), (kind, order[middle:], order[:middle])]
        if len(views) >= EIGHT + LEAST_LEFT and len(views) // 2 != EIGHT:
            divisions.append((KINDS[2], order[:EIGHT], order[EIGHT:]))
        for kind, first, rest in divisions:
            parts = [[views[index] for index in np.sort(part)] for part in (first, rest)]
            result.append(choice(kind, board, *parts))
    return result


def choice(kind: str, board: Board, views: Sequence[BoardDetection], others: Sequence[BoardDetection]) -> Choice:
    """Return the choice from some views, judged by other ones."""
    model, found, failure = calibrations(board, views)
    distances = {
        name: held_out(own.camera.model, own.camera.parameters, own.surface.points(), others)
        for name, own in found.items()
    }
    clip = CLIP * min(np.median(np.nan_to_num(own, nan=np.inf)) for own in distances.values())
    errors = {name: float(np.sqrt((np.fmin(own, clip) ** 2).mean())) for name, own in distances.items()}
    return Choice(kind, model, errors, failure)


def calibrations(board: Board, views: Sequence[BoardDetection]) -> tuple[str, dict[str, Calibration], str]:
    """Return the chosen model, the calibrations by model, and why no model was chosen."""
    found, model, failure = {}, "", ""
    try:
        taken = select(views, board, DEFAULT).calibration
        model = taken.camera.model.name
        found[model] = taken
    except CamcalError as error:
        failure = error.message
    for name in COMPARED:
        if name not in found and (calibration := solved(board, views, name)) is not None:
            found[name] = calibration
    return model, found, failure


def solved(board: Board, views: Sequence[BoardDetection], model: str) -> Calibration | None:
    try:
        return calibrate(views, board, replace(DEFAULT, model=model_named(model), max_rejected=1.0))
    except CamcalError:
        return None


# simulated lenses


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens whose radial profile is a sum of classic ones: radius = f Σ share · profile(θ), decentred by a little.

    parameters: the focal length, px, where scenes look for it.
    """

    image_size: tuple[int, int]
    parameters: np.ndarray
    centre: np.ndarray
    shares: np.ndarray
    tangential: np.ndarray
    widest: float

    def project(self, points: np.ndarray) -> "LensPoints":
        """Return the pixels (N, 2) of points (N, 3), NaN beyond the widest angle."""
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        radius = np.where(angle <= self.widest, self.radius(np.minimum(angle, self.widest)), np.nan)
        across = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-300)
        x, y = (points[:, :2] * (radius / across)[:, None]).T
        p1, p2 = self.tangential
        shift = np.column_stack([2 * p1 * x * y + p2 * (3 * x**2 + y**2), p1 * (x**2 + 3 * y**2) + 2 * p2 * x * y])
        return LensPoints(pixels=self.parameters[0] * (np.column_stack([x, y]) + shift) + self.centre)

    def unproject(self, pixels: np.ndarray) -> "LensPoints":
        """Return the unit directions (N, 3) of pixels (N, 2), NaN beyond the widest angle."""
        table = np.linspace(0, self.widest, 4001)
        goal = (pixels - self.centre) / self.parameters[0]
        plane = goal.copy()
        for _ in range(30):  # the shift is small: its fixed point is soon found
            x, y = plane.T
            p1, p2 = self.tangential
            plane = goal - np.column_stack(
                [2 * p1 * x * y + p2 * (3 * x**2 + y**2), p1 * (x**2 + 3 * y**2) + 2 * p2 * x * y]
            )
        radius = np.hypot(*plane.T)
        angle = np.interp(radius, self.radius(table), table, right=np.nan)
        for _ in range(3):
            slope = (self.radius(angle + 1e-6) - self.radius(angle - 1e-6)) / 2e-6
            angle = angle - (self.radius(angle) - radius) / slope
        across = plane * (np.sin(angle) / np.maximum(radius, 1e-300))[:, None]
        return LensPoints(directions=np.column_stack([across, np.cos(angle)]))

    def radius(self, angle: np.ndarray) -> np.ndarray:
        profiles = (
            np.tan(np.minimum(angle, 1.2)),
            2 * np.tan(angle / 2),
            angle,
            2 * np.sin(angle / 2),
            np.sin(np.minimum(angle, np.pi / 2)),
        )
        return sum(share * profile for share, profile in zip(self.shares, profiles, strict=True))


@dataclass(frozen=True, eq=False)
class LensPoints:
    pixels: np.ndarray | None = None
    directions: np.ndarray | None = None


def lens_of(seed: int) -> tuple[Lens, float]:
    """Return a lens and its angle across the image's diagonal, degrees."""
    rng = np.random.default_rng([seed, 1])
    across = rng.uniform(40, 200)
    half = np.radians(across / 2)
    possible = np.array([half < 1.0, True, True, True, half < 1.3], float)  # radii that grow to the widest angle
    shares = rng.dirichlet(np.full(5, 0.7)) * possible
    if half < 0.9:
        shares[0] += 2.0  # narrow lenses are nearly perspective
    shares /= shares.sum()
    lens = Lens(SIZE, np.ones(1), np.zeros(2), shares, rng.normal(0, 5e-4, 2), half * 1.05)
    corner = np.hypot(*SIZE) / 2
    focal = corner / lens.radius(np.array([half]))[0]
    centre = (np.array(SIZE) - 1) / 2 + rng.normal(0, 8, 2)
    return replace(lens, parameters=np.array([focal]), centre=centre), across


def print_simulated(seeds: range, jobs: int) -> None:
    print(f"{'lens':>6} {'views':>5} {'chosen':17} {'px':>7} {'best':17} {'px':>7} {'ratio':>6}", flush=True)
    ratios = {10: [], 20: []}
    for outcome in fan_out(simulated, list(seeds), jobs=jobs, processes=True):
        if outcome.error is not None:
            raise outcome.error
        for views, across, model, errors in outcome.value:
            best = min(errors, key=errors.__getitem__)
            ratios[views].append(errors.get(model, np.inf) / errors[best])
            print(
                f"{across:5.0f}° {views:5d} {model or 'refused':17} {errors.get(model, np.inf):7.3f} {best:17} "
                f"{errors[best]:7.3f} {ratios[views][-1]:6.2f}",
                flush=True,
            )
    for views, found in ratios.items():
        median, high = np.percentile(found, [50, 90], method="higher")
        print(f"{views} views: {len(found)} lenses, median {median:.3f}, 90th percentile {high:.3f}")


def simulated(seed: int) -> list[tuple[int, float, str, dict[str, float]]]:
    """Return for 10 and 20 views of a lens: views, angle, the chosen model, and the errors by model, px."""
    lens, across = lens_of(seed)
    board = BOARDS[seed % len(BOARDS)]
    setting = Setting(lens, (0.3, 0.8))
    result = []
    for count in (10, 20):
        views = [view_of(lens, board, setting, seed, index) for index in range(count)]
        model, found, _ = calibrations(board, views)
        seen = Delaunay(np.concatenate([view.pixels for view in views]))
        errors = {name: map_error(lens, own, seen) for name, own in found.items()}
        result.append((count, across, model, errors))
    return result


def view_of(lens: Lens, board: Board, setting: Setting, seed: int, index: int) -> BoardDetection:
    rotation, translation = held_by_hand(setting, board, index % 5 in (1, 3), np.random.default_rng([seed, 2, index]))
    exact = lens.project(board.points() @ rotation.T + translation).pixels
    inside = ((exact >= 2) & (exact <= np.array(SIZE) - 3)).all(axis=1)
    ids = np.flatnonzero(inside)
    noise = np.random.default_rng([seed, 3, index]).normal(0, NOISE, (len(ids), 2))
    return BoardDetection(f"{index:03d}.png", SIZE, ids, exact[ids] + noise)


def map_error(lens: Lens, found: Calibration, seen: Delaunay) -> float:
    pixels, errors = projection_errors(lens, found.camera)
    inside = seen.find_simplex(pixels) >= 0
    return float(np.sqrt(np.mean(np.nan_to_num(errors[inside], nan=50.0) ** 2)))


# moved corners


def print_jitter(folder: Path, names: Sequence[str], jobs: int) -> None:
    for outcome in fan_out(partial(jittered, folder), names, jobs=jobs, processes=True):
        if outcome.error is not None:
            raise outcome.error
        first, *others = outcome.value
        print(
            f"{outcome.item:17} {first:17} {sum(other != first for other in others)} of {len(others)} differ",
            flush=True,
        )


def jittered(folder: Path, name: str) -> list[str]:
    """Return the models that predict best: from the corners, and from corners that are moved."""
    board, views = read_views(folder, name)
    result = []
    for seed in range(JITTERS + 1):
        rng = np.random.default_rng(seed)
        moved = [
            replace(view, pixels=view.pixels + rng.normal(0, JITTER if seed else 0, view.pixels.shape))
            for view in views
        ]
        candidates = compare_models(moved, board, DEFAULT, [model_named(model) for model in COMPARED])
        result.append(chosen(candidates, DEFAULT_MODEL).name)
    return result


if __name__ == "__main__":
    main()
