"""`--resume` of commands with one result: a finished run is not repeated. And of videos, and in worker processes."""

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from batch_scenes import COMMANDS, SIMULATION, contents, draw_scene
from room_scene import BESIDE, RoomRig

from camcal.run.outputs import listed
from camcal.tasks.calibration import images_again


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """A folder with pictures of a chessboard, and one of nothing."""
    monkeypatch.chdir(tmp_path)
    Path("photos").mkdir()
    board = np.kron(np.indices((5, 6)).sum(axis=0) % 2, np.ones((30, 30))).astype(np.uint8) * 200 + 20
    for number in range(2):
        cv2.imwrite(
            f"photos/{number}.png", cv2.copyMakeBorder(board, *[40 + number] * 4, cv2.BORDER_CONSTANT, value=230)
        )
    return tmp_path


def test_a_finished_run_is_not_repeated_until_an_input_a_setting_or_its_result_changes(run, photographs):
    command = ("detect", "photos", "--board", "chessboard:5x4", "-o", "corners.csv", "--resume", "--jobs", 1)
    first = run(*command)
    assert (first[0], "nothing to do" in first[1]) == (0, False)
    again = ["nothing to do: corners.csv is complete and unchanged\n"]
    assert run(*command)[1].splitlines(keepends=True) == again
    assert "nothing to do" not in run(*command, "--partial")[1]
    assert "nothing to do" not in run(*command)[1]
    cv2.imwrite("photos/2.png", cv2.imread("photos/0.png"))
    assert "nothing to do" not in run(*command)[1]
    assert run(*command)[1].splitlines(keepends=True) == again
    Path("corners.csv").unlink()
    assert "nothing to do" not in run(*command)[1]
    assert sorted(path.name for path in photographs.iterdir()) == [".camcal-output", "corners.csv", "photos"]


def test_the_document_of_a_finished_run_is_repeated(run, photographs):
    command = ("detect", "photos", "--board", "chessboard:5x4", "-o", "corners.csv", "--resume", "--jobs", 1, "--json")
    first, again = (json.loads(run(*command)[1]) for _ in range(2))
    assert (first.pop("reused"), again.pop("reused")) == (0, 2)
    assert first.pop("timings").keys() == {"detecting"}
    assert again.pop("timings") == {}
    assert {**first, "warnings": []} == {**again, "warnings": []}


def test_a_finished_run_is_repeated_for_a_file_that_is_asked_for_now(run, photographs):
    command = ("detect", "photos", "--board", "chessboard:5x4", "-o", "corners.csv", "--resume", "--jobs", 1)
    assert run(*command)[0] == 0
    assert "nothing to do" in run(*command, "--overwrite")[1]
    assert "nothing to do" not in run(*command, "--draw", "drawn")[1]
    assert sorted(path.name for path in Path("drawn").glob("[!.]*")) == ["0_corners.png", "1_corners.png"]
    assert "nothing to do" in run(*command, "--draw", "drawn")[1]


def test_an_input_that_cannot_be_read_fails_alone_with_resume_too(run, photographs):
    Path("photos/3.png").write_bytes(b"")
    command = ("detect", "photos", "--board", "chessboard:5x4", "-o", "corners.csv", "--resume", "--jobs", 1)
    results = [run(*command) for _ in range(2)]
    assert [code for code, _, _ in results] == [6, 6]
    assert "photos/3.png" in results[1][2]


def test_without_resume_no_list_is_left_beside_a_result_that_says_camcal(run, photographs):
    command = ("detect", "photos", "--board", "chessboard:5x4", "-o", "corners.csv", "--jobs", 1)
    assert run(*command)[0] == 0
    assert sorted(path.name for path in photographs.iterdir()) == ["corners.csv", "photos"]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return RoomRig(tmp_path_factory.mktemp("rig"), "pinhole", BESIDE)


def test_frames_of_a_video_are_resumed(run, tmp_path, monkeypatch, rig):
    monkeypatch.chdir(tmp_path)
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (160, 120))
    for level in (50, 100, 150, 200):
        writer.write(np.full((120, 160, 3), level, np.uint8))
    writer.release()
    command = ("undistort", f"{rig.file}#left", "clip.avi", "-o", "out", "--resume")
    assert run(*command)[0] == 0
    before = {path: path.read_bytes() for path in Path("out").iterdir()}
    times = {path: path.stat().st_mtime_ns for path in before if path.name != ".camcal-output"}
    assert "nothing to do: 4 images complete and unchanged" in run(*command)[1]
    assert {path: path.stat().st_mtime_ns for path in times} == times
    Path("out/clip_000002.jpg").unlink()
    assert "3 of 4 images complete and unchanged" in run(*command)[1]
    assert {path: path.read_bytes() for path in Path("out").iterdir()} == before


@pytest.mark.slow
def test_worker_processes_record_what_they_write(run, tmp_path, rig):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for number in range(2):
            os.link(getattr(rig, side), tmp_path / side / f"{number}.png")
    sides = (tmp_path / "left", tmp_path / "right", rig.file)
    command = ("stereo", "disparity", *sides, "-o", tmp_path / "maps", "--quality", "fast", "--jobs", 2, "--resume")
    assert run(*command)[0] == 0
    assert "nothing to do: 2 maps complete and unchanged" in run(*command)[1]
    (tmp_path / "maps" / "1.tiff.sigma.tiff").unlink()
    assert json.loads(run(*command, "--json")[1])["reused"] == 1
    assert "1.tiff.sigma.tiff" in listed(tmp_path / "maps")


@pytest.mark.slow
def test_a_calibration_that_ends_while_it_refines_corners_does_not_search_the_images_again(run, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    draw_scene(tmp_path)
    assert run(*SIMULATION)[0] == 0
    for name, count in (("calibrate", 8), ("rig", 16)):
        command = (*COMMANDS[name], "--jobs", 1, "--json")
        assert run(*command)[0] == 0
        whole = contents()
        shutil.rmtree("out")
        with monkeypatch.context() as patch:
            patch.setattr(images_again, "fan_out", interrupted)
            assert run(*command)[0] == 130
        assert [path.endswith(".camcal-journal") for path in contents()] == [True]
        code, out, _ = run(*command, "--resume")
        assert (code, json.loads(out)["reused"]) == (0, count)
        Path("out/.camcal-output").unlink()  # which only a run with --resume keeps beside a file that says camcal
        assert contents() == whole
        shutil.rmtree("out")
