"""Detection of a board in one image: it is located, then its corners are measured."""

from dataclasses import replace

from camcal import opencv
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, CHARUCO, CHESSBOARD, CIRCLES, Board
from camcal.targets.corner_measurement import measure
from camcal.targets.detection import BoardDetection, MaskedImage

SEED = 0  # of OpenCV's random numbers, set again for every image
MIN_PIXELS = 32  # a side; smaller images hold no board, and OpenCV's detectors fail on them
LEAST_SIDE = 3  # corners along a side of a chessboard; fewer may be anything


def detect(
    gray: Array, board: Board, *, seed: int = SEED, partial: bool = False, samples: MaskedImage | None = None
) -> BoardDetection:
    """Return the points of a board in an image with their covariances, or the reason why there are none.

    gray: (H, W) uint8, in which the board is found. partial: a part of a chessboard will do that shows which part it
    is, as any part of a board with markers, tags or dots does in any case. samples: those of the same image that say
    where its corners are, None for gray itself. The result depends on the pixels and the board only: one thread, one
    seed, and points fitted to the image whatever a detector proposed.
    Raises InvalidInput for another kind of image and for a board that cannot be found, see `require_findable`.
    """
    found = locate(gray, board, seed=seed, partial=partial, samples=samples)
    return measure(samples or MaskedImage(gray), board, found) if found.located else found


def locate(
    gray: Array, board: Board, *, seed: int = SEED, partial: bool = False, samples: MaskedImage | None = None
) -> BoardDetection:
    """Return what `detect` does, in a fraction of its time, with checkerboard corners `located`: to a tenth of a pixel
    or two, without covariance, some of which measuring them may refuse. Tags and circles are measured as they are.
    """
    require_findable(board, partial=partial)
    if gray.ndim != 2 or gray.dtype != "uint8":
        raise InvalidInput(f"boards are found in gray images of 8 bits, not in {gray.dtype} of shape {gray.shape}")
    return replace(_found(gray, board, seed, samples, partial=partial), size=gray.shape[::-1])


def _found(gray: Array, board: Board, seed: int, samples: MaskedImage | None, *, partial: bool) -> BoardDetection:
    if min(gray.shape) < MIN_PIXELS:
        return BoardDetection.nothing(f"an image of {gray.shape[1]} x {gray.shape[0]} pixels is too small for a board")
    with opencv.repeatable(seed):  # each detector is imported when it is needed
        if board.type == APRILGRID:
            from camcal.targets.aprilgrid import find_aprilgrid

            return find_aprilgrid(gray, board, samples)
        if board.type in (CIRCLES, ASYMMETRIC_CIRCLES):
            from camcal.targets.circles import find_circles

            return find_circles(gray, board)
        if board.type == CHARUCO:
            from camcal.targets.checker.charuco import find_charuco

            detection = find_charuco(gray, board)
        else:
            from camcal.targets.checker.chessboard import find_chessboard

            detection = find_chessboard(gray, board, partial=partial or board.dots)
    return replace(detection, located=detection.found)


def require_findable(board: Board, *, partial: bool = False) -> None:
    """Raise InvalidInput for a chessboard that is too small to be found, a dictionary without the board's markers, or
    a grid of circles of which parts are asked for, and for several boards.
    """
    if len(board.members) > 1:
        raise InvalidInput(f"several boards ({', '.join(board.members)}) are for 'camcal rig'; give one of them")
    if board.type == CHARUCO:
        from camcal.targets.checker.charuco import require_markers

        require_markers(board)
    elif board.type == APRILGRID:
        from camcal.targets.pattern import family_named

        family_named(board.dictionary or "").require(board.first_marker, board.columns * board.rows)
    elif board.type == CHESSBOARD and min(board.columns, board.rows) < LEAST_SIDE:
        size = f"{board.columns} x {board.rows}"
        raise InvalidInput(f"a chessboard of {size} inner corners is too small to be detected (minimum 3 x 3)")
    elif partial and board.type in (CIRCLES, ASYMMETRIC_CIRCLES):
        raise InvalidInput("a grid of circles cannot be detected in part: the whole grid must be visible")
