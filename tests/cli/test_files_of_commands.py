"""What every command does with files, by the declarations of its options: a new command is covered by being there.

No input is overwritten, whatever option names it and however; nothing that others wrote is replaced unasked; an output
that cannot be is refused before the work, and in the same words everywhere.
"""

import os
from itertools import cycle, product
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from camcal.cli.main import COMMANDS, app
from camcal.errors import InvalidInput
from camcal.formats import disparity, disparity_sidecar
from camcal.formats.disparity_sidecar import Sidecar
from camcal.images.files import save
from camcal.options import GENERAL, OUTPUT, PATH
from camcal.run.options import inputs_of
from camcal.stereo.disparity import StereoGeometry

MINE = b"mine\n"
WAYS = list(product(("itself", "hard", "symbolic"), ("{}", "{}#left", "left={}")))


def declared_by_command():
    root = get_command(app)
    found = {}
    for entry in COMMANDS:
        command = root
        for word in entry.name.split():
            command = command.commands[word]
        if entry.function:
            found[entry.name] = command.declared
    return found


OPTIONS = declared_by_command()
WRITING = {name: every for name, every in OPTIONS.items() if any(each.option.written for each in every)}


def outputs(name):
    return [each for each in OPTIONS[name] if each.option.written]


def names_inputs(each, path):
    """Tell whether a text of the option can name this file as what is read."""
    if each.flag or each.option.values > 1:
        return False
    try:
        return path in inputs_of(each, each.read((str(path),) if each.several else str(path)))
    except InvalidInput:  # it takes something else, such as a number
        return False


def file_name(output, stem="name"):
    """Return a name that the option of an output takes for a file; without a suffix for a folder."""
    return stem + next((suffix for suffix in output.option.written.known if suffix), "")


def words(name, chosen):
    """Return a command line with texts for these options, and for whatever has to be given besides."""
    every = OPTIONS[name]
    last = max((place for place, each in enumerate(every) if each.positional and each in chosen), default=-1)
    for place, each in enumerate(every):
        if each not in chosen and (each.required or (each.positional and place < last)):
            chosen[each] = file_name(each, "other") if each.option.written else "1"
    named = [word for each, text in chosen.items() if not each.positional for word in (each.name, text)]
    return [*name.split(), *named, *(chosen[each] for each in every if each.positional and each in chosen)]


def by_another_name(path, way):
    if way == "itself":
        return path
    other = path.with_stem(way)
    if not other.exists():
        (other.hardlink_to if way == "hard" else other.symlink_to)(path)
    return other


def try_to_overwrite(run, name, each, output, path, way, address):
    path.write_bytes(MINE)
    text = address.format(by_another_name(path, way))
    line = words(name, {each: text, output: str(path)})
    code, _, err = run(*line, "--overwrite")
    assert path.read_bytes() == MINE, line
    assert (code, "is an input and is not overwritten; choose another output" in err) == (2, True), (line, err)


def pairs(name, folder):
    """Yield every input option with every output option, and a file that both can name."""
    for output in outputs(name):
        path = folder / file_name(output, "input")
        yield from ((each, output, path) for each in OPTIONS[name] if names_inputs(each, path))


@pytest.mark.parametrize("name", WRITING)
def test_no_option_writes_over_what_another_one_reads(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    ways = cycle(WAYS)
    for each, output, path in pairs(name, tmp_path):
        way = next(ways) if each.type is not PATH else (next(ways)[0], "{}")
        try_to_overwrite(run, name, each, output, path, *way)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITING)
def test_nor_under_any_other_name_of_it(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    for (each, output, path), way in product(pairs(name, tmp_path), WAYS):
        if each.type is not PATH or way[1] == "{}":
            try_to_overwrite(run, name, each, output, path, *way)


@pytest.mark.parametrize("name", OPTIONS)
def test_settings_are_written_over_no_input_and_over_nothing_of_others(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "settings.yaml"
    path.write_bytes(MINE)
    code, _, err = run(*name.split(), "--write-config", path)
    assert (code, "settings.yaml: exists and was not written by camcal" in err) == (2, True)
    each = next((each for each in OPTIONS[name] if names_inputs(each, path)), None)
    if each is not None:
        line = words(name, {each: str(path)})
        code, _, err = run(*line, "--write-config", path)
        assert (code, "is an input and is not overwritten" in err) == (2, True), (line, err)
    assert path.read_bytes() == MINE


@pytest.mark.parametrize("name", WRITING)
def test_what_others_wrote_is_replaced_by_no_command_unasked(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    for output in outputs(name):
        path = tmp_path / file_name(output)
        path.write_bytes(MINE)
        code, _, err = run(*words(name, {output: path.name}))
        assert path.read_bytes() == MINE
        if output.option.written.known:
            reason = f"{path.name}: exists and was not written by camcal; use --overwrite or another output"
        else:
            reason = f"{path.name}: {output.name} takes a folder, this is a file"
        assert (code, err) == (2, f"camcal: error: {reason}\n")
        path.unlink()


@pytest.mark.parametrize("name", WRITING)
def test_an_output_that_cannot_be_is_refused_before_the_work(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_bytes(MINE)
    for output in outputs(name):
        written = output.option.written
        code, _, err = run(*words(name, {output: f"file/{file_name(output)}"}))
        assert (code, "cannot be written: file is not a folder" in err) == (3, True), err
        if written.known:
            code, _, err = run(*words(name, {output: "name.zzz"}))
            listed = ", ".join(suffix for suffix in written.known if suffix)
            assert (code, err) == (2, f"camcal: error: name.zzz: .zzz is not written; use {listed}\n")
        if not written.stdout:
            code, _, err = run(*words(name, {output: "-"}))
            assert (code, err) == (2, f"camcal: error: {output.name} does not write to standard output; name a file\n")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", OPTIONS)
def test_an_input_whose_suffix_contradicts_its_content_is_refused(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path = Path("input.json")
    path.write_text("%YAML 1.1\n---\nformat: camcal\n")
    for each in OPTIONS[name]:
        if names_inputs(each, path):
            code, _, err = run(*words(name, {each: str(path)}))
            reason = "the suffix is .json and the file holds YAML; rename it"
            assert (code, err) == (3, f"camcal: error: input.json: {reason}\n"), each.name


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
@pytest.mark.parametrize("name", WRITING)
def test_a_folder_that_may_not_be_written_is_told_before_the_work(run, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "closed").mkdir(mode=0o555)
    for output in outputs(name):
        code, _, err = run(*words(name, {output: f"closed/{file_name(output)}"}))
        assert (code, "no permission to write into" in err) == (3, True)


def test_every_command_that_writes_can_be_told_to_overwrite():
    assert {name for name, every in OPTIONS.items() if any(each.name == "--overwrite" for each in every)} == set(
        WRITING
    )


def test_no_option_of_a_path_is_neither_read_nor_written():
    for name, every in OPTIONS.items():
        for each in every:
            outside = each.option.written is None and each.option.group in (OUTPUT, GENERAL)
            assert not (each.type is PATH and outside), (name, each.name)


@pytest.fixture
def simulated(run, tmp_path, monkeypatch):
    """A folder that `camcal simulate` has written, as the current one."""
    monkeypatch.chdir(tmp_path)
    assert run("simulate", "chessboard:4x3:40mm", "-o", "out", "--views", 1, "--size", "96x72", "-j", 1)[0] == 0
    return tmp_path / "out"


def test_a_simulation_keeps_the_camera_and_the_board_it_reads(run, simulated):
    before = {path: path.read_bytes() for path in simulated.rglob("*") if path.is_file()}
    for inputs in (("out/board.yaml",), ("chessboard:4x3:40mm", "out/truth.yaml")):
        code, _, err = run("simulate", *inputs, "-o", "out", "--views", 1, "-j", 1, "--overwrite")
        assert (code, "is an input and is not overwritten" in err) == (2, True), err
    assert {path: path.read_bytes() for path in simulated.rglob("*") if path.is_file()} == before


def test_the_demonstration_keeps_a_camera_file_that_a_calibration_left_there(run, simulated):
    truth = (simulated / "truth.yaml").read_bytes()
    (simulated / "camera.yaml").write_bytes(truth)
    code, _, err = run("demo", "-o", "out", "--views", 3)
    assert (code, "camera.yaml: exists and was not written by camcal" in err) == (2, True)
    assert (simulated / "camera.yaml").read_bytes() == truth


def test_a_picture_takes_the_place_of_no_file_that_its_map_names(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(Path("left.png"), np.full((8, 12, 3), 90, np.uint8))
    disparity.write(Path("map.pfm"), np.full((8, 12), 4.0, np.float32))
    geometry = StereoGeometry(fx=10.0, fy=10.0, cx=6.0, cy=4.0, baseline=0.1)
    disparity_sidecar.write(Path("map.pfm"), Sidecar(geometry=geometry, image=Path("left.png")))
    before = Path("left.png").read_bytes()
    code, _, err = run("view", "map.pfm", "-o", "left.png", "--overwrite")
    assert (code, "left.png: is an input and is not overwritten" in err) == (2, True), err
    assert Path("left.png").read_bytes() == before


@pytest.mark.parametrize("command", ["fit", "smooth", "pnp", "view"])
def test_settings_are_inputs(run, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    each = outputs(command)[0]
    path = Path(file_name(each, "settings"))
    path.write_text("verbose: true\n")
    code, _, err = run(*words(command, {each: path.name}), "--config", path, "--overwrite")
    assert (code, "is an input and is not overwritten" in err) == (2, True), err
    assert path.read_text() == "verbose: true\n"


def test_one_image_goes_to_the_file_that_is_named(run, simulated):
    line = ("undistort", "out/truth.yaml", "out/images/view0000.png", "--mask", "-o", "one.jpg")
    assert run(*line)[0] == 0
    assert run(*line)[0] == 0
    found = sorted(path.name for path in Path().iterdir() if path.is_file())
    assert found == [".camcal-output", "one.camera.yaml", "one.jpg", "one.valid_mask.png"]
    code, _, err = run("undistort", "out/truth.yaml", "out/images/view0000.png", "--format", "png", "-o", "one.jpg")
    assert (code, "--format png is another type of file" in err) == (2, True)
