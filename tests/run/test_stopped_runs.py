"""A run that is stopped or killed leaves no half file and no process, and can be repeated as it was."""

import os
import signal
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal import files, system
from camcal.images.files import load, save

TEMPORARY = ".camcal.part-*"


@pytest.fixture
def mosaics(tmp_path):
    """A folder of mosaics that take a while."""
    folder = tmp_path / "frames"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for number in range(12):
        save(folder / f"{number}.pgm", rng.integers(0, 65000, (240, 320)).astype(np.uint16))
    return folder


def arguments(folder, *more):
    return ["-m", "camcal", "demosaic", folder, "-o", folder, "--pattern", "RGGB", "--trust-pattern", "--quiet", *more]


def wait_for(folder, pattern):
    until = time.monotonic() + 60
    while not list(folder.glob(pattern)):
        assert time.monotonic() < until
        time.sleep(0.002)


def require_whole(folder, count=None):
    """Every image that is there can be read, and nothing unfinished is."""
    found = list(folder.glob("[0-9]*.tiff"))
    for path in found:
        assert load(path).size == (320, 240)
    assert list(folder.glob(TEMPORARY)) == []
    assert count is None or len(found) == count


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGTERM, 143),
        pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, 129, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_a_stopped_run_into_the_folder_it_reads_from_is_repeated_as_it_was(start_python, mosaics, number, code):
    for _ in range(3):  # on a machine with other work a run may be over before the signal reaches it
        process = start_python(*arguments(mosaics))
        wait_for(mosaics, "[0-9]*.tiff")
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
        if process.returncode != 0:
            break
        for path in mosaics.glob("[0-9]*.tiff"):
            path.unlink()
    assert process.returncode == code
    assert err.startswith("camcal: error: ")
    assert len(err.splitlines()) == 1
    require_whole(mosaics)
    again = start_python(*arguments(mosaics))
    assert again.communicate(timeout=60)[1] == ""
    assert again.returncode == 0
    require_whole(mosaics, 12)


@pytest.mark.slow
def test_a_killed_run_is_repeated_and_its_temporary_files_are_swept(start_python, mosaics):
    process = start_python(*arguments(mosaics))
    wait_for(mosaics, TEMPORARY)
    process.kill()
    process.communicate()
    (mosaics / ".camcal.part-old.tiff").write_bytes(b"half")
    again = start_python(*arguments(mosaics))
    assert again.communicate(timeout=60)[1] == ""
    require_whole(mosaics, 12)


@pytest.mark.slow
def test_what_another_run_is_writing_is_not_swept(start_python, mosaics):
    program = """
import sys, time
from pathlib import Path
from camcal.files import replacing
with replacing(Path(sys.argv[1])) as temporary:
    temporary.write_text("whole")
    Path(sys.argv[2]).touch()
    time.sleep(float(sys.argv[3]))
"""
    writer = start_python("-c", program, mosaics / "slow.txt", mosaics / "begun", 2.0)
    wait_for(mosaics, "begun")
    other = start_python("-c", program, mosaics / "fast.txt", mosaics / "done", 0.0)
    assert other.communicate(timeout=30)[1] == ""
    assert writer.communicate(timeout=30)[1] == ""
    assert (mosaics / "slow.txt").read_text() == "whole"
    assert (mosaics / "fast.txt").read_text() == "whole"


def test_runs_into_one_folder_keep_all_of_their_outputs_listed(start_python, tmp_path):
    program = """
import sys
from pathlib import Path
from camcal.run.fingerprint import append, change
for number in range(40):
    change(Path(sys.argv[1]), {f"{sys.argv[2]}{number}.png": None})
    append(Path(sys.argv[1]), {f"{sys.argv[2]}{number}.jpg": None})
"""
    runs = [start_python("-c", program, tmp_path, name) for name in "abc"]
    assert [run.communicate(timeout=60)[1] for run in runs] == ["", "", ""]
    assert len((tmp_path / ".camcal-output").read_text().splitlines()) == 240


def gone(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return True
    return state == "Z"


def workers_of(parent):
    """Return the processes that a process started, and those that these did."""
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(parent)], capture_output=True, text=True, check=False)
    children = [int(word) for word in listed.stdout.split()]
    return children + [process for child in children for process in workers_of(child)]


@pytest.mark.slow
def test_killed_parents_leave_no_half_file_no_orphan_and_no_litter(start_python, tmp_path):
    """Killed at any moment: while threads write images, and while worker processes detect. CAMCAL_KILLS: how many."""
    rng = np.random.default_rng(int(os.environ.get("CAMCAL_KILL_SEED", "1")))
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(6):
        cv2.imwrite(str(folder / f"{number}.pgm"), rng.integers(0, 65000, (240, 320)).astype(np.uint16))
    detect = ["-m", "camcal", "detect", folder, "-b", "chessboard:7x5:25mm", "-o", tmp_path / "d.csv", "--jobs", "2"]
    orphans = 0
    for turn in range(int(os.environ.get("CAMCAL_KILLS", "8"))):
        process = start_python(*(arguments(folder, "--jobs", "2") if turn % 2 else detect))
        if turn % 4 == 1:
            wait_for(folder, TEMPORARY)
        else:
            time.sleep(float(rng.uniform(0.0, 3.0)))
        workers = workers_of(process.pid)
        process.kill()
        process.communicate()
        until = time.monotonic() + 5
        while not all(map(gone, workers)) and time.monotonic() < until:
            time.sleep(0.02)
        orphans += sum(not gone(pid) for pid in workers)
        for path in folder.glob("[0-9]*.tiff"):
            assert load(path).size == (320, 240)
    assert orphans == 0
    last = start_python(*arguments(folder))
    assert last.communicate(timeout=60)[1] == ""
    require_whole(folder, 6)
    assert list(tmp_path.glob(TEMPORARY)) == []


def test_a_signal_that_a_library_does_not_let_python_hear_ends_the_run(start_python):
    # The signal comes from a thread of its own, a second later, so that the library is at work by then.
    program = """
import hashlib, os, signal, threading
from camcal.run.process import stop_on_signals
stop_on_signals()
threading.Timer(1, os.kill, (os.getpid(), signal.SIGTERM)).start()
hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""
    assert start_python("-c", program).wait(timeout=30) == 143


def test_a_signal_while_a_temporary_file_is_made_leaves_none(tmp_path, monkeypatch):
    """The moment between making the file and locking it is too short to be hit by a signal of another process."""

    def stop(_handle):
        assert list(tmp_path.glob(TEMPORARY))
        raise KeyboardInterrupt

    monkeypatch.setattr(system, "lock", stop)
    with pytest.raises(KeyboardInterrupt), files.replacing(tmp_path / "camera.yaml"):
        pytest.fail("nothing is to be written")
    assert list(tmp_path.glob(TEMPORARY)) == []
