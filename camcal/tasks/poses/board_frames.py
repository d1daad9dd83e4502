"""What the frames of videos show of a board."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from camcal.errors import CamcalError, FileError
from camcal.images.image import Image
from camcal.images.load import gray_8bit
from camcal.images.video import frame_name, frames
from camcal.progress import SILENT, Progress
from camcal.run.fanout import fan_out
from camcal.targets.board import CHARUCO, Board, Detection, Detections
from camcal.targets.checker.charuco import arrangements
from camcal.targets.detect import detect, require_findable
from camcal.tasks.calibration.board_remarks import remarks
from camcal.tasks.calibration.board_views import BoardViews

_SAMPLE = 6  # frames of a video on which the arrangement of a ChArUco board is found out
_STRIDE = 10


class _Frame(NamedTuple):
    """A gray frame of a video under its name, or what ended the video."""

    name: str
    image: Image | CamcalError


def board_frames(
    videos: Sequence[Path], board: Board, jobs: int | None = None, progress: Progress = SILENT
) -> BoardViews:
    """Return what every frame of videos shows of a board, frames named as `frame_name` does.

    A ChArUco board is taken in the arrangement that fits the first video. A video that ends early is one of those
    that failed; its frames are there. Raises FileError if no frame can be read, InvalidInput for such a board.
    """
    require_findable(board)
    known = _arranged(videos[0], board) if board.type == CHARUCO else board
    work = partial(_detect, board=known)
    views: list[Detection] = []
    errors: list[CamcalError] = []
    for outcome in fan_out(work, _frames(videos), jobs=jobs, processes=True, what="detecting", progress=progress):
        # one outcome after another: each holds its frame
        views += [outcome.value] if outcome.value else []
        errors += [outcome.error] if outcome.error else []
    if not views:
        raise errors[0] if errors else FileError("holds no frame", where=str(videos[0]))
    return BoardViews(known, Detections(known, tuple(views)), remarks(views, known, board), tuple(map(str, errors)))


def _frames(videos: Iterable[Path]) -> Iterator[_Frame]:
    for video in videos:
        try:
            for number, image in enumerate(frames(video)):
                yield _Frame(frame_name(video, number), Image(gray_8bit(image.pixels), image.orientation))
        except CamcalError as error:
            yield _Frame(str(video), error)


def _detect(frame: _Frame, board: Board) -> Detection:
    if isinstance(frame.image, CamcalError):
        raise frame.image
    return detect(frame.image.pixels, board).in_image(frame.name, frame.image.size, frame.image.orientation)


def _arranged(video: Path, board: Board) -> Board:
    """Return the arrangement of a ChArUco board with which most corners are found on a few frames."""
    candidates = arrangements(board)
    if len(candidates) == 1:
        return candidates[0]
    sample: list[Image] = []
    for number, image in enumerate(frames(video)):
        if number % _STRIDE == 0:
            sample.append(image)
        if len(sample) == _SAMPLE:
            break
    grays = [gray_8bit(image.pixels) for image in sample]
    return max(candidates, key=lambda candidate: sum(len(detect(gray, candidate).ids) for gray in grays))
