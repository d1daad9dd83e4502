"""One vertex per cube, and drawing some of many."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.stereo.cloud import drawn, one_per_voxel
from camcal.stereo.depth import vertex_type

EVERYTHING = vertex_type(colour=True, intensity=True, normals=True, sigma=True)


def random_vertices(count, kind=EVERYTHING, seed=0):
    rng = np.random.default_rng(seed)
    found = np.empty(count, kind)
    for name in kind.names:
        found[name] = rng.integers(0, 256, count) if kind[name].kind == "u" else rng.normal(0, 1, count)
    return found


def test_a_vertex_is_the_mean_of_those_in_its_cube():
    vertices = random_vertices(2000)
    found = one_per_voxel(vertices, 0.5)
    place = np.stack([np.floor(vertices[name] / 0.5) for name in "xyz"], axis=-1)
    cubes, cube = np.unique(place, axis=0, return_inverse=True)
    assert len(found) == len(cubes) < 2000
    for name in ("x", "y", "z", "intensity"):
        expected = [vertices[name][cube == i].mean(dtype=float) for i in range(len(cubes))]
        np.testing.assert_allclose(found[name], expected, rtol=1e-5, atol=1e-6)  # float32
    reds = [vertices["red"][cube == i].mean() for i in range(len(cubes))]
    np.testing.assert_allclose(found["red"], reds, atol=0.5 + 1e-9)  # rounded


def test_normals_stay_of_length_one_and_the_unknown_ones_do_not_count():
    vertices = np.zeros(4, EVERYTHING)
    vertices["x"] = [0.1, 0.2, 0.3, 5.0]
    vertices[["nx", "ny", "nz"]] = [(1, 0, 0), (0, 1, 0), (np.nan,) * 3, (np.nan,) * 3]
    near, far = one_per_voxel(vertices, 1.0)
    np.testing.assert_allclose(near[["nx", "ny", "nz"]].tolist(), (0.5**0.5, 0.5**0.5, 0), rtol=1e-6)
    assert np.isnan(far["nx"])


def test_the_mean_of_many_is_hardly_better_known_than_one():
    vertices = np.zeros(2, EVERYTHING)
    vertices["sigma"] = [1.0, 7.0]
    (found,) = one_per_voxel(vertices, 1.0)
    assert found["sigma"] == pytest.approx(5.0)  # root of (1 + 49) / 2


def test_cubes_are_counted_from_the_origin_whatever_the_cloud():
    vertices = random_vertices(3, vertex_type())
    vertices["x"], vertices["y"], vertices["z"] = [-0.1, 0.1, 0.9], 0.5, 0.5
    assert len(one_per_voxel(vertices, 1.0)) == 2


def test_far_from_the_origin_cubes_are_the_same_cubes():
    vertices = random_vertices(500, vertex_type())
    moved = vertices.copy()
    moved["x"] += 4096.0
    assert len(one_per_voxel(moved, 1.0)) == len(one_per_voxel(vertices, 1.0))


def test_an_empty_cloud_stays_empty():
    assert len(one_per_voxel(np.empty(0, EVERYTHING), 0.1)) == 0


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_a_side_that_is_none_is_refused(size):
    with pytest.raises(InvalidInput, match="side of a voxel"):
        one_per_voxel(random_vertices(3), size)


def test_cubes_too_many_to_be_counted_are_refused():
    with pytest.raises(InvalidInput, match="are too many for the extent of the cloud: use a larger side"):
        one_per_voxel(random_vertices(50), 1e-8)


def test_so_many_are_drawn_and_always_the_same():
    taken = drawn(1000, 10)
    assert taken.sum() == 10
    np.testing.assert_array_equal(taken, drawn(1000, 10))
    assert drawn(5, 10).all()


def test_none_cannot_be_drawn():
    with pytest.raises(InvalidInput, match="at least one point"):
        drawn(5, 0)
