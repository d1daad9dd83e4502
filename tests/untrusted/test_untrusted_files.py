"""What is no plain file, and files that say more than they hold: refused in one line, before memory is taken."""

import os
import resource
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from report_scenes import SCENES, detections_of

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats import detections
from camcal.formats.covariance import why_no_covariance
from camcal.formats.documents import parse_json
from camcal.formats.tables import MAX_LINES, Table, cell, csv_rows, numbered_lines
from camcal.formats.trajectories import read_lines
from camcal.images.files import load, save
from camcal.images.options import VARIABLE
from camcal.parsing import is_number, parse_integer

PROGRAM = "from camcal.cli.main import main; main()"


def camcal(*arguments, **extra):
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False, **extra
    )


def chunk(kind, data, length=None):
    stated = len(data) if length is None else length
    return struct.pack(">I", stated) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, *, data=b"", length=None):
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", data, length), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="/dev/zero is a device of Unix")
def test_devices_are_refused():
    with pytest.raises(FileError, match="/dev/zero: is a device"):
        files.read_bytes(Path("/dev/zero"))


def test_a_named_pipe_is_waited_for_and_read_to_its_end(tmp_path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)

    def write():
        time.sleep(0.1)
        pipe.write_text("x,y\n1,2\n")

    writer = threading.Thread(target=write)
    writer.start()
    assert files.read_text(pipe) == "x,y\n1,2\n"
    writer.join()


def test_a_named_pipe_that_nobody_writes_to_is_given_up(tmp_path, monkeypatch):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    monkeypatch.setattr(files, "_PIPE_TIMEOUT_S", 0.05)
    with pytest.raises(FileError, match=r"without data for 0\.05 s"):
        files.read_bytes(pipe)


def test_a_pipe_is_read_no_further_than_the_limit(tmp_path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    program = (
        f"import contextlib, pathlib\nwith contextlib.suppress(OSError): open({str(pipe)!r}, 'wb').write(bytes(10**8))"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program]),
        pytest.raises(FileError, match="more than the limit of 1000 bytes"),
    ):
        files.read_bytes(pipe, 1000)


def test_a_chunk_that_ends_beyond_its_png_file_takes_no_memory(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(64, 64, data=zlib.compress(bytes(64 * 65)), length=0xFFFFFFF0))
    with pytest.raises(FileError, match=r"PNG file: a chunk of 4294967280 bytes exceeds the file"):
        load(path)


def test_a_png_file_that_states_more_pixels_than_deflate_can_hold_is_damaged(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(16000, 16000, data=zlib.compress(bytes(1000))))
    with pytest.raises(FileError, match="16000 x 16000 pixels exceed"):
        load(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp", ".pgm"])
def test_the_largest_image_is_looked_up_in_the_header_of_every_format(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    save(path, np.zeros((30, 40), np.uint8))
    assert load(path).size == (40, 30)
    monkeypatch.setenv(VARIABLE, "1199")
    with pytest.raises(FileError, match="40 x 30 are"):
        load(path)
    monkeypatch.setenv(VARIABLE, "1200")
    assert load(path).size == (40, 30)


def test_the_limit_is_an_option(tmp_path):
    save(tmp_path / "a.png", np.zeros((300, 400), np.uint8))
    done = camcal("inspect", tmp_path / "a.png", "--pattern", "RGGB", "--max-pixels", "0.1")
    assert (done.returncode, done.stdout) == (3, "")
    assert "400 x 300 are 0 million pixels, more than --max-pixels 0.1" in done.stderr


@pytest.mark.parametrize("text", ["1_0", "１", "٣", "1e", "", "0x10", "9" * 5000, "1,0"])
def test_only_ascii_numbers_are_numbers(text):
    assert not is_number(text)
    with pytest.raises(ValueError, match=r".*"):
        parse_integer(text)


@pytest.mark.parametrize("text", ["1_0", "１"])
def test_a_trajectory_with_other_numbers_is_refused_with_its_line(tmp_path, text):
    path = tmp_path / "path.tum"
    path.write_text(f"0 0 0 0 0 0 0 1\n1 {text} 0 0 0 0 0 1\n", encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"path\.tum:2: .* is not a number"):
        read_lines(path)


def test_numbers_in_names_may_be_of_any_length():
    names = ["a1" + "0" * 5000, "a10", "a" + "9" * 5000, "a02", "a3b", "a1"]
    assert sorted(names, key=files.natural_key) == [names[k] for k in (5, 3, 4, 1, 2, 0)]


@pytest.mark.parametrize("text", ['{"a": ' + "9" * 5000 + "}", '{"a":' * 100_000, "[" * 100_000])
def test_json_of_many_digits_or_levels_is_refused(text):
    with pytest.raises((FileError, InvalidInput)):
        parse_json(text, "a.json")


@pytest.mark.parametrize(("row", "column", "value"), [(0, 1, -1e308), (2, 2, 1e-320), (2, 2, 1e308)])
def test_absurd_covariances_are_none(row, column, value):
    matrix = np.eye(6)
    matrix[row, column] = matrix[column, row] = value
    assert why_no_covariance(matrix)
    assert why_no_covariance(np.eye(6)) is None


def test_an_open_quote_is_told_with_its_line():
    lines = [(1, "x,y"), (2, '"1,2'), *((number, "1,2") for number in range(3, 2000))]
    with pytest.raises(InvalidInput, match=r"a\.csv:2: invalid CSV row"):
        csv_rows("a.csv", lines)


def test_a_table_of_too_many_lines_is_refused_before_it_is_split(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"1\n" * (MAX_LINES + 1))
    with pytest.raises(FileError, match="3000001 lines are more than the limit"):
        numbered_lines(path)


@pytest.mark.parametrize("text", ["=1+1", "+x", "@SUM(A1)", "'=x", "''@", "a=b", "'x", "-1", "plain", 'a"b,c'])
def test_no_cell_begins_like_a_formula_and_all_are_read_back(text):
    written = cell(text)
    assert written.lstrip('"')[:1] not in {"=", "+", "@"}
    table = Table.from_csv("a.csv", [(1, "name"), (2, written)], ("name",), ())
    assert table.columns["name"][0] == text


def test_control_characters_of_names_do_not_reach_the_terminal(tmp_path):
    odd = tmp_path / "a\x1b[31m\u202e\u200b\u2060b.png"
    odd.write_bytes(b"nothing")
    done = camcal("detect", odd, "-b", "chessboard:7x5:25mm", "-o", tmp_path / "d.csv", "--jobs", "1")
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert "\x1b" not in done.stderr
    assert r"a\x1b[31m\u202e\u200b\u2060b.png" in done.stderr


def test_a_name_with_a_line_break_costs_that_image_only(tmp_path):
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((20, 20))).astype(np.uint8) * 200
    board = np.pad(squares, 20, constant_values=200)
    for name in ("a\nb.png", "c.png"):
        save(tmp_path / name, board)
    done = camcal("detect", tmp_path, "-b", "chessboard:7x5:25mm", "-o", tmp_path / "d.csv", "--jobs", "1")
    assert done.returncode == 6, done.stderr
    assert "has a line break in its name" in done.stderr
    assert "c.png" in (tmp_path / "d.csv").read_text()


def test_a_deleted_working_directory_is_named(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    program = f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r}); {PROGRAM}"
    command = [sys.executable, "-c", program, "detect", "a.png", "-b", "chessboard:7x5:25mm", "-o", "d.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
def test_a_link_to_itself_and_a_name_that_is_too_long_are_file_errors(tmp_path):
    loop = tmp_path / "loop.png"
    loop.symlink_to(loop)
    for path in (loop, tmp_path / ("a" * 300 + ".png")):
        done = camcal("detect", path, "-b", "chessboard:7x5:25mm", "-o", tmp_path / "d.csv")
        assert done.returncode == 3, done.stderr
        assert len(done.stderr.splitlines()) == 1


def limited_to(kilobytes):
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (kilobytes << 10, kilobytes << 10))


def test_running_out_of_memory_says_how_much_was_asked_for(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((6000, 9000), np.uint16))
    arguments = ("demosaic", tmp_path / "a.npy", "-o", tmp_path / "a.tiff", "--pattern", "RGGB", "--trust-pattern")
    done = camcal(*arguments, "--jobs", "1", preexec_fn=limited_to(1100 << 10))
    assert done.returncode == 3, done.stderr
    assert "out of memory: " in done.stderr
    assert "llocate" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


@pytest.mark.parametrize("kilobytes", [300_000, 580_000, 720_000])
def test_an_address_space_too_small_for_the_libraries_is_one_line_before_they_load(tmp_path, kilobytes):
    done = camcal("inspect", tmp_path / "none.yaml", preexec_fn=limited_to(kilobytes))
    assert done.returncode == 3, done.stderr
    assert f"limited to {kilobytes} kB (ulimit -v); camcal needs at least 720896 kB" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [720_896, 740_000, 760_000, 800_000, 1_100_000, 1_500_000])
def test_a_calibration_in_little_memory_ends_with_a_result_or_one_line(tmp_path, kilobytes):
    detections.write(tmp_path / "views.csv", detections_of(SCENES["good"]))
    arguments = ("calibrate", tmp_path / "views.csv", "-o", tmp_path / "camera.yaml")
    done = camcal(*arguments, preexec_fn=limited_to(kilobytes), timeout=100)
    assert done.returncode in {0, 3}, done.stderr
    assert done.returncode == 0 or len(done.stderr.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.8, 1.6, 2.4])
def test_a_calibration_in_little_memory_ends_within_two_seconds_of_being_stopped(tmp_path, seconds):
    detections.write(tmp_path / "views.csv", detections_of(SCENES["good"]))
    command = [sys.executable, "-m", "camcal", "calibrate", tmp_path / "views.csv", "-o", tmp_path / "camera.yaml"]
    limited = ["sh", "-c", 'ulimit -v 740000; exec "$@"', "sh", *command]
    process = subprocess.Popen(limited, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    time.sleep(seconds)
    process.terminate()
    process.communicate(timeout=2)
    assert process.returncode in {0, 143, -15}


def test_a_file_that_cannot_grow_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    program = (
        "import resource, signal; from pathlib import Path; from camcal import files;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
        f"files.write_bytes(Path({str(path)!r}), bytes(5000))"
    )
    done = subprocess.run([sys.executable, "-B", "-c", program], capture_output=True, text=True, check=False)
    assert "FileError" in done.stderr.splitlines()[-1]
    assert "cannot be written: File too large" in done.stderr
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
