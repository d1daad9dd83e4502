"""What could be wrong with poses of views: mirrored images, boards of another size, a step in a series."""

from collections.abc import Iterator

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.rigs.links import CameraPoses
from camcal.targets.board import Board

SEVERAL = 3  # captures in a row that may be those after a change
_ROUNDS = 10  # of reweighting
_UNKNOWN = 3.0  # captures


def mirrored(poses: CameraPoses, board: Board) -> Iterator[CameraPoses]:
    """Yield the poses of views of mirrored images as they would be without mirroring: the image is mirrored left to
    right, and the detector numbers the columns of the board the other way, or its rows.
    """
    image = np.diag([-1.0, 1.0, 1.0])
    width, height = board.extent
    for own, end in ((np.diag([-1.0, 1.0, 1.0]), [width, 0.0, 0.0]), (np.diag([1.0, -1.0, 1.0]), [0.0, height, 0.0])):
        shift = poses.rotations @ np.array(end)
        yield CameraPoses(poses.captures, image @ poses.rotations @ own, (poses.translations + shift) @ image)


def robust_scale(seen: Array, rotations: Array, translations: Array) -> tuple[float, float, float] | None:
    """Return the scale s for which, with an offset y and a shift t, R_g y + s T_g + t is `seen` (n, 3), and the typical
    distance of what is left with s = 1 and with s; None where that is undetermined.

    rotations: R (n, 3, 3), translations: T (n, 3) of a board. y: where the other board's origin is on it.
    """
    count = len(seen)
    if 3 * count < 9 + SEVERAL:
        return None
    ones = np.tile(np.eye(3), (count, 1, 1))
    left, scale = [], 1.0
    for free in (False, True):
        columns = [rotations, ones] + ([translations[:, :, None]] if free else [])
        design, wanted = np.concatenate(columns, axis=2), seen if free else seen - translations
        weights = np.ones(count)
        for _ in range(_ROUNDS):
            root = np.sqrt(weights)[:, None]
            system = (root[:, :, None] * design).reshape(3 * count, -1)
            found, _, rank, _ = np.linalg.lstsq(system, (root * wanted).ravel(), rcond=1e-9)
            if rank < design.shape[2]:
                return None
            distances = np.linalg.norm(wanted - design @ found, axis=1)
            weights = 1 / (1 + (distances / max(3 * float(np.median(distances)), 1e-12)) ** 2)
        left.append(float(np.median(distances)))
        scale = float(found[-1]) if free else 1.0
    return (scale, left[0], left[1]) if scale > 0 else None


def largest_step(values: Array) -> tuple[int, float, float]:
    """Return the likeliest place of a step in a series (n, D), its size, and how clear it is, in standard deviations of
    what is left beside it; zeros where the series is too short.
    """
    places = range(SEVERAL, len(values) - SEVERAL + 1)
    if not places:
        return 0, 0.0, 0.0
    place = min(places, key=lambda own: float(np.abs(_beside(values, own)).sum()))
    size = float(np.linalg.norm(np.median(values[place:], axis=0) - np.median(values[:place], axis=0)))
    left, after = _beside(values, place), len(values) - place
    noise = float(np.sqrt(np.mean(np.median(np.abs(left), axis=0) ** 2))) / 0.6745
    few = 1 + _UNKNOWN / min(place, after)  # the noise of few captures is not known well
    return place, size, size / max(few * noise * np.sqrt(np.pi / 2 * (1 / place + 1 / after)), 1e-12)


def _beside(values: Array, place: int) -> Array:
    """Return a series (n, D) less its medians before a place and from there on."""
    return np.concatenate([part - np.median(part, axis=0) for part in (values[:place], values[place:])])
