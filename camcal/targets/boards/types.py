"""The types of boards by their names, and what the fields of a Board mean in each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

CHESSBOARD = "chessboard"
CHARUCO = "charuco"
APRILGRID = "aprilgrid"
CIRCLES = "circles"
ASYMMETRIC_CIRCLES = "asymmetric_circles"

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
TAG_FAMILY = "tag36h11"  # of an AprilGrid that does not say
TAG_BORDER = 2  # cells of black around the bits of an AprilGrid's tags; other markers have one


@dataclass(frozen=True)
class BoardType:
    """One type of board.

    counted: what columns and rows count. least: how few of them, each way, make a board. words: how it is called, with
    its size. own: the fields beside the size and the square that it may have. element: what its size is told by.
    needs, crowded: what to say if marker or dictionary are missing, or if what is printed has no room; nearest: the
    distance of neighbours that must leave it, in squares.
    border: how many more a person counts than columns and rows (a ChArUco board is known by its squares).
    """

    counted: str
    least: int
    words: str
    own: frozenset[str]
    element: str
    needs: str = ""
    crowded: str = ""
    nearest: float = 1.0
    border: int = 0


_TOUCHING = "the circles of a grid must be apart; give a smaller diameter"

BOARD_TYPES: Mapping[str, BoardType] = {
    CHESSBOARD: BoardType("inner corners", 2, "chessboard of {size} inner corners", frozenset({"dots"}), "square"),
    CHARUCO: BoardType(
        "inner corners",
        2,
        "ChArUco board of {size} squares",
        frozenset({"marker", "dictionary", "first_marker", "legacy"}),
        "square",
        needs="a ChArUco board needs a marker size and a dictionary",
        crowded="the marker of a ChArUco board must be smaller than its square",
        border=1,
    ),
    APRILGRID: BoardType(
        "tags",
        1,
        "AprilGrid of {size} tags",
        frozenset({"marker", "dictionary", "first_marker"}),
        "tag",
        needs="an AprilGrid needs the side of a tag and a family",
        crowded="the tags of an AprilGrid must be apart; give a positive spacing",
    ),
    CIRCLES: BoardType("circles", 2, "grid of {size} circles", frozenset({"diameter"}), "step", crowded=_TOUCHING),
    ASYMMETRIC_CIRCLES: BoardType(
        "circles",
        2,
        "asymmetric grid of {size} circles",
        frozenset({"diameter"}),
        "step",
        crowded=_TOUCHING,
        nearest=math.sqrt(2),
    ),
}
