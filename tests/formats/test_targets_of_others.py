"""Board files as Basalt and OpenCV's calibration program write them."""

import cv2
import pytest

from camcal.errors import InvalidInput
from camcal.formats import boards
from camcal.targets.board import parse_board

BASALT = '{\n    "tagCols": 6,\n    "tagRows": 4,\n    "tagSize": 0.088,\n    "tagSpacing": 0.3\n}\n'
SETTINGS = """<?xml version="1.0"?>
<opencv_storage>
<Settings>
  <!-- Number of inner corners per a item row and column. (square, circle) -->
  <BoardSize_Width>{width}</BoardSize_Width>
  <BoardSize_Height>{height}</BoardSize_Height>
  <Square_Size>30</Square_Size>
  <Marker_Size>22</Marker_Size>
  <Calibrate_Pattern>"{pattern}"</Calibrate_Pattern>
  <ArUco_Dict_Name>"DICT_5X5_100"</ArUco_Dict_Name>
  <Input>"images/list.xml"</Input>
</Settings>
</opencv_storage>
"""


def test_an_aprilgrid_of_basalt_is_one_of_kalibr(tmp_path):
    path = tmp_path / "aprilgrid_6x6.json"
    path.write_text(BASALT)
    assert boards.load_board(path) == parse_board("aprilgrid:6x4:88mm:0.3")
    path.write_text(BASALT.replace('"tagSize": 0.088,', ""))
    with pytest.raises(InvalidInput, match="tagSize"):
        boards.load_board(path)


@pytest.mark.parametrize(
    ("pattern", "size", "form"),
    [
        ("CHESSBOARD", (9, 6), "chessboard:9x6:30mm"),
        ("CHARUCOBOARD", (9, 7), "charuco:9x7:30mm:22mm:DICT_5X5_100"),
        ("CIRCLES_GRID", (9, 6), "circles:9x6:30mm"),
        ("ASYMMETRIC_CIRCLES_GRID", (4, 11), "asymmetric_circles:4x11:30mm"),
    ],
)
def test_settings_of_opencv_are_the_board_they_describe(tmp_path, pattern, size, form):
    path = tmp_path / "settings.xml"
    path.write_text(SETTINGS.format(width=size[0], height=size[1], pattern=pattern))
    assert boards.load_board(path) == parse_board(form)
    storage = cv2.FileStorage(str(tmp_path / "settings.yml"), cv2.FileStorage_WRITE)
    storage.startWriteStruct("Settings", cv2.FileNode_MAP)
    words = {"Calibrate_Pattern": pattern, "ArUco_Dict_Name": "DICT_5X5_100"}
    numbers = {"BoardSize_Width": size[0], "BoardSize_Height": size[1], "Square_Size": 30.0, "Marker_Size": 22.0}
    for key, value in {**words, **numbers}.items():
        storage.write(key, value)
    storage.endWriteStruct()
    storage.release()
    assert boards.load_board(tmp_path / "settings.yml") == parse_board(form)


def test_settings_of_an_unknown_pattern_are_refused(tmp_path):
    path = tmp_path / "settings.xml"
    path.write_text(SETTINGS.format(width=9, height=6, pattern="NOT_EXISTING"))
    with pytest.raises(InvalidInput, match=r"Settings.Calibrate_Pattern: 'NOT_EXISTING' is not one of CHESSBOARD"):
        boards.load_board(path)


def test_a_dictionary_of_markers_is_no_board(tmp_path):
    path = tmp_path / "dictionary.json"
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50).writeDictionary(storage)
    storage.release()
    with pytest.raises(InvalidInput, match="is a dictionary of markers of OpenCV's, not a board"):
        boards.load_board(path)
