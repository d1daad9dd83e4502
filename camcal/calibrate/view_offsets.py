"""What single views would add to parameters that ought to be the same in all of them, and changes that explain it.

Let a view v have k parameters θ_v of its own beside its pose and its effects, while lens and board are common. What is
left of the normal equations is A θ = y, and A⁻¹ is the covariance of the estimates of all θ_v. Offsets that vary from
view to view without order have a variance τ² besides, so a change is looked for under A⁻¹ + τ² I, with the τ that suits
it best.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaincc, ndtri

from camcal.arrays import Array
from camcal.calibrate.variances import scaled
from camcal.solve.steps import NormalEquations, cholesky_solve

_UNORDERED = np.concatenate([[0.0], np.geomspace(1e-5, 0.03, 25)])  # τ, a share of the parameter
# Of the log likelihood, what a τ above zero must gain: few cameras change their focal length from view to view.
_UNUSUAL = 3.0
_ROUNDING = 1e-12  # of the trace of a normal matrix
_KNOWN = 1e-6  # of the best known combination of offsets: combinations known less than that say nothing


@dataclass(frozen=True, eq=False)
class Found:
    """A change: its index among those tried, its size (k,), and twice the log likelihood that it gains."""

    index: int
    size: Array
    gain: float

    def clear(self, places: float) -> float:
        """Return how far the gain is beyond that of the best of so many independent places by chance, in standard
        deviations.
        """
        chance = places * float(gammaincc(len(self.size) / 2, max(self.gain, 0.0) / 2))
        return -float(ndtri(chance / 2)) if chance < 1 else 0.0


def followed(equations: NormalEquations, pose: int, std: Array) -> NormalEquations:
    """Return the equations of the views' own parameters, which come last in their groups, when poses and effects of
    standard deviations (V, m), which come before them, follow these.
    """
    first = pose + std.shape[1]
    own = np.ones((len(std), equations.group_group.shape[-1] - first))
    prepared = scaled(equations, np.column_stack([std, own]))
    np.einsum("vii->vi", prepared.group_group)[:, first:] -= 1.0  # they have no prior
    return prepared.without_first(first)


@dataclass(frozen=True, eq=False)
class ViewOffsets:
    """values: (R,) combinations of the offsets in standard deviations, independent of one another. mixing: (R, V, k)
    the offsets' shares in them. information: (R,) of the combinations.
    """

    values: Array
    mixing: Array
    information: Array

    @classmethod
    def of(cls, equations: NormalEquations, own: Sequence[int]) -> "ViewOffsets":
        """Return the offsets of some of the parameters of the views, by equations whose groups are these, as `followed`
        returns them.
        """
        count, chosen = len(equations.group_group), np.asarray(own)
        blocks, views = np.zeros((count, len(own), count, len(own))), np.arange(count)
        blocks[views, :, views] = equations.group_group[:, chosen[:, None], chosen]
        matrix = blocks.reshape(count * len(own), -1)
        values, coupling = -equations.gradient.groups[:, chosen].ravel(), equations.group_shared[:, chosen]
        if coupling.shape[2]:
            coupling = coupling.reshape(len(values), -1)
            unit = np.sqrt(np.diag(equations.shared_shared))
            root = np.linalg.cholesky(equations.shared_shared / np.outer(unit, unit)) * unit[:, None]
            follow = coupling @ cholesky_solve(root, np.column_stack([coupling.T, equations.gradient.shared]))
            matrix, values = matrix - follow[:, :-1], values + follow[:, -1]
        information, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        known = information > _KNOWN * information[-1]
        information, vectors = information[known], vectors[:, known]
        mixing = np.sqrt(information)[:, None] * vectors.T
        return cls(vectors.T @ values / np.sqrt(information), mixing.reshape(-1, count, len(own)), information)

    def likeliest(self, changes: Array, others: Array | None = None) -> Found:
        """Return the likeliest of changes (V, n) of the offsets, each tried by itself; others: (V, j) changes that are
        there whichever it is.
        """
        size, count = self.mixing.shape[2], changes.shape[1]
        columns = np.einsum("rvk,vn->rnk", self.mixing, changes)
        without = self._likelihoods
        if others is not None:
            common = np.einsum("rvk,vn->rnk", self.mixing, others).reshape(len(columns), 1, -1)
            without = without + self._gains(common)[0][:, 0] / 2
            columns = np.concatenate([columns, np.repeat(common, count, axis=1)], axis=2)
        gains, sizes = self._gains(columns)
        likelihoods = self._likelihoods[:, None] + gains / 2
        tau, index = np.unravel_index(int(np.argmax(likelihoods)), likelihoods.shape)
        gain = 2 * (likelihoods[tau, index] - without.max())
        return Found(int(index), sizes[tau, index, :size], float(gain))

    def unordered(self) -> tuple[float, float]:
        """Return τ and how clear it is, in standard deviations."""
        likelihoods = self._likelihoods + _UNUSUAL * (_UNORDERED > 0)
        best = int(np.argmax(likelihoods))
        return float(_UNORDERED[best]), float(np.sqrt(2 * (likelihoods[best] - likelihoods[0])))

    @cached_property
    def _weights(self) -> Array:
        """The weights (T, R) of the combinations under all τ."""
        return np.asarray(1 / (1 + _UNORDERED[:, None] ** 2 * self.information))

    @cached_property
    def _likelihoods(self) -> Array:
        """The log likelihoods (T,) of all τ without a change, up to a constant."""
        squares = np.log(self._weights).sum(axis=1) - self._weights @ self.values**2
        return np.asarray(0.5 * squares - _UNUSUAL * (_UNORDERED > 0))

    def _gains(self, columns: Array) -> tuple[Array, Array]:
        """Return by how much each of n sets of m columns (R, n, m) lowers the squares under all τ (T, n), and how large
        the columns are then (T, n, m).
        """
        combinations, count, size = columns.shape
        products = (columns[..., :, None] * columns[..., None, :]).reshape(combinations, -1)
        information = (self._weights @ products).reshape(-1, count, size, size)
        scores = (self._weights @ (columns.reshape(combinations, -1) * self.values[:, None])).reshape(-1, count, size)
        traces = np.trace(information, axis1=2, axis2=3)
        least = _KNOWN * traces.max(axis=1, initial=0.0)[:, None] + 1e-300
        sure = traces > least
        diagonal = np.einsum("tnmm->tnm", information)
        diagonal += np.where(sure, _ROUNDING * traces, 1.0)[..., None]
        sizes = np.where(sure[..., None], np.linalg.solve(information, scores[..., None])[..., 0], 0.0)
        return np.sum(scores * sizes, axis=2), sizes
