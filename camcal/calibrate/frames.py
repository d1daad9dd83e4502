"""Selection of video frames for calibration: sharp, informative about the lens, and different from each other.

What a view tells about the lens, its pose unknown, is the Schur complement of its normal matrix: a Fisher information.
Informations add up, and each frame chosen is the one that lets the determinant of the sum grow most, as a D-optimal
design does. That brings the corners of the image, tilts and distances by itself, since a lens is not known without
them. Designs repeat their best points, and videos do too; frames alike share the errors that are no noise, so a frame
near a chosen one waits until there are no others. Without a first guess of the lens no frame tells more than another,
and they follow in order.
Source: Fedorov, Theory of Optimal Experiments, 1972; Nemhauser, Wolsey, Fisher, An Analysis of Approximations for
Maximizing Submodular Set Functions, 1978 (the greedy choice reaches 63 % of the best one's gain at least).
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import sweep_focal
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import WIDE_MODEL, model_named
from camcal.cameras.observations import Observations
from camcal.dataclass import dataclass, replace
from camcal.solve.least_squares import linearise
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

NOISE = 0.1  # px of error per px of blur; its bound grows with the root of the blur, what reaches in from beside faster
SKEW = 0.05  # px of error per pixel a frame that things move: rows of most sensors are not exposed at one time
POOR = 2.5  # times the error that a quarter of the frames stay below; what is worse is left out
ALIKE = 0.02  # of the image's diagonal that points differ by (RMS) in frames that are alike, halved while too few are
LEAST = 0.003  # not alike, down to this share; what is nearer repeats even the errors of the pixels
_BETTER = 0.25
_SINGULAR = 1e14  # condition of the normal matrix of a pose, in its own units
_FEW = 4  # points in common, below which frames are not compared
_FOCAL, _CENTRE = 0.3, 0.1  # standard deviations of a first guess, shares of the focal length and of the image's width

CHOSEN, BLURRED, MOVING, SAME, SURPLUS = "chosen", "blurred", "moving", "alike", "adds less"


@dataclass(frozen=True)
class FrameChoice:
    """What became of a frame: why is one of CHOSEN, BLURRED, MOVING, SAME, SURPLUS.

    error_px: to be expected of a point. gain: by how much the frame raised the logarithm of the determinant of the
    information, or would have in the end; NaN where it was out of the question. rank: of a chosen one, from 0.
    like: the index of the chosen frame that shows the same.
    """

    why: str
    error_px: float
    gain: float = float("nan")
    rank: int | None = None
    like: int | None = None

    @property
    def chosen(self) -> bool:
        """Whether the frame is one to calibrate from."""
        return self.why == CHOSEN


def choose_frames(views: Sequence[BoardDetection], board: Board, limit: int) -> tuple[FrameChoice, ...]:
    """Return what becomes of every frame when at most `limit` are chosen; the same for the same views.

    All views have points and are of one size. Where blur or motion is not known (NaN), it is taken to be as in the
    better frames; motion is infinite where it was too fast to be followed.
    """
    by_blur, by_motion = _errors(views)
    errors = np.hypot(by_blur, by_motion)
    good = np.flatnonzero(errors <= POOR * np.quantile(errors, _BETTER, method="lower"))
    chosen = _chosen(views, good, errors[good], board, limit)
    whys = np.where(by_motion >= by_blur, MOVING, BLURRED).tolist()
    return tuple(chosen.get(index) or FrameChoice(why, float(errors[index])) for index, why in enumerate(whys))


def _errors(views: Sequence[BoardDetection]) -> Array:
    """Return the errors (2, V) px to be expected of a point: by the blur, and by rows that see things move.

    Where most frames cannot be followed they are pictures taken one by one, and nothing is known of their motion.
    """
    known = np.array([(view.blur_px, view.motion_px) for view in views]).T
    blur, motion = (np.where(np.isnan(each), _usual(each), each) for each in known)
    if np.isinf(_usual(known[1])):
        motion = np.zeros_like(motion)
    return np.stack([NOISE * np.maximum(blur, 1.0), SKEW * motion])


def _chosen(
    views: Sequence[BoardDetection], good: Array, errors: Array, board: Board, limit: int
) -> dict[int, FrameChoice]:
    """Return what becomes of the good frames (their indices), one of several with equal information."""
    views = [views[index] for index in good.tolist()]
    informations = lens_information(views, board, errors)
    search = _Search(_table(views, board), board, ALIKE * float(np.hypot(*views[0].size)))
    known = np.eye(informations.shape[1])
    gains_of: dict[int, float] = {}
    while len(gains_of) < limit and (left := search.left()).size:
        gains = _gains(known, informations[left])
        best = int(left[gains.argmax()])
        gains_of[best] = float(gains.max())
        known = known + informations[best]
        search.take(best)
    ranks = {index: rank for rank, index in enumerate(gains_of)}
    final = _gains(known, informations)
    result = []
    for index, error in enumerate(errors.tolist()):
        if index in gains_of:
            result.append(FrameChoice(CHOSEN, error, gains_of[index], ranks[index]))
        elif search.is_alike(index):
            result.append(FrameChoice(SAME, error, like=int(good[search.like[index]])))
        else:
            result.append(FrameChoice(SURPLUS, error, float(final[index])))
    return dict(zip(good.tolist(), result, strict=True))


class _Search:
    """Points of frames (V, C, 2), how far each frame is from the nearest chosen one, and which one that is.

    alike: px (RMS) below which frames are alike.
    """

    def __init__(self, pixels: Array, board: Board, alike: float) -> None:
        self.pixels, self.board = pixels, board
        self.alike, self.least = alike, alike * LEAST / ALIKE
        self.nearest = np.full(len(pixels), np.inf)
        self.like = np.zeros(len(pixels), np.intp)

    def left(self) -> Array:
        """Return the frames that are not alike to a chosen one, by a smaller measure if there are no others."""
        while not (self.nearest >= self.alike).any() and self.alike > self.least:
            self.alike /= 2
        return np.flatnonzero(self.nearest >= self.alike)

    def take(self, best: int) -> None:
        """Count a frame among the chosen ones."""
        apart = _apart(self.pixels[best], self.pixels, self.board)
        apart[best] = -1.0  # it is not chosen again
        self.like[apart < self.nearest] = best
        self.nearest = np.minimum(self.nearest, apart)

    def is_alike(self, index: int) -> bool:
        return bool(self.nearest[index] < self.alike)


def _gains(known: Array, informations: Array) -> Array:
    """Return by how much each information (V, K, K) would raise the log-determinant of what is known (K, K)."""
    root = np.linalg.inv(np.linalg.cholesky(known))
    return np.asarray(np.linalg.slogdet(np.eye(len(known)) + root @ informations @ root.T)[1])


def _apart(one: Array, others: Array, board: Board) -> Array:
    """Return how far the points (C, 2) of a view are from those of others (V, C, 2), RMS px; inf with few in common.

    A board that is symmetric under rotation may be numbered either way; the nearer way counts.
    """
    nearest = np.full(len(others), np.inf)
    for turn in board.symmetries():
        squares = ((others[:, turn] - one) ** 2).sum(axis=2)
        common = np.isfinite(squares)
        count = common.sum(axis=1)
        mean = np.where(common, squares, 0.0).sum(axis=1) / np.maximum(count, 1)
        nearest = np.minimum(nearest, np.where(count >= min(_FEW, len(one)), np.sqrt(mean), np.inf))
    return nearest


def _table(views: Sequence[BoardDetection], board: Board) -> Array:
    """Return the points of views (V, C, 2), NaN where a point was not found."""
    table = np.full((len(views), board.count, 2), np.nan)
    for row, view in zip(table, views, strict=True):
        row[view.ids] = view.pixels
    return table


def lens_information(views: Sequence[BoardDetection], board: Board, errors: Array) -> Array:
    """Return the information of each view on the lens alone, (V, K, K), with an initial value of information 1.

    errors: (V,) px, standard deviations of the points of each view. Zero where there is no initial value of a lens.
    """
    model = model_named(WIDE_MODEL)  # an estimate is all that is needed
    observations = Observations.of([replace(view, covariance=None) for view in views])  # `errors` stand for it
    state = sweep_focal(model, board, observations, views[0].size)
    if state is None:
        return np.zeros((len(views), len(model.parameter_names), len(model.parameter_names)))
    spread = np.ones(len(model.parameter_names))  # a coefficient of the distortion is 0 ± 1
    spread[:2], spread[2:4] = _FOCAL * state.parameters[0], _CENTRE * views[0].size[0]
    own = [
        _reduced(BoardProblem(model, board, observations, np.arange(len(spread))), state, index)
        for index in range(len(views))
    ]
    return np.asarray(np.array(own) * np.outer(spread, spread) / errors[:, None, None] ** 2)


def _reduced(problem: BoardProblem, state: State, index: int) -> Array:
    """Return the information (K, K) px² of one view about the lens when its pose follows; 0 where it has none."""
    view = np.array([index])
    own = replace(problem, observations=problem.observations.take(view))
    equations = linearise(own, state.take(view))
    if equations is None or np.linalg.cond(equations.group_group[0]) > _SINGULAR:
        return np.zeros((problem.shared, problem.shared))
    coupling = equations.group_shared[0]
    explained = coupling.T @ np.linalg.solve(equations.group_group[0], coupling)
    return np.asarray(equations.shared_shared - explained)


def _usual(values: Array) -> float:
    """Return what a quarter of the values that are known stay below, 0 for none."""
    known = values[~np.isnan(values)]
    return float(np.quantile(known, _BETTER, method="lower")) if known.size else 0.0
