"""How far disparities may be off: fit it to pairs with known truth, and show what share of the errors it covers.

Scenes are rendered, half as `camcal simulate --stereo` makes them by default and half of other sizes, lenses, light and
noise; folders add real pairs, in the layouts that benchmarks/stereo.py reads. The 68 % quantile of the logarithm of the
errors is regressed on the evidence of camcal/stereo/matching/match.py, by class; the tables printed are those
that stand there. Every second scene is fitted, the others are for the shares. Last, of the real pairs: the share of the
errors within the sigma that camcal reports, without the median error of a pair; in brackets, with the rounding of the
truth added to sigma.

    python benchmarks/disparity_uncertainty.py [FOLDER …] [--reported] [--scenes 44] [--slanted 500:524] [--boxes 11:15]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from box_scenes import box_scenes
from slanted_scenes import slanted_scenes
from stereo_pairs import Pair, pairs_in

from camcal.simulate.stereo_scene import PairOptions, render_pair
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.match import estimated, match
from camcal.stereo.matching.preparation import prepare
from camcal.stereo.options import ALL, QUALITIES, MatchOptions

SHARE = 0.68
SAMPLES = 4000  # pixels of a class of a pair; neighbours tell the same
FEWEST = 200
LEAST_ERROR = 2e-3  # px, which keeps logarithms finite
ROUNDS = 60
NARROWEST = 0.02  # of the residuals whose weights the rounds bring to those of a quantile
RIDGE = 1e-3


class Errors(NamedTuple):
    """Evidence (N, K), class (N,) and error (N,), px, of the pixels of a pair."""

    evidence: np.ndarray
    confidence: np.ndarray
    error: np.ndarray


Weights = Mapping[Confidence, np.ndarray]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--scenes", type=int, default=44)
    parser.add_argument("--slanted", default="", metavar="FIRST:LAST", help="seeds of generated slanted scenes")
    parser.add_argument("--boxes", default="", metavar="FIRST:LAST", help="seeds of plates, for the last of it")
    parser.add_argument("--weight", type=float, default=1.5, help="of a real pair beside a rendered one")
    parser.add_argument("--reported", action="store_true", help="only the last of it")
    arguments = parser.parse_args()
    if not arguments.reported:
        print_fit(arguments)
    boxes = range(*map(int, arguments.boxes.split(":"))) if arguments.boxes else ()
    print_reported([*(pair for folder in arguments.folders for pair in pairs_in(folder, 0.0)), *box_scenes(boxes)])


def print_fit(arguments: argparse.Namespace) -> None:
    scenes = [errors_of(*pair) for pair in rendered(arguments.scenes)]
    slanted = range(*map(int, arguments.slanted.split(":"))) if arguments.slanted else ()
    scenes += [errors_of(pair.left, pair.right, pair.truth) for pair in slanted_scenes(slanted)]
    real = {
        pair.name: errors_of(pair.left, pair.right, pair.truth)
        for folder in arguments.folders
        for pair in pairs_in(folder, 0.0)
    }
    for quality in QUALITIES:
        fitted = fit([pair[quality] for pair in [*scenes[::2], *real.values()]], len(real), arguments.weight)
        print_table(quality, fitted)
        for what, pairs in (("fitted", scenes[::2]), ("other", scenes[1::2])):
            print(f"  {what} scenes  {shares([pair[quality] for pair in pairs], fitted)}")
        for name, pair in real.items():
            print(f"  {name}  {shares([pair[quality]], fitted)}")


def print_reported(pairs: Sequence[Pair]) -> None:
    print("| |", " | ".join(QUALITIES), "|\n|---|" + "---:|" * len(QUALITIES))
    for pair in pairs:
        cells = []
        for quality in QUALITIES:
            found = match(pair.left, pair.right, MatchOptions(quality, fill=ALL))
            known = np.isfinite(pair.truth)
            off = (found.values - pair.truth)[known]
            off, sigma = np.abs(off - np.median(off)), found.sigma[known]
            rounding = float(np.diff(np.unique(pair.truth[known])).min()) / np.sqrt(12)
            own, with_rounding = (100 * np.mean(off <= np.hypot(sigma, added)) for added in (0.0, rounding))
            cells.append(f"{own:.1f} ({with_rounding:.1f})")
        print(f"| {pair.name} |", " | ".join(cells), "|", flush=True)


def rendered(count: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield left, right and truth of generated scenes."""
    for index in range(count):
        rng = np.random.default_rng(5000 + index)
        options = PairOptions(noise=(1, 1, 0, 2, 5)[index // 4 % 5]) if index // 2 % 2 == 0 else varied(rng)
        truth = render_pair(options, np.random.default_rng(9000 + index))
        yield truth.left, truth.right, truth.disparity_left


def varied(rng: np.random.Generator) -> PairOptions:
    """Return another camera before another world."""
    width = int(rng.choice([480, 640, 800]))
    nearest = float(rng.uniform(0.06, 0.13) * width)
    exposed = rng.random() < 0.3
    return PairOptions(
        size=(width, int(0.72 * width)),
        focal=float(width * rng.uniform(0.7, 1.3)),
        disparities=(float(rng.uniform(0.1, 0.35) * nearest), nearest),
        objects=int(rng.integers(5, 22)),
        blur=float(rng.uniform(0.35, 0.9)),
        noise=float(np.exp(rng.uniform(np.log(0.3), np.log(5)))),
        row_shift=float(rng.choice([0, 0, 0.3])),
        colour=bool(rng.random() < 0.6),
        depth=int(rng.choice([8, 8, 16])),
        gain=float(rng.uniform(0.7, 1.2)) if exposed else 1.0,
        gamma=float(rng.uniform(0.8, 1.4)) if exposed else 1.0,
        offset=float(rng.uniform(-5, 10)) if exposed else 0.0,
    )


def errors_of(left: np.ndarray, right: np.ndarray, truth: np.ndarray) -> dict[str, Errors]:
    """Return the evidence and the errors of a pair by quality."""
    found = {}
    for quality in QUALITIES:
        estimate = estimated(prepare(left, right), quality)
        every = slice(None, None, estimate.step)
        error = np.abs(estimate.dense - truth)[every, every]
        known = np.isfinite(error)
        found[quality] = Errors(
            estimate.evidence[:, known].T, estimate.confidence[every, every][known], error[known].astype(np.float64)
        )
    return found


def fit(pairs: Sequence[Errors], real: int, weight: float) -> Weights:
    """Return the weights of the evidence by class; the last `real` pairs weigh more."""
    rng = np.random.default_rng(0)
    fitted = {}
    for each in list(Confidence)[1:]:
        evidence, logarithm, weights = [], [], []
        for index, pair in enumerate(pairs):
            members = np.flatnonzero(pair.confidence == each)
            if len(members) < FEWEST:
                continue
            chosen = rng.choice(members, min(len(members), SAMPLES), replace=False)
            evidence.append(pair.evidence[chosen])
            logarithm.append(np.log(pair.error[chosen] + LEAST_ERROR))
            share = min(1.0, len(members) / 1000) / len(chosen)
            weights.append(np.full(len(chosen), share * (weight if index >= len(pairs) - real else 1.0)))
        if evidence:
            fitted[each] = quantile(*(np.concatenate(part).astype(float) for part in (evidence, logarithm, weights)))
    return fitted


def quantile(evidence: np.ndarray, logarithm: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the linear quantile regression (Koenker and Bassett, Econometrica 1978), by reweighted least squares."""
    ridge = RIDGE * weights.sum() * np.diag((np.arange(evidence.shape[1]) > 0).astype(float))
    solution = np.linalg.lstsq(evidence, logarithm, rcond=None)[0]
    for _ in range(ROUNDS):
        off = logarithm - evidence @ solution
        each = weights * np.where(off > 0, SHARE, 1 - SHARE) / np.maximum(np.abs(off), NARROWEST)
        normal = evidence.T @ (each[:, None] * evidence) + ridge
        solution = np.linalg.solve(normal, evidence.T @ (each * logarithm))
    return solution


def shares(pairs: Sequence[Errors], fitted: Weights) -> str:
    """Return in words what share of the errors lies within the prediction, by class and in all."""
    confidence = np.concatenate([pair.confidence for pair in pairs])
    table = np.zeros((len(Confidence), pairs[0].evidence.shape[1]))
    for each, row in fitted.items():
        table[each] = np.round(row, 3)
    within = np.concatenate(
        [pair.error <= np.exp(np.sum(pair.evidence * table[pair.confidence], axis=1)) for pair in pairs]
    )
    parts = [f"{each.name.lower()} {within[confidence == each].mean():.1%}" for each in fitted]
    return ", ".join([*parts, f"all {within.mean():.1%}"])


def print_table(quality: str, fitted: Weights) -> None:
    print(f"{quality}")
    for each, row in fitted.items():
        print(f"    Confidence.{each.name}: ({', '.join(f'{value + 0.0:.3g}' for value in np.round(row, 3))}),")


if __name__ == "__main__":
    main()
