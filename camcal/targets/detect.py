"""The corners of a board in one image."""

from camcal import opencv
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.targets.board import CHARUCO, Board
from camcal.targets.charuco import find_charuco, require_markers
from camcal.targets.chessboard import find_chessboard
from camcal.targets.sighting import Sighting

SEED = 0  # of OpenCV's random numbers, set anew for every image
MIN_PIXELS = 32  # a side; smaller images hold no board, and OpenCV's detectors fail on them
MIN_CORNERS = 3  # a side of a chessboard, for the detectors' sake


def detect(gray: Array, board: Board, *, seed: int = SEED) -> Sighting:
    """Return the corners of a board in an image, or the reason why there are none.

    gray: (H, W) uint8. The result depends on the pixels and the board only: one thread, one seed, and corners fitted
    to the image whatever a detector proposed.
    Raises InvalidInput for another kind of image and for a board that cannot be found, see `require_findable`.
    """
    require_findable(board)
    if gray.ndim != 2 or gray.dtype != "uint8":
        raise InvalidInput(f"corners are found in gray images of 8 bits, not in {gray.dtype} of shape {gray.shape}")
    if min(gray.shape) < MIN_PIXELS:
        return Sighting.nothing(f"an image of {gray.shape[1]} x {gray.shape[0]} pixels is too small for a board")
    with opencv.repeatable(seed):
        return find_charuco(gray, board) if board.type == CHARUCO else find_chessboard(gray, board)


def require_findable(board: Board) -> None:
    """Raise InvalidInput for a chessboard that is too small to be found, or a dictionary without its markers."""
    if board.type == CHARUCO:
        require_markers(board)
    elif min(board.columns, board.rows) < MIN_CORNERS:
        size = f"{board.columns} x {board.rows}"
        raise InvalidInput(f"a chessboard of {size} inner corners cannot be found; it takes 3 x 3 at least")
