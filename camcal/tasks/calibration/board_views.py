"""Views of a board from images or from a detections file.

Screenshots and drawings of a board are told from photographs: no lens has made them, so none can be calibrated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import CamcalError, InsufficientData, InvalidInput
from camcal.formats import boards, corner_lists, detections
from camcal.messages import Message
from camcal.options import given_words
from camcal.progress import Progress, warn_of
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.board_search import SAMPLE, Material, gray_of
from camcal.tasks.calibration.detect import detect_images
from camcal.tasks.calibration.mixed_sizes import same_size, usual_size
from camcal.tasks.calibration.options import BEST_FRAMES, CalibrateOptions, DetectOptions, FrameOptions
from camcal.tasks.calibration.video_frames import FrameRecord, Video

OWN_SUFFIXES = (".csv", ".vnl")
DETECTION_SUFFIXES = (*OWN_SUFFIXES, *corner_lists.SUFFIXES)
# Gray levels that most pixels of a board have: 2 of screenshots, 4 if JPEG has blurred them; 12 at least of photographs
FEW_LEVELS = 5
_MOST = 0.8
FRONTAL = 0.02  # squares, RMS distance of corners from the drawing of the board, moved, turned and scaled


@dataclass(frozen=True)
class BoardViews:
    """The board, its detections, warnings about them, and the images that could not be read.

    lines: other lines of the report. frames: what became of the frames of videos. videos: these videos. table: whether
    all comes from a detections file. files: the images whose names are not their paths.
    """

    board: Board
    detections: Detections
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
    frames: tuple[FrameRecord, ...] = ()
    videos: tuple[Video, ...] = ()
    table: bool = False
    files: Mapping[str, Path] = field(default_factory=dict)


def is_table(text: str, suffixes: Sequence[str] = DETECTION_SUFFIXES) -> bool:
    """Return whether an input is a detections file, as which standard input ("-") is read too.

    suffixes: OWN_SUFFIXES where other files may be camera files.
    """
    return text == files.STANDARD or Path(text).suffix.lower() in suffixes


def view_settings(options: object) -> dict[str, Any]:
    """Return how images are read by the options of a command, for `board_views`."""
    return {name: getattr(options, name) for name in ("recursive", "jobs", "image_size", "reading", "frames")}


def board_views(
    inputs: tuple[str, ...],
    board: str | Board | None,
    recursive: bool,
    jobs: int | None,
    progress: Progress,
    image_size: tuple[int, int] | None = None,
    reading: ImageReadOptions = AS_IMAGES,
    frames: FrameOptions = BEST_FRAMES,
    parts: bool = False,
    mixed_sizes: bool | None = None,
    batch: BatchOptions = DEFAULT_BATCH,
    locate: bool = False,
) -> BoardViews:
    """Return what images, videos, folders and globs show of a board, or what one detections file holds.

    board: a board, its file or its short form; it may be None where a detections file names the board.
    image_size: (width, height) of the images of a .vnl file, which has none; None: the images beside it tell.
    reading: what is made of raw frames, and which colours are examined. frames: which ones of videos are taken.
    parts: whether parts of a chessboard will do that show which part they are. mixed_sizes: whether views of another
    size than most are used where it is known how the sizes are related; None is no, by a command without that option.
    locate: whether it is enough to locate the board, so that corners are yet to be measured.
    Raises InvalidInput if no board is known, a detections file is not alone or is to be read as an image, FileError.
    """
    known = boards.load_board(board) if isinstance(board, str) else board
    tables = [text for text in inputs if is_table(text)]
    if tables and len(inputs) > 1 and not all(Path(text).suffix.lower() == corner_lists.DELTILLE for text in inputs):
        raise InvalidInput("a detections file cannot be combined with other inputs", where=tables[0])
    if tables and reading != AS_IMAGES:
        option = given_words(reading)[0]
        raise InvalidInput(f"{option} applies to images, not to a detections file", where=tables[0])
    if tables:
        path = Path(tables[0])
        sizes = image_size or (lambda name: _size_beside(path, name))
        found, *others = (detections.read(Path(text), known, sizes) for text in tables)  # of Deltille one an image
        found = replace(found, views=(*found.views, *(view for each in others for view in each.views)))
        if found.board is None:
            raise InvalidInput("names no board: give --board, such as --board chessboard:9x6:25mm", where=tables[0])
        sized = same_size(found.views, usual_size(found.views), found.board, mixed=mixed_sizes)
        warn_of(sized.warnings, progress)
        # views of other sizes keep their points unless they are asked to fit: the solver names what it leaves out
        return BoardViews(
            found.board, replace(found, views=sized.views) if mixed_sizes else found, sized.warnings, table=True
        )
    if known is None:
        raise InvalidInput("--board is needed to find one in images, such as --board chessboard:9x6:25mm")
    options = DetectOptions(
        inputs,
        known,
        recursive=recursive,
        jobs=jobs,
        batch=batch,
        reading=reading,
        frames=frames,
        parts=parts,
        mixed_sizes=mixed_sizes,
    )
    report = detect_images(options, progress, locate=locate)
    found = report.detections
    return BoardViews(
        found.board or known,
        found,
        warnings=report.warnings,
        lines=report.lines,
        failed=report.failed,
        frames=report.frames,
        videos=report.videos,
    )


def _size_beside(table: Path, image: str) -> tuple[int, int]:
    """Return the size of an image that a table names, relative to the table's folder or to where we are."""
    candidates = [folder / image for folder in (table.parent, Path())]
    for path in candidates:
        if path.is_file():
            height, width = read_detection_image(path).gray.shape
            return width, height
    raise InvalidInput(f"has no image size and {image} was not found: set --image-size WxH", where=str(table))


def screenshots(seen: BoardViews, options: CalibrateOptions, progress: Progress) -> InsufficientData | None:
    """Return the error that views look like screenshots of the board, None where some do not or cannot be read again.

    The images of a few are read. Views of a detections file have none.
    """
    views = {view.image: view for view in seen.detections.views if view.found}
    if not views or seen.table or max(off_drawing(view, seen.board) for view in views.values()) > FRONTAL:
        return None
    in_videos = {name for video in seen.videos for name in video.names}
    named = {seen.files.get(name, Path(name)).as_posix(): name for name in views if name not in in_videos}
    videos = [video.only(views) for video in seen.videos]
    material = Material([*map(Path, named)], videos, options.reading, options.jobs, options.batch, progress)
    levels = 0
    try:
        for name, source in material.sample(SAMPLE).sources():
            view = views[named.get(name, name)]
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
