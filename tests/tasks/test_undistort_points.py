"""Undistorting tables of pixels, and the way back."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.formats import cameras, native
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion
from camcal.images.options import ViewOptions
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import move_pixels, undistort_points

LENS = Camera(model_named("opencv5"), (640, 480), np.array([400.0, 402, 325, 236, -0.3, 0.08, 1e-3, -1e-3, 0]))
FISHEYE = Camera(model_named("kannala_brandt4"), (640, 480), np.array([150.0, 150, 320, 240, 0, 0, 0, 0]))
KEEP = ViewOptions(keep_k=True)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, camera in (("lens", LENS), ("fish", FISHEYE)):
        native.write(tmp_path / f"{name}.yaml", CameraFile({name: CameraEntry(camera)}))
    return tmp_path


def run(folder, text, camera="lens.yaml", output="moved.csv", **options):
    (folder / "points.csv").write_text(text)
    return undistort_points(UndistortOptions(camera, folder / output, points=folder / "points.csv", **options))


def rows(path):
    return [line.split(",") for line in path.read_text().splitlines()]


def test_pixels_are_moved_to_the_view_and_other_columns_stay(folder):
    run(folder, 'name,u,v,weight\na,600,400,1\n"b, c",325,236,0.5\n', view=KEEP)
    first, second, third = rows(folder / "moved.csv")[0], rows(folder / "moved.csv")[1], rows(folder / "moved.csv")[2]
    assert first == ["name", "u", "v", "weight"]
    x, y, z = LENS.unproject(np.array([[600.0, 400]])).directions[0]
    np.testing.assert_allclose([float(second[1]), float(second[2])], [400 * x / z + 325, 402 * y / z + 236], atol=1e-8)
    assert (second[0], second[3]) == ("a", "1")
    assert third[:2] == ['"b', ' c"']
    assert third[2:] == ["325", "236", "0.5"]  # the principal point stays


def test_there_and_back_is_where_it_began(folder):
    pixels = np.random.default_rng(0).uniform([5, 5], [635, 475], (200, 2))
    run(folder, "u,v\n" + "".join(f"{u:.12g},{v:.12g}\n" for u, v in pixels))
    (folder / "moved.csv").rename(folder / "view.csv")
    report = undistort_points(
        UndistortOptions("lens.yaml", folder / "back.csv", points=folder / "view.csv", distort=True)
    )
    back = np.array(rows(folder / "back.csv")[1:], dtype=float)
    np.testing.assert_allclose(back, pixels, atol=1e-8)  # 12 digits of 600 px, and the inverse's 1e-12
    assert report.camera_file is None


def test_the_camera_beside_the_table_is_the_one_the_pixels_belong_to(folder):
    report = run(folder, "u,v\n600,400\n", view=ViewOptions(alpha=1))
    view = cameras.read_camera(report.camera_file)
    assert report.camera_file.name == "moved.camera.yaml"
    moved = np.array(rows(folder / "moved.csv")[1], dtype=float)
    np.testing.assert_allclose(move_pixels(LENS, view, np.array([[600.0, 400]]))[0], moved, atol=1e-8)


def test_points_without_a_place_are_empty_and_counted(folder):
    report = run(folder, "u,v,id\n320,240,1\n,240,2\nnan,3,3\n1e6,240,4\n600,240,5\n", camera="fish.yaml", view=KEEP)
    table = rows(folder / "moved.csv")
    assert (report.count, report.lost) == (5, 4)
    assert table[1] == ["320", "240", "1"]
    assert table[2:] == [["", "", str(number)] for number in (2, 3, 4, 5)]  # the last looks 107° to the side


def test_a_folder_takes_a_table_of_the_same_name(folder):
    assert run(folder, "u,v\n1,2\n", output="out").output == folder / "out" / "points.csv"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y\n1,2\n", r"points\.csv: the first row names the columns, u and v"),
        ("1,2\n3,4\n", "the first row names the columns"),
        ("# only a remark\n", "the first row names the columns"),
        ("u,v,u\n1,2,3\n", "u and v once"),
        ("u,v,a,a\n1,2,3,4\n", "'a' occurs twice"),
        ("u,v\n1,2\n3,four\n", r"points\.csv:3: v: 'four' is not a number"),
        ("u,v\n1\n", r"points\.csv:2: 1 cells under 2 columns"),
    ],
)
def test_a_table_that_is_none_is_refused_with_its_line(folder, text, words):
    with pytest.raises(InvalidInput, match=words):
        run(folder, text)
    assert not (folder / "moved.csv").exists()


def test_a_table_without_rows_gives_one(folder):
    assert run(folder, "u,v\n").count == 0
    assert (folder / "moved.csv").read_text() == "u,v\n"


def test_the_table_itself_is_not_overwritten(folder):
    for output in ("points.csv", "."):
        with pytest.raises(InvalidInput, match="is an input and is not overwritten"):
            run(folder, "u,v\n1,2\n", output=output)
    assert (folder / "points.csv").read_text() == "u,v\n1,2\n"


def test_pixels_outside_of_the_image_circle_have_no_place_either_way(folder):
    entry = CameraEntry(FISHEYE, valid=ValidRegion(image_circle=ImageCircle((640, 480), (320.0, 240.0), 150.0)))
    native.write(folder / "circle.yaml", CameraFile({"fish": entry}))
    view = ViewOptions(projection="stereographic", fov_deg=200.0)
    report = run(folder, "u,v\n320,389\n320,391\n", "circle.yaml", view=view)
    assert report.lost == 1
    assert rows(folder / "moved.csv")[2] == ["", ""]
    back = run(folder, "u,v\n320,240\n320,10\n", "circle.yaml", "back.csv", view=view, distort=True)
    # 10 px is 1.4 rad from the axis in the view, 210 px from the centre of the image
    assert rows(folder / "back.csv")[2] == ["", ""]
    assert back.lost == 1
