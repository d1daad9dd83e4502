"""`camcal detect` on rendered boards: every corner near its truth, every image accounted for, every exit code."""

import json
import shutil

import cv2
import numpy as np
import pytest

from camcal.formats import detections
from camcal.tasks.simulate import SimulateOptions, simulate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Six rendered views of a chessboard, and their true corners."""
    folder = tmp_path_factory.mktemp("rendered") / "set"
    simulate(SimulateOptions("chessboard:9x6:25mm", folder, views=6, size=(640, 480), jobs=2))
    return folder


@pytest.fixture
def images(folder, tmp_path):
    return shutil.copytree(folder / "images", tmp_path / "images")


def test_corners_are_where_they_were_rendered(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, out, err = run("detect", folder / "images", "--board", "chessboard:9x6:25mm", "-o", output)
    assert (code, err) == (0, "")
    assert "6 of 6 images show the board" in out
    truth = detections.read(folder / "corners.csv")
    for found, true in zip(detections.read(output).views, truth.views, strict=True):
        assert len(found.ids) == 54
        # a board of odd columns + rows has one numbering only
        error = found.pixels[np.argsort(found.ids)] - true.pixels[np.argsort(true.ids)]
        assert np.abs(error).max() < 0.1  # rendered with a noise of a few gray levels


def test_the_table_is_the_same_whatever_the_jobs(run, images, tmp_path):
    tables = [tmp_path / f"{jobs}.csv" for jobs in (1, 2)]
    for jobs, table in zip((1, 2), tables, strict=True):
        assert run("detect", images, "-b", "chessboard:9x6:25mm", "-o", table, "--jobs", jobs)[0] == 0
    assert tables[0].read_bytes() == tables[1].read_bytes()


def test_every_image_that_yields_nothing_has_its_reason(run, images, tmp_path):
    cv2.imwrite(str(images / "wall.png"), np.full((480, 640), 128, np.uint8))
    cv2.imwrite(str(images / "small.png"), cv2.resize(cv2.imread(str(images / "view0000.png"), 0), (480, 360)))
    code, out, _ = run("detect", images, "-b", "chessboard:9x6:25mm", "-o", tmp_path / "c.csv", "--json")
    views = {view["image"].rsplit("/", 1)[-1]: view for view in json.loads(out)["images"]}
    assert code == 0  # an image without a board is a result
    assert views["wall.png"]["reason"]
    assert "480x360" in views["small.png"]["reason"]


def test_an_unreadable_image_costs_itself_only(run, images, tmp_path):
    (images / "broken.png").write_bytes(b"not an image")
    output = tmp_path / "corners.csv"
    code, out, err = run("detect", images, "-b", "chessboard:9x6:25mm", "-o", output)
    assert code == 6
    assert "broken.png" in out + err
    assert sum(view.found for view in detections.read(output).views) == 6


def test_a_transposed_board_is_recognised(run, images, tmp_path):
    output = tmp_path / "corners.csv"
    code, _, _ = run("detect", images, "-b", "chessboard:6x9:25mm", "-o", output)
    assert code == 0
    assert all(len(view.ids) == 54 for view in detections.read(output).views)


def test_squares_given_for_corners_are_named_and_nothing_is_written(run, images, tmp_path):
    output = tmp_path / "corners.csv"
    code, _, err = run("detect", images, "-b", "chessboard:10x7:25mm", "-o", output)
    assert code == 4
    assert "9x6" in err
    assert not output.exists()


def test_a_folder_without_boards_ends_with_exit_4(run, tmp_path):
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((480, 640), 128, np.uint8))
    code, _, err = run("detect", tmp_path / "wall.png", "-b", "chessboard:9x6", "-o", tmp_path / "c.csv")
    assert code == 4
    assert len(err.splitlines()) == 1


def test_missing_images_end_with_exit_3(run, tmp_path):
    code, _, err = run("detect", tmp_path / "nowhere.png", "-b", "chessboard:9x6", "-o", tmp_path / "c.csv")
    assert code == 3
    assert "no such file" in err
