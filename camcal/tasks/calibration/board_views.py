"""Views of a board from images or from a detections file. What looks at images is imported where there are some."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camcal import files
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.formats import boards, corner_lists, detections
from camcal.formats.camera_file import CameraEntry
from camcal.messages import Message
from camcal.options import given_words
from camcal.progress import Progress, warn_of
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.tasks.calibration.mixed_sizes import circle_fits, same_size, usual_size
from camcal.tasks.calibration.options import BEST_FRAMES, DetectOptions, FrameOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.video_frames import FrameRecord, Video

OWN_SUFFIXES = (".csv", ".vnl")
DETECTION_SUFFIXES = (*OWN_SUFFIXES, *corner_lists.SUFFIXES)


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
    frames: "tuple[FrameRecord, ...]" = ()
    videos: "tuple[Video, ...]" = ()
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
    from camcal.tasks.calibration.detect import detect_images

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
    from camcal.raw.reading import read_detection_image

    candidates = [folder / image for folder in (table.parent, Path())]
    for path in candidates:
        if path.is_file():
            height, width = read_detection_image(path).gray.shape
            return width, height
    raise InvalidInput(f"has no image size and {image} was not found: set --image-size WxH", where=str(table))


def known_circle(detections: Detections, guess: CameraEntry | None) -> ImageCircle | None:
    """Return the image circle that goes with detections of one camera, or else with a camera file's entry of it.

    None if neither has one, or it does not fit these detections: it is of images of another size, or points of a board
    lie outside of it, where there must be light.
    """
    cameras = {view.camera for view in detections.views}
    circle = detections.circles.get(cameras.pop()) if len(cameras) == 1 else None
    if circle is None and guess is not None:
        circle = guess.image_circle
    return circle if circle is not None and circle_fits(circle, detections.views) else None


def is_refined(asked: bool | None, board: Board, *, table: bool) -> bool:
    """Return whether the corners of images are to be measured again; asked: by the user, None for where it can be.

    table: the corners come from a detections file. Raises InvalidInput if it is asked for and cannot be.
    """
    if asked is None:
        return board.has_saddle_corners and not table
    if asked and not board.has_saddle_corners:
        raise InvalidInput(f"--refine needs a board with checkerboard corners, not a {board.words}")
    if asked and table:
        raise InvalidInput("--refine needs images, not a detections file")
    return asked


def is_located(refine: bool | None, reading: ImageReadOptions, *, mixed_sizes: bool | None) -> bool:
    """Return whether it is enough to locate a board in images, as its corners are measured with the calibrated lens.

    refine: as `is_refined` has it. Colours are measured where the board is found, views of other sizes before they are
    made to fit.
    """
    return refine is not False and not reading.colours and not mixed_sizes
