"""Tables of numbers over time."""

import json

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.estimate.smoothing.series import Series, SeriesOptions, smooth_series
from camcal.formats import series as tables

TEXT = "time,x,y,sigma_x,sigma_y\n0,1,2,0.1,0.2\n1,,3,0.1,0.2\n2,3,4,0.1,0.2\n"


@pytest.mark.parametrize("missing", ["", " ", "nan", "NaN"])
def test_columns_are_taken_by_name_and_empty_cells_are_missing(tmp_path, missing):
    path = tmp_path / "a.csv"
    path.write_text(TEXT.replace("1,,", f"1,{missing},"))
    found = tables.read(path)
    assert found.names == ("x", "y")
    np.testing.assert_array_equal(found.values, [[1, 2], [np.nan, 3], [3, 4]])
    np.testing.assert_array_equal(found.sigma, [[0.1, 0.2]] * 3)
    assert tables.read(path, ("time", "y")).names == ("y",)


@pytest.mark.parametrize(
    ("text", "columns", "words"),
    [
        (TEXT, ("time", "z"), "no column 'z'"),
        (TEXT, ("time",), "at least one"),
        (TEXT.replace("0.2\n1", "0\n1"), (), "a.csv:2: a sigma must be more than 0"),
        (TEXT.replace("\n2,3", "\n1,3"), (), "a.csv:4: time 1.000000000 s is not later"),
        (TEXT.replace("2,3,4", "2,three,4"), (), "a.csv:4: x: 'three' is not a number"),
        (TEXT.replace("2,3,4", "2,inf,4"), (), "a.csv:4: x: inf is not finite"),
        (TEXT.replace("2,3,4", "2,-2e50,4"), (), "a.csv:4: a measurement of more than 1e+50"),
        (TEXT.replace("0.2\n1", "2e50\n1"), (), "a.csv:2: a sigma of more than 1e+50"),
        ("0,1\n1,2\n", (), "no column names"),
        ("t,x,x\n0,1,2\n", (), "'x' occurs twice"),
        (TEXT, ("time", "x", "x"), "one twice"),
        (TEXT.replace(",", ";"), (), "separated by commas, not semicolons"),
        (TEXT.replace(",", "\t"), (), "separated by commas, not tabs"),
        (TEXT.replace(",", " "), (), "separated by commas, not blanks"),
        ("t,x,y,sigma_x\n0,1,2,3\n", (), "'y' has none"),
    ],
)
def test_what_is_wrong_with_a_table_is_told(tmp_path, text, columns, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InvalidInput) as caught:
        tables.read(path, columns)
    assert words in str(caught.value)


def test_a_header_alone_is_no_table(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n")
    with pytest.raises(FileError, match="no rows"):
        tables.read(tmp_path / "a.csv")


def test_controls_between_two_measurements_are_summed_up(tmp_path):
    path = tmp_path / "u.csv"
    path.write_text("t,x\n0.5,1\n1.0,2\n1.5,4\n2.0,8\n")
    series = Series(("x",), np.array([0.0, 1.0, 2.0]), np.zeros((3, 1)))
    np.testing.assert_array_equal(tables.read_controls(path, series)[:, 0], [0, 3, 12])
    path.write_text("t,x\n2.5,1\n")
    with pytest.raises(InvalidInput, match=r"u.csv:2: time 2.500000000 s is later"):
        tables.read_controls(path, series)


def test_smoothed_states_are_written_with_what_they_have_in_common(tmp_path):
    series = Series(("x",), np.arange(5.0), np.arange(5.0)[:, None] ** 2, np.ones((5, 1)))
    smoothed = smooth_series(series, SeriesOptions(q=1.0))
    tables.write(tmp_path / "a.csv", smoothed)
    head, *rows = (tmp_path / "a.csv").read_text().splitlines()[1:]
    assert head == "t,x,x_velocity,std_x,std_x_velocity,cov_x_x_velocity,nis_x"
    numbers = np.array([[cell or "nan" for cell in row.split(",")] for row in rows], float)
    np.testing.assert_allclose(numbers[:, 1:3], smoothed.states[:, 0], rtol=1e-11)
    np.testing.assert_allclose(numbers[:, 5], smoothed.covariances[:, 0, 0, 1], rtol=1e-11)
    np.testing.assert_allclose(numbers[:, 6], smoothed.nis[:, 0], rtol=1e-11)
    np.testing.assert_array_equal(np.isnan(numbers[:, 6]), [True, True, False, False, False])  # two make a velocity
    tables.write(tmp_path / "a.json", smoothed)
    columns = json.loads((tmp_path / "a.json").read_text())["columns"]
    assert ",".join(columns) == head
    assert columns["nis_x"][:2] == [None, None]
    with pytest.raises(
        InvalidInput, match="contains smoothed states, not measurements; choose what to smooth with --columns"
    ):
        tables.read(tmp_path / "a.csv")
    np.testing.assert_allclose(tables.read(tmp_path / "a.csv", ("t", "x")).values[:, 0], smoothed.states[:, 0, 0])
