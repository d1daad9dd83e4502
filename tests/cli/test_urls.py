"""Inputs and outputs that are URLs: the same results as with local files, and what is said where it cannot be."""

import json
import sys
import tempfile
from pathlib import Path

import fsspec
import numpy as np
import pytest

from camcal import urls
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import FileError
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save
from camcal.run import remote

LENS = Camera(model_named("opencv5"), (120, 80), np.array([90.0, 91, 61, 39, -0.25, 0.06, 0, 0, 0]))


@pytest.fixture(autouse=True)
def no_urls_before(tmp_path, monkeypatch):
    token = urls.REMOTE.set(None)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    yield
    urls.REMOTE.reset(token)


@pytest.fixture
def memory():
    """The file system of memory:// URLs, empty."""
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()
    system.pseudo_dirs[:] = [""]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working folder, with a camera file and three photographs."""
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
    rng = np.random.default_rng(1)
    for name in ("1.png", "2.png", "10.png"):
        save(tmp_path / "photos" / name, rng.integers(0, 255, (80, 120, 3), dtype=np.uint8))
    return tmp_path


@pytest.fixture(params=["memory", "file"])
def base(request, memory, here):
    """A URL that has what is in the working folder."""
    url = "memory://lab" if request.param == "memory" else f"file://{here}/lab"
    system, place = fsspec.core.url_to_fs(url)
    system.put(str(here / "photos"), f"{place}/photos", recursive=True)
    system.put(str(here / "lens.yaml"), f"{place}/lens.yaml")
    return url


def contents(url):
    """The bytes of the files below a URL by name."""
    system, place = fsspec.core.url_to_fs(url)
    return {name.removeprefix(place).lstrip("/"): system.cat_file(name) for name in system.find(place)}


def test_results_are_those_of_local_files(run, here, base):
    run("undistort", "lens.yaml", "photos", "-o", "out", "--mask", "-j", 1)
    code, out, err = run("undistort", f"{base}/lens.yaml", f"{base}/photos", "-o", f"{base}/out", "--mask", "-j", 1)
    assert (code, err) == (0, "")
    written = f"{base}/out/camera.yaml, {base}/out/valid_mask.png"
    assert out.endswith(f"\nwrote {written} and 3 images to {base}/out/\n")
    local = {path.name: path.read_bytes() for path in (here / "out").iterdir()}
    there = contents(f"{base}/out")
    for name in ("camera.yaml", ".camcal-output"):  # it names its sources, and the list has its hash
        assert there.pop(name) != local.pop(name)
    assert there == local


def test_what_is_written_and_printed_names_the_url(run, here, base):
    _, out, _ = run("undistort", f"{base}/lens.yaml", f"{base}/photos", "-o", f"{base}/out", "--json", "-j", 2)
    document = json.loads(out)
    assert document["camera_file"] == f"{base}/out/camera.yaml"
    assert [image["source"] for image in document["images"]] == [f"{base}/photos/{n}.png" for n in (1, 2, 10)]
    camera = contents(f"{base}/out")["camera.yaml"].decode()
    assert f'command: "camcal undistort {base}/lens.yaml {base}/photos"' in camera
    assert str(urls.REMOTE.get().root) not in out + camera


def test_copies_of_items_are_removed_with_the_items(run, here, base):
    run("undistort", "lens.yaml", f"{base}/photos", "-o", "out", "-j", 2)
    root = urls.REMOTE.get().root
    assert [path for path in root.parent.iterdir() if path != root] == []


def test_a_pattern_and_an_address_of_a_camera_may_be_urls(run, here, base):
    code, _, err = run("undistort", f"{base}/lens.yaml#lens", f"{base}/photos/1*.png", "-o", f"{base}/out", "-j", 1)
    assert (code, err) == (0, "")
    assert set(contents(f"{base}/out")) == {".camcal-output", "camera.yaml", "1.png", "10.png"}


def test_own_files_are_replaced_and_those_of_others_kept(run, here, base):
    call = ("undistort", "lens.yaml", f"{base}/photos", "-o", f"{base}/out", "-j", 1)
    assert run(*call)[0] == run(*call)[0] == 0
    system, place = fsspec.core.url_to_fs(f"{base}/other")
    system.makedirs(place)
    system.pipe_file(f"{place}/1.png", b"mine")
    code, _, err = run(*call[:-3], f"{base}/other", "-j", 1)
    assert code == 2
    assert f"{base}/other/1.png: exists and was not written by camcal" in err
    assert contents(f"{base}/other") == {"1.png": b"mine"}


def test_what_is_read_at_a_url_is_not_overwritten(run, here, base):
    code, _, err = run("undistort", "lens.yaml", f"{base}/photos", "-o", f"{base}/photos", "--overwrite", "-j", 1)
    assert code == 2
    assert "is an input and is not overwritten" in err


def test_what_is_missing_is_named_by_its_url(run, here, base):
    code, _, err = run("undistort", f"{base}/lense.yaml", f"{base}/photos", "-o", "out")
    assert code == 3
    assert err == f"camcal: error: {base}/lense.yaml: no such file. Did you mean '{base}/lens.yaml'?\n"


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("s3://user:secret@bucket/photos", "results would record this password"),
        ("memory://lab/../photos", "is not the URL of a file or folder"),
        ("memory://lab//photos", "is not the URL of a file or folder"),
        ("zip://a.png::memory://lab.zip", "is not the URL of a file or folder"),
        ("nonsense://lab/photos", "cannot be reached: Protocol not known: nonsense"),
    ],
)
def test_urls_that_cannot_be_used_are_refused_in_one_line(run, here, url, said):
    code, _, err = run("undistort", "lens.yaml", url, "-o", "out")
    assert code in (2, 3)
    assert said in err
    assert "secret" not in err
    assert err.count("\n") == 1
    assert not (here / "out").exists()


def test_a_listing_with_names_that_lead_elsewhere_is_refused(run, here, memory):
    memory.pipe_file("/lab/photos/1.png", b"")
    memory.store["/lab/photos/../../../stray.png"] = memory.store["/lab/photos/1.png"]
    memory.store["/lab/photos/../../../stray.png"].path = "/lab/photos/../../../stray.png"
    code, _, err = run("undistort", "lens.yaml", "memory://lab/photos", "-o", "out")
    assert code == 3
    assert "which is no name of a file" in err
    assert not list(urls.REMOTE.get().root.parent.parent.glob("stray.png"))


def test_without_fsspec_the_extra_is_named(run, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    code, _, err = run("undistort", "lens.yaml", "s3://bucket/photos", "-o", "out")
    assert code == 2
    assert err == "camcal: error: s3://bucket/photos: URLs need the extra [cluster]: pip install 'camcal[cluster]'\n"


def test_an_upload_that_fails_leaves_nothing_behind(run, here, base):
    system, place = fsspec.core.url_to_fs(f"file://{here}/blocked")
    system.pipe_file(place, b"a file where the folder should be")
    code, _, err = run("undistort", "lens.yaml", f"{base}/photos", "-o", f"file://{here}/blocked/out", "-j", 1)
    assert code == 3
    assert err.count("\n") == 1
    assert (here / "blocked").read_bytes() == b"a file where the folder should be"


@pytest.mark.slow
def test_a_url_in_the_content_of_a_file_is_never_asked_for(run, here, memory):
    rows = ["image,width,height,id,u,v", "memory://lab/photos/1.png,120,80,0,10.0,10.0"]
    (here / "corners.csv").write_text("\n".join([*rows, ""]))
    run("calibrate", "corners.csv", "-b", "chessboard:9x6:25mm", "-o", "camera.yaml")
    assert urls.REMOTE.get() is None


@pytest.mark.slow
def test_worker_processes_read_and_write_urls(run, here):
    url = f"file://{here}"
    code, _, err = run("undistort", "lens.yaml", f"{url}/photos", "-o", f"{url}/out", "-j", 2, "--timeout", 60)
    assert (code, err) == (0, "")
    run("undistort", "lens.yaml", "photos", "-o", "local")
    for path in (here / "local").glob("*.png"):
        assert path.read_bytes() == (here / "out" / path.name).read_bytes()


def test_a_process_elsewhere_needs_no_folder_of_this_one(here, memory, tmp_path):
    memory.pipe_file("/lab/1.txt", b"content")
    away = remote.RemoteFiles(tmp_path / "gone" / "urls")
    path = away.root / "memory" / "lab" / "1.txt"
    with away.item():
        assert away.local(path).read_bytes() == b"content"
        copy = away.local(path)
    assert not copy.exists()
    temporary = away.new_file(path)
    temporary.write_bytes(b"other")
    away.send(temporary, path.with_name("2.txt"))
    assert memory.cat_file("/lab/2.txt") == b"other"
    assert not away.root.exists()


def test_a_run_is_resumed_from_the_list_at_the_url(run, here, base, monkeypatch):
    call = ("undistort", "lens.yaml", f"{base}/photos", "-o", f"{base}/out", "--resume", "-j", 1)
    assert run(*call)[0] == 0
    before = contents(f"{base}/out")
    assert b"\t" in before[".camcal-output"]
    urls.REMOTE.set(None)
    code, out, _ = run(*call)
    assert code == 0
    assert "nothing" in out
    assert contents(f"{base}/out") == before


def test_the_list_at_a_url_grows_while_a_run_goes_on(run, here, base, monkeypatch):
    monkeypatch.setattr(remote, "_SEND_S", 0.0)
    monkeypatch.setattr(remote, "_SENDING", 0.0)
    seen = []
    send = remote._upload

    def noted(source, url):
        seen.append((url, source.read_bytes()))
        send(source, url)

    monkeypatch.setattr(remote, "_upload", noted)
    run("undistort", "lens.yaml", f"{base}/photos", "-o", f"{base}/out", "-j", 1)
    lists = [content for url, content in seen if url.endswith("/.camcal-output")]
    assert len(lists) >= 3
    assert lists[-1] == contents(f"{base}/out")[".camcal-output"]


@pytest.fixture
def boards(base):
    """The URL of a folder with pictures of a chessboard, beside which results go to `corners.csv`."""
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((16, 16))).astype(np.uint8) * 160 + 40
    for number in range(4):
        save(Path(f"boards/{number}.png"), np.pad(squares, 16, constant_values=200 + number))
    system, place = fsspec.core.url_to_fs(f"{base}/boards")
    system.put("boards", place, recursive=True)
    return f"{base}/boards"


def search(run, base, *more):
    """Detect in another process: what this one knows of URLs is forgotten. Returns the exit code and how many images
    were not searched again.
    """
    urls.REMOTE.set(None)
    call = ("detect", f"{base}/boards", "-b", "chessboard:7x5:25mm", "-o", f"{base}/corners.csv", "-j", 1, "--json")
    code, out, err = run(*call, *more)
    assert "Traceback" not in err
    return code, json.loads(out).get("reused")


JOURNAL = ".corners.csv.camcal-journal"


def test_a_journal_at_a_url_stays_there_until_images_are_repaired(run, base, boards):
    system, place = fsspec.core.url_to_fs(boards)
    whole = system.cat_file(f"{place}/2.png")
    system.pipe_file(f"{place}/2.png", whole[:200])
    assert search(run, base) == (6, 0)
    assert contents(base)[JOURNAL].count(b"\t") == 3
    system.pipe_file(f"{place}/2.png", whole)
    assert search(run, base, "--resume") == (0, 3)
    resumed = contents(base)
    assert JOURNAL not in resumed
    assert search(run, base, "--resume") == (0, 4)
    assert contents(base) == resumed
    search(run, base)
    assert contents(base)["corners.csv"] == resumed["corners.csv"]


def test_a_run_that_is_interrupted_sends_its_journal(run, base, boards, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(detections, "write", interrupted)
        assert search(run, base)[0] == 130
    assert contents(base)[JOURNAL].count(b"\t") == 4
    assert search(run, base, "--resume") == (0, 4)
    assert JOURNAL not in contents(base)


PIPELINE = """\
steps:
  corners:
    command: detect
    arguments: {0}/boards
    board: chessboard:7x5:25mm
    output: {0}/corners.csv
"""


def test_a_step_of_a_pipeline_goes_on_from_the_journal_at_a_url(run, here, base, boards):
    system, place = fsspec.core.url_to_fs(boards)
    whole = system.cat_file(f"{place}/2.png")
    (here / "pipeline.yaml").write_text(PIPELINE.format(base))
    for content, expected, reused in ((whole[:200], 6, 0), (whole, 0, 3)):
        system.pipe_file(f"{place}/2.png", content)
        urls.REMOTE.set(None)
        code, out, _ = run("run", "pipeline.yaml", "--json", "-j", 1)
        assert (code, JOURNAL in contents(base)) == (expected, expected != 0)
        assert json.loads(out)["steps"][0]["figures"]["reused"] == reused


def test_an_upload_of_a_list_that_fails_is_tried_again_later(here, memory, monkeypatch):
    tried = []

    def refused(source, url):
        tried.append(url)
        raise OSError("no connection")

    path = Path(remote.given("memory://lab/.corners.csv.camcal-journal"))
    monkeypatch.setattr(remote, "_upload", refused)
    with pytest.raises(FileError, match="cannot be reached: no connection"):
        urls.append(path, b"first\n")
    urls.append(path, b"second\n")
    assert tried == ["memory://lab/.corners.csv.camcal-journal"]
    monkeypatch.undo()
    urls.flush(path)
    assert memory.cat_file("/lab/.corners.csv.camcal-journal") == b"first\nsecond\n"
