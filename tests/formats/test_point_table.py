"""Tables of points: columns are kept, and what is wrong is told with its line."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.formats import correspondences

FULL = "id,X,Y,Z,NX,NY,NZ,sxx,sxy,sxz,syy,syz,szz\na,1,2,3,0,0,1,1,2,3,4,5,6\n,,,,0,1,0,1,0,0,1,0,1\n"


def read(tmp_path, text):
    (tmp_path / "points.csv").write_text(text)
    return correspondences.read_point_table(tmp_path / "points.csv")


def test_all_columns_come_back_as_they_were(tmp_path):
    found = read(tmp_path, FULL)
    np.testing.assert_array_equal(found.points[0], [1, 2, 3])
    assert np.isnan(found.points[1]).all()
    np.testing.assert_array_equal(found.covariances[0], [[1, 2, 3], [2, 4, 5], [3, 5, 6]])
    correspondences.write_point_table(tmp_path / "again.csv", found)
    assert (tmp_path / "again.csv").read_text() == FULL


def test_points_alone_have_neither_normals_nor_covariances(tmp_path):
    found = read(tmp_path, "# metres\nx,y,z\n1,2,3\n")
    assert found.normals is None
    assert found.covariances is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "x, y, z once among them"),
        ("x,y,z,X\n1,2,3,4\n", "x, y, z once among them"),
        ("x,y,z,id,id\n1,2,3,4,5\n", "'id' occurs twice"),
        ("x,y,z,nx\n1,2,3,0\n", "'ny' is missing"),
        ("x,y,z\n1,2,c\n", r"points.csv:2: z: 'c' is not a number"),
        ("x,y,z\n1,2,3\n1,inf,3\n", r"points.csv:3: y: inf is not finite"),
        (
            f"x,y,z,{','.join(correspondences.SPACE_COVARIANCE)}\n1,2,3,1,0,0,-4,0,1\n",
            r"points.csv:2: syy: -4 is not a variance",
        ),
        ("x,y,z\n1,2\n", "points.csv:2: 2 cells under 3 columns"),
    ],
)
def test_what_is_no_table_of_points_is_refused(tmp_path, text, message):
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, text)
