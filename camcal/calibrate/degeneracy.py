"""When observations cannot hold a calibration, however small the residuals would be."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData
from camcal.targets.board import Board
from camcal.targets.detection import Detection

MIN_VIEWS = 3
MIN_CORNERS = 6
SAME_VIEW_PX = 0.02  # detectors differ by more than this between two frames of a still camera
_MIN_TILT_SPREAD = np.radians(5.0)
_MAX_FOCAL_ERROR = 0.05


def reason_unusable(view: Detection, board: Board) -> str | None:
    """Return why a view's points cannot give a pose, or None if they can."""
    if not view.found:
        return view.reason or "no board found"
    if len(view.ids) < MIN_CORNERS:
        return f"only {len(view.ids)} corners, {MIN_CORNERS} are needed: show more of the board"
    places = board.points()[view.ids, :2] / board.pitch
    x, y = (places - places.mean(axis=0)).T
    if (x @ x) * (y @ y) - (x @ y) ** 2 < 1e-6:
        return "all corners are on one line of the board: show more of it"
    return None


def repeated(views: Sequence[Detection]) -> dict[int, int]:
    """Return for each view (by index) that repeats an earlier one the index of that one."""
    tables: dict[bytes, list[tuple[int, Array]]] = {}
    for index, view in enumerate(views):
        order = np.argsort(view.ids, kind="stable")
        tables.setdefault(view.ids[order].tobytes(), []).append((index, view.pixels[order]))
    result: dict[int, int] = {}
    for table in tables.values():
        indices, pixels = np.array([index for index, _ in table]), np.stack([pixels for _, pixels in table])
        # repeats agree in their first corner, so only neighbours in its order need a closer look
        rank = np.argsort(pixels[:, 0, 0], kind="stable")
        ends = np.searchsorted(pixels[rank, 0, 0], pixels[rank, 0, 0] + SAME_VIEW_PX)
        for place in np.flatnonzero(ends > np.arange(len(rank)) + 1):
            near = rank[place + 1 : ends[place]]
            same = near[np.abs(pixels[near] - pixels[rank[place]]).max(axis=(1, 2)) < SAME_VIEW_PX]
            for pair in (np.sort(indices[[rank[place], other]]) for other in same):
                result[int(pair[1])] = min(int(pair[0]), result.get(int(pair[1]), int(pair[0])))
    return result


def require_views(usable: int, total: int, repeats: int) -> None:
    """Raise InsufficientData unless at least MIN_VIEWS views that differ are at hand."""
    if usable < MIN_VIEWS:
        aside = f" ({repeats} more repeat one of them)" if repeats else ""
        raise InsufficientData(
            f"{usable} usable view{'s' * (usable != 1)}{aside} of {total}, at least {MIN_VIEWS} different ones are "
            "needed; take more images with the board tilted in different directions (camcal detect lists why others "
            "are not used)"
        )


def tilt_spread(rotations: Array) -> float:
    """Return the largest angle (rad) between the board's normals of any view and their mean direction."""
    normals = rotations[:, :, 2]
    mean = normals.mean(axis=0)
    cosines = normals @ (mean / max(float(np.linalg.norm(mean)), 1e-12))
    return float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))


def require_tilts(rotations: Array) -> None:
    """Raise InsufficientData when the board was never tilted: focal length and distance then trade freely."""
    spread = tilt_spread(rotations)
    if spread < _MIN_TILT_SPREAD:
        raise InsufficientData(
            f"the board has nearly the same tilt in every view (within {np.degrees(spread):.1f}°), so the focal length "
            "cannot be told from the distance; add views tilted by 20° to 45° about both axes, or give a known lens "
            "with --guess and --fix fx,fy"
        )


def require_focal(focal: float, std: float) -> None:
    """Raise InsufficientData when the focal length (px) is not determined to better than a twentieth."""
    if not std < _MAX_FOCAL_ERROR * focal:
        raise InsufficientData(
            f"the views leave the focal length undetermined ({focal:.0f} ± {std:.0f} px); "
            "add views tilted by 20° to 45° about both axes"
        )
