"""Every command that works from a camera file says so where that file's own verdict is not to trust it."""

from dataclasses import replace

import numpy as np
import pytest
from tagged import facing, photograph

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import disparity, native
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.quality.projection_uncertainty import KnownRegion
from camcal.report.table import region_words

SIZE = (160, 120)
LENS = Camera(model_named("pinhole"), SIZE, np.array([150.0, 150.0, 79.5, 59.5]))
REASONS = ("the focal length is known to 3.1 % only", "2 views are few")
SAID = f"untrustworthy calibration: {'; '.join(REASONS)}"
RIGHT_T_LEFT = Transform(Pose(np.eye(3), np.array([-0.1, 0.0, 0.0])))
COMMANDS = {
    "undistort": "undistort rig.yaml#left tags -o out",
    "undistort --points": "undistort rig.yaml#left --points points.csv -o out",
    "pnp": "pnp rig.yaml#left tags --tags tag36h11:50mm -j 1",
    "pnp --rig": "pnp --rig rig.yaml left=tags --tags tag36h11:50mm -j 1",
    "track": "track rig.yaml#left tags --tags tag36h11:50mm --fps 10 -j 1",
    "stereo rectify": "stereo rectify rig.yaml left right -o out -j 1",
    "stereo disparity": "stereo disparity left.png right.png rig.yaml -o map.tiff --range 0:16 --align-rows off",
    "stereo disparity of two pairs": (
        "stereo disparity left right rig.yaml -o maps --range 0:16 --quality fast --align-rows off -j 1"
    ),
    "stereo cloud": "stereo cloud flat.pfm rig.yaml -o cloud.ply",
    "stereo eval": "stereo eval flat.pfm flat.pfm rig.yaml",
    "stereo eval of two maps": "stereo eval flat flat rig.yaml",
    "optics": "optics rig.yaml#left",
    "simulate": "simulate chessboard:5x4:20mm rig.yaml#left -o made --views 1",
    "transform convert": "transform convert rig.yaml --axes left=opencv:opengl",
    "inspect": "inspect rig.yaml",
}


def write_rig(path, verdict):
    entry = CameraEntry(LENS)
    cameras = {"left": replace(entry, verdict=verdict), "right": entry}
    native.write(path, CameraFile(cameras, {"right_T_left": RIGHT_T_LEFT}))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """What the commands need: photographs of a tag, pairs of images, flat maps, and a table of pixels."""
    monkeypatch.chdir(tmp_path)
    tag = photograph(LENS, [(0, facing(0.0, 0.0, 0.25))])
    flat = np.full(SIZE[::-1], 8.0, np.float32)
    for number in range(3):
        save(tmp_path / "tags" / f"{number}.png", tag)
    for name in ("left", "right", "left/0", "left/1", "right/0", "right/1"):
        save(tmp_path / f"{name}.png", tag)
    for name in ("flat", "flat/0", "flat/1"):
        disparity.write(tmp_path / f"{name}.pfm", flat)
    (tmp_path / "points.csv").write_text("u,v\n10,20\n150,100\n")
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_a_distrusted_calibration_is_one_line_more_on_stderr_and_the_same_exit(run, folder, command):
    arguments = COMMANDS[command].split()
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=True))
    trusted = run(*arguments)
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=False, reasons=REASONS))
    code, _, err = run(*arguments)
    before = trusted[2].splitlines()
    more = [line for line in err.splitlines() if line not in before]
    assert (code, trusted[0]) == (0, 0), err
    assert len(more) == 1
    assert len(err.splitlines()) == len(before) + 1
    assert more[0].startswith("camcal: warning: rig.yaml:")
    assert more[0].endswith(f"cameras.left.verdict: {SAID}")


@pytest.mark.parametrize(("left_out", "said"), [(0.0, ""), (0.015, ""), (0.03, "3 %"), (0.5, "48 %")])
def test_a_view_that_shows_more_than_the_verdict_holds_for_is_said(run, folder, left_out, said):
    right = 159 * (1 - left_out)
    corners = np.array([[0.0, 0.0], [right, 0.0], [right, 119.0], [0.0, 119.0]])
    region = KnownRegion(1.0, 1 - left_out, 1.0, corners)
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=True, region=region))
    code, _, err = run("undistort", "rig.yaml#left", "tags", "-o", "out")
    assert code == 0
    words = f"projection uncertainty above 1 px in {said} of the view, where the verdict on the camera does not hold"
    assert (words in err) == bool(said), err
    assert native.read(folder / "out" / "camera.yaml").cameras["left"].verdict == CalibrationVerdict(trustworthy=True)


@pytest.mark.parametrize("command", ["pnp", "pnp --rig", "track", "stereo rectify", "undistort --points"])
def test_poses_and_pairs_from_where_the_verdict_does_not_hold_are_said(run, folder, command):
    for right, said in ((159.0, False), (60.0, True)):
        corners = np.array([[0.0, 0.0], [right, 0.0], [right, 119.0], [0.0, 119.0]])
        region = KnownRegion(1.0, right / 159, 1.0, corners)
        write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=True, region=region))
        code, _, err = run(*COMMANDS[command].split())
        assert code == 0, err
        shown = "the view" if command == "stereo rectify" else "the points"
        found = [line for line in err.splitlines() if "verdict on the camera does not hold" in line]
        assert len(found) == said, err
        assert all("left" in line or command in ("pnp", "track", "undistort --points") for line in found)
        assert all(f"% of {shown}, where" in line for line in found)


@pytest.mark.parametrize(("share", "said"), [(1.0, ""), (0.996, ""), (0.42, " in 42 % of the image")])
def test_where_a_verdict_holds_is_part_of_it(run, folder, share, said):
    region = KnownRegion(1.0, share, 1.0, np.array([[0.0, 0.0], [90.0, 0.0], [0.0, 90.0]]))
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=True, region=region))
    out = run("inspect", "rig.yaml")[1]
    assert f"Calibration is trustworthy{said}" in out
    assert ("of the image (projection uncertainty up to 1 px)" in out) == bool(said)
    assert region_words(region, "left") == (
        " in 42 % of the image of left (projection uncertainty up to 1 px)" * bool(said)
    )


def test_the_view_of_a_distrusted_camera_is_distrusted_too(run, folder):
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=False, reasons=REASONS))
    run("undistort", "rig.yaml#left", "tags", "-o", "out")
    assert native.read(folder / "out" / "camera.yaml").cameras["left"].verdict == CalibrationVerdict(False, REASONS)
    assert SAID in run("optics", "out/camera.yaml")[2]


def test_a_guess_whose_values_are_held_is_warned_of_and_one_that_is_a_start_is_not(run, folder):
    write_rig(folder / "rig.yaml", CalibrationVerdict(trustworthy=False, reasons=REASONS))
    given = "calibrate", "tags", "--board", "chessboard:5x4:20mm", "-o", "new.yaml", "--guess", "rig.yaml#left", "-j", 1
    assert SAID not in run(*given)[2]
    assert SAID in run(*given, "--fix", "fx,fy")[2]
