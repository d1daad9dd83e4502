"""--fail-fast and --timeout of commands: exit codes, what is written, what is said."""

import json
import os

import numpy as np
import pytest
from command_page import REGISTERED

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save

LENS = Camera(model_named("opencv5"), (200, 160), np.array([150.0, 151, 101, 79, -0.25, 0.06, 0, 0, 0]))
BATCHES = (
    *("demosaic", "detect", "calibrate", "rig", "pnp", "undistort"),
    *(f"stereo {name}" for name in ("rectify", "check", "disparity", "cloud", "eval", "run")),
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
    for number in range(4):
        picture = np.random.default_rng(number).integers(0, 255, (160, 200, 3), dtype=np.uint8)
        save(tmp_path / "photos" / f"{number}.png", picture)
    return tmp_path


def written(folder):
    return {path.name: path.read_bytes() for path in folder.glob("[!.]*")}


@pytest.mark.parametrize("command", BATCHES)
def test_every_command_over_many_items_has_both(command):
    assert {"--jobs", "--timeout", "--fail-fast"} <= {each.name for each in REGISTERED[command].declared}


def test_what_is_written_before_a_failure_is_kept(run, folder):
    (folder / "photos" / "2.png").write_bytes(b"")
    code, out, err = run("undistort", "lens.yaml", "photos", "-o", "out", "--fail-fast", "--jobs", 1, "--json")
    assert code == 6
    assert sorted(written(folder / "out")) == ["0.png", "1.png", "camera.yaml"]
    assert err.splitlines() == [
        "camcal: warning: stopped at the first failure: 1 of 4 not begun",
        "camcal: failed: photos/2.png: is empty",
        "camcal: error: 1 of 3 images failed, the rest is written",
    ]
    [warning] = json.loads(out)["warnings"]
    assert (warning["code"], warning["values"]) == ("stopped_at_failure", {"not_begun": 1})


def test_a_failure_of_the_first_item_leaves_nothing(run, folder):
    (folder / "photos" / "0.png").write_bytes(b"")
    code, _, err = run("undistort", "lens.yaml", "photos", "-o", "out", "--fail-fast", "--jobs", 1)
    assert code == 3
    assert err.splitlines()[-1] == "camcal: error: photos/0.png: is empty"
    assert not (folder / "out" / "camera.yaml").exists()


def test_one_result_for_all_items_is_not_written_after_a_failure(run, folder):
    (folder / "photos" / "1.png").write_bytes(b"")
    code, _, err = run("detect", "photos", "-b", "chessboard:9x6:25mm", "-o", "c.csv", "--fail-fast", "--jobs", 1)
    assert code == 3
    assert err.splitlines() == [
        "camcal: warning: stopped at the first failure: 2 of 4 not begun",
        "camcal: error: photos/1.png: is empty",
    ]
    assert not (folder / "c.csv").exists()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes hang on POSIX systems only")
def test_an_item_that_hangs_is_stopped_and_the_others_are_as_ever(run, folder):
    paths = [f"photos/{number}.png" for number in range(4)]
    assert run("undistort", "lens.yaml", *paths, "-o", "all")[0] == 0
    (folder / "photos" / "1.png").unlink()
    os.mkfifo(folder / "photos" / "1.png")  # nobody writes into it; reading gives up after 10 s
    code, _, err = run("undistort", "lens.yaml", *paths, "-o", "out", "--timeout", 2)
    assert code == 6
    assert err.splitlines()[0] == "camcal: failed: photos/1.png: took longer than 2 s and was stopped"
    expected = written(folder / "all")
    del expected["1.png"]
    assert written(folder / "out") == expected


@pytest.mark.parametrize("url", ["dask://a:b@127.0.0.1:80", "dask://127.0.0.1:65536", "dask://[::1:80", "dask://:80"])
def test_a_scheduler_has_a_host_and_a_port_and_no_password(run, folder, url):
    code, _, err = run("undistort", "lens.yaml", "photos", "-o", "out", "--scheduler", url)
    assert code == 2
    assert "dask://HOST:PORT, dask+tls://HOST:PORT or dask://local" in err
    assert not (folder / "out").exists()
