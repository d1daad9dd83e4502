"""What one image shows: points with their covariances, or why there are none."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.targets.detection import BoardDetection


def grid(rows, columns, missing=()):
    """Return pixels (rows, columns, 2) that name their node, NaN where missing."""
    result = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(float)
    for place in missing:
        result[place] = np.nan
    return result


def test_the_points_of_a_grid_are_numbered_row_by_row():
    detection = BoardDetection.of(grid(3, 4, missing=[(0, 1), (2, 3)]))
    assert detection.ids.tolist() == [0, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    assert [4 * v + u for u, v in detection.pixels.tolist()] == detection.ids.tolist()
    assert detection.covariance is None


def test_covariances_stay_with_their_points():
    covariance = np.arange(12)[:, None, None].reshape(3, 4, 1, 1) * np.eye(2)
    detection = BoardDetection.of(grid(3, 4, missing=[(0, 1), (2, 3)]), covariance)
    assert detection.covariance[:, 0, 0].tolist() == detection.ids.tolist()


@pytest.mark.parametrize(
    ("missing", "reason"),
    [
        ([(row, column) for row in range(2) for column in range(3)], "no corner found"),
        ([(row, column) for row in range(2) for column in range(3) if row + column], "only 1 corner"),
        ([(0, 0), (1, 1), (1, 2)], "only 3 corners"),
    ],
)
def test_too_few_points_for_a_pose_are_none(missing, reason):
    detection = BoardDetection.of(grid(2, 3, missing))
    assert (detection.found, detection.reason) == (False, reason)


def test_points_in_one_row_are_none():
    detection = BoardDetection.of(grid(2, 5, missing=[(1, column) for column in range(5)]))
    assert (detection.found, detection.reason) == (False, "only 5 corners, all collinear")


def test_covariances_of_another_number_of_points_are_refused():
    with pytest.raises(InvalidInput, match="covariance has shape"):
        BoardDetection(ids=np.arange(4), pixels=np.zeros((4, 2)), covariance=np.zeros((3, 2, 2)))


def test_other_numbers_are_those_of_the_colours_as_well():
    red = BoardDetection(ids=np.array([0, 2]), pixels=np.zeros((2, 2)))
    view = BoardDetection("a.png", (640, 480), ids=np.arange(3), pixels=np.zeros((3, 2)), colours={"red": red})
    turned = view.renumbered(np.array([2, 1, 0]))
    assert turned.ids.tolist() == [2, 1, 0]
    assert turned.colours["red"].ids.tolist() == [2, 0]


def test_a_view_without_its_points_keeps_what_else_is_known_of_the_image():
    red = BoardDetection(ids=np.array([0]), pixels=np.zeros((1, 2)))
    view = BoardDetection(
        "a.png", (640, 480), np.arange(3), np.zeros((3, 2)), camera="left", orientation=6, colours={"red": red}
    )
    bare = view.without_points("of another size")
    assert (bare.image, bare.size, bare.camera, bare.orientation) == ("a.png", (640, 480), "left", 6)
    assert (bare.found, bare.reason, dict(bare.colours)) == (False, "of another size", {})
