"""The corners of a view from which a calibration starts."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate.initialise import sweep_focal, thinned
from camcal.cameras.observations import Observations


def listed(columns, rows, present=None):
    """One view of a grid's corners, row by row, those that are not present in it of weight 0."""
    count = columns * rows
    weights = np.ones((1, count)) if present is None else present[None].astype(float)
    ids = np.arange(count)[None]
    return Observations(ids, np.stack([ids % columns, ids // columns]).astype(float), weights)


@pytest.mark.parametrize("corners", [24, 40])
@pytest.mark.parametrize(("columns", "rows"), [(125, 80), (8, 24), (12, 12), (14, 12), (9, 6), (100, 100), (40, 6)])
def test_points_of_a_view_are_taken_from_all_over_the_board(columns, rows, corners):
    found = thinned(listed(columns, rows), corners)
    places = found.pixels[:, 0][:, found.weights[0] > 0]
    assert places.shape[1] > 0.8 * min(corners, columns * rows)
    for axis, length in enumerate((columns, rows)):
        quarters = np.bincount((4 * places[axis] / length).astype(int), minlength=4)
        assert quarters.min() >= 2


def test_no_point_is_taken_twice_and_none_that_is_not_there():
    present = np.random.default_rng(1).random(150) < 0.5
    found = thinned(listed(15, 10, present), 24)
    chosen = found.ids[0, found.weights[0] > 0]
    assert len(set(chosen)) == len(chosen) > 20
    assert present[chosen].all()


def test_all_points_are_taken_of_a_view_that_has_no_more():
    present = np.zeros(150, bool)
    present[np.arange(20) * 7] = True
    found = thinned(listed(15, 10, present), 24)
    assert sorted(found.ids[0, found.weights[0] > 0]) == list(np.flatnonzero(present))


def test_views_of_another_board_do_not_choose_the_focal_length():
    """A third of the views have corners in another order: no lens suits them, and some lens always least badly."""
    scene = make_scene(count=18)
    rng = np.random.default_rng(9)
    seen = list(scene.observe(1, noise_px=0.1))
    for index in range(0, 18, 3):
        seen[index] = replace(seen[index], ids=rng.permutation(seen[index].ids))
    state = sweep_focal(scene.camera.model, scene.board, Observations.of(seen), scene.camera.image_size)
    assert state.parameters[0] == pytest.approx(1200, rel=0.15)  # the last candidates are 8 % apart
