"""Files that are not as they should be, among others in their folder: one line for each, and the others are used."""

import json
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from camcal.images.files import save
from camcal.progress import Silent
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort
from camcal.tasks.options import GivenCamera

BOARD = "chessboard:7x5:25mm"
LENS = ["--camera-matrix", "300,300,99.5,79.5"]
SQUARES = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((20, 20))).astype(np.uint8) * 160 + 40
PICTURE = np.pad(SQUARES, 20, constant_values=200)
NAMES = {"spaces": " a b .png", "not UTF-8": "a\udcff b.png", "a dash": "-o.png", "marks": "a#b=c;'$x_y$\"%s.png"}
COMMANDS = {
    "detect": ["detect", "photos", "-b", BOARD, "-o", "d.csv"],
    "undistort": ["undistort", *LENS, "photos", "-o", "out"],
    "demosaic": ["demosaic", "photos", "--pattern", "RGGB", "--trust-pattern", "-o", "out"],
    "pnp": ["pnp", *LENS, "photos", "-b", BOARD, "-o", "p.csv"],
    "pnp as YAML": ["pnp", *LENS, "photos", "-b", BOARD, "-o", "p.yaml"],
    "stereo check": ["stereo", "check", "photos", "photos_right", "-o", "out"],
}
ROWS = [
    pytest.param(words, id=name, marks=[pytest.mark.slow] * (name == "stereo check"))
    for name, words in COMMANDS.items()
]


@pytest.fixture
def photos(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path("photos")
    folder.mkdir()
    save(folder / "good.png", PICTURE)
    return folder


def put(folder, name):
    """Save the picture under a name, which a file system may refuse."""
    try:
        save(folder / "new.png", PICTURE)
        (folder / "new.png").rename(folder / name)
    except OSError:
        pytest.skip(f"this file system takes no {name!r}")


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
@pytest.mark.parametrize("command", ROWS)
def test_images_of_any_name_are_read_and_recorded(run, photos, command, name):
    put(photos, name)
    if "check" in command:
        right = Path("photos_right")
        right.mkdir()
        save(right / "good.png", PICTURE)
        put(right, name)
    code, out, err = run(*command, "--jobs", "1", "--json")
    assert code == 0, err
    assert "good.png" in out
    json.loads(out)
    for written in (path for path in Path().iterdir() if path.is_file()):
        assert "good.png" in written.read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["detect", "undistort", "demosaic", "pnp"])
def test_bad_files_of_a_folder_cost_themselves_only(run, photos, command):
    (photos / "empty.png").touch()
    (photos / "cut.png").write_bytes((photos / "good.png").read_bytes()[:200])
    (photos / "gone.png").symlink_to("nowhere.png")
    (photos / "text.png").write_text("no image\n")
    code, out, err = run(*COMMANDS[command], "--jobs", "1")
    assert code == 6, err
    said = out + err
    assert "Traceback" not in said
    for name in ("empty.png", "cut.png", "gone.png: a broken link to nowhere.png", "text.png"):
        assert name in said


def test_a_folder_of_broken_links_alone_says_that_they_are(run, photos):
    (photos / "good.png").unlink()
    (photos / "gone.png").symlink_to("nowhere.png")
    code, _, err = run(*COMMANDS["detect"])
    assert code == 3
    assert "photos/gone.png: a broken link to nowhere.png" in err


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_image_that_vanishes_between_listing_and_reading_costs_itself_only(photos, jobs):
    save(photos / "vanishing.png", PICTURE)

    class Thief(Silent):
        def start(self, what, total):
            (photos / "vanishing.png").unlink(missing_ok=True)

    camera = GivenCamera(camera_matrix=(300.0, 300.0, 99.5, 79.5))
    options = UndistortOptions(inputs=("photos",), given=camera, output=Path("out"), jobs=jobs)
    report = undistort(options, progress=Thief())
    errors = [str(outcome.error) for outcome in report.outcomes if outcome.error is not None]
    assert errors == ["photos/vanishing.png: no such file"]
    assert [path.name for path in Path("out").glob("*.png")] == ["good.png"]


@pytest.mark.parametrize("command", ["detect", "undistort", "pnp"])
def test_bit_depths_and_channels_may_be_mixed_in_a_folder(run, photos, command):
    colour = np.stack([PICTURE] * 3, axis=2)
    save(photos / "deep.png", PICTURE.astype(np.uint16) * 257)
    save(photos / "colour.png", colour)
    save(photos / "alpha.png", np.dstack([colour, np.full_like(PICTURE, 255)]))
    save(photos / "float.tiff", PICTURE.astype(np.float32) / 255)
    code, out, err = run(*COMMANDS[command], "--jobs", "1", "--json")
    assert code == 0, err
    for name in ("deep.png", "colour.png", "alpha.png", "float.tiff"):
        assert name in out


def test_a_pair_of_different_bit_depths_is_compared(run, photos):
    texture = np.random.default_rng(1).integers(0, 256, (60, 80)).astype(np.uint8).repeat(4, 0).repeat(4, 1)
    save(Path("left.png"), texture)
    save(Path("right.png"), np.roll(texture, -8, axis=1).astype(np.uint16) * 257)
    code, out, err = run("stereo", "check", "left.png", "right.png")
    assert code == 0, err
    assert "exposures agree" in out


def test_a_video_that_cannot_be_read_leaves_nothing_behind(run, photos):
    Path("clip.avi").write_bytes(b"RIFF\0\0\0\0AVI LIST")
    code, _, err = run("undistort", *LENS, "--size", "200x160", "clip.avi", "-o", "out")
    assert code in {2, 3}, err
    assert not Path("out").exists()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="users of POSIX systems")
@pytest.mark.parametrize(("closed", "more"), [("photos", []), ("photos/deep", ["--recursive", "--resume"])])
def test_a_folder_that_may_not_be_read_is_told(run, monkeypatch, closed, more):
    superuser = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as room:  # that of the tests is closed to other users
        monkeypatch.chdir(room)
        Path(room).chmod(0o777)
        save(Path("photos/good.png"), PICTURE)
        save(Path("photos/deep/good.png"), PICTURE)
        run("detect", "photos", "-b", BOARD, "-o", "first.csv")  # imports what another user may not read
        Path(closed).chmod(0)
        if superuser:  # who may read every folder
            os.seteuid(65534)
        try:
            code, _, err = run(*COMMANDS["detect"], *more)
        finally:
            if superuser:
                os.seteuid(0)
            Path(closed).chmod(0o755)
        monkeypatch.undo()
    assert code == 3
    assert err == f"camcal: error: {closed}: cannot be read: Permission denied\n"
