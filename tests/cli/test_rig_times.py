"""`camcal rig --time-offset`: two cameras with clocks of their own before one moving board, from detections."""

import json
from dataclasses import replace

import numpy as np
import pytest
from timed_scenes import BOARD, Clocked, by_hand, rotations

from camcal.calibrate.timing.record import CameraTime, CameraTimes
from camcal.formats import detections, native
from camcal.report.calibration import time_lines
from camcal.targets.detection import Detections
from camcal.tasks.rigs.calibrate_rig import document, rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions
from camcal.tasks.timing import Timing

FRAME = 1 / 30
OFFSET, RATE = 11.37 * FRAME, 3e-5  # s of the right one's stamps, and its clock's rate
READOUTS = 0.018, 0.012
TURN, PLACE = (0.02, -0.2, 0.01), (0.02, 0.01, 0.05)  # right_T_left


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Write the detections of both cameras, whose names of images are their times in nanoseconds."""
    folder = tmp_path_factory.mktemp("clocks")
    rng = np.random.default_rng(11)
    motion = by_hand(rng)
    cameras = {
        "left": Clocked(readout=READOUTS[0]),
        "right": Clocked(turn=TURN, place=PLACE, offset=OFFSET, rate=RATE, readout=READOUTS[1]),
    }
    for name, camera in cameras.items():
        views = camera.views(motion, 120, rng, dropped=0.05)
        named = [replace(view, image=f"{name}/{round(1e9 * view.time)}.png", time=None) for view in views]
        detections.write(folder / f"{name}.csv", Detections(BOARD, tuple(named)))
    return folder


@pytest.fixture(scope="module")
def calibrated(seen):
    settings = RigSettings(
        output=seen / "rig.yaml",
        models=("opencv5",),
        timing=Timing(source="name", unit="ns"),
        time_offset=True,
        rolling_shutter=True,
    )
    options = RigTaskOptions(inputs=[f"left={seen / 'left.csv'}", f"right={seen / 'right.csv'}"], settings=settings)
    return options.settings.output, document(rig(options), settings)


def test_the_offset_of_a_clock_is_known_to_a_thousandth_of_a_frame(calibrated):
    output, told = calibrated
    own = told["times"]["right"]
    assert own["offset_std_s"] < 2e-3 * FRAME
    assert abs(own["offset_s"] - (OFFSET + RATE * own["reference_s"])) < 3 * own["offset_std_s"]
    assert abs(own["rate"] - RATE) < 3 * own["rate_std"]
    cameras = native.read(output).cameras
    assert cameras["right"].timing == pytest.approx(own)
    assert set(cameras["left"].timing) == {"readout_s", "readout_std_s"}


def test_the_readout_time_of_each_camera_is_told(calibrated):
    _, told = calibrated
    for name, readout in zip(("left", "right"), READOUTS, strict=True):
        own = told["times"][name]
        assert abs(own["readout_s"] - readout) < 3 * own["readout_std_s"] < 1e-3


def test_the_offset_between_middle_rows_is_told_beside_that_of_first_rows(calibrated):
    _, told = calibrated
    own = told["times"]["right"]
    readouts = [told["times"][name]["readout_s"] for name in ("left", "right")]
    assert own["middle_offset_s"] == pytest.approx(own["offset_s"] + (readouts[1] - readouts[0]) / 2)
    known = CameraTime(0.3, 1e-5, 0, 1e-6, 2.0, 0.02, 1e-4, middle_offset=0.298, middle_offset_std=4e-6)
    assert "Time offset of right between the middle rows: 298.0000 ± 0.0040 ms" in time_lines(
        CameraTimes({"right": known}, FRAME)
    )


def test_where_the_cameras_stand_is_that_of_one_moment(calibrated):
    output, _ = calibrated
    [transform] = native.read(output).transforms.values()
    std = np.sqrt(np.diag(transform.covariance))
    [turn] = rotations(np.array([TURN]))
    # of the board's centre, about which timed_scenes moves it, nothing is known here: both cameras have the same
    error = np.abs(transform.pose.translation - np.array(PLACE))
    assert (error < 4 * std[:3]).all()
    assert np.abs(transform.pose.rotation - turn).max() < 4 * std[3:].max()
    assert std[:3].max() < 1e-3


def test_times_are_not_matched_by_names(run, seen, tmp_path):
    inputs = f"left={seen / 'left.csv'}", f"right={seen / 'right.csv'}"
    code, _, err = run("rig", *inputs, "--time-offset", "--match", "name", "-o", tmp_path / "rig.yaml")
    assert code == 2
    assert "match by time" in err


def test_images_of_a_rig_need_times(run, seen, tmp_path):
    inputs = f"left={seen / 'left.csv'}", f"right={seen / 'right.csv'}"
    code, out, _ = run("rig", *inputs, "--time-offset", "-o", tmp_path / "rig.yaml", "--json")
    assert code == 2
    assert "set --fps" in json.loads(out)["error"]["message"]
