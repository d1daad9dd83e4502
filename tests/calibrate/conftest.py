"""Sets of views that many tests calibrate from."""

import pytest
from observed import make_scene

from camcal.targets.board import Board


@pytest.fixture(scope="session")
def scene():
    return make_scene()


@pytest.fixture(scope="session")
def even_scene():
    """A board that looks the same turned by 180°."""
    return make_scene(board=Board("chessboard", 10, 8, 0.030), count=20)
