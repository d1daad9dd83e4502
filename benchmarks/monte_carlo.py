"""Whether the reported uncertainty is the true one: the same views measured again and again with fresh noise.

20 views of a 9 x 6 board, noise 0.1 px, opencv5; once flat, once bent by 1 and 0.5 mm. Per row of the table:
NEES/dof: the mean over the runs of the estimation error squared, normalised by the reported covariance, per degree of
    freedom; 1 is right, and its 99 % interval under a right covariance stands beside it. 'lens' and 'all' (lens, poses
    and board shape, with all their correlations) follow Fisher's F in each run, as the noise is estimated too; 'poses'
    takes each view's pose on its own, and its interval is from the spread between runs, since the poses of one run
    share the errors of its lens.
std ratio: reported over empirical standard deviation, the geometric mean over the parameters (0.95 to 1.05 wanted).
coverage: how often the truth lies within 1.96 reported standard deviations (94 to 96 % wanted).
OpenCV: cv2.calibrateCameraExtended and its stdDeviationsIntrinsics; it reports no covariance to normalise by.

    python benchmarks/monte_carlo.py [--runs 2000] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import cv2
import numpy as np
from scipy.stats import f as fisher
from scipy.stats import norm

from camcal.calibrate.intrinsics import Calibration, Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.run.fanout import fan_out
from camcal.simulate import render
from camcal.simulate.scene import observe, views
from camcal.solve.least_squares import linearise
from camcal.solve.steps import NormalEquations, Step
from camcal.targets.board import Board
from camcal.targets.detection import Detections

SIZE, NOISE, VIEWS = (1600, 1200), 0.1, 20
BOARD = Board("chessboard", 9, 6, 0.025)
MODEL = model_named("opencv5")
TRUTH = Camera(MODEL, SIZE, np.array([1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]))
SHAPES = {"flat": render.FLAT, "bent 1/0.5 mm": render.bow(1e-3, 5e-4)}
TWO_SIDED_95, HALF_WIDTH = float(norm.ppf(0.975)), float(norm.ppf(0.995))


@dataclass(frozen=True)
class Errors:
    """Of a group of parameters in one run: errors, reported standard deviations, NEES and its degrees of freedom, those
    of the noise that it is normalised by.
    """

    errors: np.ndarray
    stds: np.ndarray
    nees: float = np.nan
    degrees_of_freedom: int = 0
    noise_dof: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--first-seed", type=int, default=0, help="another one for fresh noise")
    parser.add_argument("--jobs", type=int)
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; seeds from {arguments.first_seed}")
    print(
        f"{'board':14} {'parameters':12} {'runs':>5} {'dof':>6} {'NEES/dof':>9} {'99 % interval':>15} "
        f"{'std ratio':>10} {'coverage':>9}"
    )
    for name in SHAPES:
        seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
        runs = fan_out(partial(run, name), seeds, jobs=arguments.jobs, processes=True)
        results = [outcome.value for outcome in runs if outcome.value is not None]
        for row in results[0]:
            show(name, row, [result[row] for result in results])


def show(board: str, row: str, results: Sequence[Errors]) -> None:
    """Print one row of the table; runs without a NEES have no say in its mean."""
    errors, stds = (np.stack([getattr(result, key) for result in results]) for key in ("errors", "stds"))
    print(f"{board:14} {row:12} {len(results):5d} ", end="")
    table = np.array(
        [(each.nees, each.degrees_of_freedom, each.noise_dof) for each in results if np.isfinite(each.nees)]
    )
    if len(table):
        sums, dof, noise_dof = table.T
        low, high = interval_of_poses(sums / dof) if row == "poses" else interval(dof, noise_dof)
        print(f"{dof.mean():6.1f} {sums.sum() / dof.sum():9.4f} {low:7.4f} {high:7.4f} ", end="")
    else:
        print(f"{'-':>6} {'-':>9} {'-':>15} ", end="")
    ratios = np.sqrt((stds**2).mean(axis=0)) / errors.std(axis=0, ddof=1)
    coverage = (np.abs(errors) < TWO_SIDED_95 * stds).mean()
    print(f"{np.exp(np.log(ratios).mean()):10.3f} {100 * coverage:7.2f} %", flush=True)


def interval(dof: np.ndarray, noise_dof: np.ndarray) -> tuple[float, float]:
    """Return where the sum of a NEES over many runs lies, per degree of freedom, if the covariances are right."""
    mean = (dof * fisher.mean(dof, noise_dof)).sum() / dof.sum()
    std = np.sqrt((dof**2 * fisher.var(dof, noise_dof)).sum()) / dof.sum()
    return mean - HALF_WIDTH * std, mean + HALF_WIDTH * std


def interval_of_poses(means: np.ndarray) -> tuple[float, float]:
    """Return where the mean of independent runs lies about 1, from their own spread."""
    half = HALF_WIDTH * means.std(ddof=1) / np.sqrt(len(means))
    return 1 - half, 1 + half


@cache
def poses() -> tuple[Pose, ...]:
    return tuple(views(TRUTH, BOARD, VIEWS, rng=np.random.default_rng(7)))


def run(shape: str, seed: int) -> dict[str, Errors]:
    """Return the errors of one measurement of the views, by row of the table."""
    detections, _ = observe(
        TRUTH, BOARD, poses(), rng=np.random.default_rng([seed, 11]), noise_px=NOISE, shape=SHAPES[shape]
    )
    result = calibrate(detections.views, BOARD, Options(MODEL))
    steps = pose_errors(result, SHAPES[shape])
    return {
        "lens": lens_errors(result),
        "poses": poses_alone(result, steps),
        "all": all_errors(result, detections, steps, SHAPES[shape]),
        "OpenCV lens": opencv_errors(detections),
    }


def lens_errors(result: Calibration) -> Errors:
    errors, covariance = result.camera.parameters - TRUTH.parameters, result.camera.covariance
    nees = float(errors @ np.linalg.solve(covariance, errors))
    return Errors(errors, np.sqrt(np.diag(covariance)), nees, len(errors), result.degrees_of_freedom)


def pose_errors(result: Calibration, shape: render.Shape) -> np.ndarray:
    """Return the errors (V, 6) of the poses in the order tx ty tz rx ry rz.

    The truth's bow 1 - x² is the estimate's -2/3 P2(x) on a board that lies 2/3 of the bow deeper.
    """
    lift = np.array([0.0, 0.0, 2 / 3 * (shape.bow_x + shape.bow_y)])
    found = [view.camera_T_board for view in result.views]
    shifts = [
        pose.translation - true.translation - true.rotation @ lift for pose, true in zip(found, poses(), strict=True)
    ]
    turns = [so3.log(pose.rotation @ true.rotation.T) for pose, true in zip(found, poses(), strict=True)]
    return np.concatenate([shifts, turns], axis=1)


def poses_alone(result: Calibration, errors: np.ndarray) -> Errors:
    covariances = np.stack([view.pose_covariance for view in result.views])
    nees = float(np.einsum("vi,vi->", errors, np.linalg.solve(covariances, errors[:, :, None])[..., 0]))
    stds = np.sqrt(np.einsum("vii->vi", covariances))
    return Errors(errors.ravel(), stds.ravel(), nees, errors.size, result.degrees_of_freedom)


def all_errors(result: Calibration, detections: Detections, steps: np.ndarray, shape: render.Shape) -> Errors:
    """Return lens and poses with the NEES of everything that was estimated, correlations and board shape included.

    Without a NEES where the points of the board were freed one by one: their prior says nothing true of them.
    """
    lens, alone = lens_errors(result), poses_alone(result, steps)
    errors, stds = np.concatenate([lens.errors, alone.errors]), np.concatenate([lens.stds, alone.stds])
    if result.surface.offsets is not None:
        return Errors(errors, stds)
    true = {"P2(x)": -2 / 3 * shape.bow_x, "P2(y)": -2 / 3 * shape.bow_y}
    bend = result.surface.coefficients - [true.get(term, 0.0) for term in result.surface.terms]
    step = Step(np.concatenate([lens.errors, bend]), steps)
    nees = quadratic(equations(result, detections), step)
    return Errors(errors, stds, nees, len(step.shared) + steps.size, result.degrees_of_freedom)


def equations(result: Calibration, detections: Detections) -> NormalEquations:
    """Return the normal equations at the estimate, over the noise that was estimated."""
    observations = Observations.of(detections.views)
    rows = {view.image: row for row, view in enumerate(detections.views)}
    for corner in result.rejected:
        observations.weights[rows[corner.image]][observations.ids[rows[corner.image]] == corner.id] = 0.0
    state = State(
        result.camera.parameters,
        np.stack([view.camera_T_board.rotation for view in result.views]),
        np.stack([view.camera_T_board.translation for view in result.views]),
        result.surface.coefficients,
        np.zeros((BOARD.count, 3)),
    )
    problem = BoardProblem(
        MODEL,
        BOARD,
        observations,
        np.arange(len(TRUTH.parameters)),
        result.surface.terms,
        sigma=result.sigma_px,
        lens_spread=MODEL.prior_std(SIZE, TRUTH.value("fx")),
    )
    return linearise(problem, state)


def quadratic(normal: NormalEquations, step: Step) -> float:
    """Return the step's square in the metric of the normal matrix, the inverse of the joint covariance."""
    own = np.einsum("vi,vij,vj->", step.groups, normal.group_group, step.groups)
    cross = np.einsum("vi,vis,s->", step.groups, normal.group_shared, step.shared)
    return float(own + 2 * cross + step.shared @ normal.shared_shared @ step.shared)


def opencv_errors(detections: Detections) -> Errors:
    points = BOARD.points().astype(np.float32)
    objects = [points[view.ids] for view in detections.views]
    pixels = [view.pixels.astype(np.float32) for view in detections.views]
    _, matrix, distortion, _, _, stds, *_ = cv2.calibrateCameraExtended(objects, pixels, SIZE, None, None)
    estimate = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]]
    return Errors(np.array(estimate) - TRUTH.parameters, stds.ravel()[: len(estimate)])


if __name__ == "__main__":
    main()
