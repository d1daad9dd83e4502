"""The detections CSV: bit for bit there and back, whoever wrote it, and one clear line for what is wrong."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.validity import ImageCircle
from camcal.errors import FileError, InvalidInput
from camcal.formats import detections
from camcal.formats.detections import read_csv
from camcal.targets.board import parse_board
from camcal.targets.detection import BoardDetection, Detections

BOARD = parse_board("chessboard:4x3:25mm")
GOOD = """# camcal-detections 1 board=chessboard:4x3:25mm
image,width,height,id,u,v
a.png,640,480,0,100.5,50.25
a.png,640,480,1,120.5,50.5
# none b.png,640,480,no board found
c.png,640,480,11,300.0,200.0
"""
CIRCLE = "# image_circle 640,480,319.5,239.5,228.125"


def assert_same(found: Detections, expected: Detections) -> None:
    assert found.board == expected.board
    assert found.circles == expected.circles
    assert len(found.views) == len(expected.views)
    for one, other in zip(found.views, expected.views, strict=True):
        for name in ("image", "size", "camera", "reason", "orientation"):
            assert getattr(one, name) == getattr(other, name)
        np.testing.assert_array_equal(one.ids, other.ids)
        assert one.pixels.tobytes() == other.pixels.tobytes()
        assert (one.covariance is None) == (other.covariance is None)
        if one.covariance is not None:
            assert one.covariance.tobytes() == other.covariance.tobytes()


def read_text(tmp_path, content: str, **options) -> Detections:
    path = tmp_path / "d.csv"
    path.write_text(content, encoding="utf-8", newline="")
    return detections.read(path, **options)


def fault(tmp_path, content: str, **options) -> str:
    with pytest.raises(InvalidInput) as caught:
        read_text(tmp_path, content, **options)
    return str(caught.value).replace(str(tmp_path / "d.csv"), "d.csv")


def random_view(seed: int, image: str, camera: str, *, measured: bool, orientation: int) -> BoardDetection:
    rng = np.random.default_rng(seed)
    ids = rng.permutation(BOARD.count)[: rng.integers(1, BOARD.count + 1)]
    pixels = rng.uniform(-0.5, 479.5, (len(ids), 2))
    factor = rng.normal(size=(len(ids), 2, 2))
    covariance = factor @ factor.transpose(0, 2, 1) if measured else None
    return BoardDetection(image, (640, 480), ids, pixels, covariance, camera, orientation=orientation)


names = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
found_views = st.builds(
    random_view,
    st.integers(0, 10**6),
    names,
    st.sampled_from(["", "left", "right, upper"]),
    measured=st.booleans(),
    orientation=st.sampled_from([1, 6]),
)
empty_views = st.builds(
    lambda image, camera, reason, orientation: replace(
        BoardDetection(image, (640, 480), reason=" ".join(reason.split()) or "none"),
        camera=camera,
        orientation=orientation,
    ),
    names,
    st.sampled_from(["", "left"]),
    names,
    st.sampled_from([1, 8]),
)
view_lists = st.lists(st.one_of(found_views, empty_views), max_size=6, unique_by=lambda view: (view.camera, view.image))


@given(view_lists, st.sampled_from([None, BOARD, parse_board("chessboard:4x3")]))
def test_whatever_is_written_comes_back_bit_for_bit(tmp_path_factory, views, board):
    path = tmp_path_factory.mktemp("csv") / "d.csv"
    written = Detections(board, tuple(views))
    detections.write(path, written)
    assert_same(detections.read(path), written)


def test_writing_what_was_read_gives_the_same_bytes(tmp_path):
    read_text(tmp_path, GOOD)
    detections.write(tmp_path / "e.csv", detections.read(tmp_path / "d.csv"))
    assert (tmp_path / "e.csv").read_bytes() == GOOD.encode()


def test_a_file_by_hand_needs_no_first_line_and_no_order_of_columns(tmp_path):
    content = (
        "id, v, u, image, height, width\n1, 50.5, 120.5, a b.png, 480, 640\n\n# a remark\n0,50.25,100,a b.png,480,640\n"
    )
    found = read_text(tmp_path, content)
    assert found.board is None
    assert found.views[0].image == "a b.png"
    np.testing.assert_array_equal(found.views[0].ids, [1, 0])
    np.testing.assert_array_equal(found.views[0].pixels, [[120.5, 50.5], [100.0, 50.25]])


@pytest.mark.parametrize("form", ["\ufeff" + GOOD, GOOD.replace("\n", "\r\n"), GOOD.rstrip("\n")])
def test_byte_order_mark_and_any_line_end_are_accepted(tmp_path, form):
    assert_same(read_text(tmp_path, form), read_text(tmp_path, GOOD))


def test_views_keep_the_order_in_which_the_file_names_them(tmp_path):
    assert [view.image for view in read_text(tmp_path, GOOD).views] == ["a.png", "b.png", "c.png"]
    assert read_text(tmp_path, GOOD).views[1].reason == "no board found"


def test_images_of_the_same_name_are_kept_apart_by_their_camera(tmp_path):
    content = "image,width,height,id,u,v,camera\n0.png,640,480,0,1,1,left\n0.png,320,240,0,2,2,right\n"
    assert [(view.camera, view.size) for view in read_text(tmp_path, content).views] == [
        ("left", (640, 480)),
        ("right", (320, 240)),
    ]


def test_the_board_given_wins_over_the_one_named_but_must_have_its_grid(tmp_path):
    without_size, other = parse_board("chessboard:4x3"), parse_board("chessboard:5x4")
    assert read_text(tmp_path, GOOD).board == BOARD
    assert read_text(tmp_path, GOOD, board=without_size).board == without_size
    assert fault(tmp_path, GOOD, board=other) == (
        "d.csv:1: the points are those of another board (chessboard of 4x3 inner corners) than given "
        "(chessboard of 5x4 inner corners)"
    )


@pytest.mark.parametrize(
    "form",
    [
        "chessboard:9x6:25mm:dots",
        "aprilgrid:6x6:88mm:0.3",
        "aprilgrid:6x6:0.3:tag25h9",
        "circles:10x8:25mm:15mm",
        "asymmetric_circles:4x11",
    ],
)
def test_a_board_of_any_type_is_named_and_all_its_points_are_kept(tmp_path, form):
    board = parse_board(form)
    view = BoardDetection("a.png", (640, 480), np.arange(board.count), np.full((board.count, 2), 7.5))
    detections.write(tmp_path / "d.csv", Detections(board, (view,)))
    found = detections.read(tmp_path / "d.csv")
    assert found.board == board
    assert found.views[0].ids.tolist() == view.ids.tolist()


def test_a_board_that_numbers_its_points_otherwise_is_refused(tmp_path):
    detections.write(tmp_path / "d.csv", Detections(parse_board("circles:6x4:25mm"), ()))
    alike = parse_board("charuco:7x5:30mm:22mm:DICT_4X4_50")  # 6 x 4 points, row by row
    assert detections.read(tmp_path / "d.csv", alike).board == alike
    for form in ("aprilgrid:6x4:0.3", "asymmetric_circles:6x4"):
        with pytest.raises(InvalidInput, match=r"those of another board \(grid of 6x4 circles\) than given"):
            detections.read(tmp_path / "d.csv", parse_board(form))


def test_a_board_with_another_first_marker_is_kept(tmp_path):
    board = replace(parse_board("charuco:9x7:30mm:22mm:DICT_5X5_100"), first_marker=12)
    detections.write(tmp_path / "d.csv", Detections(board, ()))
    assert detections.read(tmp_path / "d.csv").board == board


FAULTS = {
    "u,v\n": "d.csv:1: missing column 'image'; needed: image,width,height,id,u,v",
    "a.png,640,480,0,1,1\n": "d.csv:1: no header; the first row names the columns image,width,height,id,u,v",
    "# camcal-detections 1\n": "d.csv: no header line; the first row names the columns image,width,height,id,u,v",
    "# camcal-detections 2\n": "d.csv:1: detections of version '2'; this camcal reads 1",
    "# camcal-detections 1 board=chess:9x6\n": "d.csv:1: board 'chess:9x6': expected chessboard:",
    "# camcal-detections 1 board=chessboard:9x6 first_marker_id=x\n": "d.csv:1: first_marker_id is not a whole number",
}
ROW_FAULTS = {
    "a.png,640,480,0,1\n": "5 cells under 6 columns",
    "a.png,640,480,0,nan,1\n": "u: nan is not finite",
    "a.png,640,480,0,1,-inf\n": "v: -inf is not finite",
    "a.png,640,480,0,1_0,1\n": "u: '1_0' is not a number",
    "a.png,640,480,0,,1\n": "u: '' is not a number",
    "a.png,640,480,0.5,1,1\n": "id: '0.5' is not a whole number",
    "a.png,640,480,-1,1,1\n": "id -1 is not in 0 … 11",
    "a.png,640,480,12,1,1\n": "id 12 is not in 0 … 11",
    "a.png,640,0,0,1,1\n": "height 0 is not in 1 … 1000000",
    "a.png,640,480,0,600,900\n": "image 'a.png': (600, 900) is far outside the image of 640 x 480; check",
    '"a.png,640,480,0,1,1\n': "invalid CSV row: unexpected end of data",
    '"a"b.png,640,480,0,1,1\n': "invalid CSV row",
    "# none a.png,640,480\n": "# none needs IMAGE,WIDTH,HEIGHT,REASON[,CAMERA[,ORIENTATION]]",
    "# none a.png,640,x,no board\n": "height: 'x' is not a whole number",
    "# image_circle 640,480,319.5,239.5\n": "# image_circle needs WIDTH,HEIGHT,U,V,RADIUS[,CAMERA]",
    "# image_circle 640,480,319.5,nan,200\n": "v: nan is not finite",
    "# image_circle 640,480,319.5,239.5,0\n": "radius 0 px is not positive",
    "a.png,640,480,3,9,9\na.png,640,480,4,9,9\na.png,640,480,3,8,8\n": "image 'a.png': id 3 occurs twice",
    "a.png,640,480,3,9,9\na.png,640,480,4,9,9\na.png,640,481,5,8,8\n": (
        "image 'a.png': size 640 x 481 here, 640 x 480 at line 3"
    ),
}


@pytest.mark.parametrize("content", FAULTS)
def test_a_head_that_says_nothing_is_told_how_it_looks(tmp_path, content):
    assert fault(tmp_path, content).startswith(FAULTS[content])


@pytest.mark.parametrize("rows", ROW_FAULTS)
def test_a_wrong_row_is_told_with_its_line(tmp_path, rows):
    head = "# camcal-detections 1 board=chessboard:4x3:25mm\nimage,width,height,id,u,v\n"
    assert fault(tmp_path, head + rows).startswith(f"d.csv:{2 + rows.count(chr(10))}: {ROW_FAULTS[rows]}")


@pytest.mark.parametrize(
    ("columns", "row", "expected"),
    [
        ("suu,suv", "1,0", "d.csv: column 'suu' without the others of suu,suv,svv"),
        ("suu,suv,svv", "1,0,", "d.csv:2: only a part of suu,suv,svv"),
        ("suu,suv,svv", "1,2,1", "d.csv:2: suu, suv, svv are not positive definite"),
        ("suu,suv,svv", "-1,0,-1", "d.csv:2: suu, suv, svv are not positive definite"),
        ("orientation", "9", "d.csv:2: orientation 9 is not in 1 … 8"),
        ("sigma", "1", "d.csv:1: unknown column 'sigma'; possible here: camera, board, orientation, suu, suv, svv"),
        ("u", "1", "d.csv:1: column 'u' occurs twice"),
    ],
)
def test_a_wrong_optional_column_is_told(tmp_path, columns, row, expected):
    assert fault(tmp_path, f"image,width,height,id,u,v,{columns}\na.png,640,480,0,1,1,{row}\n") == expected


def test_a_covariance_is_given_for_a_whole_image_or_not_at_all(tmp_path):
    head = "image,width,height,id,u,v,suu,suv,svv\n"
    content = head + "a.png,640,480,0,1,1,,,\nb.png,640,480,0,1,1,1,0,1\nb.png,640,480,1,1,1,,,\n"
    assert fault(tmp_path, content) == "d.csv:4: no covariance here, but in other rows of the same image"


def test_an_image_is_named_in_one_way(tmp_path):
    head = "image,width,height,id,u,v\n# none a.png,640,480,blurred\n"
    assert fault(tmp_path, head + "a.png,640,480,0,1,1\n") == "d.csv:3: image 'a.png' is already named at line 2"


def test_image_circles_come_back_bit_for_bit_by_the_names_of_their_cameras(tmp_path):
    circles = {
        "": ImageCircle((640, 480), (319.1234567890123, 239.5), 228.1),
        "left, upper": ImageCircle((720, 640), (1 / 3, 2 / 3), 200.0),
    }
    written = Detections(None, read_text(tmp_path, GOOD).views, circles)
    detections.write(tmp_path / "d.csv", written)
    assert_same(detections.read(tmp_path / "d.csv"), written)


def test_a_circle_may_stand_on_any_line(tmp_path):
    expected = {"": ImageCircle((640, 480), (319.5, 239.5), 228.125)}
    assert read_text(tmp_path, f"{GOOD}{CIRCLE}\n").circles == expected
    assert read_text(tmp_path, f"{CIRCLE}\nimage,width,height,id,u,v\na.png,640,480,0,1,1\n").circles == expected
    assert read_text(tmp_path, GOOD).circles == {}


def test_two_circles_of_one_camera_are_refused(tmp_path):
    assert fault(tmp_path, f"{GOOD}{CIRCLE}\n{CIRCLE}\n").startswith("d.csv:8: a second image circle")


def test_a_name_with_a_line_break_cannot_be_written(tmp_path):
    view = BoardDetection("a\nb.png", (640, 480), np.array([0]), np.array([[1.0, 1.0]]))
    with pytest.raises(InvalidInput, match="line break"):
        detections.write(tmp_path / "d.csv", Detections(None, (view,)))
    assert not (tmp_path / "d.csv").exists()


@pytest.mark.parametrize("content", [b"", b"\xff\xd8\xff"])
def test_an_empty_or_binary_file_is_a_file_error(tmp_path, content):
    path = tmp_path / "d.csv"
    path.write_bytes(content)
    with pytest.raises(FileError):
        detections.read(path)


@given(st.text(max_size=120))
def test_any_text_is_read_or_refused_with_file_and_reason(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("csv") / "d.csv"
    path.write_text("image,width,height,id,u,v\n" + content, encoding="utf-8", newline="")
    try:
        found = read_csv(path)
    except InvalidInput as error:
        assert str(error).startswith(str(path))  # noqa: PT017 either outcome is right, a traceback is not
    else:
        assert all(np.isfinite(view.pixels).all() for view in found.views)


def test_a_row_takes_at_most_two_hundred_bytes_of_memory(tmp_path):
    views, points = 2500, 24
    rng = np.random.default_rng(1)
    path = tmp_path / "many.csv"
    with path.open("w") as stream:
        stream.write("image,width,height,id,u,v\n")
        for view in range(views):
            pixels = rng.uniform(0, 700, (points, 2)).tolist()
            stream.writelines(f"frames/{view}.png,1280,720,{i},{u!r},{v!r}\n" for i, (u, v) in enumerate(pixels))
    tracemalloc.start()
    read = detections.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(read.views) == views
    assert peak < 200 * views * points


@pytest.mark.parametrize("line", ["{},640,480,0,1,1", "# none {},640,480,nothing found", "# none a.png,640,480,{}"])
def test_a_text_that_a_camera_file_cannot_hold_is_refused_as_it_is_read(line):
    head = "image,width,height,id,u,v\n"
    detections.parse_csv(head + line.format("a" * 4000) + "\n", "long.csv")
    with pytest.raises(InvalidInput, match=r"long.csv:2: a{40}… has 4001 bytes; .* at most 4000"):
        detections.parse_csv(head + line.format("a" * 4001) + "\n", "long.csv")


def test_a_view_may_be_spread_over_a_long_file():
    rows = [f"{number % 1500}.png,640,480,{number // 1500},1,1" for number in range(4500)]
    text = "\n".join(["image,width,height,id,u,v", *rows])
    views = detections.parse_csv(text, "long.csv").views
    assert len(views) == 1500
    assert all(view.ids.tolist() == [0, 1, 2] for view in views)
    with pytest.raises(InvalidInput, match=r"long.csv:4502: image '0.png': id 1 occurs twice"):
        detections.parse_csv(f"{text}\n0.png,640,480,1,1,1", "long.csv")
    with pytest.raises(InvalidInput, match=r"long.csv:4502: image '0.png': size 641 x 480 here, 640 x 480 at line 2"):
        detections.parse_csv(f"{text}\n0.png,641,480,3,1,1", "long.csv")
