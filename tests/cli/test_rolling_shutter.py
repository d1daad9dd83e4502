"""`camcal calibrate --rolling-shutter` on detections of a moving board: what is told, written and refused."""

import json

import numpy as np
import pytest
from timed_scenes import BOARD, Clocked, by_hand

from camcal.formats import detections, native
from camcal.report.calibration import time_lines
from camcal.targets.detection import Detections
from camcal.tasks.calibration.calibrate import calibrate, document
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.timing import Timing

READOUT_S = 0.02


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Write the detections and times of a hand-held board before a rolling shutter."""
    folder = tmp_path_factory.mktemp("moving")
    rng = np.random.default_rng(3)
    views = Clocked(readout=READOUT_S).views(by_hand(rng), 60, rng)
    detections.write(folder / "seen.csv", Detections(BOARD, tuple(views)))
    (folder / "times.txt").write_text("".join(f"{view.time!r} {view.image}\n" for view in views))
    return folder


@pytest.fixture(scope="module")
def calibrated(seen):
    """Return the camera file, with the JSON document."""
    options = CalibrateOptions(
        inputs=[seen / "seen.csv"],
        output=seen / "camera.yaml",
        timing=Timing(source=str(seen / "times.txt")),
        rolling_shutter=True,
        model="opencv5",
    )
    report = calibrate(options)
    [line] = time_lines(report.times)
    assert line.startswith("Readout time: ")
    return options.output, document(report, options)


def test_the_readout_time_is_told_and_written_with_its_deviation(calibrated):
    output, told = calibrated
    timing = native.read(output).cameras["camera"].timing
    assert timing == pytest.approx(told["times"])
    assert set(timing) == {"readout_s", "readout_std_s"}
    assert timing["readout_std_s"] < 6e-4  # of two seconds of video
    assert abs(timing["readout_s"] - READOUT_S) < 3 * timing["readout_std_s"]


def test_the_lens_is_that_of_rows_taken_at_once(calibrated):
    _, told = calibrated
    assert told["sigma_px"] < 0.11  # the noise is 0.1 px; rows of one moment would leave 0.2
    assert told["within_views"]["rolling_px"] is None
    assert told["trustworthy"]


def test_gyroflow_profiles_have_the_readout_time_in_milliseconds(run, calibrated, tmp_path):
    output, told = calibrated
    profile = tmp_path / "lens.json"
    code, _, err = run("convert", output, profile, "--to", "gyroflow")
    assert code == 0, err
    written = json.loads(profile.read_text())["frame_readout_time"]
    assert written == pytest.approx(1e3 * told["times"]["readout_s"])
    back = tmp_path / "back.yaml"
    assert run("convert", profile, back)[0] == 0
    assert native.read(back).cameras["camera"].timing["readout_s"] == pytest.approx(told["times"]["readout_s"])


def test_images_need_times(run, seen, tmp_path):
    code, _, err = run("calibrate", seen / "seen.csv", "--rolling-shutter", "-o", tmp_path / "camera.yaml")
    assert code == 2
    assert "set --fps, or --timestamps" in err


def test_times_go_with_the_rolling_shutter(run, seen, tmp_path):
    code, _, err = run("calibrate", seen / "seen.csv", "--fps", 30, "-o", tmp_path / "camera.yaml")
    assert code == 2
    assert "--fps goes with --rolling-shutter" in err


def test_a_readout_time_must_be_a_number(run, calibrated, tmp_path):
    output, _ = calibrated
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(output.read_text().replace("readout_s:", "readout_ms:"))
    code, _, err = run("inspect", wrong)
    assert code == 2
    assert "readout_ms" in err
