"""What one image shows: points with their covariances, or why there are none."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.targets.sighting import Sighting


def grid(rows, columns, missing=()):
    """Return pixels (rows, columns, 2) that name their node, NaN where missing."""
    result = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(float)
    for place in missing:
        result[place] = np.nan
    return result


def test_the_points_of_a_grid_are_numbered_row_by_row():
    sighting = Sighting.of(grid(3, 4, missing=[(0, 1), (2, 3)]))
    assert sighting.ids.tolist() == [0, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    assert [4 * v + u for u, v in sighting.pixels.tolist()] == sighting.ids.tolist()
    assert sighting.covariance is None


def test_covariances_stay_with_their_points():
    covariance = np.arange(12)[:, None, None].reshape(3, 4, 1, 1) * np.eye(2)
    sighting = Sighting.of(grid(3, 4, missing=[(0, 1), (2, 3)]), covariance)
    assert sighting.covariance[:, 0, 0].tolist() == sighting.ids.tolist()


@pytest.mark.parametrize(
    ("missing", "reason"),
    [
        ([(row, column) for row in range(2) for column in range(3)], "no corner found"),
        ([(row, column) for row in range(2) for column in range(3) if row + column], "only 1 corner"),
        ([(0, 0), (1, 1), (1, 2)], "only 3 corners"),
    ],
)
def test_too_few_points_for_a_pose_are_none(missing, reason):
    sighting = Sighting.of(grid(2, 3, missing))
    assert (sighting.found, sighting.reason) == (False, reason)


def test_points_in_one_row_are_none():
    sighting = Sighting.of(grid(2, 5, missing=[(1, column) for column in range(5)]))
    assert (sighting.found, sighting.reason) == (False, "only 5 corners, all in one line")


def test_covariances_of_another_number_of_points_are_refused():
    with pytest.raises(InvalidInput, match="covariance has shape"):
        Sighting(np.arange(4), np.zeros((4, 2)), covariance=np.zeros((3, 2, 2)))


def test_what_was_seen_in_an_image_is_recorded_under_its_name():
    covariance = np.tile(0.01 * np.eye(2), (12, 1, 1))
    sighting = Sighting(np.arange(12), grid(3, 4).reshape(-1, 2), covariance=covariance)
    view = sighting.in_image("a.png", (640, 480), orientation=6)
    assert (view.image, view.size, view.orientation, view.reason) == ("a.png", (640, 480), 6, None)
    assert np.array_equal(view.pixels, sighting.pixels)
    assert np.array_equal(view.covariance, covariance)
    assert Sighting.nothing("no board").in_image("b.png", (640, 480)).reason == "no board"
