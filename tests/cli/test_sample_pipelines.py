"""Every pipeline under sample_configs runs on simulated images of what it is a sample of, and once only."""

import json
import shutil
from pathlib import Path

import pytest

SAMPLES = Path(__file__).parents[2] / "sample_configs"
PIPELINES = SAMPLES / "pipelines"
BOARD = "chessboard:9x6:25mm"
SMALL = ("--size", "400x300", "--views", "10", "--jobs", "1", "--quiet")


def photos(run, *options):
    assert run("simulate", BOARD, *options, "-o", "scene", *SMALL)[0] == 0


def camera(run):
    photos(run)
    Path("scene/images").rename("photos")


def bayer(run):
    photos(run, "--raw", "RGGB")
    Path("scene/images").rename("frames")


def fisheye(run):
    photos(run, "--model", "kannala_brandt4", "--fov", "110", "--partial")
    Path("scene/images").rename("photos")


def marker(run):
    camera(run)
    board = ("charuco:3x3:60mm:40mm:DICT_4X4_50", "scene/truth.yaml")
    assert run("simulate", *board, "-o", "moving", "--motion", "--views", "20", "--jobs", "1", "--quiet")[0] == 0
    Path("moving/images").rename("images")


def rig(run):
    views = ("--views", "8", "--jobs", "1", "--quiet")
    assert run("simulate", BOARD, SAMPLES / "cameras" / "stereo_rig.yaml", "-o", "scene", *views)[0] == 0
    Path("scene/images").rename("images")


def stereo(run):
    """Rectified pairs of a scene, and a board in front of the same two cameras."""
    pairs = ("--stereo", "-o", "scene", "--size", "400x300", "--pairs", "1", "--jobs", "1", "--quiet")
    assert run("simulate", *pairs)[0] == 0
    views = ("--views", "10", "--jobs", "1", "--quiet")
    assert run("simulate", BOARD, "scene/rig.yaml", "-o", "seen", *views)[0] == 0
    Path("seen/images").rename("board")


def factory(run):
    for name in ("A2", "A10"):
        photos(run, "--seed", str(len(name)), "--overwrite")
        Path("cameras").mkdir(exist_ok=True)
        shutil.move("scene/images", Path("cameras") / name)


def nightly(run):
    photos(run)
    calibrated = ("--board", BOARD, "--model", "opencv4", "--jobs", "1", "--quiet")
    assert run("calibrate", "scene/images", *calibrated, "-o", "cameras/front.yaml")[0] == 0
    photos(run, "--seed", "1", "--overwrite")
    Path("tonight").mkdir()
    shutil.move("scene/images", Path("tonight") / "front")


SCENES = {
    "camera": (camera, ()),
    "bayer": (bayer, ()),
    "stereo": (stereo, ()),
    "rig": (rig, ()),
    "gate": (camera, ()),
    "marker": (marker, ("--set", "tags=DICT_4X4_50:40mm")),
    "fisheye": (fisheye, ()),
    "factory": (factory, ()),
    "nightly": (nightly, ()),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_sample_pipeline_runs_and_is_up_to_date_afterwards(name, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene, options = SCENES[name]
    scene(run)
    shutil.copy(PIPELINES / f"{name}.yaml", tmp_path)
    code, out, err = run("run", f"{name}.yaml", *options, "--jobs", "1", "--json")
    document = json.loads(out)
    assert (code, document["counts"]["done"]) == (0, len(document["steps"])), err
    code, out, _ = run("run", f"{name}.yaml", *options, "--jobs", "1", "--json")
    assert (code, json.loads(out)["counts"]["up_to_date"]) == (0, len(document["steps"]))


@pytest.mark.slow
def test_the_gate_stops_what_comes_after_it(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera(run)
    for image in sorted(Path("photos").iterdir())[3:]:
        image.unlink()
    shutil.copy(PIPELINES / "gate.yaml", tmp_path)
    code, out, _ = run("run", "gate.yaml", "--set", "max_uncertainty=0.0001", "--jobs", "1", "--json")
    states = {each["step"]: (each["state"], each["exit"]) for each in json.loads(out)["steps"]}
    assert (code, states) == (7, {"calibrate": ("failed", 7), "release": ("not_run", 0)})


def test_every_sample_is_run_and_has_an_entry_here():
    assert {path.stem for path in PIPELINES.glob("*")} == set(SCENES)
