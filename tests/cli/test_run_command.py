"""`camcal run`: which steps run and why, what is refused before one does, and what is reported."""

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_page import REGISTERED

from camcal import urls
from camcal.cli.call import ImageCall
from camcal.cli.pipeline import StepCommands
from camcal.options import declared
from camcal.run.options import counts
from camcal.tasks.options import CAMERA_SUFFIXES
from camcal.tasks.pipelines.reading import KEYS, OF_ALL_STEPS, STEP_KEYS
from camcal.tasks.pipelines.step import NOT_STEPS

CAMERAS = Path(__file__).parents[2] / "sample_configs" / "cameras"

CHAIN = """\
steps:
  second:
    command: convert
    arguments: [first.xml, second.yaml]
  first:
    command: convert
    arguments: [camera.yaml, first.xml]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a camera file and a pipeline of two steps, which stand in the wrong order; it is not the working
    directory.
    """
    place = tmp_path / "work"
    place.mkdir()
    shutil.copy(CAMERAS / "pinhole.yaml", place / "camera.yaml")
    (place / "pipeline.yaml").write_text(CHAIN)
    monkeypatch.chdir(tmp_path)
    return place


@pytest.fixture
def states(run, folder):
    """A function that runs the pipeline and gives its exit code, and the states of its steps by their names."""

    def call(*options, text=None):
        if text is not None:
            (folder / "pipeline.yaml").write_text(text)
        code, out, err = run("run", "work/pipeline.yaml", "--json", "--jobs", "1", *options)
        document = json.loads(out)
        assert document["exit"] == code
        if "steps" not in document:
            return code, err
        return code, {each["step"]: each["state"] for each in document["steps"]}

    return call


def refused(run, folder, text, *options):
    """Return the lines that refuse a pipeline, without the name of the file."""
    (folder / "pipeline.yaml").write_text(text)
    before = sorted(path.name for path in folder.iterdir())
    code, out, err = run("run", "work/pipeline.yaml", *options)
    assert (code, out, sorted(path.name for path in folder.iterdir())) == (2, "", before)
    return [line.removeprefix("camcal: error: ").removeprefix("work/pipeline.yaml:") for line in err.splitlines()]


def test_steps_run_in_the_order_of_their_files_and_once(states, folder):
    assert states() == (0, {"first": "done", "second": "done"})
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert states() == (0, {"first": "up_to_date", "second": "up_to_date"})
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_the_state_is_the_same_wherever_and_whenever_the_steps_ran(states, folder, tmp_path, run):
    states()
    shutil.copytree(folder, other := tmp_path / "other", ignore=lambda *_: [".pipeline.state.json", "first.xml"])
    os.utime(other / "camera.yaml", (0, 0))
    assert run("run", other / "pipeline.yaml", "--quiet")[0] == 0
    assert (other / ".pipeline.state.json").read_bytes() == (folder / ".pipeline.state.json").read_bytes()
    assert json.loads((folder / ".pipeline.state.json").read_text())["format"] == "camcal/run-state/1"


def changed_input(folder):
    text = (folder / "camera.yaml").read_text()
    (folder / "camera.yaml").write_text(text.replace("fx: ", "fx: 1"))


def changed_output(folder):
    with (folder / "second.yaml").open("a") as stream:
        stream.write("# edited\n")


@pytest.mark.parametrize(
    ("change", "expected", "reason"),
    [
        (changed_input, {"first": "done", "second": "done"}, "camera.yaml changed"),
        (changed_output, {"first": "up_to_date", "second": "done"}, "second.yaml changed"),
        (
            lambda folder: (folder / "first.xml").unlink(),
            {"first": "done", "second": "up_to_date"},
            "first.xml missing",
        ),
        (lambda folder: os.utime(folder / "camera.yaml"), {"first": "up_to_date", "second": "up_to_date"}, ""),
        (
            lambda folder: (folder / "pipeline.yaml").write_text(CHAIN + "    max-error: 2\n"),
            {"first": "done", "second": "up_to_date"},
            "max-error changed",
        ),
    ],
)
def test_what_changed_and_what_depends_on_it_runs_again(states, run, folder, change, expected, reason):
    states()
    change(folder)
    planned = run("run", "work/pipeline.yaml", "--dry-run")[1]
    assert reason in planned
    assert states() == (0, expected)


def test_other_arguments_and_another_date_of_files_run_a_step_again(states, run, folder, monkeypatch):
    states()
    (folder / "pipeline.yaml").write_text(CHAIN.replace("second.yaml", "third.yaml"))
    assert "arguments changed" in run("run", "work/pipeline.yaml", "--dry-run")[1]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    reason = "SOURCE_DATE_EPOCH is 1970-01-01T00:00:00Z, was none"
    assert reason in " ".join(run("run", "work/pipeline.yaml", "--dry-run")[1].split())


def test_a_step_runs_again_for_another_file_that_is_asked_for(states, folder):
    cv2.imwrite(str(folder / "photo.png"), np.zeros((480, 640), np.uint8))
    text = "steps: {views: {command: undistort, arguments: [camera.yaml, photo.png], output: out}}\n"
    assert states(text=text)[1] == {"views": "done"}
    assert states(text=text.replace("output", "mask: true, output"))[1] == {"views": "done"}
    assert (folder / "out" / "valid_mask.png").is_file()
    assert states(text=text.replace("output", "mask: true, overwrite: true, output"))[1] == {"views": "up_to_date"}


def test_a_dry_run_lists_why_steps_would_run_and_does_nothing(run, folder, states):
    code, out, err = run("run", "work/pipeline.yaml", "--dry-run")
    assert (code, err, out.splitlines()[-1]) == (0, "", "2 steps: 2 would run")
    assert sorted(path.name for path in folder.iterdir()) == ["camera.yaml", "pipeline.yaml"]
    states()
    (folder / "first.xml").unlink()
    out = run("run", "work/pipeline.yaml", "-n")[1]
    assert "needs first, which would run" in out
    assert "first.xml missing" in out


def test_a_dry_run_says_what_came_of_steps_that_are_up_to_date(run, folder, states):
    states()
    steps = json.loads(run("run", "work/pipeline.yaml", "--json")[1])["steps"]
    planned = json.loads(run("run", "work/pipeline.yaml", "--json", "--dry-run")[1])["steps"]
    assert planned == steps
    assert steps[0]["outputs"] == ["first.xml"]


def test_steps_can_be_chosen_and_forced(states, folder):
    states()
    assert states("--only", "second", "--force") == (0, {"second": "done"})
    assert states("--from", "second") == (0, {"second": "up_to_date"})
    assert states("--from", "first", "--force") == (0, {"first": "done", "second": "done"})
    (folder / "first.xml").unlink()
    code, err = states("--only", "second")
    assert (code, "first.xml is not there and step first, which makes it, is not chosen" in err) == (2, True)
    code, err = states("--only", "secnd")
    assert (code, "--only secnd: the pipeline has no such step. Did you mean 'second'?" in err) == (2, True)


FAILING = """\
lists:
  name: [good, bad]
steps:
  copy:
    command: convert
    foreach: name
    arguments: [$(name).yaml, $(name).xml]
  again:
    command: convert
    foreach: name
    arguments: [$(name).xml, out/$(name).yaml]
"""


def test_a_step_that_fails_stops_those_that_need_it_and_no_others(states, folder, run):
    shutil.move(folder / "camera.yaml", folder / "good.yaml")
    (folder / "bad.yaml").write_text("cameras: {}\n")
    code, found = states(text=FAILING)
    expected = {"copy[bad]": "failed", "again[bad]": "not_run", "copy[good]": "done", "again[good]": "done"}
    assert (code, found) == (2, expected)
    assert list(found)[:2] == ["copy[bad]", "again[bad]"]  # the worst first
    _, out, err = run("run", "work/pipeline.yaml", "--jobs", 1)
    assert "needs copy[bad], which failed" in out
    assert out.splitlines()[-1] == "4 steps: 1 failed, 1 not run, 2 up to date"
    assert err.splitlines()[-1].startswith("camcal: error: step copy[bad] failed: bad.yaml")
    assert states("--fail-fast", "--force")[1]["again[good]"] == "not_run"
    shutil.copy(folder / "good.yaml", folder / "bad.yaml")
    assert states()[1] == {name: "done" if "bad" in name else "up_to_date" for name in found}


GATES = """\
steps:
  gate:
    command: transform check
    arguments: ["1.0 0 0 0 1 0 0 0 1.1"]
    form: matrix
  after:
    command: convert
    arguments: [camera.yaml, copy.xml]
    after: gate
  broken:
    command: convert
    arguments: [broken.yaml, broken.xml]
"""


def test_the_exit_code_is_that_of_the_worst_step(states, folder):
    (folder / "broken.yaml").write_text("cameras: {}\n")
    code, found = states(text=GATES)
    assert (code, found["gate"], found["after"], found["broken"]) == (2, "failed", "not_run", "failed")
    code, found = states("--only", "gate", "--only", "after")
    assert (code, found) == (7, {"gate": "failed", "after": "not_run"})


def test_an_interrupted_run_keeps_the_steps_that_have_ended(folder, run, monkeypatch):
    from camcal.cli import inspect

    def interrupted(options, call):
        if options.outputs[0].name == "second.yaml":
            raise KeyboardInterrupt
        return original(options, call)

    original = inspect.convert
    interrupted.__annotations__ = original.__annotations__
    monkeypatch.setattr(inspect, "convert", interrupted)
    code, _, err = run("run", "work/pipeline.yaml", "--jobs", 1)
    assert (code, err.splitlines()[-1]) == (
        130,
        "camcal: error: interrupted; repeat it to run the steps that are left",
    )
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    out = run("run", "pipeline.yaml", "--dry-run")[1]
    assert out.splitlines()[-1] == "2 steps: 1 up to date, 1 would run"


def test_every_fault_of_a_file_is_named_with_its_line_before_a_step_runs(run, folder):
    text = """\
variabels: {}
variables:
  board: chessboard:9x6:25mm
lists:
  camera: cameras/*
steps:
  one:
    command: callibrate
  two:
    command: calibrate
    arguments: camera.yaml
    bord: $(board)
    output: out/two.yaml
  three:
    command: calibrate
    arguments: camera.yaml
    board: $(bord)
    max-rejected: lots
    flat-board: maybe
    output: out/three.yaml
  four:
    command: convert
    arguments: camera.yaml
    after: thre
  five: {}
  six:
    command: calibrate
    arguments: camera.yaml
    foreach: cameras
  seven:
    command: undistort
    arguments: [camera.yaml, $(camera)]
  eight:
    command: [undistort]
  nine:
    command: undistort
    argument: [camera.yaml, camera.yaml]
    max-pixels: 2
    output: out
  ten:
    command: doctor
  eleven:
    command: convert
    arguments: [camera.yaml, copy.xml]
    config: none.yaml
"""
    assert refused(run, folder, text) == [
        "1: variabels: unknown key. Did you mean 'variables'?",
        "5: lists.camera: 'cameras/*' matches no file or folder",
        "8: steps.one.command: no command 'callibrate' for a step. Did you mean 'calibrate'?",
        "12: steps.two.bord: unknown key. Did you mean 'board'?",
        "17: steps.three.board: $(bord): no such variable. Did you mean 'board'?",
        "18: steps.three.max-rejected: 'lots' is not a number",
        "19: steps.three.flat-board: takes true or false, not 'maybe'",
        "23: steps.four.arguments: OUT… missing",
        "24: steps.four.after: no step 'thre'. Did you mean 'three'?",
        "25: steps.five: has no command",
        "29: steps.six.foreach: no list 'cameras' under 'lists'. Did you mean 'camera'?",
        "30: steps.seven: output is missing",
        "32: steps.seven.arguments: $(camera) is a list: add 'foreach: camera' to the step",
        "34: steps.eight.command: no command \"['undistort']\" for a step. Did you mean 'undistort'?",
        "37: steps.nine.argument: unknown key. Did you mean 'arguments'?",
        "38: steps.nine.max-pixels: give --max-pixels to camcal run, for all steps",
        "41: steps.ten.command: doctor cannot be a step",
        "45: steps.eleven.config: none.yaml: no such file",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            CHAIN.replace("camera.yaml", "second.yaml"),
            "2: steps.second: each needs the result of the one before: second -> first -> second",
        ),
        (
            CHAIN.replace("first.xml]", "second.yaml]"),
            "5: steps.first: OUT…: second.yaml is written by step second too; give each a place of its own",
        ),
        (
            CHAIN.replace("camera.yaml", "camra.yaml"),
            "7: steps.first.arguments: camra.yaml: no such file. Did you mean 'camera.yaml'?",
        ),
        (
            CHAIN.replace("first.xml]", "-]"),
            "5: steps.first: OUT… -: a step reads and writes files, not standard streams",
        ),
        (
            CHAIN.replace("first.xml]", "first.gif]"),
            f"5: steps.first: first.gif: .gif is not written; use {', '.join(CAMERA_SUFFIXES)}",
        ),
        (
            CHAIN.replace("camera.yaml", '""'),
            "7: steps.first.arguments: an empty text; is a variable of the shell not set?",
        ),
        (
            CHAIN.replace("first.xml]", "first.xml]\n    frobnicate: 1"),
            "8: steps.first.frobnicate: unknown key; --write-config lists those of the command",
        ),
        (
            "lists: {size: [1, 2, 3]}\n" + CHAIN.replace("  first:", "  first:\n    foreach: size"),
            "6: steps.first: OUT…: first.xml is the same for several items; put the item of the list into it",
        ),
        (
            "variables: {a: $(b), b: 1}\n" + CHAIN,
            "1: variables.a: $(b) is set below it; put it above",
        ),
        (
            'steps: {a: {command: detect, arguments: camera.yaml, board: "chessbord:9x6", output: a.csv}}\n',
            "1: steps.a.board: board 'chessbord:9x6': did you mean 'chessboard:9x6'?",
        ),
        (CHAIN + "    config: [a.yaml]\n", "8: steps.first.config: is the name of one settings file"),
        ("steps: {}\n", "1: steps: no steps; each is NAME: with its command and options"),
        ("steps: [a]\n", "1: steps: is a mapping, NAME: …, one for each line"),
        (
            "variables: {a: 1}\n" + CHAIN.replace("camera.yaml", "$(b c)"),
            "8: steps.first.arguments: $(b c) is no variable; write $$(b c) for the text itself",
        ),
        (CHAIN.replace("camera.yaml", "{b: 1}"), "7: steps.first.arguments: is a text or a list of texts"),
        ("environment: [CAMCAL_NONE]\n" + CHAIN, "1: environment[0]: the environment has no variable CAMCAL_NONE"),
    ],
)
def test_a_pipeline_that_cannot_run_is_refused(run, folder, text, message):
    assert refused(run, folder, text)[0] == message


@pytest.mark.parametrize(
    ("name", "code", "message"),
    [("work", 3, "work: is a folder"), ("-", 2, "-: a pipeline is read from a file"), ("none.yaml", 3, "no such file")],
)
def test_what_is_no_pipeline_file_is_refused(run, folder, name, code, message):
    found = run("run", name)
    assert (found[0], message in found[2]) == (code, True)


def test_a_step_may_not_write_over_the_pipeline_or_its_inputs(states, folder):
    code, found = states(text=CHAIN.replace("second.yaml", "pipeline.yaml"))
    assert (code, found["second"]) == (2, "failed")
    assert (folder / "pipeline.yaml").read_text() == CHAIN.replace("second.yaml", "pipeline.yaml")


def test_values_come_from_variables_the_command_line_and_the_environment_if_asked(states, folder, monkeypatch):
    monkeypatch.setenv("CAMCAL_TEST_NAME", "copy")
    text = (
        "environment: CAMCAL_TEST_NAME\n"
        "variables: {kind: xml, name: $(CAMCAL_TEST_NAME).$(kind)}\n"
        "steps: {copy: {command: convert, arguments: [camera.yaml, $$(a)_$(name)]}}\n"
    )
    assert states(text=text)[0] == 0
    assert states("--set", "kind=json")[0] == 0
    assert {path.name for path in folder.glob("$*")} == {"$(a)_copy.xml", "$(a)_copy.json"}
    unasked = text.replace("environment: CAMCAL_TEST_NAME\n", "")
    assert "$(CAMCAL_TEST_NAME): no such variable" in states(text=unasked)[1]
    assert (
        "--set kid: the pipeline has no such variable. Did you mean 'kind'?" in states("--set", "kid=1", text=text)[1]
    )


def test_steps_read_and_write_urls(states, folder):
    pytest.importorskip("fsspec")
    (folder / "store").mkdir()
    shutil.copy(folder / "camera.yaml", folder / "store" / "lens.yaml")
    store = f"file://{folder / 'store'}"
    text = CHAIN.replace("camera.yaml", f"{store}/lens.yaml").replace("first.xml", f"{store}/first.xml")
    assert states(text=text) == (0, {"first": "done", "second": "done"})
    assert states() == (0, {"first": "up_to_date", "second": "up_to_date"})
    assert f'"{store}/first.xml": "' in (folder / ".pipeline.state.json").read_text()
    changed_input(folder)
    shutil.copy(folder / "camera.yaml", folder / "store" / "lens.yaml")
    urls.REMOTE.set(None)  # as in a process of its own, which knows nothing of these files
    assert states() == (0, {"first": "done", "second": "done"})
    urls.REMOTE.set(None)
    assert "no such file. Did you mean" in states(text=text.replace("lens.yaml", "lns.yaml"))[1]


def test_a_list_holds_what_the_star_of_a_pattern_stands_for_in_natural_order(states, folder):
    for name in ("cam10", "cam9", "b"):
        (folder / "units" / f"unit_{name}_x").mkdir(parents=True)
        shutil.copy(folder / "camera.yaml", folder / "units" / f"unit_{name}_x" / "lens.yaml")
    text = """\
lists:
  unit: units/unit_*_x
steps:
  copy:
    command: convert
    foreach: unit
    arguments: [units/unit_$(unit)_x/lens.yaml, out/$(unit).xml]
  figures:
    command: plot
    arguments: out/*.xml
    output: figures
"""
    code, found = states("--only", "copy", text=text)
    assert (code, list(found)) == (0, ["copy[b]", "copy[cam9]", "copy[cam10]"])
    assert states("--only", "copy[cam9]", "--force") == (0, {"copy[cam9]": "done"})
    assert list(states("--only", "copy[cam*]")[1]) == ["copy[cam9]", "copy[cam10]"]


def test_a_step_takes_options_from_a_settings_file_and_its_own_come_first(states, folder):
    (folder / "convert.yaml").write_text("to: opencv\nmax-error: 1\n")
    text = "steps: {copy: {command: convert, arguments: [camera.yaml, copy.yml], config: convert.yaml, to: ros}}\n"
    assert states(text=text) == (0, {"copy": "done"})
    assert "camera_matrix" in (folder / "copy.yml").read_text()
    (folder / "convert.yaml").write_text("to: opencv\nmax-eror: 1\n")
    assert "convert.yaml:2: max-eror: unknown key. Did you mean 'max-error'?" in states()[1]


def test_a_folder_that_one_step_reads_and_another_writes_into_needs_an_order(run, folder):
    text = """\
steps:
  rig: {command: rig, arguments: views, board: "chessboard:9x6:25mm", output: rig.yaml}
  left: {command: demosaic, arguments: raw, output: views/left}
"""
    (folder / "views").mkdir()
    message = "2: steps.rig: reads views, into which step left writes; add 'after: left'"
    assert refused(run, folder, text)[0] == message


def test_a_damaged_state_means_that_all_steps_run_and_other_files_are_not_replaced(states, folder):
    states()
    state = folder / ".pipeline.state.json"
    state.write_text(state.read_text()[:200])
    assert states() == (0, {"first": "done", "second": "done"})
    state.write_text('{"a": 1}')
    code, err = states()
    assert (code, "is not the state of a pipeline" in err) == (3, True)
    assert states("--state", "other.json") == (0, {"first": "done", "second": "done"})


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_pipeline_in_a_folder_that_cannot_be_written_needs_another_place_for_its_state(states, folder):
    folder.chmod(0o555)
    try:
        code, err = states()
        planned = states("--dry-run")
    finally:
        folder.chmod(0o755)
    assert (code, "pipeline.state.json: cannot be written" in err) == (3, True)
    assert err.endswith("; choose another place with --state\n")
    assert planned == (0, {"first": "would_run", "second": "would_run"})


def test_the_document_has_these_keys(run, folder):
    document = json.loads(run("run", "work/pipeline.yaml", "--json")[1])
    assert list(document) == ["schema", "pipeline", "exit", "counts", "steps", "warnings"]
    assert document["schema"] == "camcal/run/1"
    assert document["counts"] == {"failed": 0, "not_run": 0, "done": 2, "up_to_date": 0, "would_run": 0}
    assert list(document["steps"][0]) == [
        "step", "command", "state", "reason", "exit", "error", "failed", "failures", "warnings", "outputs", "figures",
    ]  # fmt: skip
    assert document["steps"][0]["outputs"] == ["first.xml"]


def test_outputs_of_inputs_that_are_gone_are_named(run, folder):
    (folder / "photos").mkdir()
    for name in ("a", "b", "c"):
        cv2.imwrite(str(folder / "photos" / f"{name}.png"), np.zeros((480, 640), np.uint8))
    (folder / "pipeline.yaml").write_text(
        "steps: {views: {command: undistort, arguments: [camera.yaml, photos], output: out}}\n"
    )
    assert run("run", "work/pipeline.yaml", "--quiet")[1:] == ("", "")
    (folder / "photos" / "b.png").unlink()
    (folder / "photos" / "c.png").unlink()
    left = "camcal: warning: views: out/b.png: left from an earlier run and 1 other file; remove what later steps are"
    assert run("run", "work/pipeline.yaml", "--quiet")[2].startswith(left)
    assert run("run", "work/pipeline.yaml", "--quiet")[2] == ""


def test_what_a_run_says_while_it_works(run, folder):
    _, out, err = run("run", "work/pipeline.yaml")
    assert err.splitlines() == [
        "camcal: step first: started: has not succeeded before",
        "camcal: step first: done: 1 file",
        "camcal: step second: started: has not succeeded before",
        "camcal: step second: done: 1 file",
    ]
    assert out.splitlines()[0] == "work/pipeline.yaml"
    assert run("run", "work/pipeline.yaml", "--quiet")[1:] == ("", "")
    assert "wrote first.xml" in run("run", "work/pipeline.yaml", "--verbose", "--force")[2]


def test_no_option_is_called_as_a_key_of_a_step_and_every_command_but_three_may_be_one():
    commands = StepCommands()
    names = {
        each.key.replace("-", "_") for record in commands.values() for each in declared(record) if not each.positional
    }
    assert names.isdisjoint(STEP_KEYS)
    assert set(REGISTERED) - set(commands) == set(NOT_STEPS)
    assert {each.key for each in declared(ImageCall)} == set(OF_ALL_STEPS)
    assert set(KEYS) == {"variables", "environment", "lists", "steps"}


def test_only_options_that_say_how_a_step_works_do_not_count():
    """Others, checks of the result among them, run a step again when they change."""
    options = [each for record in StepCommands().values() for each in declared(record)]
    how = {"--jobs", "--overwrite", "--timeout", "--fail-fast", "--resume", "--scheduler"}
    assert {each.name for each in options if not counts(each)} == how


SPELLED = """\
steps:
  second:
    command: convert
    arguments: [{}, {}]
  first:
    command: convert
    arguments: [{}, ../results/first.xml]
"""
LENS, SECOND = "../work/camera.yaml", "../results/second.yaml"


@pytest.mark.parametrize("spelled", ["../results/first.xml", "../work/../results/first.xml", "linked/first.xml"])
def test_paths_may_lead_out_of_the_folder_and_be_spelled_in_any_way(states, folder, spelled):
    (folder.parent / "results").mkdir()
    (folder / "linked").symlink_to(folder.parent / "results")
    text = SPELLED.format(spelled, SECOND, LENS)
    assert states(text=text) == (0, {"first": "done", "second": "done"})
    assert (folder.parent / "results" / "second.yaml").is_file()
    assert states() == (0, {"first": "up_to_date", "second": "up_to_date"})


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ((LENS, "../work/../results/first.xml", LENS), "is written by step second too; give each a place of its own"),
        (("../work/../work/absent.xml", SECOND, LENS), "../work/../work/absent.xml: no such file"),
        (("../results/first.xml", SECOND, "../work/../results/second.yaml"), "each needs the result of the one before"),
    ],
)
def test_what_is_wrong_with_files_is_found_however_they_are_spelled(states, folder, paths, message):
    code, err = states(text=SPELLED.format(*paths))
    assert code == 2
    assert message in err
