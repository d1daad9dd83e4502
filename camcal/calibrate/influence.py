"""What leaving out a view does to an estimate, in one step from its last linear solve (the jackknife's one step).

Where single points of the board are estimated too, they follow: they are determined anew without the view, which the
others then determine worse than all views did. Taken for determined as well as before, they would hide what a view does
that sees the board in a way of its own.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import Posterior
from camcal.solve.least_squares import assemble, part_of
from camcal.solve.steps import Block, Factors

_LARGEST = 0.99  # leverage of a view: what it alone determines cannot be distinguished from the others
# Times the variance that equal views would have, at most: CR3 has 1 / (1 - leverage), which grows without end where one
# view determines something all but alone.
_SAFETY = 3.0
_NEARLY = 1 - 1e-6  # of a view is left out, so that the others determine whatever there is
_ROUNDING = 1e-12  # of the diagonal
_ABOVE_ALL = 1e300  # the square of a row that no other one follows


class Solution(Protocol):
    """An estimate, of one camera or of several, as far as averages ask for it."""

    @property
    def problem(self) -> "SharedParameters": ...
    @property
    def state(self) -> Any: ...
    @property
    def factors(self) -> Factors: ...
    @property
    def linearised(self) -> Any: ...
    @property
    def posterior(self) -> Posterior: ...


class SharedParameters(Protocol):
    """A problem whose views share parameters (D,) of known precision (D, D) before the data."""

    def shared_values(self, state: Any, /) -> Array: ...
    def prior_precision(self, state: Any, /) -> Array: ...
    def observed(self, state: Any, /) -> Sequence[Block]: ...


def influence(estimate: Solution) -> Array:
    """Return the changes (G, D) of the parameters that all views share, lens and terms of the board's shape, when each
    of the views is left out, in one step from the last linear solve; scaled so that their squares add up to CR3.
    """
    factors, covariance = estimate.factors, estimate.posterior.shared
    root = np.linalg.cholesky(covariance)
    if len(factors.shared_root) > len(covariance):
        kept, scores = _without_each(estimate)
        shares, light = root.T @ kept @ root, np.zeros(len(scores), bool)
    else:
        scores = factors.group_scores()
        leverages = root.T @ factors.group_information() @ root
        shares = np.eye(len(root)) - leverages
        # the largest leverage is no more than their sum: of such a view nothing is limited below
        light = np.trace(leverages, axis1=1, axis2=2) < 1 - 1 / _SAFETY
    pulls = scores @ root
    pulls[light] = np.linalg.solve(shares[light], pulls[light, :, None])[..., 0]
    values, vectors = np.linalg.eigh(shares[~light])
    left = np.clip(values, 1 - _LARGEST, 1)
    turned = np.einsum("gki,gk->gi", vectors, pulls[~light]) / np.maximum(left, np.sqrt(left / _SAFETY))
    pulls[~light] = np.einsum("gki,gi->gk", vectors, turned)
    count = len(scores)
    return np.asarray(np.sqrt((count - 1) / count) * pulls @ root.T)


def _without_each(estimate: Solution) -> tuple[Array, Array]:
    """Return the information (G, D, D) on the shared parameters without each of the views, and the gradients (G, D)
    that it stands against, single points of the board eliminated from both.

    Observations and factors have to be of one state: parts of views are small differences of large products.
    """
    factors, dense = estimate.factors, len(estimate.posterior.shared)
    matrix, scores = factors.shared_root @ factors.shared_root.T, factors.group_scores()
    blocks, size = estimate.problem.observed(estimate.linearised), len(matrix)
    points_first = np.roll(np.arange(size), -dense)
    kept, pulls = np.empty((len(scores), dense, dense)), np.empty((len(scores), dense))
    # the last rows of a Cholesky factor are the factor of the Schur complement, and of a row below L⁻¹ times that
    bordered = np.full((size + 1, size + 1), _ABOVE_ALL)
    for view, score in enumerate(scores):
        others = matrix - _NEARLY * _information(blocks, factors.reduced[view], view)
        others[range(size), range(size)] += _ROUNDING * np.diag(matrix)
        bordered[:size, :size] = others[points_first[:, None], points_first]
        bordered[size, :size] = bordered[:size, size] = score[points_first]
        root, last = np.split(np.linalg.cholesky(bordered)[size - dense :, size - dense : size], [dense])
        kept[view], pulls[view] = root @ root.T, root @ last[0]
    return kept, pulls


def _information(blocks: Sequence[Block], reduced: Array, view: int) -> Array:
    """Return the part (S, S) of a view in the Schur complement.

    blocks: rows of all views. reduced: (g, S) of the view, see Factors.
    """
    own = []
    for block in blocks:
        runs = [view] if block.groups is None else np.flatnonzero(block.groups == view)
        own += [replace(part_of(block, slice(run, run + 1)), groups=np.zeros(1, np.intp)) for run in runs]
    size, shared = reduced.shape
    return np.asarray(assemble(own, shared, 1, size).shared_shared - reduced.T @ reduced)
