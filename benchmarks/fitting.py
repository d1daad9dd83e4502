"""NIST's 27 reference problems of nonlinear regression from both starts: camcal beside scipy and textbook Gauss–Newton.

Solved: at least 4 correct digits in every parameter. Digits are -log10 of the relative error of the worst parameter
(and standard error), at most the 11 that are certified. Every solver has one setting for all problems; those of scipy
named "tuned" have exact derivatives, scaling by the Jacobian and tolerances of 1e-15.

    python benchmarks/fitting.py [FOLDER of .dat files] [--each]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

PROJECT = Path(__file__).parents[1]
sys.path.append(str(PROJECT / "tests" / "real"))  # where the reader of these files is tested

import nist_strd  # noqa: E402

from camcal.estimate.curves.curve import predictions, predictions_with_jacobian  # noqa: E402
from camcal.estimate.curves.fit import fit_curve  # noqa: E402
from camcal.estimate.curves.search import METHODS, SearchOptions  # noqa: E402

TUNED = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15, "x_scale": "jac", "max_nfev": 10000}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=PROJECT.parent / "shared" / "data" / "nist")
    parser.add_argument("--each", action="store_true", help="print every problem")
    arguments = parser.parse_args()
    problems = [nist_strd.read(arguments.folder / f"{name}.dat") for name in nist_strd.NAMES]
    print(f"{'solver':34} {'solved':>7} {'6 digits':>9} {'mean digits':>12} {'std, 4 digits':>14} {'CPU s':>7}")
    for name, solver in SOLVERS.items():
        started = time.process_time()
        found = [scored(problem, solver, start) for problem in problems for start in (1, 2)]
        elapsed = time.process_time() - started
        values, errors = np.array(found).T
        solved = np.count_nonzero(values >= 4)
        print(
            f"{name:34} {solved:4d}/{len(found)} {np.count_nonzero(values >= 6):9d} {values.mean():12.2f} "
            f"{np.count_nonzero(errors >= 4):14d} {elapsed:7.2f}",
            flush=True,
        )
        if arguments.each:
            for index, (digits, of_errors) in enumerate(found):
                print(f"    {nist_strd.NAMES[index // 2]:10} {index % 2 + 1} {digits:5.1f} {of_errors:5.1f}")


def scored(problem, solver, start):
    """Correct digits of the worst parameter and of the worst standard error, 0 where a solver gives up."""
    with np.errstate(all="ignore"):
        try:
            values, errors = solver(problem, start)
        except (ValueError, np.linalg.LinAlgError):
            return 0.0, 0.0
        if not np.all(np.isfinite(values)):
            return 0.0, 0.0
        return nist_strd.digits(values, problem.values), nist_strd.digits(errors, problem.deviations)


def camcal(options):
    def solve(problem, start):
        fit = fit_curve(problem.curve, problem.data, problem.start(start), options)
        errors = [np.nan if estimate.std is None else estimate.std for estimate in fit.parameters.values()]
        return fit.values, np.nan_to_num(errors)

    return solve


def scipy(method, *, exact):
    def solve(problem, start):
        def residuals(values):
            return (
                predictions(problem.curve, problem.data.columns, values, len(problem.data))[:, 0] - problem.data.target
            )

        def jacobian(values):
            curve = problem.curve
            return predictions_with_jacobian(curve, problem.data.columns, values, len(problem.data), curve.parameters)[
                1
            ][:, 0]

        settings = TUNED | {"jac": jacobian} if exact else {}
        found = least_squares(residuals, problem.starts[start - 1], method=method, **settings)
        return found.x, standard_errors(found.fun, jacobian(found.x))

    return solve


def textbook(problem, start):
    """Normal equations, full steps, and a stop when the cost has risen: after the bad step was taken."""
    values, last = problem.starts[start - 1].copy(), np.inf
    names = problem.curve.parameters
    for _ in range(100):
        predicted, slopes = predictions_with_jacobian(
            problem.curve, problem.data.columns, values, len(problem.data), names
        )
        residuals, jacobian = predicted[:, 0] - problem.data.target, slopes[:, 0]
        step = np.linalg.solve(jacobian.T @ jacobian, -jacobian.T @ residuals)
        cost = residuals @ residuals
        if not cost < last:
            break
        values, last = values + step, cost
    return values, standard_errors(residuals, jacobian)


def standard_errors(residuals, jacobian):
    variance = residuals @ residuals / (len(residuals) - jacobian.shape[1])
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)) * variance)


SOLVERS = {
    "textbook Gauss-Newton": textbook,
    "camcal --method gauss-newton": camcal(SearchOptions(method=METHODS[1])),
    "scipy trf, defaults": scipy("trf", exact=False),
    "scipy lm, defaults": scipy("lm", exact=False),
    "scipy trf, tuned": scipy("trf", exact=True),
    "scipy lm, tuned": scipy("lm", exact=True),
    "camcal": camcal(SearchOptions()),
}


if __name__ == "__main__":
    main()
