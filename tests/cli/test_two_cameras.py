"""`camcal calibrate` with images of two cameras in one input, as a table of their corners."""

import json
from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

BOARD = Board("chessboard", 9, 6, 0.040)


def shots(name, focal, centre, count, seed):
    parameters = [focal, 1.002 * focal, *centre, -0.12, 0.06, 5e-4, -3e-4, 0.01]
    camera = Camera(model_named("opencv5"), (1600, 1200), np.array(parameters))
    rng = np.random.default_rng(seed)
    seen, _ = observe(camera, BOARD, views(camera, BOARD, count, rng=rng), rng=rng, noise_px=0.1)
    return [replace(view, image=name.format(index)) for index, view in enumerate(seen.views)]


@pytest.fixture
def table(tmp_path):
    """A function that writes corners of left and right images, of a camera each."""

    def write(focal, centre, right="right{:02}.png"):
        path = tmp_path / "corners.csv"
        left = shots("left{:02}.png", 1200.0, (805.0, 590.0), 10, 1)
        detections.write(path, Detections(BOARD, (*left, *shots(right, focal, centre, 8, 2))))
        return path

    return write


@pytest.mark.slow
def test_left_and_right_images_together_are_not_to_be_trusted_and_both_are_named(run, table, tmp_path):
    corners = table(1206.0, (797.0, 603.0))
    output = tmp_path / "camera.yaml"
    code, out, _ = run("calibrate", corners, "-o", output, "--model", "opencv5", "--json", "--require", "trustworthy")
    document = json.loads(out)
    assert code == 7
    (failure,) = [found for found in document["failures"] if found["code"] == "several_cameras_by_name"]
    assert "10 views (left00.png" in failure["text"]
    assert failure["values"]["images"] == [f"right{index:02}.png" for index in range(8)]
    assert document["two_cameras"]["groups"][1] == failure["values"]["images"]
    assert document["two_cameras"]["by_name"]
    assert (
        "DO NOT TRUST: views of two cameras, or of one with changed zoom or focus"
        in run("calibrate", corners, "-o", output)[1]
    )


@pytest.mark.slow
def test_cameras_of_which_nothing_fits_together_end_with_exit_4_and_both_are_named(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    code, _, err = run("calibrate", table(2600.0, (797.0, 603.0), "b{:02}.png"), "-o", output, "--model", "opencv5")
    assert code == 4
    assert "two cameras" in err
    assert "b00.png, b01.png, b02.png and 5 more" in " ".join(err.split())
    assert not output.exists()


@pytest.mark.slow
def test_images_of_one_camera_by_two_names_are_one_camera(run, table, tmp_path):
    code, out, _ = run("calibrate", table(1200.0, (805.0, 590.0)), "-o", tmp_path / "camera.yaml", "--json")
    document = json.loads(out)
    assert (code, document["trustworthy"]) == (0, True)
    assert document["two_cameras"] is None
