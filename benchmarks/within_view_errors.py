"""Errors that adjacent corners of a view share: accuracy of the camera, and whether the covariance covers its errors.

Simulated corners of corner_error_scenes.py; each seed takes the next of its cameras and boards, so that nine seeds in a
row have all nine combinations. The error of a camera is the RMS over the full frame of the rotation-compensated
projection at infinity, in px.
accuracy: the RMS of the errors over the seeds, and the ratio of two of them with its standard deviation by resampling
    of the seeds. 'median' is the median of the ratios of single seeds. 'cv2' is cv2.calibrateCamera; it is left out
    for kannala_brandt4, as cv2.fisheye has no corners beyond 90° from the axis. The oracle knows the board as it is,
    the true covariance of all errors and where the outliers would have been without their error; it starts at the
    truth and estimates lens and poses. '-': not applicable. Only seeds on which both methods succeed count in a ratio;
    'failed' counts the seeds on which camcal did not. 'lost' is the share of rejected corners.
coverage: how often the truth is within 1.96 reported standard deviations (95 % wanted), and RMS(error) over
    RMS(reported): over the seeds, and the median over single seeds. 'lens' is fx, fy, cx and cy, where each error is
    divided by its own standard deviation; 'map' is the rotation-compensated projection at 12 points of the image.
'base' is another version of camcal, in the folder given, on the same corners.

    python benchmarks/within_view_errors.py [--base FOLDER] [--seeds 9] [--views 10 20] [--jobs 2]
        [--scenarios clean correlated] [--tables accuracy coverage]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from base_program import answer_of
from corner_error_scenes import CAMERAS, SCENARIOS, Known, Scene, scene
from projection_error import projection_errors

import camcal
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.geometry.pose import point_jacobian, retract
from camcal.run.fanout import fan_out
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

TABLES = ("accuracy", "coverage")
PROGRAMS = ("camcal", "base")
LENS = ("fx", "fy", "cx", "cy")
WITHIN = 1.96
LOST = 0.05  # a lens that has no image of more than this share of the frame has failed
FAILURES = (CamcalError, ValueError, ArithmeticError, cv2.error)
ORACLE_STEPS = 30


@dataclass(frozen=True, eq=False)
class Estimate:
    """A camera, or why there is none, the share of rejected corners, and the seconds that it took."""

    camera: Camera | None
    failure: str = ""
    rejected: float = np.nan
    seconds: float = np.nan


@dataclass(frozen=True)
class Outcome:
    """How an estimate compares with the truth.

    error: RMS over the full frame in px, NaN where it failed. lens, lens_std: errors (4,) and what was reported. map,
    map_std: the same (24,) for the projections of 12 points, px.
    """

    error: float = np.nan
    failure: str = ""
    rejected: float = np.nan
    seconds: float = np.nan
    lens: np.ndarray = field(default_factory=lambda: np.full(4, np.nan))
    lens_std: np.ndarray = field(default_factory=lambda: np.full(4, np.nan))
    map: np.ndarray = field(default_factory=lambda: np.full(24, np.nan))
    map_std: np.ndarray = field(default_factory=lambda: np.full(24, np.nan))


@dataclass(frozen=True)
class Item:
    """What makes a scene."""

    scenario: str
    views: int
    seed: int


Row = dict[str, Outcome]  # by method


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", type=Path, help="folder that has another version of the package camcal")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS), metavar="NAME")
    parser.add_argument("--cameras", nargs="+", choices=CAMERAS, default=list(CAMERAS), metavar="NAME")
    parser.add_argument("--views", type=int, nargs="+", default=[5, 10, 20, 40])
    parser.add_argument("--seeds", type=int, default=9)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--claimed", type=float, default=1.0, help="factor on the standard deviations of the corners")
    parser.add_argument("--max-rejected", type=float, default=0.1, help="the share of rejected corners that may be")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        serve()
        return
    methods = PROGRAMS[: 2 if arguments.base else 1] + (("cv2", "oracle") if "accuracy" in arguments.tables else ())
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; seeds {seeds.start} to {seeds.stop - 1}")
    print(f"camcal: {home_of_camcal()}" + (f"; base: {arguments.base}" if arguments.base else ""))
    print(f"cameras {', '.join(arguments.cameras)}; stated standard deviations x {arguments.claimed:g}")
    items = [Item(name, views, seed) for name in arguments.scenarios for views in arguments.views for seed in seeds]
    base = arguments.base and arguments.base.resolve()
    work = partial(run, methods, base, tuple(arguments.cameras), arguments.claimed, arguments.max_rejected)
    outcomes = fan_out(work, items, jobs=arguments.jobs, processes=True)
    groups: dict[Item, list[Row]] = {}
    if "accuracy" in arguments.tables:
        print_accuracy_header()
    for outcome in outcomes:
        if outcome.error is not None:
            raise outcome.error
        group = replace(outcome.item, seed=0)
        groups.setdefault(group, []).append(outcome.value)
        if len(groups[group]) == len(seeds) and "accuracy" in arguments.tables:
            print_accuracy(f"{group.scenario:21} {group.views:5d}", groups[group])
    if "accuracy" in arguments.tables:
        print_means(groups)
    if "coverage" in arguments.tables:
        print_coverage(groups, [method for method in methods if method in PROGRAMS])
    print_failures(groups)


def run(
    methods: Sequence[str], base: Path | None, cameras: tuple[str, ...], claimed: float, max_rejected: float, item: Item
) -> Row:
    """Return the outcome of each method on one scene, without those that do not apply to it."""
    data = scene(item.scenario, item.views, item.seed, cameras, claimed)
    solvers: dict[str, Callable[[], Estimate | None]] = {
        "camcal": lambda: solve(data.views, data.board, Options(data.truth.model, max_rejected=max_rejected)),
        "base": lambda: solve_by_base(base, data, max_rejected),
        "cv2": lambda: opencv(data),
        "oracle": lambda: None if data.known is None else oracle(data.truth, data.known),
    }
    estimates = {method: solvers[method]() for method in methods}
    return {
        method: compared(data.truth, estimate, reported=method in PROGRAMS)
        for method, estimate in estimates.items()
        if estimate is not None
    }


# estimates


def solve(views: Sequence[BoardDetection], board: Board, options: Options) -> Estimate:
    """Return the camera by camcal."""
    start = time.perf_counter()
    try:
        result = calibrate(views, board, options)
    except FAILURES as error:
        return Estimate(None, f"{type(error).__name__}: {error}", seconds=time.perf_counter() - start)
    rejected = len(result.rejected) / sum(len(view.ids) for view in views)
    return Estimate(result.camera, "", rejected, time.perf_counter() - start)


def solve_by_base(folder: Path, data: Scene, max_rejected: float) -> Estimate:
    """Return the camera by the camcal in a folder, in a process that serves all scenes of this one."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "scene.npz"
        np.savez(
            file,
            counts=[len(view.ids) for view in data.views],
            ids=np.concatenate([view.ids for view in data.views]),
            pixels=np.concatenate([view.pixels for view in data.views]),
            covariance=np.concatenate([view.covariance for view in data.views]),
            size=data.truth.image_size,
            board=[data.board.columns, data.board.rows],
            square=data.board.square,
            model=data.truth.model.name,
            max_rejected=max_rejected,
        )
        answer = answer_of(Path(__file__), folder, str(file))
    camera = None
    if not answer["failure"]:
        arrays = (np.array(answer[key]) for key in ("parameters", "covariance"))
        camera = Camera(data.truth.model, data.truth.image_size, *arrays)
    return Estimate(camera, answer["failure"], answer["rejected"], answer["seconds"])


def serve() -> None:
    """Answer each file name of a scene on the standard input by the estimate as a line of JSON."""
    cv2.setNumThreads(1)
    print(home_of_camcal(), flush=True)
    for line in sys.stdin:
        table = np.load(line.strip())
        ends = np.cumsum(table["counts"])[:-1]
        parts = (np.split(table[key], ends) for key in ("ids", "pixels", "covariance"))
        size = tuple(table["size"].tolist())
        views = [BoardDetection(f"{i:03d}.png", size, *part) for i, part in enumerate(zip(*parts, strict=True))]
        board = Board("chessboard", *table["board"].tolist(), float(table["square"]))
        options = Options(model_named(str(table["model"])), max_rejected=float(table["max_rejected"]))
        estimate = solve(views, board, options)
        answer = {"failure": estimate.failure, "rejected": estimate.rejected, "seconds": estimate.seconds}
        if estimate.camera is not None:
            answer["parameters"] = estimate.camera.parameters.tolist()
            answer["covariance"] = estimate.camera.covariance.tolist()
        print(json.dumps(answer), flush=True)


def home_of_camcal() -> Path:
    return Path(camcal.__file__).resolve().parent.parent


def opencv(data: Scene) -> Estimate | None:
    """Return the camera by cv2.calibrateCamera, None where it does not have the model."""
    if data.truth.model.name != "opencv5":
        return None
    points = data.board.points().astype(np.float32)
    objects = [points[view.ids][:, None] for view in data.views]
    pixels = [view.pixels.astype(np.float32)[:, None] for view in data.views]
    model, size = data.truth.model, data.truth.image_size
    start = time.perf_counter()
    try:
        _, matrix, distortion, *_ = cv2.calibrateCamera(objects, pixels, size, None, None)
    except FAILURES as error:
        return Estimate(None, f"{type(error).__name__}: {error}".splitlines()[0], seconds=time.perf_counter() - start)
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    camera = Camera(model, size, np.array([*core, *distortion.ravel()[:5]]))
    return Estimate(camera, seconds=time.perf_counter() - start)


@dataclass(frozen=True, eq=False)
class OracleState:
    parameters: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray


def oracle(truth: Camera, known: Known) -> Estimate:
    """Return the camera of least squares over lens and poses, weighted by the true covariance of the corners."""
    start = time.perf_counter()
    whitenings = [np.linalg.inv(np.linalg.cholesky(covariance)) for covariance in known.covariances]
    state = OracleState(truth.parameters, known.rotations, known.translations)
    rows = oracle_rows(truth.model, known, whitenings, state)
    cost = oracle_cost(rows)
    for _ in range(ORACLE_STEPS):
        lens, poses = oracle_step(rows)
        for scale in 0.5 ** np.arange(12):
            rotations, translations = retract(state.rotations, state.translations, scale * poses)
            trial = OracleState(state.parameters + scale * lens, rotations, translations)
            trial_rows = oracle_rows(truth.model, known, whitenings, trial)
            trial_cost = oracle_cost(trial_rows)
            if trial_cost <= cost:
                break
        else:
            break
        fall, state, rows, cost = cost - trial_cost, trial, trial_rows, trial_cost
        if fall < 1e-9 * cost:
            break
    return Estimate(Camera(truth.model, truth.image_size, state.parameters), seconds=time.perf_counter() - start)


def oracle_rows(
    model: CameraModel, known: Known, whitenings: list[np.ndarray], state: OracleState
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return for each view the whitened residuals (2n,) and their derivatives by lens (2n, K) and pose (2n, 6)."""
    rows = []
    for ids, pixels, whitening, rotation, translation in zip(
        known.ids, known.pixels, whitenings, state.rotations, state.translations, strict=True
    ):
        rotated = known.points[ids] @ rotation.T
        projected = model.project_with_jacobians(state.parameters, rotated + translation, within_domain=False)
        by_pose = (projected.d_point @ point_jacobian(rotated)).reshape(-1, 6)
        by_lens = projected.d_parameters.reshape(len(by_pose), -1)
        residuals = (projected.pixels - pixels).ravel()
        rows.append((whitening @ residuals, whitening @ by_lens, whitening @ by_pose))
    return rows


def oracle_cost(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> float:
    cost = sum(float(residuals @ residuals) for residuals, *_ in rows)
    return cost if np.isfinite(cost) else np.inf


def oracle_step(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Newton steps of the lens (K,) and of the poses (V, 6)."""
    bases = [np.linalg.qr(by_pose) for *_, by_pose in rows]
    reduced = [
        np.column_stack([by_lens, -residuals]) - basis @ (basis.T @ np.column_stack([by_lens, -residuals]))
        for (residuals, by_lens, _), (basis, _) in zip(rows, bases, strict=True)
    ]
    stacked = np.concatenate(reduced)
    lens = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]
    poses = [
        np.linalg.solve(root, basis.T @ (-residuals - by_lens @ lens))
        for (residuals, by_lens, _), (basis, root) in zip(rows, bases, strict=True)
    ]
    return lens, np.stack(poses)


# comparison with the truth


def compared(truth: Camera, estimate: Estimate, *, reported: bool) -> Outcome:
    """Return how an estimate compares; `reported`: with its covariance as well."""
    if estimate.camera is None:
        return Outcome(failure=estimate.failure, seconds=estimate.seconds)
    camera = estimate.camera
    _, errors = projection_errors(truth, camera)
    if np.isnan(errors).mean() > LOST:
        failure = f"no image of {100 * np.isnan(errors).mean():.0f} % of the frame"
        return Outcome(failure=failure, rejected=estimate.rejected, seconds=estimate.seconds)
    outcome = Outcome(float(np.sqrt(np.nanmean(errors**2))), "", estimate.rejected, estimate.seconds)
    if not reported:
        return outcome
    places = [camera.model.parameter_names.index(name) for name in LENS]
    pixels = twelve_points(truth.image_size)
    slopes = map_of(camera, pixels)
    return replace(
        outcome,
        lens=(camera.parameters - truth.parameters)[places],
        lens_std=np.sqrt(np.diag(camera.covariance)[places]),
        map=displacement(truth, camera, pixels).ravel(),
        map_std=np.sqrt(np.einsum("ij,jk,ik->i", slopes, camera.covariance, slopes)),
    )


def twelve_points(image_size: tuple[int, int]) -> np.ndarray:
    """Return the pixels (12, 2) of a grid that divides the image into equal parts."""
    u, v = np.meshgrid((np.arange(4) + 0.5) / 4, (np.arange(3) + 0.5) / 3)
    return np.column_stack([u.ravel(), v.ravel()]) * image_size - 0.5


def map_of(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return how far the projections of the rays of pixels (N, 2) move with each lens parameter (2N, K).

    The camera turns so that they move as little as possible.
    """
    by_lens, by_turn = ray_jacobians(camera, camera.unproject(pixels).directions)
    return by_lens - by_turn @ np.linalg.lstsq(by_turn, by_lens, rcond=None)[0]


def displacement(truth: Camera, estimate: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return how far (N, 2) the estimate projects the true rays of pixels from these, after the best rotation."""
    rays = truth.unproject(pixels).directions
    for _ in range(10):
        off = estimate.project(rays).pixels - pixels
        turn = np.linalg.lstsq(ray_jacobians(estimate, rays)[1], -off.ravel(), rcond=None)[0]
        rays = rays @ so3.exp(turn).T
    return estimate.project(rays).pixels - pixels


def ray_jacobians(camera: Camera, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the pixels of rays (N, 3) by the lens (2N, K) and by a rotation of the rays (2N, 3)."""
    projected = camera.model.project_with_jacobians(camera.parameters, rays, within_domain=False)
    by_turn = np.einsum("nij,njk->nik", projected.d_point, -so3.hat(rays))
    return projected.d_parameters.reshape(2 * len(rays), -1), by_turn.reshape(-1, 3)


# tables


def print_accuracy_header() -> None:
    print("\naccuracy: RMS of the errors over the seeds, px; ratios on the seeds that both have")
    print(
        f"{'scenario':21} {'views':>5} {'seeds':>5} {'failed':>6} {'camcal':>8} {'base':>8} {'cv2':>8} {'oracle':>8}  "
        f"{'/base':>6} {'±':>5} {'median':>6}  {'/oracle':>7} {'±':>5} {'median':>6}  {'cv2/':>6} "
        f"{'lost %':>7} {'s':>5} {'base s':>6}"
    )


def print_accuracy(label: str, rows: list[Row]) -> None:
    errors = {method: errors_of(rows, method) for method in (*PROGRAMS, "cv2", "oracle")}
    levels = " ".join(number(rms(values), 8, 3) for values in errors.values())
    print(
        f"{label} {len(rows):5d} {int(np.isnan(errors['camcal']).sum()):6d} {levels}  "
        f"{ratio_words(errors['camcal'], errors['base'])}  {ratio_words(errors['camcal'], errors['oracle'], 7)}  "
        f"{number(ratio(errors['cv2'], errors['camcal'])[0], 6, 2)} "
        f"{number(100 * mean_of(rows, 'camcal', 'rejected'), 7, 2)} "
        f"{number(mean_of(rows, 'camcal', 'seconds'), 5, 2)} {number(mean_of(rows, 'base', 'seconds'), 6, 2)}",
        flush=True,
    )


def print_means(groups: dict[Item, list[Row]]) -> None:
    """Print the geometric means over the scenarios of the ratios of RMS errors, and the largest ones."""
    for views in sorted({group.views for group in groups}):
        for other in ("base", "oracle"):
            ratios = {
                group.scenario: ratio(errors_of(rows, "camcal"), errors_of(rows, other))[0]
                for group, rows in groups.items()
                if group.views == views
            }
            ratios = {name: value for name, value in ratios.items() if np.isfinite(value)}
            if ratios:
                mean, worst = np.exp(np.mean(np.log(list(ratios.values())))), max(ratios, key=lambda name: ratios[name])
                print(
                    f"{views} views, camcal / {other}: geometric mean over {len(ratios)} scenarios {mean:.3f}, "
                    f"largest {ratios[worst]:.3f} ({worst})"
                )


def print_coverage(groups: dict[Item, list[Row]], methods: list[str]) -> None:
    print("\ncoverage: share of errors within 1.96 standard deviations; RMS(error) / RMS(reported)")
    print(
        f"{'scenario':21} {'views':>5} {'method':6} {'scenes':>6}  {'lens within':>11} {'ratio':>6} {'median':>6}  "
        f"{'map within':>10} {'ratio':>6} {'median':>6}"
    )
    for group, rows in groups.items():
        for method in methods:
            print_covered(f"{group.scenario:21} {group.views:5d} {method:6}", rows, method)
    for views in sorted({group.views for group in groups}):
        rows = [row for group, part in groups.items() if group.views == views for row in part]
        for method in methods:
            print_covered(f"{'all':21} {views:5d} {method:6}", rows, method)


def print_covered(label: str, rows: list[Row], method: str) -> None:
    outcomes = [row[method] for row in rows if np.isfinite(row[method].map_std).all()]
    if not outcomes:
        print(f"{label} {0:6d}")
        return
    scores = np.stack([outcome.lens / outcome.lens_std for outcome in outcomes])
    errors, stds = (np.stack([getattr(outcome, key) for outcome in outcomes]) for key in ("map", "map_std"))
    by_lens = np.sqrt((scores**2).mean(axis=1))
    by_map = np.sqrt((errors**2).mean(axis=1) / (stds**2).mean(axis=1))
    print(
        f"{label} {len(outcomes):6d}  {100 * (np.abs(scores) <= WITHIN).mean():9.1f} % {number(rms(by_lens), 6, 2)} "
        f"{number(np.median(by_lens), 6, 2)}  {100 * (np.abs(errors) <= WITHIN * stds).mean():8.1f} % "
        f"{number(rms(by_map), 6, 2)} {number(np.median(by_map), 6, 2)}",
        flush=True,
    )


def print_failures(groups: dict[Item, list[Row]]) -> None:
    """Print how often each method failed on what, and the first reason."""
    for method in (*PROGRAMS, "cv2"):
        failures: dict[Item, list[str]] = {}
        for group, rows in groups.items():
            reasons = [row[method].failure for row in rows if method in row and row[method].failure]
            if reasons:
                failures[group] = reasons
        if failures:
            print(f"\n{method}: {sum(map(len, failures.values()))} failed")
            for group, reasons in failures.items():
                print(f"  {group.scenario}, {group.views} views: {len(reasons)}, such as {reasons[0]}")


def errors_of(rows: list[Row], method: str) -> np.ndarray:
    """Return the errors of a method, NaN where it failed or was not run."""
    return np.array([row[method].error if method in row else np.nan for row in rows])


def mean_of(rows: list[Row], method: str, key: str) -> float:
    values = np.array([getattr(row[method], key) if method in row else np.nan for row in rows])
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else np.nan


def rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def ratio(errors: np.ndarray, others: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio of the RMS errors, its standard deviation by resampling, and the median of the ratios."""
    both = np.isfinite(errors) & np.isfinite(others)
    if not both.any():
        return np.nan, np.nan, np.nan
    squared, other = errors[both] ** 2, others[both] ** 2
    median = np.median(np.sqrt(squared / other))
    draws = np.random.default_rng(0).integers(0, len(squared), (2000, len(squared)))
    resampled = np.sqrt(squared[draws].sum(axis=1) / other[draws].sum(axis=1))
    return (
        float(np.sqrt(squared.sum() / other.sum())),
        float(resampled.std()),
        float(median),
    )


def ratio_words(errors: np.ndarray, others: np.ndarray, width: int = 6) -> str:
    value, spread, median = ratio(errors, others)
    return f"{number(value, width, 3)} {number(spread, 5, 2)} {number(median, 6, 3)}"


def number(value: float, width: int, digits: int) -> str:
    return f"{value:{width}.{digits}f}" if np.isfinite(value) else f"{'-':>{width}}"


if __name__ == "__main__":
    main()
