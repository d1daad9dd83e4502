"""`camcal run`: in which order steps run, which of them run again, and which files they count."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

CAMERAS = Path(__file__).parents[2] / "sample_configs" / "cameras"

VIEWS = "views: {command: undistort, arguments: [camera.yaml, photos], output: out}"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a camera file and two photographs, which is the working directory."""
    shutil.copy(CAMERAS / "pinhole.yaml", tmp_path / "camera.yaml")
    (tmp_path / "photos").mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.png"), np.zeros((480, 640), np.uint8))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def steps(run, folder):
    """A function that runs a pipeline of steps and gives its exit code, and what is said of each in their order; or
    the message that refuses it.
    """

    def call(text, *options):
        Path("pipeline.yaml").write_text(text if "steps:" in text else f"steps:\n  {text}\n")
        code, out, err = run("run", "pipeline.yaml", "--json", "--jobs", 1, *options)
        return code, {each["step"]: each for each in json.loads(out).get("steps", [])} or err

    return call


def states(steps):
    return {name: each["state"] for name, each in steps.items()}


def test_steps_that_do_not_need_one_another_keep_the_order_of_the_file(steps):
    text = "b: {command: convert, arguments: [camera.yaml, b.xml]}\n"
    text += "  a: {command: convert, arguments: [camera.yaml, a.xml]}"
    assert list(steps(text, "--dry-run")[1]) == ["b", "a"]


def test_a_folder_that_is_read_with_those_below_it_comes_after_what_is_written_there(steps):
    text = "all: {command: undistort, arguments: [camera.yaml, photos], recursive: true, output: out}\n"
    text += "  more: {command: undistort, arguments: [camera.yaml, photos/a.png], output: photos/more}"
    code, found = steps(text, "--dry-run")
    assert (code, list(found)) == (0, ["more", "all"])


def test_a_pattern_stands_for_nothing_below_what_it_matches(steps):
    Path("lenses").mkdir()
    shutil.copy("camera.yaml", "lenses/one.yaml")
    text = "figures: {command: plot, arguments: lenses/*, output: figures}\n"
    text += "  below: {command: convert, arguments: [camera.yaml, lenses/below/copy.xml]}"
    code, found = steps(text, "--dry-run")
    assert (code, list(found)) == (0, ["figures", "below"])


def test_a_folder_that_only_a_later_step_makes_has_to_be_there(steps):
    text = "first: {command: undistort, arguments: [camera.yaml, none], output: out}\n"
    text += "  later: {command: undistort, arguments: [camera.yaml, out], output: none/below}"
    code, said = steps(text, "--dry-run")
    assert code == 2
    assert "none is not there; if step later makes it, add 'after' with its name" in said


def test_a_new_file_in_a_folder_runs_a_step_again(steps):
    assert states(steps(VIEWS)[1]) == {"views": "done"}
    shutil.copy("photos/a.png", "photos/c.png")
    found = steps(VIEWS, "--dry-run")[1]
    assert (found["views"]["state"], found["views"]["reason"]) == ("would_run", "photos/c.png new")


def test_a_step_that_failed_runs_again_although_its_files_are_those_of_its_last_success(steps):
    text = "copy: {command: convert, arguments: [camera.yaml, copy.xml]}"
    good = Path("camera.yaml").read_text()
    assert steps(text)[0] == 0
    Path("camera.yaml").write_text("cameras: {}\n")
    assert steps(text)[0] == 2
    Path("camera.yaml").write_text(good)
    assert steps(text)[1]["copy"]["reason"] == "has not succeeded before"


def test_a_step_of_which_some_items_failed_does_not_stop_those_that_need_it(steps):
    Path("photos/b.png").write_bytes(b"no image")
    text = f"{VIEWS}\n  again: {{command: undistort, arguments: [camera.yaml, out], output: twice}}"
    code, found = steps(text)
    assert (code, states(found)) == (6, {"views": "failed", "again": "done"})


def test_outputs_that_are_gone_with_their_inputs_are_not_said_to_be_left(steps):
    steps(VIEWS)
    Path("photos/b.png").unlink()
    Path("out/b.png").unlink()
    assert steps(VIEWS)[1]["views"]["warnings"] == []


def test_a_forced_step_makes_all_of_its_items_again(steps):
    steps(VIEWS)
    before = Path("out/a.png").stat().st_mtime_ns
    assert states(steps(VIEWS)[1]) == {"views": "up_to_date"}
    assert states(steps(VIEWS, "--force")[1]) == {"views": "done"}
    assert Path("out/a.png").stat().st_mtime_ns > before


def test_an_item_of_a_list_stands_there_once(steps):
    text = "lists: {name: [a, b, a]}\nsteps:\n"
    text += "  copy: {command: convert, foreach: name, arguments: [camera.yaml, $(name).xml]}\n"
    code, said = steps(text)
    assert (code, "pipeline.yaml:1: lists.name: has 'a' twice" in said) == (2, True)
