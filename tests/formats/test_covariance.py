"""Covariances as blocks; a large one stands beside the file under the name of its hash."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import covariance


def random_covariance(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(count, count)) * 10.0 ** rng.uniform(-6, 2, size=(count, 1))
    return factor @ factor.T


@given(st.integers(0, 10**6), st.integers(1, 18))
def test_rounding_to_twelve_digits_leaves_a_covariance(seed, count):
    exact = random_covariance(seed, count)
    rounded = np.array([[float(f"{value:.12g}") for value in row] for row in exact])
    assert covariance.why_no_covariance(rounded) is None


def test_a_fully_correlated_pair_is_a_covariance_and_more_is_not():
    assert covariance.why_no_covariance(np.array([[4.0, 2.0], [2.0, 1.0]])) is None
    assert "semidefinite" in covariance.why_no_covariance(np.array([[4.0, 2.001], [2.001, 1.0]]))


def test_a_row_of_zeros_is_a_covariance_but_not_if_it_is_correlated():
    assert covariance.why_no_covariance(np.diag([1.0, 0.0])) is None
    assert "semidefinite" in covariance.why_no_covariance(np.array([[1.0, 0.1], [0.1, 0.0]]))


def test_fixed_names_are_left_out_and_come_back_as_zeros(tmp_path):
    names, matrix = ("a", "b", "c"), random_covariance(1, 3)
    matrix[1] = matrix[:, 1] = 0
    block = covariance.block(names, matrix, tmp_path / "f.yaml", fixed=("b",))
    assert block["covariance_order"] == ["a", "c"]
    found, unknown = covariance.read(block, names, tmp_path, fixed=("b",))
    np.testing.assert_array_equal(found, matrix)
    assert unknown == ()


def test_names_without_any_uncertainty_are_told(tmp_path):
    assert covariance.read({"std": {"a": 1.0}}, ("a", "b", "c"), tmp_path, fixed=("c",)) == (None, ("b",))


def large(tmp_path, count=120):
    names, matrix = [f"p{i}" for i in range(count)], random_covariance(2, count)
    return names, matrix, covariance.block(names, matrix, tmp_path / "cam.yaml")


def test_a_large_covariance_stands_beside_the_file_and_comes_back_exactly(tmp_path):
    names, matrix, block = large(tmp_path)
    assert "covariance" not in block
    assert [path.name for path in tmp_path.iterdir()] == [block["covariance_file"]]
    assert not list(covariance.check(block, "", names))
    np.testing.assert_array_equal(covariance.read(block, names, tmp_path)[0], matrix)


def test_the_file_beside_has_the_same_name_and_bytes_every_time(tmp_path):
    (tmp_path / "again").mkdir()
    first, second = large(tmp_path)[2]["covariance_file"], large(tmp_path / "again")[2]["covariance_file"]
    assert first == second
    assert (tmp_path / first).read_bytes() == (tmp_path / "again" / second).read_bytes()


def test_a_file_beside_that_holds_other_numbers_is_refused(tmp_path):
    names, _, block = large(tmp_path)
    path = tmp_path / block["covariance_file"]
    np.savez_compressed(path, covariance=random_covariance(3, 120))
    with pytest.raises(InvalidInput, match="does not match covariance_order and its hash"):
        covariance.read(block, names, tmp_path)


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 cut off", b"not a zip"])
def test_a_missing_or_broken_file_beside_is_a_file_error(tmp_path, content):
    names, _, block = large(tmp_path)
    path = tmp_path / block["covariance_file"]
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=r"\.npz"):
        covariance.read(block, names, tmp_path)


def test_a_file_beside_lies_beside_and_nowhere_else(tmp_path):
    block = {"covariance_order": ["a"], "covariance_file": "../../secret.npz"}
    assert [fault.path for fault in covariance.check(block, "u", ["a"])] == ["u.covariance_file"]
