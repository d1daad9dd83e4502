"""The CSV of correspondences: what is read, and that whatever is wrong is told with file and line."""

import numpy as np
import pytest

from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import correspondences

SIZE = (640, 480)
GOOD = """\
image,id,X,Y,Z,u,v
b.png,0,0,0,0,100,50
a.png,0,0,0,0,101,51
b.png,1,0.1,0,0,200.5,50
"""


def read(tmp_path, text):
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8")
    return correspondences.read(path, SIZE)


def test_images_come_in_the_order_of_their_first_row(tmp_path):
    views = read(tmp_path, GOOD)
    assert [view.image for view in views] == ["b.png", "a.png"]
    np.testing.assert_array_equal(views[0].points, [[0, 0, 0], [0.1, 0, 0]])
    np.testing.assert_array_equal(views[0].pixels, [[100, 50], [200.5, 50]])
    assert views[0].covariance is None


def test_without_an_image_column_all_rows_are_of_one_image_named_for_the_file(tmp_path):
    views = read(tmp_path, "# measured by hand\nu,v,X,Y,Z\n1,2,0,0,0\n3,4,1,0,0\n")
    assert [view.image for view in views] == ["points.csv"]
    np.testing.assert_array_equal(views[0].pixels, [[1, 2], [3, 4]])


def test_covariances_are_read_as_symmetric_matrices(tmp_path):
    views = read(tmp_path, "X,Y,Z,u,v,suu,suv,svv\n0,0,0,1,2,0.04,0.01,0.09\n")
    np.testing.assert_array_equal(views[0].covariance, [[[0.04, 0.01], [0.01, 0.09]]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X,Y,Z,u\n0,0,0,1\n", ":1: missing column 'v'"),
        ("X,Y,Z,u,v,sigmau\n0,0,0,1,2,3\n", ":1: unknown column 'sigmau'"),
        ("X,Y,Z,u,v\n0,0,0,1\n", ":2: 4 cells under 5 columns"),
        ("X,Y,Z,u,v\n0,0,0,1,2\n0,0,nan,1,2\n", ":3: Z: nan is not finite"),
        ("X,Y,Z,u,v\n0,0,zero,1,2\n", ":2: Z: 'zero' is not a number"),
        ("X,Y,Z,u,v\n0,0,0,100,700\n", ":2: (100, 700) is far outside the camera's image of 640 x 480"),
        ("X,Y,Z,u,v\n0,0,0,1,2\n# a remark\n0,0,0,5,6\n", ":4: image 'points.csv': the point (0, 0, 0) stands twice"),
        ("id,X,Y,Z,u,v\n7,0,0,0,1,2\n7,1,0,0,5,6\n", ":3: image 'points.csv': id 7 stands twice"),
        ("id,X,Y,Z,u,v\n1.5,0,0,0,1,2\n", ":2: id: '1.5' is not a whole number"),
        ("X,Y,Z,u,v,suu\n0,0,0,1,2,3\n", ": column 'suu' without the others"),
        ("X,Y,Z,u,v,suu,suv,svv\n0,0,0,1,2,1,2,1\n", ":2: suu, suv, svv are no covariance"),
    ],
)
def test_a_row_that_breaks_a_rule_is_named_by_file_and_line(tmp_path, text, message):
    with pytest.raises(InvalidInput) as caught:
        read(tmp_path, text)
    assert f"{tmp_path / 'points.csv'}{message}" in str(caught.value)


def test_a_table_without_rows_holds_no_points(tmp_path):
    with pytest.raises(InsufficientData, match="holds no points"):
        read(tmp_path, "X,Y,Z,u,v\n")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        correspondences.read(tmp_path / "none.csv", SIZE)
