"""Smoothers of K steps, and what the textbooks' measurement noise does to a filter.

First table: x_k = x_{k-1} + u_k + w_k, y_k = x_k + n_k, solved four ways: the inverse of the dense normal equations
(as lectures print it), Kalman filter and RTS, the banded factor (states alone, and with all covariances), and filterpy
where it is installed. Second: a point of constant velocity (acceleration noise 2 m/s² held over a step, positions
measured to 0.05 m), filtered with the sensor's variance as R, and with R = dt⁴/4, which has no relation to it.

    python benchmarks/smoother.py [--steps 100 300 1000 3000] [--trials 20] [--repeats 5]
"""

import argparse
import importlib.util
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from camcal.estimate.smoothing.batch import solve_batch
from camcal.estimate.smoothing.linear_system import LinearSystem, MotionModel, kalman_filter, rts
from camcal.estimate.smoothing.series import Series, system_of

Q, R = 0.04, 0.25
ACCELERATION, SIGMA = 2.0, 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, nargs="+", default=[100, 300, 1000, 3000])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    times(arguments.steps, arguments.repeats)
    print()
    noises(arguments.trials)


def times(steps: list[int], repeats: int) -> None:
    ways: dict[str, Callable[[LinearSystem], np.ndarray]] = {
        "dense": dense,
        "RTS": lambda system: rts(system, kalman_filter(system))[0][:, 0],
        "banded": lambda system: solve_batch(system).means[:, 0],
        "with cov": lambda system: solve_batch(system).smoothed()[0][:, 0],
    }
    if importlib.util.find_spec("filterpy"):
        ways["filterpy"] = filterpy
    print(f"{'steps':>6} " + " ".join(f"{name + ' ms':>12}" for name in ways) + f" {'largest difference':>20}")
    for count in steps:
        system = chain(count)
        taken = {name: fastest(partial(way, system), repeats) for name, way in ways.items()}
        states = [way(system) for name, way in ways.items() if name != "filterpy"]  # it starts from a guess
        off = max(np.abs(state - states[0]).max() for state in states)
        print(f"{count:6d} " + " ".join(f"{1e3 * taken[name]:12.3f}" for name in ways) + f" {off:20.1e}", flush=True)


def chain(count: int) -> LinearSystem:
    rng = np.random.default_rng(count)
    controls = rng.normal(size=(count, 1))
    truth = np.cumsum(controls + np.sqrt(Q) * rng.normal(size=(count, 1)), axis=0)
    measured = truth + np.sqrt(R) * rng.normal(size=(count, 1))
    series = Series(("x",), np.arange(float(count)), measured, np.full((count, 1), np.sqrt(R)), controls)
    unit = system_of(series, MotionModel("rw"))
    return LinearSystem(
        unit.transitions, unit.controls, Q * unit.process, unit.linked, unit.observation, unit.measurements, unit.noise
    )


def dense(system: LinearSystem) -> np.ndarray:
    count = len(system)
    H = np.vstack([np.eye(count)[1:] - np.eye(count)[:-1], np.eye(count)])
    weights = np.concatenate([np.full(count - 1, 1 / Q), np.full(count, 1 / R)])
    z = np.concatenate([system.controls[:, 0], system.measurements[:, 0]])
    return np.linalg.inv(H.T * weights @ H) @ (H.T @ (weights * z))


def filterpy(system: LinearSystem) -> np.ndarray:
    from filterpy.kalman import KalmanFilter

    kalman = KalmanFilter(1, 1, 1)
    kalman.F = kalman.H = kalman.B = np.eye(1)
    kalman.Q, kalman.R = np.array([[Q]]), np.array([[R]])
    kalman.x, kalman.P = system.measurements[:1], np.array([[R]])
    means, covariances, *_ = kalman.batch_filter(system.measurements[1:], us=system.controls)
    return kalman.rts_smoother(means, covariances)[0].ravel()


def fastest(work: Callable[[], np.ndarray], repeats: int) -> float:
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def noises(trials: int) -> None:
    print(
        f"{'dt s':>7} {'R':>8} {'NIS':>10} {'position rms m':>15} {'velocity rms m/s':>17}   medians of {trials} runs"
    )
    for dt in (0.01, 1 / 30, 1.0):
        for name, sigma in (("sensor", SIGMA), ("dt^4/4", dt**2 / 2)):
            runs = [filtered(dt, sigma, seed) for seed in range(trials)]
            nis, position, velocity = np.median(runs, axis=0)
            print(f"{dt:7.4f} {name:>8} {nis:10.4g} {position:15.4f} {velocity:17.4f}", flush=True)


def filtered(dt: float, sigma: float, seed: int, count: int = 300) -> tuple[float, float, float]:
    """Return NIS of one number, and the errors of position and velocity, of a filter told this sigma."""
    rng = np.random.default_rng(seed)
    motion = MotionModel("cv", "discrete")
    F, pushed = motion.transition(np.array([dt]))[0], np.array([dt**2 / 2, dt])
    states = [np.zeros(2)]
    for _ in range(count - 1):
        states.append(F @ states[-1] + pushed * ACCELERATION * rng.normal())
    truth = np.array(states)
    measured = truth[:, :1] + SIGMA * rng.normal(size=(count, 1))
    series = Series(("x",), dt * np.arange(count), measured, np.full((count, 1), sigma))
    unit = system_of(series, motion)
    system = LinearSystem(
        unit.transitions,
        unit.controls,
        ACCELERATION**2 * unit.process,
        unit.linked,
        unit.observation,
        unit.measurements,
        unit.noise,
    )
    run = kalman_filter(system)
    late = slice(count // 3, None)  # after it has settled
    off = np.array([state.mean for state in run.states[late]]) - truth[late]
    rms = np.sqrt(np.mean(off**2, axis=0))
    return float(np.nanmean(run.nis[late])), float(rms[0]), float(rms[1])


if __name__ == "__main__":
    main()
