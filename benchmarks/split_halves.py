"""Halves of real sets: how far two lenses differ, what was predicted, and how well a half predicts the other's corners.

The views of a set are divided at random into two halves, --splits times. Each program calibrates both halves from the
same corners with the same lens model.
map: RMS over the splits of the distance in px between the images that the two lenses have of the same directions, on a
    grid within the hull of the set's corners, at infinity, after the rotation that suits best. 'predicted' is what the
    two covariances lead one to expect, 'ratio' is map / predicted (wanted: 1), 'median' the median of single splits.
held-out: the corners of one half as predicted by lens and board of the other. The pose of each view is fitted to these
    corners, robustly, by the same code for all programs; lens and board are held. RMS distance in px over the splits,
    where distances count up to 6 times the lowest of the programs' medians; a corner that a lens cannot take counts as
    such a distance. '/best' is the ratio to the program with the lowest RMS of those with the fewest failures, '/ref'
    that to base or, without it, camcal; on the splits that both have.
true: with --simulated, RMS distance of the map of a half's lens from that of the lens that the corners were made with.
    Halves that agree may be wrong alike: lenses of a board taken as drawn are, where it is bent.
failed: splits of which a half was not calibrated. s: median seconds of one calibration by the clock, with the start of
    a process for mrcal and lensboy.
Sets whose halves have fewer than 8 views have a table of their own.

The programs: camcal; plain (camcal with the board as drawn); base (the camcal in the folder given); opencv
(cv2.calibrateCamera, or cv2.fisheye.calibrate for kannala_brandt4; the board as drawn, no corner rejected); mrcal and
lensboy in the interpreters given, for opencv5 and opencv8. Both start from the focal length of the whole set. The
estimated shape of the board is part of what a half predicts. A board that looks the same when turned may be numbered
otherwise from view to view; all programs have the numbers of one calibration of the whole set (by base if it is given,
else by camcal).

--simulated: the corners are those of a scene that repeats the set. Lens, board and poses are camcal's of the whole set;
the errors of a view are those that the set shows there, with either sign at random.

Corners come from FOLDER/SET.csv, spaces in the set's name as underscores; tables that are missing are made from the
images.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/split_halves.py [--detections FOLDER] [--splits 10] [--sets NAME …]
        [--base FOLDER] [--mrcal /usr/bin/python3] [--lensboy PYTHON] [--programs NAME …] [--simulated] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from base_program import answer_of
from real_sets import DATA, SETS
from scipy.spatial import ConvexHull, Delaunay

import camcal
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import CameraModel
from camcal.errors import CamcalError
from camcal.formats import detections
from camcal.geometry import rotation as so3
from camcal.geometry.pose import point_jacobian, retract
from camcal.run.fanout import fan_out
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.calibrate import calibrate as calibrate_files
from camcal.tasks.calibration.options import CalibrateOptions

PROGRAMS = ("camcal", "plain", "base", "opencv", "mrcal", "lensboy")
MORE_SETS = {
    "chessboard-video": ("pnp/boofcv-chessboard-video/movie.mjpeg", "chessboard:6x4:30mm"),
    "tumvi": ("aprilgrid/tumvi-1024/*.png", "aprilgrid:6x6:88mm:0.3"),
}
ALL_SETS = SETS | MORE_SETS
OTHER_MODELS = {
    "udacity-gopro": "kannala_brandt4",
    "theta fisheye": "kannala_brandt4",
    "ocamcalib fish2": "opencv8",
    "sourishg fish l": "kannala_brandt4",
    "sourishg fish r": "opencv8",
    "tumvi": "kannala_brandt4",
}
MODELS = {name: OTHER_MODELS.get(name, "opencv5") for name in ALL_SETS}
PEER_MODELS = ("opencv5", "opencv8")
LEAST_CORNERS = 6
LEAST_VIEWS = 8  # of a half, for the main table
LEAST_SPLIT = 3  # of a half, for any table
CLIP = 6  # times the lowest median
GRID = (24, 18)
UNKNOWN_SQUARE = 0.03  # metres; the peers expect lengths of this kind where the board has none
PEERS = Path(__file__).parent / "peers"
PEER_SECONDS = 300
FAILURES = (CamcalError, ValueError, ArithmeticError, cv2.error)


@dataclass(frozen=True, eq=False)
class Work:
    """What is common to all sets."""

    folder: Path
    programs: tuple[str, ...]
    splits: int
    base: Path | None = None
    interpreters: dict[str, str] = field(default_factory=dict)
    simulated: bool = False

    @property
    def reference(self) -> str:
        """The program that numbers the views and is compared with."""
        return "base" if self.base else "camcal"


@dataclass(frozen=True, eq=False)
class Estimate:
    """The lens (K,) with its covariance, if known, and the board's points (C, 3), or why there are none.

    symmetries: for each view, the symmetry of the board by which camcal exchanged its ids.
    """

    lens: np.ndarray | None = None
    points: np.ndarray | None = None
    covariance: np.ndarray | None = None
    symmetries: tuple[int, ...] = ()
    failure: str = ""
    seconds: float = np.nan


@dataclass(frozen=True, eq=False)
class Split:
    """What a program made of one division: mean squares of the map in px², distances (N,) of the held-out corners."""

    failure: str = ""
    observed: float = np.nan
    true: float = np.nan
    predicted: float = np.nan
    distances: np.ndarray = field(default_factory=lambda: np.zeros(0))
    held_out: float = np.nan
    seconds: float = np.nan


@dataclass(frozen=True, eq=False)
class Outcome:
    """The splits of a set by program, or why there are none."""

    name: str
    views: int
    splits: dict[str, list[Split]]
    failure: str = ""

    @property
    def large(self) -> bool:
        return self.views // 2 >= LEAST_VIEWS


@dataclass(frozen=True)
class Figures:
    """One row of the table; see the head of this file."""

    splits: int
    failed: int
    map: float
    true: float
    predicted: float
    ratio: float
    median: float
    held_out: float
    to_best: float
    map_to_reference: float
    to_reference: float
    seconds: float


Solver = Callable[[Sequence[BoardDetection]], Estimate]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detections", type=Path, help="folder of detection tables")
    parser.add_argument("--sets", nargs="+", choices=ALL_SETS, default=list(ALL_SETS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=10)
    parser.add_argument("--programs", nargs="+", choices=PROGRAMS, default=list(PROGRAMS), metavar="NAME")
    parser.add_argument("--base", type=Path, help="folder that has another version of the package camcal")
    parser.add_argument("--mrcal", help="interpreter that has mrcal")
    parser.add_argument("--lensboy", help="interpreter that has lensboy")
    parser.add_argument("--simulated", action="store_true", help="corners of a scene that repeats the set")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        serve()
        return
    interpreters = {name: getattr(arguments, name) for name in ("mrcal", "lensboy") if getattr(arguments, name)}
    available = {"camcal", "opencv", *interpreters} | ({"base"} if arguments.base else set())
    if plain_options(model_named("opencv5")) is not None:
        available.add("plain")
    programs = tuple(name for name in PROGRAMS if name in available and name in arguments.programs)
    with tempfile.TemporaryDirectory() as scratch:
        base = arguments.base and arguments.base.resolve()
        folder = arguments.detections or Path(scratch)
        work = Work(folder, programs, arguments.splits, base, interpreters, arguments.simulated)
        print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; {arguments.splits} splits of each set")
        print(f"programs: {', '.join(programs)}; numbers of the views and '/ref': {work.reference}", flush=True)
        run_sets(work, arguments.sets, arguments.jobs)


def run_sets(work: Work, names: Sequence[str], jobs: int) -> None:
    for name in names:
        make_table(work.folder, name)
    outcomes = []
    for item in fan_out(partial(run, work), names, jobs=jobs, processes=True):
        if item.error is not None:
            raise item.error
        outcomes.append(item.value)
        print(f"# {item.item}: {item.value.views} views {item.value.failure}", file=sys.stderr, flush=True)
    groups = {f"at least {LEAST_VIEWS} views": True, f"fewer than {LEAST_VIEWS} views": False}
    for words, large in groups.items():
        group = [outcome for outcome in outcomes if outcome.large == large]
        if group:
            print_group(words, group, work)


def table_of(folder: Path, name: str) -> Path:
    return folder / f"{name.replace(' ', '_')}.csv"


def make_table(folder: Path, name: str) -> None:
    """Write the detections of a set, unless they are there."""
    table = table_of(folder, name)
    if table.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    pattern, board = ALL_SETS[name]
    with tempfile.TemporaryDirectory() as scratch:
        camera = Path(scratch) / "camera.yaml"
        try:
            calibrate_files(CalibrateOptions((str(DATA / pattern),), camera, board, save_detections=table))
        except CamcalError as error:
            if not table.exists():
                raise
            print(f"# {name}: {error}", file=sys.stderr)  # the corners are there, only the camera is not


def read_views(folder: Path, name: str) -> tuple[Board, list[BoardDetection]]:
    """Return the views of the most frequent image size that have enough corners."""
    table = detections.read(table_of(folder, name))
    found = [view for view in table.views if view.found]
    size = Counter(view.size for view in found).most_common(1)[0][0]
    return table.board, [view for view in found if view.size == size and len(view.ids) >= LEAST_CORNERS]


def run(work: Work, name: str) -> Outcome:
    """Return what the programs make of one set."""
    cv2.setNumThreads(1)
    board, views = read_views(work.folder, name)
    if len(views) // 2 < LEAST_SPLIT:
        return Outcome(name, len(views), {}, "too few views")
    model = model_named(MODELS[name])
    reference = solve_by_base(work.base, board, model, views) if work.base else solve(board, model, views)
    if reference.lens is None:
        return Outcome(name, len(views), {}, f"{work.reference} on all views: {reference.failure}")
    views = numbered(board, views, reference.symmetries)
    solvers = dict(solvers_of(work, board, model, float(reference.lens[0])))
    judge = Judge.of(model, reference.lens, views)
    scene = Scene.of(board, model, views) if work.simulated else None
    if scene is not None:
        judge = replace(judge, truth=scene.lens)
        views = scene.views
    splits: dict[str, list[Split]] = {program: [] for program in solvers}
    rng = np.random.default_rng(1)
    for first, second in divisions(views, work.splits):
        halves = (first, second) if scene is None else (scene.measured(first, rng), scene.measured(second, rng))
        found = {program: judged(judge, halves, solver) for program, solver in solvers.items()}
        for program, split in clipped(found).items():
            splits[program].append(split)
    return Outcome(name, len(views), splits)


def numbered(board: Board, views: Sequence[BoardDetection], symmetries: Sequence[int]) -> list[BoardDetection]:
    """Return the views with the ids that a calibration of all of them gave to their corners."""
    turns = board.symmetries()
    return [replace(view, ids=turns[turn][view.ids]) for view, turn in zip(views, symmetries, strict=True)]


@dataclass(frozen=True, eq=False)
class Scene:
    """A set as camcal sees it: its lens (K,), views with the corners where lens and board put them, errors by image."""

    lens: np.ndarray
    views: list[BoardDetection]
    errors: dict[str, np.ndarray]

    @classmethod
    def of(cls, board: Board, model: CameraModel, views: Sequence[BoardDetection]) -> "Scene":
        """Return the scene of the views that one calibration of all of them uses."""
        result = calibrate(views, board, Options(model, max_rejected=1.0))
        points = result.surface.points()
        exact, errors = [], {}
        for view, record in zip(views, result.views, strict=True):
            if not record.used:
                continue
            ids = board.symmetries()[record.symmetry][view.ids]
            pixels = result.camera.project(record.camera_T_board.apply(points[ids])).pixels
            off = view.pixels - pixels
            sound = np.linalg.norm(off, axis=1) < CLIP * result.rms_px
            exact.append(replace(view, ids=ids, pixels=pixels))
            errors[view.image] = np.where(sound[:, None], off, 0.0)
        return cls(result.camera.parameters, exact, errors)

    def measured(self, views: Sequence[BoardDetection], rng: np.random.Generator) -> list[BoardDetection]:
        """Return views whose errors have the sizes and shapes of the set's and either sign."""
        signs = rng.choice([-1.0, 1.0], len(views))
        return [
            replace(view, pixels=view.pixels + sign * self.errors[view.image])
            for view, sign in zip(views, signs, strict=True)
        ]


def divisions(
    views: Sequence[BoardDetection], count: int
) -> Iterator[tuple[list[BoardDetection], list[BoardDetection]]]:
    rng = np.random.default_rng(0)
    for _ in range(count):
        order = rng.permutation(len(views))
        first, second = (np.sort(part) for part in np.split(order, [len(views) // 2]))
        yield [views[i] for i in first], [views[i] for i in second]


# programs


def solvers_of(work: Work, board: Board, model: CameraModel, focal: float) -> Iterator[tuple[str, Solver]]:
    """Yield the programs that have the lens model, by name."""
    every: dict[str, Solver] = {
        "camcal": partial(solve, board, model),
        "plain": partial(solve, board, model, plain=True),
        "base": partial(solve_by_base, work.base, board, model),
        "opencv": partial(opencv, board, model),
    }
    if model.name in PEER_MODELS and board.has_grid:
        for name, interpreter in work.interpreters.items():
            every[name] = partial(peer, name, interpreter, board, model, focal)
    for name in work.programs:
        if name in every:
            yield name, every[name]


def solve(board: Board, model: CameraModel, views: Sequence[BoardDetection], *, plain: bool = False) -> Estimate:
    """Return the estimate of camcal; plain: with the board as drawn."""
    options = plain_options(model) if plain else Options(model, max_rejected=1.0)
    start = time.perf_counter()
    try:
        result = calibrate(views, board, options)
    except FAILURES as error:
        return failed(error, start)
    seconds = time.perf_counter() - start
    symmetries = tuple(view.symmetry for view in result.views)
    # the numbers of the half are those that most of its views came with
    points = result.surface.points()[board.symmetries()[Counter(symmetries).most_common(1)[0][0]]]
    return Estimate(result.camera.parameters, points, result.camera.covariance, symmetries, seconds=seconds)


def plain_options(model: CameraModel) -> Options | None:
    """Return the options that hold the board as drawn, None where camcal has no such options."""
    try:
        from camcal.calibrate.fit import ShapeOptions

        return Options(model, shape=ShapeOptions(smooth=False, offsets=False), max_rejected=1.0)
    except (ImportError, TypeError):
        return None


def failed(error: Exception, start: float) -> Estimate:
    words = f"{type(error).__name__}: {error}".splitlines()[0]
    return Estimate(failure=words, seconds=time.perf_counter() - start)


def solve_by_base(folder: Path, board: Board, model: CameraModel, views: Sequence[BoardDetection]) -> Estimate:
    """Return the estimate of the camcal in a folder, from a process that serves all calls of this one."""
    stated = {item.name: getattr(board, item.name) for item in fields(board)}
    defaults = {item.name: item.default for item in fields(board)}
    request = {
        "board": {key: value for key, value in stated.items() if value != defaults[key]},
        "model": model.name,
        "views": [
            {
                "image": view.image,
                "size": view.size,
                "ids": view.ids.tolist(),
                "pixels": view.pixels.tolist(),
                "covariance": None if view.covariance is None else view.covariance.tolist(),
            }
            for view in views
        ],
    }
    answer = answer_of(Path(__file__), folder, json.dumps(request))
    arrays = {key: answer[key] and np.array(answer[key]) for key in ("lens", "points", "covariance")}
    symmetries = tuple(answer["symmetries"])
    return Estimate(**arrays, symmetries=symmetries, failure=answer["failure"], seconds=answer["seconds"])


def serve() -> None:
    """Answer each calibration on the standard input, a line of JSON, by the estimate as a line of JSON."""
    cv2.setNumThreads(1)
    print(Path(camcal.__file__).resolve().parent.parent, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        views = [BoardDetection(**{**view, "size": tuple(view["size"])}) for view in map(with_arrays, request["views"])]
        estimate = solve(Board(**request["board"]), model_named(request["model"]), views)
        values = {item.name: getattr(estimate, item.name) for item in fields(estimate)}
        listed = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}
        print(json.dumps(listed), flush=True)


def with_arrays(view: dict) -> dict:
    return {key: np.array(value) if isinstance(value, list) and key != "size" else value for key, value in view.items()}


def opencv(board: Board, model: CameraModel, views: Sequence[BoardDetection]) -> Estimate:
    """Return the estimate of OpenCV, with the board as drawn."""
    points = board.points().astype(np.float32)
    objects = [points[view.ids][None] for view in views]
    pixels = [view.pixels.astype(np.float32)[None] for view in views]
    size = views[0].size
    start = time.perf_counter()
    try:
        if model.name == "kannala_brandt4":
            names = cv2 if hasattr(cv2, "CALIB_FIX_SKEW") else cv2.fisheye  # OpenCV 5 moved them
            flags = names.CALIB_RECOMPUTE_EXTRINSIC | names.CALIB_FIX_SKEW
            _, matrix, distortion, *_ = cv2.fisheye.calibrate(objects, pixels, size, None, None, flags=flags)
        else:
            flags = cv2.CALIB_RATIONAL_MODEL if model.name == "opencv8" else 0
            _, matrix, distortion, *_ = cv2.calibrateCamera(objects, pixels, size, None, None, flags=flags)
    except FAILURES as error:
        return failed(error, start)
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    lens = np.array([*core, *distortion.ravel()])[: len(model.parameter_names)]
    return Estimate(lens, board.points(), seconds=time.perf_counter() - start)


def peer(
    name: str, interpreter: str, board: Board, model: CameraModel, focal: float, views: Sequence[BoardDetection]
) -> Estimate:
    """Return the estimate that a peer's script prints; see peers/."""
    scale = UNKNOWN_SQUARE if board.square is None else 1.0
    table = np.full((len(views), board.count, 2), np.nan)
    for index, view in enumerate(views):
        table[index, view.ids] = view.pixels
    values = {"pixels": table, "points": scale * board.points(), "size": views[0].size, "focal": focal}
    values |= {"shape": (board.columns, board.rows), "model": model.name}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "data.npz", **values)
        command = [interpreter, PEERS.resolve() / f"{name}_solve.py", folder]
        try:
            result = subprocess.run(command, check=True, capture_output=True, text=True, timeout=PEER_SECONDS)
        except subprocess.CalledProcessError as error:
            words = (error.stderr.strip().splitlines() or ["no message"])[-1]
            return Estimate(failure=words, seconds=time.perf_counter() - start)
        except subprocess.TimeoutExpired as error:
            return failed(error, start)
    points, lens = map(np.array, map(json.loads, result.stdout.splitlines()[-2:]))
    return Estimate(lens, points / scale, seconds=time.perf_counter() - start)


# comparison of the halves


@dataclass(frozen=True, eq=False)
class Judge:
    """A lens model, pixels (N, 2) on which lenses are compared, and how the map there depends on the lens (2M, K).

    truth: the lens of the scene, None where nobody knows it.
    """

    model: CameraModel
    pixels: np.ndarray
    slopes: np.ndarray
    truth: np.ndarray | None = None

    @classmethod
    def of(cls, model: CameraModel, lens: np.ndarray, views: Sequence[BoardDetection]) -> "Judge":
        """Return the judge of a set, from a lens of the whole set."""
        pixels = grid_within(np.concatenate([view.pixels for view in views]))
        return cls(model, pixels, map_slopes(model, lens, pixels))

    def observed(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the mean square distance of the maps of two lenses."""
        off = displacement(self.model, first, second, self.pixels)
        return float((off**2).sum(axis=1).mean()) if len(off) > len(self.pixels) / 2 else np.nan

    def predicted(self, covariance: np.ndarray) -> float:
        """Return the mean square distance that a covariance of the lens leads to."""
        return float(np.einsum("ij,jk,ik->", self.slopes, covariance, self.slopes)) / (len(self.slopes) // 2)


def grid_within(pixels: np.ndarray) -> np.ndarray:
    """Return the points (N, 2) of a grid that are within the convex hull of pixels."""
    hull = Delaunay(pixels[ConvexHull(pixels).vertices])
    ranges = (np.linspace(low, high, count) for low, high, count in zip(*extremes(pixels), GRID, strict=True))
    grid = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, 2)
    return grid[hull.find_simplex(grid) >= 0]


def extremes(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return pixels.min(axis=0), pixels.max(axis=0)


def map_slopes(model: CameraModel, lens: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return how far the images of the rays of pixels move with each lens parameter (2M, K).

    The camera turns so that they move as little as possible.
    """
    rays = model.unproject(lens, pixels)
    directions = rays.directions[rays.valid]
    projected = model.project_with_jacobians(lens, directions, within_domain=False)
    by_turn = np.einsum("nij,njk->nik", projected.d_point, -so3.hat(directions)).reshape(-1, 3)
    by_lens = projected.d_parameters.reshape(len(by_turn), -1)
    held = np.isfinite(by_lens).all(axis=1)
    by_lens, by_turn = by_lens[held], by_turn[held]
    return by_lens - by_turn @ np.linalg.lstsq(by_turn, by_lens, rcond=None)[0]


def displacement(model: CameraModel, first: np.ndarray, second: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return how far (M, 2) the second lens projects the rays that the first has of pixels from these.

    The rotation that suits best is taken out; pixels that one of the lenses cannot take are left out.
    """
    rays = model.unproject(first, pixels)
    directions, pixels = rays.directions[rays.valid], pixels[rays.valid]
    rotation = np.eye(3)
    off = np.zeros((0, 2))
    for _ in range(8):
        symmetries = directions @ rotation.T
        projected = model.project_with_jacobians(second, symmetries, within_domain=False)
        by_turn = np.einsum("nij,njk->nik", projected.d_point, -so3.hat(symmetries))
        off = pixels - projected.pixels
        held = np.isfinite(off).all(axis=1) & projected.valid
        off = off[held]
        if len(off) < 2:
            break
        rotation = so3.exp(np.linalg.lstsq(by_turn[held].reshape(-1, 3), off.ravel(), rcond=None)[0]) @ rotation
    return off


def judged(judge: Judge, halves: tuple[list[BoardDetection], list[BoardDetection]], solver: Solver) -> Split:
    """Return what one program makes of two halves."""
    first, second = (solver(half) for half in halves)
    seconds = float(np.mean([first.seconds, second.seconds]))
    for estimate in (first, second):
        if estimate.lens is None or not np.isfinite(estimate.lens).all():
            return Split(estimate.failure or "the lens is not finite", seconds=seconds)
    predicted = np.nan
    if first.covariance is not None and second.covariance is not None:
        predicted = judge.predicted(first.covariance + second.covariance)
    distances = [
        held_out(judge.model, estimate.lens, estimate.points, views)
        for estimate, views in zip((second, first), halves, strict=True)
    ]
    observed = judge.observed(first.lens, second.lens)
    true = np.nan
    if judge.truth is not None:
        true = float(np.mean([judge.observed(judge.truth, estimate.lens) for estimate in (first, second)]))
    return Split("", observed, true, predicted, np.concatenate(distances), seconds=seconds)


def clipped(splits: dict[str, Split]) -> dict[str, Split]:
    """Return the splits of the programs with the mean squares of their held-out distances, large ones clipped."""
    medians = [np.median(np.nan_to_num(split.distances, nan=np.inf)) for split in splits.values() if not split.failure]
    clip = CLIP * min(medians, default=np.nan)
    return {
        name: split
        if split.failure
        else replace(split, held_out=float((np.fmin(split.distances, clip) ** 2).mean()), distances=np.zeros(0))
        for name, split in splits.items()
    }


# prediction of corners


@dataclass(frozen=True, eq=False)
class Corners:
    """Views in arrays of one length: points (V, P, 3) of the board, pixels (V, P, 2), and which are present (V, P)."""

    points: np.ndarray
    pixels: np.ndarray
    present: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, views: Sequence[BoardDetection]) -> "Corners":
        """Return the corners of views; absent ones repeat the first of their view."""
        most = max(len(view.ids) for view in views)
        counts = np.array([len(view.ids) for view in views])
        present = np.arange(most) < counts[:, None]
        places = [np.where(row, np.arange(most), 0) for row in present]
        ids = np.stack([view.ids[place] for view, place in zip(views, places, strict=True)])
        pixels = np.stack([view.pixels[place] for view, place in zip(views, places, strict=True)])
        return cls(points[ids], pixels, present)


@dataclass(frozen=True, eq=False)
class Poses:
    """Rotations (V, 3, 3) and translations (V, 3) of the board in the camera."""

    rotations: np.ndarray
    translations: np.ndarray


SCALES = (1.0, 0.2, 0.05)  # px; the assumed noise, from far to near
CAUCHY = 3.0  # noise levels
STEPS = 30
FAR = 1e8  # px², what a corner without an image costs


def held_out(model: CameraModel, lens: np.ndarray, points: np.ndarray, views: Sequence[BoardDetection]) -> np.ndarray:
    """Return the distances (N,) of the views' corners from where lens and points put them, NaN where nowhere.

    The pose of each view is that of least robust cost over its corners.
    """
    corners = Corners.of(points, views)
    poses = first_poses(model, lens, corners)
    for scale in SCALES:
        poses = refined(model, lens, corners, poses, (CAUCHY * scale) ** 2)
    in_camera = np.einsum("vij,vpj->vpi", poses.rotations, corners.points) + poses.translations[:, None]
    projected = model.project(lens, in_camera[corners.present])
    return np.linalg.norm(projected.pixels - corners.pixels[corners.present], axis=1)


def first_poses(model: CameraModel, lens: np.ndarray, corners: Corners) -> Poses:
    """Return poses by linear least squares: a plane's points p and their rays d obey d × (H p) = 0.

    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 4.1, with rays in place of pixels.
    """
    rays = model.unproject(lens, corners.pixels.reshape(-1, 2))
    shape = corners.present.shape
    weights = (corners.present & rays.valid.reshape(shape)).astype(float)
    directions = np.nan_to_num(rays.directions).reshape(*shape, 3)
    low, high = corners.points.min(axis=(0, 1)), corners.points.max(axis=(0, 1))
    centre, size = (low + high) / 2, (high - low).max() / 2
    plane = (corners.points - centre) / size
    plane[..., 2] = 1.0
    rows = np.einsum("vpij,vpk->vpijk", so3.hat(directions), plane).reshape(*shape, 3, 9)
    normal = np.einsum("vp,vpia,vpib->vab", weights, rows, rows)
    homographies = np.linalg.eigh(normal)[1][:, :, 0].reshape(-1, 3, 3)
    facing = np.einsum("vp,vpi,vij,vpj->v", weights, directions, homographies, plane)
    homographies *= np.where(facing < 0, -1.0, 1.0)[:, None, None]
    lengths = np.linalg.norm(homographies[:, :, :2], axis=1).mean(axis=1)
    columns = homographies / np.maximum(lengths, 1e-12)[:, None, None]
    third = np.cross(columns[:, :, 0], columns[:, :, 1])
    rotations = so3.nearest(np.stack([columns[:, :, 0], columns[:, :, 1], third], axis=2))
    return Poses(rotations, columns[:, :, 2] * size - rotations @ centre)


def refined(model: CameraModel, lens: np.ndarray, corners: Corners, poses: Poses, square: float) -> Poses:
    """Return the poses after damped Gauss-Newton steps on Cauchy's loss; square: of its scale, px²."""
    damping = np.full(len(poses.rotations), 1e-4)
    residuals, slopes, cost = linearised(model, lens, corners, poses, square)
    for _ in range(STEPS):
        weights = corners.present / (1 + (residuals**2).sum(axis=-1) / square)
        normal = np.einsum("vp,vpia,vpib->vab", weights, slopes, slopes)
        gradient = np.einsum("vp,vpia,vpi->va", weights, slopes, residuals)
        diagonal = np.einsum("vaa->va", normal)
        normal += np.eye(6) * (damping[:, None] * diagonal + 1e-12 * (1 + diagonal))[:, None]
        steps = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        trial = Poses(*retract(poses.rotations, poses.translations, steps))
        trial_residuals, trial_slopes, trial_cost = linearised(model, lens, corners, trial, square)
        better = trial_cost < cost
        fall = np.where(better, cost - trial_cost, 0.0)
        done = np.where(better, fall <= 1e-9 * cost, damping > 1e6)
        choose = better[:, None, None]
        poses = Poses(
            np.where(choose, trial.rotations, poses.rotations),
            np.where(better[:, None], trial.translations, poses.translations),
        )
        residuals = np.where(choose, trial_residuals, residuals)
        slopes = np.where(choose[..., None], trial_slopes, slopes)
        cost = np.where(better, trial_cost, cost)
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-9, 1e9)
        if done.all():
            break
    return poses


def linearised(
    model: CameraModel, lens: np.ndarray, corners: Corners, poses: Poses, square: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (V, P, 2), their derivatives by the poses (V, P, 2, 6), and the costs (V,)."""
    shape = corners.present.shape
    rotated = np.einsum("vij,vpj->vpi", poses.rotations, corners.points)
    in_camera = rotated + poses.translations[:, None]
    projected = model.project_with_jacobians(lens, in_camera.reshape(-1, 3), within_domain=False)
    residuals = projected.pixels.reshape(*shape, 2) - corners.pixels
    slopes = projected.d_point.reshape(*shape, 2, 3) @ point_jacobian(rotated)
    sound = np.isfinite(residuals).all(axis=-1) & np.isfinite(slopes).all(axis=(-2, -1))
    residuals, slopes = np.where(sound[..., None], residuals, 0.0), np.where(sound[..., None, None], slopes, 0.0)
    squares = np.where(sound, (residuals**2).sum(axis=-1), FAR)
    return residuals, slopes, (corners.present * np.log1p(squares / square)).sum(axis=1)


# tables


def print_group(words: str, outcomes: Sequence[Outcome], work: Work) -> None:
    print(f"\nhalves of {words}; '/ref': ratio to {work.reference}")
    print(
        f"{'set':17} {'model':15} {'views':>5} {'program':8} {'splits':>6} {'failed':>6}  {'map':>7} {'/ref':>6} "
        f"{'true':>6} {'predicted':>9} {'ratio':>6} {'median':>6}  {'held-out':>8} {'/best':>6} {'/ref':>6} {'s':>6}"
    )
    rows: dict[str, list[Figures]] = {}
    for outcome in outcomes:
        label = f"{outcome.name:17} {MODELS[outcome.name]:15} {outcome.views // 2:5d}"
        if outcome.failure:
            print(f"{label} {outcome.failure}")
        for program, figures in figures_of(outcome, work.reference).items():
            rows.setdefault(program, []).append(figures)
            print(f"{label} {program:8} {words_of(figures)}")
    print_failures(outcomes)
    print(
        f"\nhalves of {words}: median over the sets (least to greatest); 'best': sets where it has the lowest held-out"
    )
    print(
        f"{'program':8} {'sets':>4} {'failed':>6}  {'map / predicted':>18} {'its median':>18}  {'map /ref':>18}  "
        f"{'held-out /best':>21} {'held-out /ref':>21} {'best':>4} {'s':>6}"
    )
    for program, figures in rows.items():
        spreads = [spread([getattr(row, key) for row in figures], 2) for key in ("ratio", "median", "map_to_reference")]
        held = [spread([getattr(row, key) for row in figures], 3) for key in ("to_best", "to_reference")]
        failures, best = sum(row.failed for row in figures), sum(row.to_best == 1 for row in figures)
        seconds = median_of(np.array([row.seconds for row in figures]))
        print(
            f"{program:8} {len(figures):4d} {failures:6d}  {spreads[0]:>18} {spreads[1]:>18}  {spreads[2]:>18}  "
            f"{held[0]:>21} {held[1]:>21} {best:4d} {number(seconds, 6, 2)}",
            flush=True,
        )


def figures_of(outcome: Outcome, reference: str) -> dict[str, Figures]:
    """Return the rows of a set by program."""
    held = {name: np.array([split.held_out for split in splits]) for name, splits in outcome.splits.items()}
    maps = {name: np.array([split.observed for split in splits]) for name, splits in outcome.splits.items()}
    lowest = {
        name: (np.isnan(squares).sum(), np.nan_to_num(root_mean(squares), nan=np.inf)) for name, squares in held.items()
    }
    best = min(lowest, key=lowest.get, default="")  # among those with the fewest failures
    result = {}
    for name, splits in outcome.splits.items():
        predicted = np.array([split.predicted for split in splits])
        missing = np.full(len(splits), np.nan)
        result[name] = Figures(
            len(splits),
            sum(bool(split.failure) for split in splits),
            root_mean(maps[name]),
            root_mean(np.array([split.true for split in splits])),
            root_mean(predicted),
            ratio(maps[name], predicted),
            median_of(np.sqrt(maps[name] / predicted)),
            root_mean(held[name]),
            ratio(held[name], held[best]),
            ratio(maps[name], maps.get(reference, missing)),
            ratio(held[name], held.get(reference, missing)),
            median_of(np.array([split.seconds for split in splits])),
        )
    return result


def print_failures(outcomes: Sequence[Outcome]) -> None:
    """Print the first reason for each failure."""
    for outcome in outcomes:
        for program, splits in outcome.splits.items():
            reasons = [split.failure for split in splits if split.failure]
            if reasons:
                print(f"{outcome.name}, {program}: {len(reasons)} failed, such as {reasons[0][:160]}")


def words_of(row: Figures) -> str:
    return (
        f"{row.splits:6d} {row.failed:6d}  {number(row.map, 7, 3)} {number(row.map_to_reference, 6, 2)} "
        f"{number(row.true, 6, 3)} {number(row.predicted, 9, 3)} {number(row.ratio, 6, 2)} {number(row.median, 6, 2)}  "
        f"{number(row.held_out, 8, 4)} {number(row.to_best, 6, 3)} {number(row.to_reference, 6, 3)} "
        f"{number(row.seconds, 6, 2)}"
    )


def ratio(squares: np.ndarray, others: np.ndarray) -> float:
    """Return the ratio of root mean squares where both are known."""
    both = np.isfinite(squares) & np.isfinite(others)
    return float(np.sqrt(squares[both].sum() / others[both].sum())) if both.any() else np.nan


def root_mean(squares: np.ndarray) -> float:
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if len(squares) else np.nan


def median_of(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan


def spread(values: Sequence[float], digits: int) -> str:
    known = np.array(values)[np.isfinite(values)]
    if not len(known):
        return "-"
    return f"{np.median(known):.{digits}f} ({known.min():.{digits}f}–{known.max():.{digits}f})"


def number(value: float, width: int, digits: int) -> str:
    return f"{value:{width}.{digits}f}" if np.isfinite(value) else f"{'-':>{width}}"


if __name__ == "__main__":
    main()
