"""What residuals of different views share at the same place of the image.

Noise, poses and what is wrong with single images differ between views; what their residuals have in common is the
lens's. With the sums S of the residuals of views in n corners of a cell of the image, the products S_v · S_w / n of all
pairs of views add up to the square of what they share, free of the noise of either; if each view's sign were random, to
zero.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.solve.losses import chi_square_beyond

CELLS = (10, 8)
_MOST_DOF = 200  # beyond which a sum of squares is as good as normal


@dataclass(frozen=True, eq=False)
class CellSums:
    """Sums (V, C, 2) of the residuals of views in cells, and the counts (V, C) of their corners."""

    sums: Array
    counts: Array

    @classmethod
    def of(cls, pixels: Array, residuals: Array, views: Array, image_size: tuple[int, int]) -> "CellSums":
        """Return the sums of residuals (N, 2) at pixels (N, 2) of views with the numbers (N,)."""
        cells, shape = cell_numbers(pixels, image_size), (int(views.max(initial=-1)) + 1, CELLS[0] * CELLS[1])
        counts, sums = np.zeros(shape), np.zeros((*shape, 2))
        np.add.at(counts, (views, cells), 1)
        np.add.at(sums, (views, cells), residuals)
        return cls(sums, counts)

    @property
    def rows(self) -> Array:
        """S / √n of every view (V, 2 C)."""
        return np.asarray(
            (self.sums / np.sqrt(np.maximum(self.counts.sum(axis=0), 1))[:, None]).reshape(len(self.sums), -1)
        )

    @property
    def share(self) -> float:
        """The products of all pairs of views over the squares: V - 1 if views have the same residuals, near 0 if what
        they have has nothing to do with the place.
        """
        rows = self.rows
        squares = float(np.sum(rows**2))
        return float(np.sum(rows.sum(axis=0) ** 2)) / squares - 1 if squares > 0 else 0.0

    @property
    def chance(self) -> float:
        """The probability that the products of all pairs of views add up to more, with a random sign for each.

        The sum is taken for a sum of squares with the same first three moments, of the matrix A = rows rowsᵀ without
        its diagonal: its variance is 2 tr A², its skewness by that of tr A³. Source: Pearson 1959, for quadratic forms.
        """
        rows = self.rows
        gram, own = rows.T @ rows, np.sum(rows**2, axis=1)
        second = float(np.sum(gram**2) - np.sum(own**2))
        third = np.trace(gram @ gram @ gram) - 3 * own @ np.sum((rows @ gram) * rows, axis=1) + 2 * np.sum(own**3)
        if second <= 0:
            return 1.0
        clear = float(np.sum(rows.sum(axis=0) ** 2) - own.sum()) / np.sqrt(2 * second)
        dof = int(np.clip(np.rint(second**3 / max(third**2, 1e-300)), 1, _MOST_DOF)) if third > 0 else _MOST_DOF
        return chi_square_beyond(dof + clear * np.sqrt(2 * dof), dof)


def cell_numbers(pixels: Array, image_size: tuple[int, int]) -> Array:
    """Return the numbers (N,) of the cells of the grid in which pixels (N, 2) lie, column by column."""
    places = np.clip((pixels + 0.5) // (np.array(image_size) / CELLS), 0, np.array(CELLS) - 1).astype(np.intp)
    return np.asarray(places[:, 0] * CELLS[1] + places[:, 1])
