"""What is wrong with one view and not with the next, as zero-mean effects: their columns beside those of its pose.

smooth: a field over the board, whatever its cause (blur, compression, air, a lens that focuses). rolling: the rows of
the image were exposed one after the other while the camera moved. flex: the board bent out of its own shape.
A coefficient of variance τ moves the corners of a view by √τ RMS: pixels, for flex the board's unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, Derivatives, State
from camcal.targets.board import Board
from camcal.targets.surface import CLASSES, basis, normalised

SMOOTH_DEGREE = 3
# how fast the spectrum of a field with the correlation exp(-d / 4 squares) falls, by degree: seen on boards of 6 x 4 to
# 14 x 10 corners
_SPECTRUM = (0.0, 1.0, 0.3, 0.12)
FLEX_TERMS = tuple(term for name in ("twist", "bow", "cubic") for term in CLASSES[name].terms)


@dataclass(frozen=True)
class Effect:
    """One kind of effect: its name, the columns that a view has of it, and whether its coefficients are the board's (in
    its unit) or pixels.
    """

    name: str
    columns: int
    of_board: bool = False


SMOOTH = Effect("smooth", 2 * sum(degree + 1 for degree in range(1, SMOOTH_DEGREE + 1)))
ROLLING = Effect("rolling", 6)
FLEX = Effect("flex", len(FLEX_TERMS), of_board=True)
EFFECTS = (SMOOTH, ROLLING, FLEX)


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns (2, m, V, P) of effects, pixels per unit of a coefficient, and which effect each belongs to (m,)."""

    values: Array
    effect: Array

    def of(self, effects: Sequence[int]) -> "EffectColumns":
        """Return the columns of some effects alone, by their places in EFFECTS."""
        chosen = np.isin(self.effect, list(effects))
        if chosen.all():
            return self
        return EffectColumns(np.ascontiguousarray(self.values[:, chosen]), self.effect[chosen])


def columns_at(
    problem: BoardProblem, state: State, derivatives: Derivatives, present: Array, names: Sequence[str]
) -> EffectColumns:
    """Return the columns of the effects of some names at a state; at states nearby they differ by scale alone."""
    if not names:
        return EffectColumns(np.zeros((2, 0, *present.shape)), np.zeros(0, np.intp))
    columns = effect_columns(
        problem.board,
        problem.observations.ids,
        # as projected: columns with the noise of measured corners in them could explain this noise
        problem.observations.pixels + derivatives.residuals.reshape(2, *present.shape),
        derivatives.by_pose().reshape(2, 6, *present.shape),
        np.moveaxis(derivatives.by_board(state.rotations)[..., 2], 2, 0),
        present,
    )
    return columns.of([index for index, effect in enumerate(EFFECTS) if effect.name in names])


def effect_columns(
    board: Board, ids: Array, pixels: Array, by_pose: Array, by_height: Array, present: Array
) -> EffectColumns:
    """Return the columns of all EFFECTS for V views of P corners.

    ids: (V, P). pixels: (2, V, P) of the projected corners. by_pose: (2, 6, V, P) derivatives by the pose. by_height:
    (2, V, P) by a corner's height over the board. present: (V, P) bool.
    """
    values = np.zeros((2, sum(effect.columns for effect in EFFECTS), *ids.shape))
    modes = SMOOTH.columns // 2
    values[0, :modes] = values[1, modes : 2 * modes] = _smooth(board)[:, ids]
    rows = pixels[1]
    time = (rows - np.mean(rows[present])) / max(float(np.std(rows[present])), 1.0)  # of unit variance over all corners
    # a pose parameter's share of the shift: so much of it as moves the corners of this view by 1 px RMS
    squared = np.sum(by_pose**2 * present, axis=(0, 3)) / np.maximum(present.sum(axis=1), 1)
    rolling = slice(SMOOTH.columns, SMOOTH.columns + ROLLING.columns)
    values[:, rolling] = time * by_pose / np.sqrt(np.maximum(squared, 1e-30))[None, :, :, None]
    values[:, rolling.stop :] = by_height[:, None] * np.moveaxis(basis(board, FLEX_TERMS)[:, 2][ids], 2, 0)
    values *= present
    return EffectColumns(values, np.repeat(np.arange(len(EFFECTS)), [effect.columns for effect in EFFECTS]))


def _smooth(board: Board) -> Array:
    """Return the modes (m / 2, C) of a smooth field in one coordinate, whose sum has a mean square of 1 at unit
    coefficients.
    """
    x, y = normalised(board).T
    modes, shares = [], []
    for degree in range(1, SMOOTH_DEGREE + 1):
        for order in range(degree + 1):
            modes.append(_legendre(degree - order, x) * _legendre(order, y))
            shares.append(_SPECTRUM[degree])
    values = np.array(modes) * np.sqrt(np.array(shares) / np.sum(shares))[:, None]
    return np.asarray(values)


def _legendre(degree: int, values: Array) -> Array:
    """Return the Legendre polynomial of unit mean square over [-1, 1]."""
    return np.asarray(np.sqrt(2 * degree + 1) * np.polynomial.legendre.legval(values, np.eye(degree + 1)[degree]))
