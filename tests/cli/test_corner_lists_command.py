"""Commands that take a detections file take corner lists of other programs."""

import numpy as np
from corner_files import CAMERA, bouguet, deltille, photonvision, seen_views

from camcal.formats import native

MODEL = ("--model", "pinhole", "--flat-board")


def test_corner_lists_are_calibrated_as_detections_are(run, tmp_path):
    seen = seen_views()
    given = [bouguet(tmp_path / "calib_data.mat", seen)], [photonvision(tmp_path / "photon.json", seen)]
    single = [deltille(tmp_path / f"{number}.orpc", view) for number, view in enumerate(seen)]
    board = ("--board", "chessboard:9x6:25mm")
    for number, arguments in enumerate((*given, [*single, *board])):
        output = tmp_path / f"{number}.yaml"
        assert run("calibrate", *arguments, *MODEL, "-o", output)[0] == 0
        found = native.read(output).cameras["camera"].camera
        assert np.abs(found.parameters - CAMERA.parameters).max() < 1e-3
    code, _, err = run("calibrate", single[0], given[0][0], *MODEL, "-o", tmp_path / "c.yaml")
    assert (code, "cannot be combined" in err) == (2, True)
