"""Target files of Kalibr, in the words of its documentation, and what is wrong with others."""

from dataclasses import replace

import pytest

from camcal.errors import InvalidInput
from camcal.formats import boards
from camcal.targets.board import parse_board

APRILGRID = """\
target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 4               #number of apriltags
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
"""
CHECKERBOARD = """\
target_type: 'checkerboard' #gridtype
targetCols: 6               #number of internal chessboard corners
targetRows: 7               #number of internal chessboard corners
rowSpacingMeters: 0.06      #size of one chessboard square [m]
colSpacingMeters: 0.06      #size of one chessboard square [m]
"""
CIRCLEGRID = """\
target_type: 'circlegrid'  #gridtype
targetCols: 6              #number of circles (cols)
targetRows: 7              #number of circles (rows)
spacingMeters: 0.02        #distance between circles [m]
asymmetricGrid: False      #use asymmetric grid (opencv) [bool]
"""


def board_in(tmp_path, content):
    path = tmp_path / "target.yaml"
    path.write_text(content)
    return boards.load_board(str(path))


@pytest.mark.parametrize(
    ("content", "form"),
    [
        (APRILGRID, "aprilgrid:6x4:88mm:0.3"),
        (CHECKERBOARD, "chessboard:6x7:60mm"),
        (CIRCLEGRID, "circles:6x7:20mm"),
        (CIRCLEGRID.replace("False", "True"), "asymmetric_circles:6x7:20mm"),
        (CIRCLEGRID.replace("asymmetricGrid: False", ""), "circles:6x7:20mm"),
    ],
)
def test_a_target_of_kalibr_is_the_board_it_describes(tmp_path, content, form):
    assert board_in(tmp_path, content) == parse_board(form)


def test_the_code_offset_is_the_first_tag(tmp_path):
    assert board_in(tmp_path, APRILGRID + "codeOffset: 36\n").first_marker == 36


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (APRILGRID.replace("aprilgrid", "apriltag"), ":1: target_type: unknown target type 'apriltag'. Did you mean"),
        (APRILGRID.replace("tagSize", "tagsize"), ":4: tagsize: unknown key. Did you mean 'tagSize'?"),
        (APRILGRID.replace("0.088", "88mm"), ":4: tagSize: '88mm' is not a number"),
        (APRILGRID.replace("0.3", "0.0"), ":5: tagSpacing: 0.0 must be > 0"),
        (APRILGRID.replace("tagRows: 4", "tagRows: 0"), ":3: tagRows: 0 must be at least 1"),
        (APRILGRID.replace("tagRows: 4", "tagRows: 4000"), "4000 tags is more than the limit of 1000 a side"),
        (CHECKERBOARD.replace("colSpacingMeters: 0.06", "colSpacingMeters: 0.05"), ":5: colSpacingMeters: differs"),
        (CIRCLEGRID.replace("False", "0"), ":5: asymmetricGrid: 0 is not true or false"),
        ("target_type: [aprilgrid]\n", "target_type: unknown target type a list"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, content, message):
    with pytest.raises(InvalidInput) as caught:
        board_in(tmp_path, content)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "form",
    ["aprilgrid:6x4:88mm:0.3", "aprilgrid:3x2:40mm:0.25", "chessboard:6x7:60mm", "circles:6x7:20mm",
     "asymmetric_circles:6x7:20mm"],
)  # fmt: skip
def test_a_target_file_that_is_written_describes_the_same_board(tmp_path, form):
    assert board_in(tmp_path, boards.kalibr_text(parse_board(form))) == parse_board(form)


def test_the_first_tag_is_written_as_the_code_offset(tmp_path):
    board = replace(parse_board("aprilgrid:6x4:88mm:0.3"), first_marker=36)
    assert board_in(tmp_path, boards.kalibr_text(board)) == board


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("charuco:9x7:30mm:22mm:DICT_5X5_100", "Kalibr does not support the ChArUco board of 9x7 squares"),
        ("aprilgrid:6x4:88mm:0.3:tag25h9", "Kalibr does not support the AprilGrid"),
        ("chessboard:9x6:25mm:dots", "Kalibr does not support the chessboard of 9x6 inner corners and three dots"),
        ("chessboard:9x6", "needs the size of the board"),
    ],
)
def test_a_board_that_kalibr_does_not_know_is_refused(form, message):
    with pytest.raises(InvalidInput, match=message):
        boards.kalibr_data(parse_board(form))


@pytest.mark.parametrize(
    "form", ["aprilgrid:6x4:35mm:0.2857", "chessboard:6x7:60mm", "circles:6x7:20mm", "asymmetric_circles:4x11:1in"]
)
def test_a_target_that_is_written_is_read_as_the_same_board(tmp_path, form):
    board = parse_board(form)
    assert board_in(tmp_path, boards.kalibr_text(board)) == board


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("charuco:9x7:30mm:22mm:DICT_5X5_100", "Kalibr does not support the ChArUco board of 9x7 squares"),
        ("chessboard:9x6:25mm:dots", "Kalibr does not support the chessboard of 9x6 inner corners and three dots"),
        ("aprilgrid:6x6:88mm:0.3:tag25h9", "only AprilGrids of tag36h11"),
        ("aprilgrid:6x6:0.3", "needs the size of the board"),
    ],
)
def test_a_board_that_kalibr_does_not_know_is_not_written(form, message):
    with pytest.raises(InvalidInput, match=message):
        boards.kalibr_text(parse_board(form))
