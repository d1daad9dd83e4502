"""What a filter's innovations say about the noise it was told: are its errors as large as it claims?"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.smoothing.kalman import gate

CONSISTENT, OVERCONFIDENT, UNDERCONFIDENT = "consistent", "overconfident", "underconfident"
NOT_JUDGED, AMBIGUOUS = "not judged", "ambiguous"

_NEAR_ONE = 0.1  # a mean NIS this near to 1 means standard deviations right to 5 %: no reason to change anything
_CONFIDENCE = 0.95
_MANY = 0.08  # of innovations beyond their 95 % bound
_NOTHING = "no measurement could be predicted from earlier ones"
_ADVICE = {
    CONSISTENT: "errors are as large as the covariances say",
    OVERCONFIDENT: "errors are larger than the covariances say: raise sigma",
    UNDERCONFIDENT: "errors are smaller than the covariances say: lower sigma or q",
}
_ALTERNATING = {
    CONSISTENT: "errors are as large as the covariances say, but the filter runs after the noise: lower q, raise sigma",
    OVERCONFIDENT: "the filter runs after noise that is larger than sigma says: raise sigma",
    UNDERCONFIDENT: "the filter runs after the noise, its gain is too high: lower q",
}


@dataclass(frozen=True)
class Consistency:
    """How innovations compare with what was claimed of them.

    innovations: how many. mean_nis: mean normalised innovation squared of one degree of freedom, 1 if all is right.
    interval: in which it lies with 95 % if all is right. beyond_95: share of innovations beyond their own 95 % bound.
    autocorrelation: of successive innovations, 0 if all is right; autocorrelation_limit: its 95 % bound.
    verdict: consistent, overconfident, underconfident, not judged without innovations, or, of poses, ambiguous where
    too many may be another pose. advice: what to do, in words.
    """

    innovations: int
    mean_nis: float
    interval: tuple[float, float]
    beyond_95: float
    autocorrelation: float
    autocorrelation_limit: float
    verdict: str
    advice: str


def consistency(nis: Array, freedom: Array, pairs: tuple[Array, Array]) -> Consistency:
    """Return what innovations say about the noise.

    nis: (N,) their normalised squares. freedom: (N,) the numbers each has. pairs: two arrays (M,) of whitened numbers,
    the second measured one step after the first, of the same kind.
    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    if len(nis) == 0:
        unknown = float("nan")
        return Consistency(0, unknown, (unknown, unknown), unknown, 0.0, 1.0, NOT_JUDGED, _NOTHING)
    total = float(np.sum(freedom))
    mean = float(np.sum(nis)) / total
    tail = (1 - _CONFIDENCE) / 2
    low, high = (gate(total, level) / total for level in (tail, 1 - tail))
    limits = {number: gate(number, _CONFIDENCE) for number in np.unique(freedom).tolist()}
    beyond = float(np.mean(nis > [limits[number] for number in freedom.tolist()]))
    correlation, limit = _autocorrelation(*pairs)
    verdict = _verdict(mean, low, high)
    least = max(limit, _NEAR_ONE)
    advice = _advice(verdict, correlation > least, correlation < -least, beyond > _MANY)
    return Consistency(len(nis), mean, (low, high), beyond, correlation, limit, verdict, advice)


def successive(whitened: Array, chains: Array) -> tuple[Array, Array]:
    """Return whitened innovations (N, m), NaN where there is none, paired with the next of the same chain.

    chains: (N,) innovations of one number belong together. Returns two arrays (M,).
    """
    pairs: tuple[list[Array], list[Array]] = ([], [])
    for chain in np.unique(chains):
        for column in whitened[chains == chain].T:
            present = column[np.isfinite(column)]
            pairs[0].append(present[:-1])
            pairs[1].append(present[1:])
    return np.concatenate(pairs[0] or [np.empty(0)]), np.concatenate(pairs[1] or [np.empty(0)])


def _autocorrelation(first: Array, second: Array) -> tuple[float, float]:
    """Return the correlation of successive numbers of mean 0 and the 95 % bound of white noise; 0 and 1 without any."""
    scale = np.sqrt(np.sum(first**2) * np.sum(second**2))
    if not scale > 0:
        return 0.0, 1.0
    return float(np.sum(first * second) / scale), float(min(1.96 / np.sqrt(len(first)), 1.0))


def _verdict(mean: float, low: float, high: float) -> str:
    if low <= mean <= high or abs(mean - 1) <= _NEAR_ONE:
        return CONSISTENT
    return OVERCONFIDENT if mean > 1 else UNDERCONFIDENT


def _advice(verdict: str, lasting: bool, alternating: bool, many_large: bool) -> str:
    """Return what to do.

    lasting: errors stay from step to step, a motion the model does not follow. alternating: they change sign from step
    to step, as where a filter runs after the noise of its measurements. many_large: more innovations are beyond their
    bound than noise makes.
    """
    if alternating:
        return _ALTERNATING[verdict]
    if verdict == OVERCONFIDENT and lasting:
        return "the motion changes faster than the model allows: raise q"
    if verdict == CONSISTENT and lasting:
        return "errors are as large as the covariances say, but successive ones are alike: try another motion model"
    if verdict == CONSISTENT and many_large:
        return "errors are as large as the covariances say, but large ones come too often: use a robust loss"
    return _ADVICE[verdict]
