"""Corner lists as MATLAB, Bouguet's toolbox, PhotonVision and Deltille write them: the same corners, numbered alike."""

from dataclasses import replace

import mat73
import numpy as np
import pytest
from corner_files import BOARD, SIZE, bouguet, deltille, grids, matlab, photonvision, seen_views
from scipy.io import savemat

from camcal.errors import FileError, InvalidInput
from camcal.formats import corner_lists, detections
from camcal.targets.board import parse_board


@pytest.fixture(scope="module")
def seen():
    return seen_views()


def require_same(found, seen):
    assert len(found.views) == len(seen)
    for view, told in zip(found.views, seen, strict=True):
        kept = np.isin(told.ids, view.ids)
        assert view.ids.tolist() == told.ids[kept].tolist()
        assert np.abs(view.pixels - told.pixels[kept]).max() < 1e-9
        assert view.size == SIZE


SAVES = pytest.mark.parametrize("save", [savemat, mat73.write])


@SAVES
@pytest.mark.parametrize("board", [None, BOARD])
def test_corners_of_matlab_count_from_one_and_down_the_columns(tmp_path, seen, board, save):
    path = matlab(tmp_path / "points.mat", seen, save, imageSize=np.array([960.0, 1280]))
    found = detections.read(path, board)
    assert found.board == BOARD
    require_same(found, seen)


@SAVES
def test_without_points_of_the_board_its_size_in_squares_numbers_the_corners(tmp_path, seen, save):
    told = {"boardSize": np.array([7.0, 10]), "worldPoints": np.zeros((0, 0))}
    path = matlab(tmp_path / "points.mat", seen, save, **told)
    with pytest.raises(InvalidInput, match=r"tells no size of its images: set --image-size WxH"):
        detections.read(path)
    found = detections.read(path, None, SIZE)
    assert found.board == replace(BOARD, square=None)
    require_same(found, seen)


@SAVES
@pytest.mark.parametrize("board", [None, BOARD])
def test_corners_of_bouguet_count_from_zero_with_y_upwards(tmp_path, seen, board, save):
    found = detections.read(bouguet(tmp_path / "calib_data.mat", seen, save), board)
    assert found.board == BOARD
    assert found.views[0].image == "left1"
    require_same(found, seen)


def test_observations_of_photonvision_leave_out_what_was_not_found(tmp_path, seen):
    found = detections.read(photonvision(tmp_path / "photon.json", seen))
    assert found.board == BOARD
    assert (len(found.views[1].ids), found.views[2].image) == (53, "img2.png")
    require_same(found, seen)


def test_a_board_that_lies_across_is_turned(tmp_path, seen):
    """A quarter turn, so that the board is still seen from its printed side."""
    across = parse_board("chessboard:6x9:25mm")
    view = detections.read(bouguet(tmp_path / "calib_data.mat", seen), across).views[0]
    pixels = view.pixels[np.argsort(view.ids)].reshape(9, 6, 2)
    assert np.abs(np.rot90(grids(seen)[0]) - pixels).max() < 1e-9


def test_deltilles_files_are_one_for_each_image(tmp_path, seen):
    path = deltille(tmp_path / "a.orpc", seen[0])
    found = detections.read(path, BOARD)
    assert found.views[0].image == seen[0].image
    require_same(found, seen[:1])
    with pytest.raises(InvalidInput, match=r"names no board: give --board"):
        detections.read(path)


@pytest.mark.parametrize(
    ("name", "content", "error", "words"),
    [
        ("a.json", b'{"a": 1}', InvalidInput, "holds no corners that camcal knows: imagePoints of MATLAB"),
        ("a.json", b'{"observations": [], "resolution": {"width": 4, "height": 4}}', InvalidInput, "holds no corners"),
        ("a.json", b'{"observations": [{}]}', FileError, "damaged or truncated"),
        ("a.m", b"fc = [1 ; 2];", InvalidInput, "holds no corners"),
        ("a.mat", b"MATLAB 7.3 MAT-file", FileError, "not a MAT-file of version 7.3"),
        ("a.mat", b"MATLAB 5.0 MAT-file", FileError, "damaged or truncated"),
        ("a.orpc", b"filename: a\nwidth: 4\nheight: 4\nnum_corners: 2\nencoding: ascii\n", FileError, "damaged"),
    ],
)
def test_what_is_no_corner_list_is_refused_in_words(tmp_path, name, content, error, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(error, match=words):
        detections.read(tmp_path / name, BOARD)


def test_corners_of_another_board_are_refused(tmp_path, seen):
    path = photonvision(tmp_path / "photon.json", seen)
    with pytest.raises(InvalidInput, match=r"those of 9x6 corners, not of a chessboard of 8x5"):
        detections.read(path, parse_board("chessboard:8x5:30mm"))
    (tmp_path / "b.orpc").write_text(deltille(tmp_path / "a.orpc", seen[0]).read_text())
    with pytest.raises(InvalidInput, match="corners beyond the board or the image"):
        detections.read(tmp_path / "b.orpc", parse_board("chessboard:8x5:30mm"))


def test_truncated_lists_are_errors_of_the_file(tmp_path, seen):
    for path in (bouguet(tmp_path / "a.mat", seen), photonvision(tmp_path / "b.json", seen)):
        content = path.read_bytes()
        for end in np.linspace(200, len(content) - 2, 25).astype(int):
            path.write_bytes(content[:end])
            with pytest.raises((FileError, InvalidInput)):
                corner_lists.read(path, BOARD, SIZE)


@pytest.mark.parametrize(
    "points", [np.zeros((54, 2)), np.full((54, 2), np.nan), np.random.default_rng(1).random((54, 2))]
)
def test_points_that_are_no_grid_are_refused(tmp_path, seen, points):
    path = matlab(tmp_path / "points.mat", seen, worldPoints=points)
    with pytest.raises(InvalidInput, match="no grid of squares"):
        detections.read(path, None, SIZE)
