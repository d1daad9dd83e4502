"""Results of views and of single corners, the reasons why some are not used, and what residuals of views share.

Noise, poses and what is wrong with single images differ between views; what their residuals have in common at the same
place of the image is the lens's. With the sums S of the residuals of views in n corners of a cell of the image, the
products S_v · S_w / n of all pairs of views add up to the square of what they share, free of the noise of either; if
each view's sign were random, to zero.
"""

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.calibrate.fit import CalibrationFit
from camcal.calibrate.noise import median_limit
from camcal.dataclass import dataclass, replace
from camcal.geometry.pose import Pose
from camcal.records import Brief
from camcal.solve.losses import chi_square_beyond
from camcal.targets.detection import BoardDetection

_NAMED = 5  # images in a sentence

CELLS = (10, 8)
_MOST_DOF = 200  # beyond which a sum of squares is as good as normal


@dataclass(frozen=True, eq=False)
class View(Brief):
    """What became of one image. reason: why it is not used, None if it is; rejected: whether that is because it
    does not fit the others. symmetry: the symmetry of the board (see Board.symmetries) by which its ids were exchanged.
    rms_px is over the kept corners, per point. sha256: of the file, where it was read, or of a frame's gray
    levels. body: the name of the board, where there are several.
    """

    image: str
    points: int
    kept: int = 0
    rms_px: float | None = None
    camera_T_board: Pose | None = None
    pose_covariance: FloatArray | None = None
    symmetry: int = 0
    reason: str | None = None
    rejected: bool = False
    sha256: str | None = None
    body: str = ""

    @property
    def used(self) -> bool:
        return self.reason is None


@dataclass(frozen=True, eq=False)
class RejectedCorner:
    """A corner that was measured but rejected; residual: projected minus observed, px."""

    image: str
    id: int
    pixel: FloatArray
    residual: FloatArray

    @property
    def distance(self) -> float:
        """The length of the residual in pixels; NaN where the lens cannot take the corner."""
        return float(np.hypot(*self.residual))


def view_records(
    result: CalibrationFit,
    detections: Sequence[BoardDetection],
    reasons: list[str | None],
    covariances: Array,
    residuals: Array,
    kept: Array,
    medians: Array,
) -> tuple[View, ...]:
    """Return what became of every image; reasons: why it was left out from the start, None if it was not. The other
    arguments are of the views that were not: pose covariances (V, 6, 6), residuals (2, V, P) px, which corners (V, P)
    are kept, and the medians (V,) px of their distances.
    """
    squared = np.where(kept, np.nansum(residuals**2, axis=0), 0.0)
    views, row = [], 0
    for detection, reason in zip(detections, reasons, strict=True):
        if reason is not None:
            views.append(
                View(
                    detection.image,
                    len(detection.ids),
                    reason=reason,
                    sha256=detection.sha256,
                    body=detection.body,
                )
            )
            continue
        count = int(kept[row].sum())
        view = View(
            detection.image,
            len(detection.ids),
            kept=count,
            rms_px=float(np.sqrt(squared[row].sum() / count)) if count else None,
            camera_T_board=Pose(result.state.rotations[row], result.state.translations[row]),
            pose_covariance=readonly(covariances[row], (6, 6), "pose covariance"),
            symmetry=int(result.turns[row]),
            sha256=detection.sha256,
            body=detection.body,
        )
        if not count:
            words = _misfit_words(float(medians[row]), median_limit(result.plain.noise))
            view = replace(view, camera_T_board=None, pose_covariance=None, reason=words, rejected=True)
        views.append(view)
        row += 1
    return tuple(views)


def _misfit_words(median_px: float, limit_px: float) -> str:
    how = (
        f"median reprojection error {px_words(median_px)}"
        if np.isfinite(median_px)
        else "points outside the domain of the lens model"
    )
    return f"rejected: {how} (limit {px_words(limit_px)})"


def rejected_corners(
    result: CalibrationFit,
    detections: Sequence[BoardDetection],
    reasons: list[str | None],
    lost: Array,
    residuals: Array,
) -> tuple[RejectedCorner, ...]:
    """Return the corners (V, P) that are `lost`, with their residuals (2, V, P) px."""
    images = [detection.image for detection, reason in zip(detections, reasons, strict=True) if reason is None]
    observations = result.problem.observations
    return tuple(
        RejectedCorner(
            images[view],
            int(observations.ids[view, point]),
            observations.pixels[:, view, point],
            residuals[:, view, point],
        )
        for view, point in np.argwhere(lost)
    )


def px_words(distance: float) -> str:
    """Return a distance in pixels at two digits or more, never in exponents."""
    return f"{distance:.0f} px" if distance >= 10 else f"{distance:.2g} px"


def names_of(images: Sequence[str], most: int = _NAMED) -> str:
    """Return the names of images in a sentence, `most` of them."""
    more = f" and {len(images) - most} more" if len(images) > most else ""
    return ", ".join(map(shown_name, images[:most])) + more


def shown_name(image: str) -> str:
    """Return the name of an image for a reader: of an absolute path the folder and the file."""
    path = PurePath(image)
    return "/".join(path.parts[-2:]) if path.is_absolute() else image


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
