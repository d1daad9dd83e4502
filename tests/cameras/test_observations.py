"""All that was seen as one table: what each row says of its view, and what padding says."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.observations import Observations, whitened, whitening_of
from camcal.targets.detection import BoardDetection


def view(count, **said):
    return BoardDetection("a.png", (640, 480), np.arange(count), np.arange(2.0 * count).reshape(-1, 2) + 1, **said)


def test_a_row_has_the_camera_the_body_and_the_time_of_its_view():
    seen = [view(2, camera="left", body="board", time=0.5), None, view(3, camera="right"), view(1, camera="left")]
    table = Observations.of(seen)
    assert [table.cameras[place] for place in table.camera] == ["left", "", "right", "left"]
    assert [table.bodies[place] for place in table.body] == ["board", "", "", ""]
    np.testing.assert_array_equal(table.time, [0.5, np.nan, np.nan, np.nan])
    assert table.present.sum(axis=1).tolist() == [2, 0, 3, 1]
    assert table.ids[2].tolist() == [0, 1, 2]
    some = table.take(np.array([2, 0]))
    assert [some.cameras[place] for place in some.camera] == ["right", "left"]
    assert np.count_nonzero(some.weights) == 5


def test_padding_repeats_a_pixel_that_the_lens_knows():
    table = Observations.of([view(3), view(1)])
    np.testing.assert_array_equal(table.pixels[:, 1], [[1, 1, 1], [2, 2, 2]])
    np.testing.assert_array_equal(table.weights, [[1, 1, 1], [1, 0, 0]])


def test_a_view_without_covariances_counts_as_the_typical_one_or_as_is_said():
    known = np.array([1.0, 2.0, 9.0])[:, None, None] * np.eye(2)
    seen = [view(3, covariance=known), view(2)]
    np.testing.assert_array_equal(Observations.of(seen).covariance[1, 0], 2 * np.eye(2))
    np.testing.assert_array_equal(Observations.of(seen, unknown=np.eye(2)).covariance[1, 0], np.eye(2))
    assert Observations.of([view(3), view(2)]).covariance is None


def test_points_that_count_alike_again_are_those_that_there_are():
    table = Observations.of([view(3, covariance=np.tile(np.eye(2), (3, 1, 1)))])
    weighed = replace(table.weighted(table.covariance), weights=np.array([[1.0, 0.0, 0.3]]))
    alike = weighed.alike()
    assert (alike.weights.tolist(), alike.whitening, alike.covariance) == ([[1, 1, 1]], None, None)


def test_whitened_errors_have_the_covariance_of_unit_noise():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(2, 3, 2, 2))
    covariance = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(2)
    whitening = whitening_of(covariance)
    product = np.einsum("ijvp,vpjk,lkvp->vpil", whitening, covariance, whitening)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-9)
    values = rng.normal(size=(2, 5, 2, 3))
    np.testing.assert_allclose(whitened(whitening, values), np.einsum("ijvp,jkvp->ikvp", whitening, values))
    assert whitened(None, values) is values


def test_values_of_points_are_padded_as_the_table_is():
    table = Observations.of([view(1), None, view(2)])
    padded = table.padded([np.array([[1.0, 2, 3]]), None, np.array([[4.0, 5, 6], [7, 8, 9]])], 3)
    assert padded.shape == (3, 3, 2)
    assert padded[:, 2].T.tolist() == [[4, 5, 6], [7, 8, 9]]
    assert padded[:, 1].tolist() == pytest.approx(np.zeros((3, 2)))
