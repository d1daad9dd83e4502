"""XYZ: rows of numbers, and what the number of columns means."""

import numpy as np
import pytest

from camcal.errors import FileError
from camcal.formats import pointclouds
from camcal.formats.pointclouds import write


def test_a_file_is_a_row_of_numbers_per_point(tmp_path, vertices, stream):
    cloud = vertices(9, colour=True, intensity=True)
    write(tmp_path / "cloud.XYZ", stream(cloud))
    assert (tmp_path / "cloud.XYZ").read_bytes()[:1] != b"#"
    table = np.loadtxt(tmp_path / "cloud.XYZ")
    for name, column in zip(cloud.dtype.names, table.T, strict=True):
        np.testing.assert_array_equal(column.astype(cloud.dtype[name]), cloud[name])


def test_what_columns_alone_would_not_tell_stands_in_front(tmp_path, vertices, stream):
    write(tmp_path / "cloud.xyz", stream(vertices(2, sigma=True), unit="mm"))
    assert (tmp_path / "cloud.xyz").read_text().splitlines()[:2] == ["# columns: x y z sigma", "# unit: mm"]


@pytest.mark.parametrize(
    ("row", "names"),
    [
        ("1 2 3", ()),
        ("1 2 3 0.5", ("intensity",)),
        ("1 2 3 10 20 30", ("red", "green", "blue")),
        ("1 2 3 0 0.6 -0.8", ("nx", "ny", "nz")),
        ("1 2 3 10 20 30 0.5", ("red", "green", "blue", "intensity")),
        ("1 2 3 4 5", ()),
        ("1,2,3", ()),
        ("1; 2; 3", ()),
    ],
)
def test_columns_are_told_by_their_number_and_their_look(row, names):
    found = pointclouds.read_xyz(f"// from elsewhere\n{row}\n\n{row}\n".encode()).vertices
    assert found.dtype.names == ("x", "y", "z", *names)
    assert found[["x", "y", "z"]].tolist() == [(1, 2, 3)] * 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"1 2\n", "a row has 2 numbers .minimum 3"),
        (b"1 2 3\n1 2\n", "not a table of numbers: .* changed from 3 to 2 at row 2$"),
        (b"x y z\n1 2 3\n", "not a table of numbers"),
        (b"# columns: x y z sigma\n1 2 3\n", "names 4 columns, its rows have 3"),
        (b"# columns: a b c\n1 2 3\n", "no x, y and z"),
    ],
)
def test_a_file_that_is_none_says_what_was_expected_and_found(content, message):
    with pytest.raises(FileError, match=message):
        pointclouds.read_xyz(content)
