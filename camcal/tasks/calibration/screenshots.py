"""Screenshots and drawings of a board in the place of photographs: no lens has made them, so none can be calibrated."""

from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import CamcalError, InsufficientData
from camcal.messages import Message
from camcal.progress import Progress
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_search import SAMPLE, Material, gray_of
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.options import CalibrateOptions

# Gray levels that most pixels of a board have: 2 of screenshots, 4 if JPEG has blurred them; 12 at least of photographs
FEW_LEVELS = 5
_MOST = 0.8
FRONTAL = 0.02  # squares, RMS distance of corners from the drawing of the board, moved, turned and scaled


def screenshots(seen: BoardViews, options: CalibrateOptions, progress: Progress) -> InsufficientData | None:
    """Return the error that views look like screenshots of the board, None where some do not or cannot be read again.

    The images of a few are read. Views of a detections file have none.
    """
    views = {view.image: view for view in seen.detections.views if view.found}
    if not views or seen.table or max(off_drawing(view, seen.board) for view in views.values()) > FRONTAL:
        return None
    in_videos = {name for video in seen.videos for name in video.names}
    files = {seen.files.get(name, Path(name)).as_posix(): name for name in views if name not in in_videos}
    videos = [video.only(views) for video in seen.videos]
    material = Material([*map(Path, files)], videos, options.reading, options.jobs, options.batch, progress)
    levels = 0
    try:
        for name, source in material.sample(SAMPLE).sources():
            view = views[files.get(name, name)]
            levels = max(levels, gray_levels(gray_of(source, options.reading), view.pixels))
    except CamcalError:
        return None
    if levels > FEW_LEVELS:
        return None
    text = (
        "the images look like screenshots or drawings of the board, not photographs: every view is frontal and has "
        f"only {levels} gray levels: photograph the board, tilted by 20° to 45° about both axes"
    )
    return InsufficientData(text, failures=[Message("screenshots", text, {"gray_levels": levels})])


def gray_levels(gray: Array, pixels: Array) -> int:
    """Return how many gray levels most pixels of `gray`, (H, W) uint8, have around points (N, 2)."""
    left, top = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int) + 1
    counts = np.sort(np.bincount(gray[top:bottom, left:right].ravel(), minlength=256))[::-1].cumsum()
    return int(np.searchsorted(counts, _MOST * counts[-1])) + 1


def off_drawing(view: BoardDetection, board: Board) -> float:
    """Return how far (squares, RMS) corners are from the board as drawn, moved, turned and scaled."""
    drawn, shown = (points[:, 0] + 1j * points[:, 1] for points in (board.points()[view.ids], view.pixels))
    terms = np.column_stack([drawn, np.ones_like(drawn)])
    solution = np.linalg.lstsq(terms, shown, rcond=None)[0]
    left = np.abs(shown - terms @ solution)
    return float(np.sqrt(np.mean(left**2)) / max(abs(solution[0]) * board.spacing, 1e-9))
