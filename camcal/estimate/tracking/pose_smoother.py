"""What later frames say of earlier poses: the fixed-interval smoother and, for a bounded delay, the fixed-lag one.

Source: Rauch, Tung, Striebel 1965; on the error of a pose, which is linear for small steps, as the filter has it.
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.pose_filter import Belief, moved
from camcal.geometry import rotation as so3


class Run(NamedTuple):
    """A filter's beliefs at M successive frames, along the first axis of every array.

    filtered: after each frame. predicted: before it; the first is the filtered one. growth: (M, 12, 12) how errors
    grew from the frame before; the first is of no use.
    """

    filtered: Belief
    predicted: Belief
    growth: Array


def smoothed(run: Run) -> Belief:
    """Return the beliefs (M, …) at every frame given all frames."""
    result = [run.filtered.each(lambda values: values[-1])]
    for frame in range(len(run.growth) - 2, -1, -1):
        result.append(_back(run, np.array(frame), result[-1]))
    return Belief(*(np.stack(parts[::-1]) for parts in zip(*result, strict=True)))


def smoothed_with_lag(run: Run, lag: int) -> Belief:
    """Return the beliefs (M, …) at every frame given the frames up to `lag` later ones, the last ones given all."""
    last = len(run.growth) - 1
    frames = np.arange(last + 1)
    newest = np.minimum(frames + lag, last)
    result = run.filtered.each(lambda values: values[newest])
    for behind in range(lag):
        at = newest - 1 - behind
        going = at >= frames
        back = _back(run, at[going], result.each(lambda values: values[going]))  # noqa: B023 - used at once
        for whole, part in zip(result, back, strict=True):
            whole[going] = part
    return result


def _back(run: Run, frame: Array, later: Belief) -> Belief:
    """Return the beliefs at frames (...) from what became of the beliefs at the frames after them."""
    filtered = run.filtered.each(lambda values: values[frame])
    expected = run.predicted.each(lambda values: values[frame + 1])
    growth = run.growth[frame + 1]
    gain = np.linalg.solve(expected.covariances, growth @ filtered.covariances).swapaxes(-1, -2)
    covariances = filtered.covariances + gain @ (later.covariances - expected.covariances) @ gain.swapaxes(-1, -2)
    step = (gain @ _difference(later, expected)[..., None])[..., 0]
    return moved(filtered, step, (covariances + covariances.swapaxes(-1, -2)) / 2)


def _difference(after: Belief, before: Belief) -> Array:
    """Return the step (..., 12) from one mean to another."""
    turn = so3.log(after.rotations @ before.rotations.swapaxes(-1, -2))
    shift = after.translations - before.translations
    return np.concatenate([shift, turn, after.velocities - before.velocities], axis=-1)
