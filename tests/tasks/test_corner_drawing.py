"""`camcal detect --draw`: which pictures are written, under which names, and that no input is overwritten."""

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.run.paths import find_media
from camcal.targets.board import Board
from camcal.tasks.calibration.detect import detect_images
from camcal.tasks.calibration.options import DetectOptions, FrameOptions

BOARD = Board("chessboard", 6, 5, 0.03)


def drawing(offset=0):
    row, column = np.mgrid[0 : BOARD.rows + 1, 0 : BOARD.columns + 1]
    squares = np.kron(np.where((row + column) % 2, 220, 30), np.ones((30, 30))).astype(np.uint8)
    framed = cv2.copyMakeBorder(squares, 30, 30, 55, 55, cv2.BORDER_CONSTANT, value=220)
    return np.roll(framed, offset, axis=1)


@pytest.fixture
def folder(tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    cv2.imwrite(str(images / "board.png"), drawing())
    cv2.imwrite(str(images / "wall.png"), np.full_like(drawing(), 120))
    return images


def drawn(tmp_path, *inputs, **options):
    options = {"jobs": 1, "draw": tmp_path / "drawn"} | options
    return detect_images(DetectOptions(inputs, BOARD, **options))


def test_every_image_has_its_picture_with_or_without_the_board(folder, tmp_path):
    report = drawn(tmp_path, folder)
    assert [path.name for path in report.pictures] == ["board_corners.png", "wall_corners.png"]
    pictures = [cv2.imread(str(path)) for path in report.pictures]
    assert all(picture.shape[1] == 3 * drawing().shape[1] for picture in pictures)
    assert np.abs(np.diff(pictures[1].astype(int), axis=2)).max() > 100  # the reason, in red


def test_pictures_are_left_out_when_the_folder_is_read_again(folder, tmp_path):
    drawn(tmp_path, folder, draw=folder)
    assert [path.name for path in find_media([folder]).images] == ["board.png", "wall.png"]


def test_images_of_one_name_in_two_folders_have_pictures_of_their_own(folder, tmp_path):
    other = tmp_path / "more"
    other.mkdir()
    cv2.imwrite(str(other / "board.png"), drawing())
    report = drawn(tmp_path, folder / "board.png", other / "board.png")
    assert [path.name for path in report.pictures] == ["images_board_corners.png", "more_board_corners.png"]


def test_frames_that_are_taken_have_pictures_under_their_names(folder, tmp_path):
    video = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 25, drawing().shape[::-1])
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for offset in (0, 20, -20):
        writer.write(cv2.merge([drawing(offset)] * 3))
    writer.release()
    report = drawn(tmp_path, folder / "wall.png", video, frames=FrameOptions(every=2))
    names = [path.name for path in report.pictures]
    assert names == ["wall_corners.png", "video_000000_corners.png", "video_000002_corners.png"]
    first, last = (cv2.imread(str(path)) for path in report.pictures[1:])
    assert (first != last).any()


def test_an_input_is_not_overwritten_and_nothing_is_written_then(folder, tmp_path):
    (folder / "board.png").rename(folder / "a_corners.png")
    (folder / "wall.png").rename(folder / "a.png")
    output = tmp_path / "corners.csv"
    with pytest.raises(InvalidInput, match=r"a_corners\.png: is an input and is not overwritten"):
        drawn(tmp_path, folder, draw=folder, output=output)
    assert not output.exists()


def test_the_picture_of_one_image_may_go_to_a_file(folder, tmp_path):
    report = drawn(tmp_path, folder / "board.png", draw=tmp_path / "one.jpg")
    assert report.pictures == (tmp_path / "one.jpg",)
    assert (tmp_path / "one.jpg").is_file()
    with pytest.raises(InvalidInput, match="2 inputs cannot be written to one file; give a folder"):
        drawn(tmp_path, folder, draw=tmp_path / "both.jpg")


def test_images_that_would_have_one_picture_are_refused(folder, tmp_path):
    cv2.imwrite(str(folder / "board.bmp"), drawing())
    with pytest.raises(InvalidInput, match="would both be written to it; rename one"):
        drawn(tmp_path, folder)
