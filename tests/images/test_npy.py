"""NumPy files: what comes back, and what is refused."""

import numpy as np
import pytest

from camcal.errors import FileError
from camcal.images.image import read_npy, write_npy


@pytest.mark.parametrize(("stored", "read"), [("<f8", "f4"), (">f4", "f4"), (">u2", "u2"), ("u1", "u1"), (">i4", "i4")])
def test_numbers_come_in_the_order_of_this_machine_and_floating_point_as_float32(tmp_path, stored, read):
    np.save(tmp_path / "map.npy", np.arange(6).reshape(2, 3).astype(stored))
    values = read_npy(tmp_path / "map.npy")
    assert values.dtype == np.dtype(read).newbyteorder("=")
    np.testing.assert_array_equal(values, [[0, 1, 2], [3, 4, 5]])


def test_what_is_written_is_read_back(tmp_path):
    values = np.random.default_rng(4).random((3, 5, 3)).astype(np.float32)
    write_npy(tmp_path / "image.npy", values[:, 1:4])
    np.testing.assert_array_equal(read_npy(tmp_path / "image.npy"), values[:, 1:4])


@pytest.mark.parametrize("values", [np.array(["a"]), np.array([True]), np.array([1j])])
def test_what_is_not_a_number_is_refused(tmp_path, values):
    np.save(tmp_path / "map.npy", values)
    with pytest.raises(FileError, match="contains no numeric array"):
        read_npy(tmp_path / "map.npy")


def test_an_archive_of_several_arrays_is_refused(tmp_path):
    np.savez(tmp_path / "map", a=np.zeros(2))
    (tmp_path / "map.npz").rename(tmp_path / "map.npy")
    with pytest.raises(FileError, match=r"map\.npy"):
        read_npy(tmp_path / "map.npy")


@pytest.mark.parametrize("content", [b"", b"no array", b"\x93NUMPY\x01\x00"])
def test_a_file_of_another_kind_is_a_file_error(tmp_path, content):
    (tmp_path / "map.npy").write_bytes(content)
    with pytest.raises(FileError, match=r"map\.npy"):
        read_npy(tmp_path / "map.npy")


def test_a_header_that_promises_more_than_the_file_holds_is_a_file_error(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros(4))
    content = (tmp_path / "map.npy").read_bytes()
    (tmp_path / "map.npy").write_bytes(content.replace(b"(4,)", b"(9999999999999,)"))
    with pytest.raises(FileError, match=r"map\.npy"):
        read_npy(tmp_path / "map.npy")
