"""Files of correspondences: what is read, and that whatever is wrong is told with file and line."""

import json

import numpy as np
import pytest
import yaml

from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import correspondences

SIZE = (640, 480)
GOOD = """\
image,id,X,Y,Z,u,v
b.png,0,0,0,0,100,50
a.png,0,0,0,0,101,51
b.png,1,0.1,0,0,200.5,50
"""


RIG = {"left": (640, 480), "right": (320, 240)}


def read(tmp_path, text, size=SIZE, name="points.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return correspondences.read(path, size)


def test_images_come_in_the_order_of_their_first_row(tmp_path):
    found = read(tmp_path, GOOD)
    views = found.views
    assert [view.image for view in views] == ["b.png", "a.png"]
    np.testing.assert_array_equal(views[0].points, [[0, 0, 0], [0.1, 0, 0]])
    np.testing.assert_array_equal(views[0].pixels, [[100, 50], [200.5, 50]])
    assert views[0].covariance is None
    assert [ids.tolist() for ids in found.ids] == [[0, 1], [0]]
    assert not found.absolute


def test_without_an_image_column_all_rows_are_of_one_image_named_for_the_file(tmp_path):
    views = read(tmp_path, "# measured by hand\nu,v,X,Y,Z\n1,2,0,0,0\n3,4,1,0,0\n").views
    assert [view.image for view in views] == ["points.csv"]
    np.testing.assert_array_equal(views[0].pixels, [[1, 2], [3, 4]])


def test_covariances_are_read_as_symmetric_matrices(tmp_path):
    found = read(tmp_path, "X,Y,Z,u,v,suu,suv,svv\n0,0,0,1,2,0.04,0.01,0.09\n")
    np.testing.assert_array_equal(found.views[0].covariance, [[[0.04, 0.01], [0.01, 0.09]]])
    assert found.absolute


def test_sigma_is_in_pixels_and_weight_is_relative(tmp_path):
    sigma = read(tmp_path, "X,Y,Z,u,v,sigma\n0,0,0,1,2,0.5\n1,0,0,3,4,2\n")
    np.testing.assert_array_equal(sigma.views[0].covariance, [0.25 * np.eye(2), 4 * np.eye(2)])
    assert sigma.absolute
    weight = read(tmp_path, "X,Y,Z,u,v,weight\n0,0,0,1,2,4\n1,0,0,3,4,1\n0,1,0,5,6,0\n")
    np.testing.assert_array_equal(weight.views[0].covariance, [0.25 * np.eye(2), np.eye(2)])
    assert not weight.absolute


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_yaml_and_json_hold_what_a_csv_does(tmp_path, suffix):
    rows = [line.split(",") for line in GOOD.splitlines()[1:]]
    points = [
        {"image": row[0], "id": int(row[1]), **dict(zip("XYZuv", map(float, row[2:]), strict=True))} for row in rows
    ]
    text = json.dumps({"points": points}) if suffix == ".json" else yaml.safe_dump({"points": points})
    table, other = read(tmp_path, GOOD), read(tmp_path, text, name=f"points{suffix}")
    for first, second in zip(table.views, other.views, strict=True):
        assert first.image == second.image
        np.testing.assert_array_equal(first.points, second.points)
        np.testing.assert_array_equal(first.pixels, second.pixels)


def test_points_of_a_rig_name_their_cameras(tmp_path):
    text = "image,camera,X,Y,Z,u,v\n1,left,0,0,0,600,2\n1,right,0,0,0,3,4\n"
    views = read(tmp_path, text, RIG).views
    assert [(view.image, view.camera) for view in views] == [("1", "left"), ("1", "right")]
    with pytest.raises(InvalidInput, match=r"several cameras \(left, right\): give --rig"):
        read(tmp_path, text)
    with pytest.raises(InvalidInput, match="need a column camera: left, right"):
        read(tmp_path, GOOD, RIG)
    with pytest.raises(InvalidInput, match=r":3: camera 'top' is unknown; the rig has left, right"):
        read(tmp_path, text.replace("1,right", "1,top"), RIG)
    with pytest.raises(InvalidInput, match=r":3: \(600, 4\) is far outside the camera's image of 320 x 240"):
        read(tmp_path, text.replace("3,4", "600,4"), RIG)


def test_points_of_one_camera_may_name_it(tmp_path):
    (view,) = read(tmp_path, "camera,X,Y,Z,u,v\nleft,0,0,0,600,2\n").views
    assert view.camera is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X,Y,Z,u\n0,0,0,1\n", ":1: missing column 'v'"),
        ("X,Y,Z,u,v,sigmau\n0,0,0,1,2,3\n", ":1: unknown column 'sigmau'"),
        ("X,Y,Z,u,v\n0,0,0,1\n", ":2: 4 cells under 5 columns"),
        ("X,Y,Z,u,v\n0,0,0,1,2\n0,0,nan,1,2\n", ":3: Z: nan is not finite"),
        ("X,Y,Z,u,v\n0,0,zero,1,2\n", ":2: Z: 'zero' is not a number"),
        ("X,Y,Z,u,v\n0,0,0,100,700\n", ":2: (100, 700) is far outside the camera's image of 640 x 480"),
        ("X,Y,Z,u,v\n0,0,0,1,2\n# a remark\n0,0,0,5,6\n", ":4: image 'points.csv': the point (0, 0, 0) occurs twice"),
        ("id,X,Y,Z,u,v\n7,0,0,0,1,2\n7,1,0,0,5,6\n", ":3: image 'points.csv': id 7 occurs twice"),
        ("id,X,Y,Z,u,v\n1.5,0,0,0,1,2\n", ":2: id: '1.5' is not a whole number"),
        ("X,Y,Z,u,v,suu\n0,0,0,1,2,3\n", ": column 'suv' is missing; suu,suv,svv go together"),
        ("X,Y,Z,u,v,sigma\n0,0,0,1,2,0\n", ":2: sigma 0 px is not positive"),
        ("X,Y,Z,u,v,weight\n0,0,0,1,2,-1\n", ":2: weight -1 is negative"),
        ("X,Y,Z,u,v,sigma,weight\n0,0,0,1,2,1,1\n", ": columns sigma and weight are redundant"),
        ("X,Y,Z,u,v,suu,suv,svv\n0,0,0,1,2,1,2,1\n", ":2: suu, suv, svv are not positive definite"),
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


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "p.yaml",
            "points:\n  - {X: 0, Y: 0, Z: 0, u: 1, v: 2, sigm: 1}\n",
            "p.yaml:2: points[0].sigm: unknown key. Did",
        ),
        ("p.yaml", "points:\n  - {X: 0, Y: 0, Z: 0, u: 1, v: yon}\n", "p.yaml:2: v: 'yon' is not a number"),
        ("p.yaml", "points: 3\n", "p.yaml:1: points: expected a list"),
        ("p.json", '{"points": [{"X": 0, "Y": 0, "Z": 0, "u": 1, "v": true}]}', "p.json: points[0].v: is not a number"),
        ("p.json", '{"points": [{"X": 0, "Y": 0, "Z": 0, "u": 1, "v": NaN}]}', "p.json: NaN is not a JSON number"),
        (
            "p.json",
            '{"points": [{"X": 0, "Y": 0, "Z": 0, "u": 9e9, "v": 1}]}',
            "p.json:points[0]: (9e+09, 1) is far outside",
        ),
        ("p.json", '{"points": [], "points": []}', "p.json: duplicate key 'points'"),
        (
            "p.json",
            (
                '{"points": [{"X": 0, "Y": 0, "Z": 0, "u": 1, "v": 1, "sigma": 1}, '
                '{"X": 1, "Y": 0, "Z": 0, "u": 1, "v": 1}]}'
            ),
            "p.json: points[1]: 'sigma' is given for some points only",
        ),
    ],
)
def test_a_fault_in_yaml_or_json_is_named_by_its_place(tmp_path, name, text, message):
    with pytest.raises(InvalidInput) as caught:
        read(tmp_path, text, name=name)
    assert message in str(caught.value)


def test_yaml_or_json_without_points_holds_none(tmp_path):
    with pytest.raises(InsufficientData, match="holds no points"):
        read(tmp_path, '{"points": []}', name="p.json")
