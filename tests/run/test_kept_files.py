"""What a run may replace: its own files, known by what they say or by the list of their folder, and no others."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Written
from camcal.run import fingerprint, outputs
from camcal.run.outputs import claim, says_camcal, writes
from camcal.tasks.options import Overwrite


@dataclass(frozen=True)
class Options(OptionsRecord):
    source: Annotated[Path, Argument("What is read.", metavar="SOURCE")]
    output: Annotated[Path, Option("Where.", group=OUTPUT, written=Written((".png", ".yaml"), folder=True))]
    other: Annotated[Path | None, Option("More.", group=INPUT)] = None
    names: tuple[str, ...] = ()
    overwrite: Overwrite = False


@writes
def work(options, content=b"result\n"):
    """Copy a file to an output, or into a folder under some names; what the source names is read too."""
    outputs = [options.output / name for name in options.names] or [options.output]
    claim(outputs)
    source = files.read_bytes(options.source)
    if source.startswith(b"see "):
        files.read_bytes(options.source.with_name(source[4:].decode()))
    for path in outputs:
        files.write_bytes(path, content)


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "in" / "source.txt"
    path.parent.mkdir()
    path.write_bytes(b"input\n")
    return path


def listed(folder):
    return sorted(outputs.listed(folder))


def test_a_second_run_replaces_what_the_first_one_wrote(source, tmp_path):
    for content in (b"one", b"two"):
        work(Options(source, tmp_path / "a.png"), content)
        work(Options(source, tmp_path / "out", names=("b.png", "c.yaml")), content)
    assert (tmp_path / "a.png").read_bytes() == b"two"
    assert (listed(tmp_path), listed(tmp_path / "out")) == (["a.png"], ["b.png", "c.yaml"])


def test_a_file_of_others_is_replaced_only_when_asked_and_is_camcals_then(source, tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"mine")
    with pytest.raises(InvalidInput, match=r"a\.png: exists and was not written by camcal; use --overwrite"):
        work(Options(source, path))
    assert (path.read_bytes(), listed(tmp_path)) == (b"mine", [])
    work(Options(source, path, overwrite=True))
    work(Options(source, path))
    assert (path.read_bytes(), listed(tmp_path)) == (b"result\n", ["a.png"])


def test_a_text_that_says_camcal_is_known_where_the_user_named_it_and_not_where_a_command_did(source, tmp_path):
    ours = b"%YAML 1.1\n---\n# camcal camera file. Units: pixels.\nformat: camcal\n"
    path = tmp_path / "out" / "camera.yaml"
    work(Options(source, path), ours)
    assert listed(path.parent) == []
    work(Options(source, path), ours)
    with pytest.raises(InvalidInput, match="was not written by camcal"):
        work(Options(source, path.parent, names=("camera.yaml",)))
    assert path.read_bytes() == ours


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"# camcal-poses 1 frames=a_T_b\n", True),
        (b'{\n "format": "camcal-poses",\n', True),
        (b'{"schema": "camcal/disparity/1"}', True),
        (b"# What camcal demosaic did\n", True),
        (b"# not of camcalculator\n", False),
        (b"a,b\n# camcal\n", False),
        (b"format: camcal-frames\n", False),
        (b"", False),
    ],
)
def test_what_says_that_camcal_wrote_a_text(tmp_path, content, says):
    (tmp_path / "text").write_bytes(content)
    assert says_camcal(tmp_path / "text") == says


def test_a_file_that_an_input_names_is_an_input(source, tmp_path):
    named = source.with_name("named.png")
    named.write_bytes(b"mine")
    source.write_bytes(b"see named.png")
    with pytest.raises(InvalidInput, match=r"named\.png: is an input and is not overwritten"):
        work(Options(source, named, overwrite=True))
    assert named.read_bytes() == b"mine"


def test_links_to_an_input_are_the_input(source, tmp_path):
    hard, symbolic = tmp_path / "hard.png", tmp_path / "symbolic.png"
    hard.hardlink_to(source)
    symbolic.symlink_to(source)
    for path in (hard, symbolic):
        with pytest.raises(InvalidInput, match="is an input"):
            work(Options(source, path, overwrite=True))
        with pytest.raises(InvalidInput, match="is an input"):
            work(Options(source, tmp_path, names=(path.name,), overwrite=True))
    with pytest.raises(InvalidInput, match="is an input"):
        work(Options(tmp_path / "missing", hard, other=source, overwrite=True))
    assert source.read_bytes() == b"input\n"


def test_a_run_that_fails_leaves_neither_a_list_nor_a_folder(source, tmp_path):
    with pytest.raises(FileError):
        work(Options(tmp_path / "missing", tmp_path / "new" / "out", names=("a.png",)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]
    kept = tmp_path / "kept.png"
    kept.write_bytes(b"mine")
    with pytest.raises(FileError):
        work(Options(tmp_path / "missing", kept, overwrite=True))
    assert (kept.read_bytes(), listed(tmp_path)) == (b"mine", [])


def test_a_file_is_no_folder_and_a_folder_no_file(source, tmp_path):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(FileError, match=r"a\.png: cannot be written: .*source\.txt is not a folder"):
        work(Options(source, source / "a.png"))
    with pytest.raises(InvalidInput, match="takes a folder, this is a file"):
        work(Options(source, source.with_suffix("")), b"") if source.with_suffix("").touch() is None else None
    with pytest.raises(FileError, match=r"folder\.png: is a folder, not a file"):
        work(Options(source, tmp_path, names=("folder.png",)))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no such files here")
def test_a_device_is_written_to_and_stays_one(source):
    work(Options(source, Path(os.devnull)))
    assert Path(os.devnull).is_char_device()


@pytest.mark.parametrize(
    ("suffix", "content", "kind"),
    [
        (".json", b"%YAML 1.1\n---\na: 1\n", "holds YAML"),
        (".json", b"a,b\n1,2\n", "does not begin as JSON does"),
        (".yaml", b'{\n "a": 1}', "holds JSON"),
        (".YML", b"<?xml version='1.0'?>", "holds XML"),
        (".csv", b"[[1, 2]]", "holds JSON"),
        (".csv", b"--- \na: 1", "holds YAML"),
        (".xml", b"%YAML:1.0\n", "holds YAML"),
        (".json", b'\xef\xbb\xbf {"a": 1}', None),
        (".json", b"[]", None),
        (".json", b"", None),
        (".yaml", b"a: 1\n", None),
        (".yaml", b"# a, b\n{a: 1}\n", None),
        (".csv", b'"a","b"\n', None),
        (".csv", b"-1,2\n", None),
        (".txt", b"{}", None),
    ],
)
def test_a_suffix_and_a_content_that_contradict_each_other(tmp_path, suffix, content, kind):
    path = tmp_path / f"file{suffix}"
    path.write_bytes(content)
    if kind is None:
        files.require_content(path)
    else:
        with pytest.raises(FileError, match=f"the suffix is {suffix} and the file {kind}; rename it"):
            files.require_content(path)


def test_a_file_that_another_process_writes_for_a_run_is_listed_with_its_hash(tmp_path):
    path = tmp_path / "a.png"
    with outputs.watch_files():
        claim([path])
        path.write_bytes(b"result\n")
    assert fingerprint.entries(tmp_path) == {"a.png": fingerprint.Entry.of(path)}


@pytest.mark.parametrize("elsewhere", [False, True])
def test_what_other_processes_write_for_a_resumed_run_is_listed_before(tmp_path, elsewhere):
    with outputs.watch_files() as run:
        run.resume = True
        claim([tmp_path / "a.png"], elsewhere=elsewhere)
        assert listed(tmp_path) == ["a.png"][:elsewhere]


@pytest.mark.parametrize("elsewhere", [0, 1])
def test_a_file_that_a_cluster_may_still_write_stays_listed(tmp_path, elsewhere):
    with outputs.watch_files() as run:
        claim([tmp_path / "a.png", tmp_path / "b.png"])
        files.write_bytes(tmp_path / "a.png", b"result\n")
        run.elsewhere = elsewhere
    assert listed(tmp_path) == ["a.png", "b.png"][: 1 + elsewhere]
