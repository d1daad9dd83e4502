"""`camcal check` as it is called from a shell."""

import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import camcal
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, detections, native
from camcal.formats.camera_file import CameraFile
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.rigs.calibrate_rig import rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions

LENS = Camera(model_named("opencv4"), (800, 600), np.array([620.0, 620.0, 402.0, 297.0, -0.1, 0.03, 0.0, 0.0]))
BOARD = Board("charuco", 8, 6, 0.030, 0.022, "DICT_5X5_100")
APART = Pose(so3.exp(np.array([0.0, -0.02, 0.0])), np.array([-0.1, 0.0, 0.0]))
KEYS = ["cause", "reason", "views", "notes", "limit_px", "drift_px", "worst_px", "chance", "smallest_px"]


def seen(camera, seed, count, away=None, name=""):
    rng = np.random.default_rng(seed)
    poses = views(LENS, BOARD, count, rng=rng)
    found = observe(camera, BOARD, [away @ pose for pose in poses] if away else poses, noise_px=0.03, rng=rng)[0]
    named = [replace(view, camera=name, image=f"{name}{place:03d}.png") for place, view in enumerate(found.views)]
    return tuple(view for view in named if len(view.ids) >= 6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a camera and a rig, and with new detections of what they are and of what they are not."""
    folder = tmp_path_factory.mktemp("check")
    moved = replace(LENS, parameters=LENS.parameters * [1.01, 1.01, 1, 1, 1, 1, 1, 1])
    tables = {
        "first": seen(LENS, 1, 25),
        "again": seen(LENS, 2, 12),
        "one": seen(LENS, 3, 1),
        "moved": seen(moved, 4, 12),
        "pair": (*seen(LENS, 5, 25, name="left"), *seen(LENS, 5, 25, APART, "right")),
        "later": (*seen(LENS, 6, 14, name="left"), *seen(LENS, 6, 14, APART, "right")),
        "bent": (
            *seen(LENS, 7, 14, name="left"),
            *seen(LENS, 7, 14, APART.retract(np.array([0, 0, 0, 0, np.radians(0.5), 0])), "right"),
        ),
        "still": seen(LENS, 8, 1),
        "nothing": (replace(seen(LENS, 9, 1)[0], ids=[], pixels=np.zeros((0, 2)), reason="no board"),),
    }
    for name, own in tables.items():
        detections.write(folder / f"{name}.csv", Detections(BOARD, own))
    calibrate(CalibrateOptions((str(folder / "first.csv"),), folder / "camera.yaml", model="opencv4"))
    settings = RigSettings(folder / "rig.yaml", models=("opencv4",))
    rig(RigTaskOptions((str(folder / "pair.csv"),), settings))
    return folder


@pytest.fixture(autouse=True)
def in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


def test_a_calibration_that_still_holds_is_said_in_a_line(run):
    code, out, err = run("check", "camera.yaml", "again.csv")
    assert (code, err) == (0, "")
    assert out.startswith("still valid: moved by 0.")
    assert len(out.splitlines()) == 1


def test_a_drift_ends_with_seven_and_hidden_ones_with_four(run):
    code, out, err = run("check", "camera.yaml", "moved.csv")
    assert (code, err) == (7, "camcal: error: drifted: camera\n")
    assert "drifted: the lens moved: projections by" in out
    assert "focal length +1.0" in out
    code, out, err = run("check", "camera.yaml", "one.csv", "--max-drift", "0.1")
    assert (code, err) == (4, "camcal: error: not shown: camera\n")
    assert "px or more (limit 0.1 px)" in out
    code, out, _ = run("check", "camera.yaml", "nothing.csv")
    assert code == 4
    assert "none of 1 image shows 4 corners of the board" in out


def test_a_limit_that_is_given_counts_in_place_of_the_usual_one(run):
    assert run("check", "camera.yaml", "moved.csv", "--max-drift", "2")[0] == 7
    assert run("check", "camera.yaml", "moved.csv", "--max-drift", "8")[0] == 0


def test_the_document_has_its_keys(run):
    code, out, _ = run("check", "camera.yaml", "moved.csv", "--json")
    document = json.loads(out)
    assert code == 7
    assert list(document)[:4] == ["schema", "verdict", "checks", "outputs"]
    own = document["checks"]["camera"]
    assert list(own) == [
        "verdict",
        *KEYS,
        "calibration_px",
        "focal_change",
        "principal_point_shift_px",
        "distortion_px",
    ]
    assert own["focal_change"]["value"] == pytest.approx(0.01, abs=4 * own["focal_change"]["std"])
    assert [each["code"] for each in document["failures"]] == ["drifted"]
    code, out, _ = run("check", "camera.yaml", "one.csv", "--max-drift", "0.1", "--json")
    assert [each["code"] for each in json.loads(out)["failures"]] == ["not_shown"]


def test_the_cameras_of_a_rig_and_where_they_stand_are_checked(run):
    code, out, err = run("check", "rig.yaml", "later.csv", "--json")
    checks = json.loads(out)["checks"]
    assert (code, err) == (0, "")
    assert list(checks) == ["left", "right", "right_T_left"]
    code, out, _ = run("check", "rig.yaml", "bent.csv", "--json")
    place = json.loads(out)["checks"]["right_T_left"]
    assert code == 7
    assert (place["verdict"], place["cause"]) == ("drifted", "mount")
    assert np.degrees(place["turn_rad"][1]) == pytest.approx(0.5, abs=0.05)
    shown = run("check", "rig.yaml", "bent.csv")[1]
    assert "the cameras moved against each other" in " ".join(shown.split())


def test_the_covariance_may_be_that_of_the_whole_rig_alone(run, tmp_path):
    file = cameras.read("rig.yaml")
    bare = {name: replace(entry, camera=replace(entry.camera, covariance=None)) for name, entry in file.cameras.items()}
    native.write(tmp_path / "joint.yaml", replace(file, cameras=bare))
    assert run("check", tmp_path / "joint.yaml", "later.csv")[0] == 0


def test_results_for_build_servers_and_people(run, tmp_path):
    junit, page, drawn = tmp_path / "check.xml", tmp_path / "check.html", tmp_path / "drift.png"
    code, out, _ = run("check", "rig.yaml", "bent.csv", "--junit", junit, "--report", page)
    assert code == 7
    suite = ET.parse(junit).getroot()
    assert dict(suite.attrib) == {"name": "camcal check", "tests": "3", "failures": "1", "skipped": "0", "errors": "0"}
    cases = {case.get("name"): [child.tag for child in case] for case in suite}
    assert cases == {"left": ["system-out"], "right": ["system-out"], "right_T_left": ["failure"]}
    assert "Drift since the calibration" in page.read_text(encoding="utf-8")
    assert f"wrote {junit}" in out or "check.xml" in out
    assert run("check", "camera.yaml", "moved.csv", "--plot", drawn)[0] == 7
    assert drawn.stat().st_size > 10_000
    code, _, err = run("check", "rig.yaml", "later.csv", "--plot", tmp_path / "no.png")
    assert code == 2
    assert "draws the drift of one lens" in err
    assert run("check", "rig.yaml#left", "again.csv", "--junit", tmp_path / "left.xml")[0] == 0


def test_errors_are_annotations_in_a_runner_of_github(run, monkeypatch):
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    err = run("check", "camera.yaml", "moved.csv")[2].splitlines()
    assert err[0] == "camcal: error: drifted: camera"
    assert err[1].startswith("::error title=camcal::camera: drifted: the lens moved")
    assert "%25, principal" in err[1]
    assert run("inspect", "missing.yaml")[2].splitlines()[1].startswith("::error title=camcal::")


def test_a_camera_is_checked_against_what_has_not_moved(run, tmp_path):
    reference = tmp_path / "installed.yaml"
    assert run("pnp", "camera.yaml", "still.csv", "-o", reference, "--quiet")[0] == 0
    code, out, _ = run("check", "camera.yaml", "still.csv", "--reference", reference)
    assert code == 0
    assert out.startswith("still valid: shifted by 0.0")
    table = detections.read("still.csv")
    shifted = replace(table.views[0], pixels=table.views[0].pixels + np.array([12.0, 0.0]))
    detections.write(tmp_path / "later.csv", replace(table, views=(shifted,)))
    code, out, _ = run("check", "camera.yaml", tmp_path / "later.csv", "--reference", reference, "--json")
    found = json.loads(out)["checks"]["mount"]
    assert code == 7
    assert found["cause"] == "mount"
    assert "to undo it" in found["reason"]
    assert found["turn_rad"]["value"] > 0.01 or found["shift_m"]["value"] > 0.005
    assert run("check", "camera.yaml", "nothing.csv", "--reference", reference)[0] == 4
    bare = tmp_path / "bare.yaml"  # where a camera stands needs no covariance of its lens
    native.write(bare, CameraFile({"camera": replace(cameras.read("camera.yaml").cameras["camera"], camera=LENS)}))
    code, _, err = run("check", bare, "still.csv", "--reference", reference)
    assert code == 0, err


def test_what_cannot_be_checked_is_refused_with_what_to_do(run, tmp_path):
    bare = tmp_path / "bare.yaml"
    native.write(bare, CameraFile({"camera": replace(cameras.read("camera.yaml").cameras["camera"], camera=LENS)}))
    code, _, err = run("check", bare, "again.csv")
    assert code == 2
    assert "states no covariance" in err
    assert "camcal diff" in err
    assert run("check", "camera.yaml", "again.csv", "--tags", "tag36h11:50mm")[0] == 2
    assert run("check", "camera.yaml", "missing.png")[0] == 3
    code, _, err = run("check", "camera.yaml#other", "again.csv")
    assert code == 2
    assert "other" in err


def test_the_library_answers_too(folder):
    assert camcal.check_camera("camera.yaml", ["again.csv"]).verdict == "valid"
    found = camcal.check_camera(folder / "camera.yaml", [folder / "moved.csv"])
    assert found.verdict == "drifted"
    assert found.found["camera"].drift.focal.value == pytest.approx(0.01, abs=2e-3)
