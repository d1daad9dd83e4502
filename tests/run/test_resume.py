"""Batches that are resumed: what is complete and matches is left as it is, the rest is made as it would have been."""

import os
from pathlib import Path

import numpy as np
import pytest

from camcal import files
from camcal.errors import InvalidInput
from camcal.images.files import save
from camcal.run import fingerprint
from camcal.run.fingerprint import MANIFEST
from camcal.run.options import BatchOptions
from camcal.run.outputs import claim, watch_files
from camcal.run.resume import Items, resumable
from camcal.tasks.calibration.undistort import UndistortOptions, undistort
from camcal.tasks.options import GivenCamera

COUNT = 5
CAMERA = GivenCamera(camera_matrix=(50.0, 50.0, 31.5, 23.5), distortion=(-0.2, 0.0, 0.0, 0.0))
RESUME = BatchOptions(resume=True)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of small images, from which runs write into `out` beside it."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    for number in range(COUNT):
        save(Path("in") / f"{number}.png", rng.integers(0, 255, (48, 64), np.uint8))
    return tmp_path


def run(*, resume=True, camera=CAMERA, **more):
    options = UndistortOptions(None, Path("out"), ("in",), camera, batch=BatchOptions(resume=resume), **more)
    return undistort(options)


def redone(report):
    """The names of the outputs that were not reused."""
    return [outcome.value.output.name for outcome in report.outcomes if not outcome.reused]


def contents(folder=Path("out")):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def times(folder=Path("out")):
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_a_second_run_does_nothing_whether_the_first_was_resumed_or_not(folder):
    first = run(resume=False)
    assert not any(outcome.reused for outcome in first.outcomes)
    before = contents(), times()
    again = run()
    assert (contents(), times()) == before
    assert redone(again) == []
    assert [outcome.value for outcome in again.outcomes] == [outcome.value for outcome in first.outcomes]


@pytest.mark.parametrize("left", [0, 1, 1000])
def test_outputs_that_are_missing_or_cut_off_are_made_again(folder, left):
    run()
    before = contents()
    Path("out/1.png").unlink()
    os.truncate("out/3.png", left)
    assert redone(run()) == ["1.png", "3.png"]
    assert contents() == before


def test_only_inputs_that_changed_are_worked_on_again(folder):
    run()
    save(Path("in/2.png"), np.zeros((48, 64), np.uint8))
    save(Path("in/5.png"), np.zeros((48, 64), np.uint8))
    os.utime("in/1.png", (0, 0))
    assert redone(run()) == ["2.png", "5.png"]


@pytest.mark.parametrize(
    "more",
    [{"camera": GivenCamera(camera_matrix=(51.0, 50.0, 31.5, 23.5))}, {"border": (7.0,)}, {"interpolation": "cubic"}],
    ids=lambda more: next(iter(more)),
)
def test_another_camera_or_option_makes_all_outputs_again(folder, more):
    run()
    assert len(redone(run(**more))) == COUNT
    assert redone(run(**more)) == []


def test_another_version_of_camcal_makes_all_outputs_again(folder, monkeypatch):
    run()
    monkeypatch.setattr("camcal.__version__", "999.0")
    assert len(redone(run())) == COUNT


@pytest.mark.parametrize("resume", [True, False])
@pytest.mark.parametrize("change", [lambda content: content + b"x", lambda content: b"mine"], ids=["longer", "shorter"])
def test_an_output_that_was_changed_by_hand_is_kept_unless_it_may_be_overwritten(folder, resume, change):
    run()
    path = Path("out/1.png")
    before = contents()
    mine = change(path.read_bytes())
    path.write_bytes(mine)
    try:
        failed = [outcome.error for outcome in run(resume=resume).outcomes if outcome.error is not None]
    except InvalidInput as error:
        failed = [error]
    assert [str(error) for error in failed] == [
        "out/1.png: exists and was changed after camcal wrote it; use --overwrite or another output"
    ]
    assert path.read_bytes() == mine
    assert redone(run(overwrite=True)) == ["1.png"]
    assert contents() == before


def test_an_input_that_is_gone_fails_or_is_left_out_and_its_output_is_kept(folder):
    run()
    before = contents()
    Path("in/1.png").unlink()
    report = run()
    assert (redone(report), len(report.outcomes)) == ([], COUNT - 1)
    assert contents() == before


def test_the_list_of_an_earlier_version_has_no_hashes_and_everything_is_made_again(folder):
    run()
    before = contents()
    names = sorted(set(before) - {MANIFEST})
    Path("out", MANIFEST).write_text("".join(f"{name}\n" for name in names))
    assert len(redone(run())) == COUNT
    assert contents() == before


def test_a_broken_last_line_is_ignored(folder):
    run()
    before = contents()
    entry = fingerprint.entries(Path("out"))["1.png"]
    fingerprint.append(Path("out"), {"1.png": None})
    with Path("out", MANIFEST).open("a") as stream:
        stream.write("\t".join(map(str, entry))[:90])
    assert redone(run()) == ["1.png"]
    assert contents() == before


@pytest.mark.parametrize(
    "result", ["", "{}", "[1]", '{"files": [7], "value": {}}', '{"files": [0], "value": {"size": 1}}']
)
def test_a_result_in_the_list_that_cannot_be_read_is_made_again(folder, result):
    run()
    entry = fingerprint.entries(Path("out"))["1.png"]
    fingerprint.change(Path("out"), {"1.png": entry._replace(result=result)})
    assert redone(run()) == ["1.png"]


def test_the_list_is_the_same_for_any_number_of_jobs_and_any_order_of_the_folder(folder, monkeypatch):
    run(jobs=1)
    before = contents()
    for path in Path("out").iterdir():
        path.unlink()
    listing = Path.iterdir
    with monkeypatch.context() as patch:
        patch.setattr(Path, "iterdir", lambda self: iter(sorted(listing(self), reverse=True)))
        run(jobs=2)
    assert contents() == before


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_enough_where_nothing_is_left_to_do(folder):
    run()
    Path("out").chmod(0o500)
    try:
        assert redone(run()) == []
    finally:
        Path("out").chmod(0o700)


def test_a_size_in_the_list_that_is_no_size_is_ignored(folder):
    run()
    text = Path("out", MANIFEST).read_text()
    size = str(fingerprint.entries(Path("out"))["1.png"].size)
    Path("out", MANIFEST).write_text(text.replace(f"\t{size}\t", f"\t{'9' * 5000}\t", 1))
    assert "1.png" not in fingerprint.entries(Path("out"))


def lengths(texts, *, fail_fast=False, stream=False):
    """Write the length of each text to two files; return of each what became of it: its name, reused, made or failed.

    stream: the texts come one after another.
    """

    def outputs(path):
        return [Path("out", f"{path.stem}.{kind}") for kind in ("a", "b")]

    def measured(path):
        for output in outputs(path):
            files.write_text(output, f"{len(files.read_text(path))}\n")
        return path.stem

    items = Items("any", lambda path: [path], outputs, str)
    with watch_files() as account:
        account.resume = True
        claim(output for path in texts for output in outputs(path))
        every = (path for path in texts) if stream else texts
        found = list(resumable(measured, every, items, jobs=1, batch=BatchOptions(fail_fast=fail_fast, resume=True)))
    return [(each.item.stem, "failed" if each.error else "reused" if each.reused else "made") for each in found]


@pytest.fixture
def texts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in range(3):
        Path(f"{number}.txt").write_text("some text\n")
    return [Path(f"{number}.txt") for number in range(3)]


@pytest.mark.parametrize("stream", [False, True])
def test_an_item_with_a_file_that_another_run_has_made_since_is_made_again(texts, stream):
    lengths(texts)
    entry = fingerprint.entries(Path("out"))["1.b"]
    fingerprint.change(Path("out"), {"1.b": entry._replace(made_from="0" * 64)})
    assert lengths(texts, stream=stream) == [("0", "reused"), ("1", "made"), ("2", "reused")]
    assert lengths(texts, stream=stream) == [("0", "reused"), ("1", "reused"), ("2", "reused")]


def test_what_is_made_again_with_the_same_content_is_not_written(texts):
    lengths(texts)
    before = times()
    texts[1].write_text("same size\n")
    assert lengths(texts) == [("0", "reused"), ("1", "made"), ("2", "reused")]
    assert {name: time for name, time in times().items() if name != MANIFEST} == {
        name: time for name, time in before.items() if name != MANIFEST
    }


def test_an_output_of_the_same_size_with_another_content_is_not_reused_and_not_replaced(texts):
    lengths(texts)
    Path("out/1.a").write_text("11\n")
    with pytest.raises(InvalidInput, match="was changed after camcal wrote it"):
        lengths(texts)


def test_inputs_after_one_that_is_gone_are_compared_whatever_ends_the_run(texts):
    lengths(texts)
    texts[0].unlink()
    assert lengths(texts, fail_fast=True) == [("0", "failed"), ("1", "reused"), ("2", "reused")]


def test_the_list_is_in_natural_order(texts):
    Path("10.txt").write_text("some text\n")
    lengths([*texts, Path("10.txt")])
    assert list(fingerprint.entries(Path("out"))) == ["0.a", "0.b", "1.a", "1.b", "2.a", "2.b", "10.a", "10.b"]
