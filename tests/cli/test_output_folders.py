"""Output folders of commands: one run at a time works in one."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from camcal import system
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save

LENS = Camera(model_named("opencv5"), (24, 16), np.array([20.0, 20, 12, 8, -0.1, 0, 0, 0, 0]))
PIPELINE = """\
lists:
  output: [out, other/out]
steps:
  straight:
    command: undistort
    foreach: output
    arguments: [lens.yaml, photos]
    output: $(output)
"""
HOLD = """
import sys
from pathlib import Path
from camcal.run.outputs import watch_files
with watch_files() as run:
    run.folders.hold(Path("out"), "--output")
    print("held", flush=True)
    sys.stdin.read()
"""
with_locks = pytest.mark.skipif(not system.HAS_LOCKS, reason="this system has no locks")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
    for value, name in enumerate("abc"):
        save(tmp_path / "photos" / f"{name}.png", np.full((16, 24), 40 * value, np.uint8))
    return tmp_path


@pytest.fixture
def other_run(start_python, folder):
    """A run in another process that holds the folder out until its standard input ends."""
    process = start_python("-c", HOLD, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == "held\n"
    return process


def names(place):
    return sorted(path.name for path in place.iterdir())


@with_locks
def test_the_later_of_two_runs_into_one_folder_is_refused_until_the_first_one_ends(run, other_run):
    command = ("undistort", "lens.yaml", "photos", "-o", "out")
    refusal = "out: another run writes into this folder; wait until it has ended, or give another --output"
    assert run(*command) == (3, "", f"camcal: error: {refusal}\n")
    assert names(Path("out")) == [system.HELD]
    assert run(*command[:-1], "other")[0] == 0
    other_run.communicate(timeout=60)
    assert run(*command)[0] == 0
    assert names(Path("out")) == [".camcal-output", "a.png", "b.png", "c.png", "camera.yaml"]


@with_locks
def test_files_that_are_named_go_into_a_folder_in_which_another_run_works(run, other_run):
    assert run("convert", "lens.yaml", "out/lens.xml")[0] == 0


@with_locks
def test_a_killed_run_keeps_nobody_from_its_folder(run, other_run):
    other_run.kill()
    other_run.wait()
    assert names(Path("out")) == [system.HELD]
    assert run("undistort", "lens.yaml", "photos", "-o", "out")[0] == 0
    assert system.HELD not in names(Path("out"))


@with_locks
def test_a_step_into_a_folder_in_which_another_run_works_fails_alone(run, other_run):
    Path("pipeline.yaml").write_text(PIPELINE)
    code, _, err = run("run", "pipeline.yaml", "-j", 1)
    assert code == 3
    assert "step straight[out] failed: out: another run writes into this folder" in err
    assert Path("other/out/a.png").is_file()
    assert names(Path("out")) == [system.HELD]


@pytest.mark.parametrize("jobs", [1, 2], ids=["one after the other", "at once"])
def test_steps_of_a_pipeline_have_their_folders_to_themselves(run, folder, jobs):
    (folder / "pipeline.yaml").write_text(PIPELINE)
    assert run("run", "pipeline.yaml", "-j", jobs)[0] == 0
    for place in ("out", "other/out"):
        assert names(folder / place) == [".camcal-output", "a.png", "b.png", "c.png", "camera.yaml"]


def test_an_output_folder_of_a_run_that_fails_is_not_left(run, folder):
    assert run("undistort", "lens.yaml", "photos", "-o", "new/out", "--size", "0x0")[0] == 2
    save(folder / "photos" / "a.png", np.zeros((4, 4), np.uint8))
    assert run("undistort", "lens.yaml", "photos/a.png", "-o", "new/out")[0] != 0
    assert not (folder / "new").exists()


def test_a_link_to_a_folder_is_an_output_folder_as_long_as_it_leads_there(run, folder):
    (folder / "real").mkdir()
    (folder / "out").symlink_to(folder / "real")
    assert run("undistort", "lens.yaml", "photos", "-o", "out")[0] == 0
    assert "a.png" in names(folder / "real")
