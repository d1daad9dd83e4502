"""What single views would add to parameters that ought to be the same in all of them, and changes that explain it.

Let a view v have k parameters θ_v of its own beside its pose and its effects, while lens and board are common. What is
left of the normal equations is A θ = y, and A⁻¹ is the covariance of the estimates of all θ_v. Offsets that vary from
view to view without order have a variance τ² besides, so a change is looked for under A⁻¹ + τ² I, with the τ that suits
it best.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from camcal.arrays import Array
from camcal.calibrate.variances import scaled
from camcal.solve.steps import NormalEquations
from camcal.solve.triangles import cholesky_solve

_UNORDERED = np.concatenate([[0.0], np.geomspace(1e-5, 0.03, 25)])  # τ, a share of the parameter
# Of the log likelihood, what a τ above zero must gain: few cameras change their focal length from view to view.
_UNUSUAL = 3.0
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
        chance = chi2.logsf(max(self.gain, 0.0), len(self.size)) + np.log(max(places, 1.0))
        return float(norm.isf(np.exp(chance) / 2)) if -700 < chance < 0 else 0.0 if chance >= 0 else np.inf


@dataclass(frozen=True, eq=False)
class ViewOffsets:
    """values: (R,) combinations of the offsets in standard deviations, independent of one another. mixing: (R, V, k)
    the offsets' shares in them. information: (R,) of the combinations.
    """

    values: Array
    mixing: Array
    information: Array

    @classmethod
    def of(cls, equations: NormalEquations, pose: int, std: Array) -> "ViewOffsets":
        """Return the offsets by equations whose groups have pose, effects of standard deviations (V, m), and the k
        parameters of the view itself, in this order.
        """
        count, effects = std.shape
        first = pose + effects
        size = equations.group_group.shape[-1] - first
        prepared = scaled(equations, np.column_stack([std, np.ones((count, size))]))
        np.einsum("vii->vi", prepared.group_group)[:, first:] -= 1.0  # offsets have no prior
        left = prepared.without_first(first)
        matrix, views = np.zeros((count, size, count, size)), np.arange(count)
        matrix[views, :, views] = left.group_group
        matrix, values = matrix.reshape(count * size, -1), -left.gradient.groups.ravel()
        coupling = left.group_shared.reshape(count * size, -1)
        if coupling.shape[1]:
            unit = np.sqrt(np.diag(left.shared_shared))
            root = np.linalg.cholesky(left.shared_shared / np.outer(unit, unit)) * unit[:, None]
            follow = coupling @ cholesky_solve(root, np.column_stack([coupling.T, left.gradient.shared]))
            matrix, values = matrix - follow[:, :-1], values + follow[:, -1]
        information, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        known = information > _KNOWN * information[-1]
        information, vectors = information[known], vectors[:, known]
        mixing = np.sqrt(information)[:, None] * vectors.T
        return cls(vectors.T @ values / np.sqrt(information), mixing.reshape(-1, count, size), information)

    def likeliest(self, changes: Array, others: Array | None = None) -> Found:
        """Return the likeliest of changes (V, n) of the offsets, each tried by itself; others: (V, j) changes that are
        there whichever it is.
        """
        tried = np.einsum("rvk,vn->rnk", self.mixing, changes)
        best, result, likelihoods = -np.inf, Found(0, np.zeros(tried.shape[2]), 0.0), self._likelihoods(others)
        for tau, before in zip(_UNORDERED, likelihoods, strict=True):
            rest, columns = self._left_over(tau, others, self.values[:, None], tried.reshape(len(tried), -1))
            columns = columns.reshape(tried.shape).transpose(1, 2, 0)
            scores, information = columns @ rest[:, 0], columns @ columns.transpose(0, 2, 1)
            traces = np.trace(information, axis1=1, axis2=2)
            sure = traces > _KNOWN * traces.max(initial=0.0)
            information[~sure] = 0.0
            information += (_KNOWN * traces.max(initial=0.0) + 1e-300) * np.eye(tried.shape[2])
            sizes = np.linalg.solve(information, scores[..., None])[..., 0]
            gains = np.where(sure, np.sum(scores * sizes, axis=1), 0.0)
            index = int(np.argmax(gains))
            if before + gains[index] / 2 > best:
                best = before + gains[index] / 2
                result = Found(index, sizes[index], float(2 * (best - likelihoods.max())))
        return result

    def unordered(self) -> tuple[float, float]:
        """Return τ and how clear it is, in standard deviations."""
        likelihoods = self._likelihoods(None) + _UNUSUAL * (_UNORDERED > 0)
        best = int(np.argmax(likelihoods))
        return float(_UNORDERED[best]), float(np.sqrt(2 * (likelihoods[best] - likelihoods[0])))

    def _likelihoods(self, others: Array | None) -> Array:
        """Return the log likelihoods of all τ, up to a constant."""
        result = []
        for tau in _UNORDERED:
            rest = self._left_over(tau, others, self.values[:, None])[0]
            spread = 0.5 * np.sum(np.log1p(tau**2 * self.information))
            result.append(-spread - 0.5 * np.sum(rest**2) - _UNUSUAL * (tau > 0))
        return np.array(result)

    def _left_over(self, tau: float, others: Array | None, *columns: Array) -> list[Array]:
        """Return columns (R, n) in standard deviations under τ, without what other changes explain of them."""
        root = np.sqrt(1 + tau**2 * self.information)[:, None]
        result = [values / root for values in columns]
        if others is not None:
            taken = np.einsum("rvk,vn->rnk", self.mixing, others).reshape(len(root), -1)
            basis = np.linalg.qr(taken / root)[0]
            result = [values - basis @ (basis.T @ values) for values in result]
        return result
