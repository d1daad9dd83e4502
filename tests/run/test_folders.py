"""Folders that a run writes into: one that is moved, removed or replaced meanwhile gets nothing more."""

from pathlib import Path

import numpy as np
import pytest
from fanout_work import write_image

from camcal import files, system
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import FileError
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save
from camcal.progress import SILENT
from camcal.run import fingerprint
from camcal.run.fanout import fan_out
from camcal.run.outputs import watch_files
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

LENS = Camera(model_named("opencv5"), (24, 16), np.array([20.0, 20, 12, 8, -0.1, 0, 0, 0, 0]))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
    for value, name in enumerate("abc"):
        save(tmp_path / "photos" / f"{name}.png", np.full((16, 24), 40 * value, np.uint8))
    return tmp_path


def swap_for_link(place, target):
    """Put a link into the place of a folder."""
    place.rename(place.with_name("moved"))
    place.symlink_to(target)


def names(place):
    return sorted(path.name for path in place.iterdir())


class Swapping:
    """Progress that puts a link into the place of the folder out when the first item is done."""

    def __init__(self, target):
        self.target = target

    def __getattr__(self, name):
        return getattr(SILENT, name)

    def advance(self, count=1):
        if not Path("out").is_symlink():
            swap_for_link(Path("out"), self.target)


def test_an_output_folder_that_becomes_a_link_ends_the_run_and_nothing_goes_through_it(folder):
    foreign = folder / "foreign"
    foreign.mkdir()
    (foreign / "c.png").write_bytes(b"theirs")
    fingerprint.change(foreign, {"c.png": None})  # which would else be replaced
    before = {path.name: path.read_bytes() for path in foreign.iterdir()}
    options = UndistortOptions("lens.yaml", Path("out"), ("photos",), jobs=1)
    with pytest.raises(FileError, match=r"out: was moved, removed or replaced while the run wrote into it"):
        undistort(options, Swapping(foreign))
    assert {path.name: path.read_bytes() for path in foreign.iterdir()} == before


def test_worker_processes_write_nothing_into_a_folder_that_was_exchanged(folder):
    (folder / "foreign").mkdir()
    items = [Path("out") / f"{number}.png" for number in range(40)]
    with watch_files():
        system.prepare(Path("out"))
        outcomes = fan_out(write_image, items, jobs=2, processes=True)
        next(outcomes)
        swap_for_link(Path("out"), folder / "foreign")
        with pytest.raises(FileError, match="replaced while the run wrote into it"):
            list(outcomes)
    assert names(folder / "foreign") == []


@pytest.mark.parametrize("name", ["b.png", "below/b.png"])
def test_a_folder_exchanged_while_a_file_is_made_does_not_get_it(folder, name):
    """Nor does another folder that takes its name."""

    def write_while_exchanged():
        with files.replacing(Path("out") / name) as temporary:
            temporary.write_bytes(b"ours")
            Path("out").rename("moved")
            (Path("out") / name).parent.mkdir(parents=True)
            (Path("out") / name).write_bytes(b"theirs")

    with watch_files():
        files.write_bytes(Path("out/a.png"), b"ours")
        with pytest.raises(FileError, match="replaced while the run wrote into it"):
            write_while_exchanged()
    assert (Path("out") / name).read_bytes() == b"theirs"
    assert [path.name for path in Path("out").rglob("*") if path.is_file()] == ["b.png"]


def test_no_folder_is_made_below_one_that_was_exchanged(folder):
    (folder / "foreign").mkdir()
    with watch_files():
        files.write_bytes(Path("out/a.png"), b"ours")
        swap_for_link(Path("out"), folder / "foreign")
        with pytest.raises(FileError, match="out: was moved"):
            files.write_bytes(Path("out/below/b.png"), b"ours")
        with pytest.raises(FileError, match="out: was moved"):
            fingerprint.append(Path("out"), {"a.png": None})
    assert names(folder / "foreign") == []
