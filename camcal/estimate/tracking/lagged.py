"""Poses with a bounded look-ahead: at every frame the best hypothesis that so many later frames leave.

Source: Rauch, Tung, Striebel 1965, back along the hypothesis that is best at the newest frame.
"""

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.free_motion import MotionState, difference
from camcal.estimate.tracking.hypotheses import Forward, Hypotheses
from camcal.geometry import rotation as so3


def lagged(forward: Forward, lag: int, far: float) -> tuple[MotionState, Array, Array]:
    """Return the states (M), covariances (M, S, S) and chances (M) that another pose holds, from the first detection.

    far: angle (rad) from which on a pose is another one.
    """
    known = [hypotheses for hypotheses in forward.frames if hypotheses is not None]
    last = len(known) - 1
    frames = np.arange(last + 1)
    newest = np.minimum(frames + lag, last)
    chosen = np.array([int(np.argmin(known[frame].costs)) for frame in newest])
    states, covariances = _gathered(known, newest, chosen, "states", "covariances")
    at = newest.copy()
    which = chosen.copy()
    while (going := at > frames).any():
        rows = np.flatnonzero(going)
        later, index = at[rows], which[rows]
        expected, expected_spread = _gathered(known, later, index, "forecasts", "forecast_covariances")
        growth = np.array([known[frame].transitions[one] for frame, one in zip(later, index, strict=True)])
        which[rows] = [int(known[frame].parents[one]) for frame, one in zip(later, index, strict=True)]
        at[rows] -= 1
        filtered, spread = _gathered(known, at[rows], which[rows], "states", "covariances")
        gain = np.linalg.solve(expected_spread, growth @ spread).swapaxes(-1, -2)
        step = (gain @ difference(states.at(rows), expected)[..., None])[..., 0]
        after = spread + gain @ (covariances[rows] - expected_spread) @ gain.swapaxes(-1, -2)
        for whole, part in zip(states, filtered.moved(step), strict=True):
            whole[rows] = part
        covariances[rows] = (after + after.swapaxes(-1, -2)) / 2
    return states, covariances, _wrong(known, newest, states.rotations, far)


def _gathered(
    known: list[Hypotheses], frames: Array, which: Array, states: str, covariances: str
) -> tuple[MotionState, Array]:
    """Return one hypothesis of each of some frames."""
    pairs = list(zip(frames, which, strict=True))
    chosen = [getattr(known[frame], states).at(one) for frame, one in pairs]
    spread = np.array([getattr(known[frame], covariances)[one] for frame, one in pairs])
    return MotionState(*map(np.stack, zip(*chosen, strict=True))), spread


def _wrong(known: list[Hypotheses], newest: Array, rotations: Array, far: float) -> Array:
    """Return the weight (M) of the hypotheses at the newest frames that were at another pose."""
    result = np.zeros(len(newest))
    for frame, last in enumerate(newest):
        hypotheses = known[last]
        if len(hypotheses.costs) == 1:
            continue
        weights = np.exp(-(hypotheses.costs - hypotheses.costs.min()) / 2)
        which = np.arange(len(weights))
        for back in range(last, frame, -1):
            which = known[back].parents[which]
        apart = so3.angle_between(known[frame].states.rotations[which], rotations[frame]) > far
        result[frame] = weights[apart].sum() / weights.sum()
    return result
