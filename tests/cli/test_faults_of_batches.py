"""Faults of a batch are the same on this machine, with `--resume` and on a cluster.

A bad file costs itself only, what is good has the same bytes, and what is repaired is made by the next run while the
rest is reused.
"""

import gc
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.images.files import save
from camcal.progress import SILENT, Silent
from camcal.run import cluster
from camcal.run.options import BatchOptions
from camcal.run.outputs import listed
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort
from camcal.tasks.options import GivenCamera

sys.path.insert(0, str(Path(__file__).parents[1]))

from batch_scenes import recorded
from dask_cluster import dask_cluster, wait_until

CAMCAL = "import sys; from camcal.cli.main import main; sys.argv[0] = 'camcal'; main()"
LENS = ("--camera-matrix", "120,120,79.5,63.5", "--distortion", "-0.2,0.05,0,0")
COMMANDS = {
    "undistort": ("undistort", *LENS, "photos", "-o", "{}"),
    "detect": ("detect", "photos", "-b", "chessboard:7x5:25mm", "-o", "{}/corners.csv"),
    "pnp": ("pnp", *LENS, "photos", "-b", "chessboard:7x5:25mm", "-o", "{}/poses.csv"),
}
SQUARES = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((16, 16))).astype(np.uint8) * 160 + 40
PICTURE = np.pad(SQUARES, 16, constant_values=200)
COLOUR = np.dstack([PICTURE] * 3)
GOOD = {
    "1970.png": PICTURE,
    "future.png": PICTURE[::-1],
    "a b.png": PICTURE,
    "new\nline.png": PICTURE,
    "not UTF-8 \udcff.png": PICTURE,
    "deep.png": PICTURE.astype(np.uint16) * 257,
    "colour.png": COLOUR,
    "alpha.png": np.dstack([COLOUR, np.full_like(PICTURE, 255)]),
    "float.tiff": PICTURE.astype(np.float32) / 255,
}
BAD = ["cut.jpg", "cut.png", "empty.png", "gone.png", "text.png"]
BAD_IN_TABLES = [*BAD[:-1], "new\nline.png", BAD[-1]]
FUTURE_S = 4e9  # 2096

pytestmark = [  # of connections to clusters; Dask leaves their sockets to the collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
HERE_AND_THERE = pytest.mark.parametrize("where", ["here", pytest.param("there", marks=pytest.mark.slow)])


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    with dask_cluster(tmp_path_factory.mktemp("dask")) as running:
        yield running.url
    gc.collect()


@pytest.fixture
def extra(request, where):
    """What makes a run be worked on here, by this process, or there, by the workers of a cluster."""
    return ("-j", 1) if where == "here" else ("--scheduler", request.getfixturevalue("scheduler"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, where no temporary file is left behind, nor in the folder for such files."""
    room = tmp_path / "temporary"
    room.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(room))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert [path.name for path in room.iterdir() if path.name != "dask-scratch-space"] == []  # Dask keeps its locks
    assert list(tmp_path.rglob(".camcal.part-*")) == []


def put(name, pixels):
    """Save a picture under any name; a file system that does not take it is without this picture."""
    made = Path(f"new{Path(name).suffix}")
    save(made, pixels)
    try:
        made.rename(Path("photos") / name)
    except OSError:
        made.unlink()


def put_all():
    """Make a folder of good and bad files."""
    Path("photos", "folder.png").mkdir(parents=True)
    for name, pixels in GOOD.items():
        put(name, pixels)
    os.utime("photos/1970.png", (0, 0))
    os.utime("photos/future.png", (FUTURE_S, FUTURE_S))
    save(Path("photos/cut.jpg"), PICTURE)
    for name, size in (("cut.jpg", 500), ("alpha.png", 200)):
        Path("photos", f"cut{Path(name).suffix}").write_bytes(Path("photos", name).read_bytes()[:size])
    Path("photos/empty.png").touch()
    Path("photos/gone.png").symlink_to("nowhere.png")
    Path("photos/text.png").write_text("no image\n")


def repair(bad):
    """Put pictures in the place of bad files; one with a name that a table cannot hold gets another."""
    for name in bad:
        Path("photos", name).unlink()
        put(name.replace("\n", " "), PICTURE)


def contents(folder):
    """The bytes of all files but the list of camcal, which commands with one result keep with --resume only."""
    return {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.name[0] != "."}


def outcome(result):
    """The exit code of a run, its failed images with the reasons, and how many it has reused."""
    code, out, err = result
    assert "Traceback" not in err
    document = json.loads(out)
    assert ("; with --resume" in err) == (document["schema"] != "camcal/undistort/1" and code == 6)
    failed = [each["message"] if isinstance(each, dict) else each for each in document["failed"]]
    return code, failed, document["reused"]


@HERE_AND_THERE
@pytest.mark.parametrize("command", ["undistort", "detect", pytest.param("pnp", marks=pytest.mark.slow)])
def test_bad_files_cost_themselves_only_until_they_are_repaired(run, folder, extra, command):
    def into(output, *more):
        return outcome(run(*(word.format(output) for word in COMMANDS[command]), "--json", *more))

    put_all()
    bad = BAD if command == "undistort" else BAD_IN_TABLES
    expected = into("expected", "-j", 1)
    assert (expected[0], len(expected[1])) == (6, len(bad))
    for name, message in zip(bad, expected[1], strict=True):
        assert message.startswith(f"photos/{name}: ".replace("\n", "\\n"))
    assert into("out", *extra) == expected
    for path in Path("out").iterdir():
        os.utime(path, (0, 0))  # older than all that it was made from
    good = len(list(Path("photos").glob("*.*"))) - 1 - len(bad)
    assert into("out", *extra, "--resume") == (*expected[:2], good)
    assert contents("out") == contents("expected")
    repair(bad)
    assert into("out", *extra, "--resume") == (0, [], good)
    assert into("whole", "-j", 1) == (0, [], 0)
    assert contents("out") == contents("whole")
    assert [path for path in Path("out").iterdir() if "journal" in path.name] == []


@HERE_AND_THERE
@pytest.mark.parametrize("resume", [False, True])
def test_an_input_that_vanishes_costs_itself_only(folder, request, where, resume):
    Path("photos").mkdir()
    for name in ("1.png", "2.png", "3.png"):
        put(name, PICTURE)
    if resume:
        undistorted(None, resume)
        Path("out/3.png").unlink()

    class Thief(Silent):
        def start(self, what, total):
            Path("photos/2.png").unlink(missing_ok=True)

    report = undistorted(request.getfixturevalue("scheduler") if where == "there" else None, resume, Thief())
    assert [str(each.error) for each in report.failed] == ["photos/2.png: no such file"]
    assert [each.reused for each in report.outcomes] == [resume, False, False]
    assert Path("out/1.png").read_bytes() == Path("out/3.png").read_bytes()


def undistorted(scheduler, resume, progress=SILENT):
    lens = GivenCamera(camera_matrix=(120.0, 120.0, 79.5, 63.5))
    batch = BatchOptions(resume=resume, scheduler=scheduler)
    options = UndistortOptions(inputs=("photos",), given=lens, output=Path("out"), jobs=1, batch=batch)
    return undistort(options, progress)


@HERE_AND_THERE
def test_images_65_000_pixels_wide_are_drawn(run, folder, extra):
    ramp = np.arange(65000) // 300
    save(Path("photos/0.png"), np.stack([ramp, ramp[::-1]] * 3).astype(np.uint8))
    words = ("undistort", "--camera-matrix", "60000,60000,32499.5,2.5", "--distortion", "-0.2,0,0,0", "photos", "-o")
    assert run(*words, "out", *extra)[0] == 0
    drawn = cv2.imread("out/0.png", cv2.IMREAD_UNCHANGED)
    assert drawn.shape == (6, 65000)
    assert np.abs(drawn.astype(int) - drawn[:, ::-1][::-1]).max() <= 1  # halves of a grey level are rounded up
    again = run(*words, "out", *extra, "--resume")
    assert (again[0], "nothing to do: 1 image complete and unchanged" in again[1]) == (0, True)
    assert run(*words, "expected", "-j", 1)[0] == 0
    assert contents("out") == contents("expected")


# Python cuts the bytecode of what it imports off where a file may not grow, and every later process reads the rest.
WITHOUT_BYTECODE = {"PYTHONDONTWRITEBYTECODE": "1"}


def small_files():
    """Let this process and those that it starts write no file of more than some kilobytes, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))


@pytest.mark.slow
@pytest.mark.usefixtures("local_cluster")
@pytest.mark.parametrize(("command", "where"), [("undistort", "here"), ("undistort", "there"), ("detect", "here")])
def test_a_full_disk_costs_what_it_does_not_take_and_the_rest_is_reused(run, folder, where, command):
    """The one table of detections is written here wherever the images are searched."""
    Path("photos").mkdir()
    noise = np.random.default_rng(1).integers(0, 99, PICTURE.shape).astype(np.uint8)
    for number in range(6):
        put(f"{number}.png", noise if number == 3 else PICTURE)
    extra = ("-j", "1") if where == "here" else ("-j", "1", "--scheduler", "dask://local")

    def into(output, *more):
        return [*(word.format(output) for word in COMMANDS[command]), *more]

    full = subprocess.run(
        [sys.executable, "-c", CAMCAL, *into("out", *extra)],
        env=os.environ | {"TMPDIR": tempfile.gettempdir(), **WITHOUT_BYTECODE},
        preexec_fn=small_files,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in full.stderr
    if command == "undistort":
        assert full.returncode == 6, full.stderr
        assert "camcal: failed: out/3.png: cannot be written: File too large" in full.stderr
    else:
        assert full.returncode == 3, full.stderr
        assert "out/corners.csv: cannot be written: File too large" in full.stderr
    code, out, err = run(*into("out", *extra, "--resume", "--json"))
    assert (code, "Traceback" in err) == (0, False), err
    assert json.loads(out)["reused"] == (5 if command == "undistort" else 1)
    assert run(*into("expected", "-j", "1"))[0] == 0
    assert contents("out") == contents("expected")


@pytest.mark.slow
def test_a_run_whose_scheduler_was_lost_is_resumed_to_the_same_bytes(run, folder, monkeypatch):
    monkeypatch.setattr(cluster, "_PATIENCE_S", 2.0)
    Path("photos").mkdir()
    for number in range(300):
        put(f"{number}.png", PICTURE)
    words = COMMANDS["undistort"]

    with dask_cluster(folder) as running:

        def lose_scheduler():
            wait_until(lambda: recorded() > 20)
            running.kill("scheduler")

        thief = threading.Thread(target=lose_scheduler)
        thief.start()
        call = (*(word.format("out") for word in words), "--scheduler", running.url)
        code, _, err = run(*call)
        thief.join()
        running.wait_for_end("worker")
        assert code == 3
        assert err.startswith(f"camcal: error: {running.url}: the scheduler was lost and did not come back in 2 s; ")
        assert "--resume" in err
        assert (done := recorded()) < 300
        assert len(listed(Path("out"))) == 301  # with the camera file: a worker may still finish one of the others
        running.start()
        code, out, _ = run(*call, "--resume", "--json")
        assert (code, json.loads(out)["reused"]) == (0, done)
    assert run(*(word.format("expected") for word in words), "-j", 1)[0] == 0
    assert contents("out") == contents("expected")
