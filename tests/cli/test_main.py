"""The boundary every command passes through: exit codes, one-line errors, JSON failures, settings files, streams."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import pytest
import typer

from camcal import __version__
from camcal.cli import show
from camcal.cli.call import Call
from camcal.cli.command import command
from camcal.cli.main import COMMANDS, Boundary, CommandGroup
from camcal.cli.main import app as camcal_app
from camcal.errors import (
    FileError,
    GateFailed,
    InsufficientData,
    InvalidInput,
    ItemsFailed,
    NotConverged,
)
from camcal.messages import Message
from camcal.options import Argument, Option, OptionsRecord
from camcal.run.options import BatchOptions
from camcal.tasks.options import Jobs

ERRORS = {
    error.kind: error for error in (InvalidInput, FileError, InsufficientData, NotConverged, ItemsFailed, GateFailed)
}


@dataclass(frozen=True)
class WorkOptions(OptionsRecord):
    kind: Annotated[str, Argument("How to fail.", metavar="KIND")] = ""
    square: Annotated[float, Option("A length.", names="--square-mm")] = 1.0
    names: Annotated[tuple[str, ...], Option("Names.", names="--name")] = ()
    label: Annotated[str, Option("A label.")] = "none"
    flat: Annotated[bool, Option("A flag.", names="--flat-board")] = False
    after_document: Annotated[bool, Option("Show the document first.")] = False
    jobs: Jobs = None


def work(options: WorkOptions, call: Call) -> None:
    """Work, or fail in the way asked for."""
    kind = options.kind
    if options.after_document or (call.json and not kind):
        values = {name: value for name, value in vars(options).items() if name not in ("kind", "after_document")}
        show.result("work", values)
    if kind == "bug":
        raise KeyError(kind)
    if kind == "interrupt":
        raise KeyboardInterrupt
    if kind == "gates":
        call.progress.warn(Message("poor_fit", "a poor fit", where="b.yaml"))
        raise GateFailed.of([Message("bad_rows", "rows differ by 6 px", {"rows_px": 6}, "a.png")])
    if kind:
        raise ERRORS[kind]("is wrong\nb.yaml:3: is wrong too", where="a.yaml")


def rest(call: Call) -> None:
    """Rest."""


@dataclass(frozen=True)
class BatchWorkOptions(OptionsRecord):
    batch: BatchOptions = field(default_factory=BatchOptions)


def batch_work(options: BatchWorkOptions, call: Call) -> None:
    """Be interrupted."""
    raise KeyboardInterrupt


@pytest.fixture(scope="module")
def app():
    nested = CommandGroup(
        name="nested", commands={"work": command("nested work", work), "rest": command("nested rest", rest)}
    )
    commands = {"work": command("work", work), "batch": command("batch", batch_work), "nested": nested}
    return Boundary(name="camcal", commands=commands, rich_markup_mode=None)


@pytest.fixture
def run(app, capsys):
    def run(*arguments: str, app=app):
        with pytest.raises(SystemExit) as exit_:
            app(list(arguments))
        output = capsys.readouterr()
        return exit_.value.code, output.out, output.err

    return run


@pytest.mark.parametrize("error", ERRORS.values(), ids=ERRORS)
def test_an_error_becomes_its_exit_code_and_a_line_for_each_finding(run, error):
    code, out, err = run("work", error.kind)
    assert (code, out) == (error.exit_code, "")
    assert err == "camcal: error: a.yaml: is wrong\ncamcal: error: b.yaml:3: is wrong too\n"


def test_success_exits_with_zero_and_says_nothing_of_its_own(run):
    assert run("work") == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["wrk"], "No such command 'wrk'. Did you mean 'work'?; see 'camcal --help'"),
        (["work", "--job", "2"], "No such option: --job (Possible options: --jobs, --json); see 'camcal work --help'"),
        (["work", "--jobs"], "Option '--jobs' requires an argument; see 'camcal work --help'"),
        (["work", "--flat-board=3"], "Option '--flat-board' does not take a value; see 'camcal work --help'"),
        (["work", "", "b"], "Got unexpected extra argument(s) (b); see 'camcal work --help'"),
    ],
)
def test_a_wrong_command_line_is_told_in_one_line(run, arguments, line):
    assert run(*arguments) == (2, "", f"camcal: error: {line}\n")


@pytest.mark.parametrize("value", ["0", "two"])
def test_a_wrong_value_names_its_option(run, value):
    code, _, err = run("work", "--jobs", value)
    assert code == 2
    assert err.startswith("camcal: error: Invalid value for '--jobs'")
    assert err.count("\n") == 1


def test_a_bug_keeps_its_traceback(app):
    with pytest.raises(KeyError) as caught:
        app(["work", "bug"])
    assert "work" in [entry.name for entry in caught.traceback]


def test_a_failure_is_a_document_when_json_is_asked_for(run):
    code, out, err = run("nested", "work", "file", "--json")
    assert code == 3
    assert json.loads(out) == {
        "schema": "camcal/nested-work/1",
        "warnings": [],
        "error": {"kind": "file", "message": "is wrong\nb.yaml:3: is wrong too", "where": "a.yaml"},
        "exit": 3,
    }
    assert out.startswith('{\n  "schema"')
    assert err.startswith("camcal: error: a.yaml: is wrong")


@pytest.mark.parametrize(
    ("arguments", "schema", "code"),
    [
        (["work", "--jbs", "--json"], "camcal/work/1", 2),
        (["--json"], "camcal/camcal/1", 2),
        (["work", "interrupt", "--json"], "camcal/work/1", 130),
    ],
)
def test_every_failure_is_a_document_when_json_is_asked_for(run, arguments, schema, code):
    exit_code, out, _ = run(*arguments)
    document = json.loads(out)
    assert (exit_code, document["schema"], document["exit"]) == (code, schema, code)


def test_a_bug_is_a_document_too_when_json_is_asked_for(app, capsys):
    with pytest.raises(KeyError):
        app(["work", "bug", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["error"]["kind"] == "bug"
    assert document["exit"] == 1


def test_a_failure_after_the_result_is_in_the_same_document(run):
    code, out, err = run("work", "items_failed", "--after-document", "--json")
    document = json.loads(out)
    assert (code, document["exit"]) == (6, 6)
    assert document["jobs"] is None
    assert document["error"]["kind"] == "items_failed"
    assert "is wrong" in err


def test_every_document_holds_the_warnings_and_a_gate_its_failures(run):
    code, out, err = run("work", "gates", "--after-document", "--json")
    document = json.loads(out)
    wanted = [{"code": "bad_rows", "text": "rows differ by 6 px", "values": {"rows_px": 6}, "where": "a.png"}]
    assert (code, list(document)[-4:]) == (7, ["warnings", "failures", "error", "exit"])
    assert document["failures"] == wanted
    assert document["warnings"][0]["code"] == "poor_fit"
    assert document["error"]["message"] == "a.png: rows differ by 6 px"
    assert "camcal: warning: b.yaml: a poor fit" in err


def test_json_after_a_double_dash_is_an_argument(run):
    assert run("work", "--", "file")[1] == ""


def test_an_interrupt_exits_with_130(run):
    assert run("work", "interrupt") == (130, "", "camcal: error: interrupted\n")
    text = "interrupted; repeat it with --resume to do only what is left"
    assert run("batch") == (130, "", f"camcal: error: {text}\n")
    code, out, _ = run("batch", "--json")
    assert (code, json.loads(out)["error"]["message"]) == (130, text)


def test_a_text_that_is_empty_is_no_path(run):
    code, out, err = run("inspect", "", app=camcal_app)
    message = (
        "Invalid value for 'FILE': an empty text; is a variable of the shell not set?; see 'camcal inspect --help'"
    )
    assert (code, out, err) == (2, "", f"camcal: error: {message}\n")


def test_no_command_shows_the_help_and_is_a_usage_error(run):
    code, out, err = run(app=camcal_app)
    assert (code, out) == (2, "")
    assert "Commands:" in err


def test_the_version_is_printed(run):
    assert run("--version", app=camcal_app) == (0, f"camcal {__version__}\n", "")


def test_the_package_is_run_as_the_command_is(start_python):
    process = start_python("-m", "camcal", "inspect", "none.yaml", stdout=subprocess.PIPE)
    assert process.communicate(timeout=30) == ("", "camcal: error: none.yaml: no such file\n")
    assert process.returncode == 3


def test_every_command_has_help_and_the_options_all_share():
    for each, parameters in every_command(typer.main.get_command(camcal_app)):
        assert each.help, each.name
        names = {option for parameter in parameters for option in parameter.opts}
        assert {"--json", "--quiet", "--verbose", "--config"} <= names, each.name
        for parameter in parameters:
            assert parameter.help, f"{each.name} {parameter.name}"


def every_command(group):
    for each in group.commands.values():
        if hasattr(each, "commands"):
            yield from every_command(each)
        else:
            yield each, [parameter for parameter in each.params if parameter.name != "help"]


@pytest.fixture
def settings(tmp_path):
    def write(text: str) -> str:
        path = tmp_path / "settings.yaml"
        path.write_text(text)
        return str(path)

    return write


def test_a_settings_file_gives_defaults_and_the_command_line_comes_first(run, settings):
    path = settings("square-mm: 25\nname: [a, b]\nlabel: 7\nflat_board: true\njobs: 2\n")
    _, out, _ = run("work", "--json", "--jobs", "3", "--config", path, "--square-mm", "30")
    assert json.loads(out) == {
        "schema": "camcal/work/1",
        "square": 30.0,
        "names": ["a", "b"],
        "label": "7",
        "flat": True,
        "jobs": 3,
        "warnings": [],
    }


def test_a_settings_file_works_for_a_nested_command(run, settings):
    _, out, _ = run("nested", "work", "--config", settings("jobs: 2\n"), "--json")
    assert json.loads(out)["jobs"] == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("jobs: 2\nsquare-m: 3\n", ":2: square-m: unknown key. Did you mean 'square-mm'?"),
        ("json: true\n", ":1: json: unknown key; --write-config lists those of the command"),
        ("label: a\njobs: many\n", ":2: Invalid value for '--jobs'"),
        ("square-mm: wide\n", ":1: Invalid value for '--square-mm'"),
        ("jobs: true\n", ":1: Invalid value for '--jobs'"),
        ("flat-board: 7\n", ":1: Invalid value for '--flat-board'"),
    ],
)
def test_a_fault_in_a_settings_file_names_the_file_and_the_line(run, settings, text, words):
    path = settings(text)
    code, _, err = run("work", "--config", path)
    assert code == 2
    assert err.startswith(f"camcal: error: {path}{words}")
    assert err.count("\n") == 1


def test_a_missing_settings_file_is_a_file_error(run):
    assert run("work", "--config", "nowhere.yaml") == (3, "", "camcal: error: nowhere.yaml: no such file\n")


@pytest.fixture
def console(start_python):
    """A function that starts a small program with camcal's boundary."""
    return partial(start_python, "-c", CONSOLE)


CONSOLE = """
import sys
import typer
from camcal.cli import main, show
from camcal.messages import Message

def talk(): show.text("x" * 100_000)

def noise():
    import os
    os.write(2, b"libpng warning: iCCP")
    show.warning(Message("poor_fit", "ours"))
    print("and Python's", file=sys.stderr)

def crash():
    import ctypes
    ctypes.string_at(0)

def wait():
    import time
    show.text("waiting")
    show.flush()
    time.sleep(60)

for command in (talk, noise, crash, wait):
    main.app.command(command.__name__)(command)
main.main()
"""


def test_a_closed_pipe_is_not_an_error(console):
    reader, writer = os.pipe()
    os.close(reader)
    process = console("talk", stdout=writer)
    os.close(writer)
    assert process.communicate()[1] == ""
    assert process.returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is a device of Linux")
def test_a_full_disk_behind_stdout_is_a_file_error(console):
    with Path("/dev/full").open("w") as full:
        process = console("talk", stdout=full)
    assert process.communicate()[1] == "camcal: error: standard output: cannot be written: the disk is full\n"
    assert process.returncode == 3


def test_c_libraries_are_not_heard_and_we_are(console):
    process = console("noise", stdout=subprocess.DEVNULL)
    assert process.communicate()[1] == "camcal: warning: ours\nand Python's\n"


def test_a_crash_in_a_c_library_still_says_where(console):
    process = console("crash", stdout=subprocess.DEVNULL)
    assert "Segmentation fault" in process.communicate()[1]
    assert process.returncode == -signal.SIGSEGV


def test_ctrl_c_exits_with_130_at_once(console):
    process = console("wait", stdout=subprocess.PIPE)
    assert process.stdout.readline() == "waiting\n"
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30)[1] == "camcal: error: interrupted\n"
    assert process.returncode == 130


def test_help_imports_nothing_heavy():
    heavy = {"numpy", "scipy", "cv2", "yaml", "rich", "matplotlib", "pydantic", "multiprocessing"}
    program = (
        "import sys\nfrom camcal.cli.main import main\ntry:\n main()\nfinally:\n print(*sys.modules, file=sys.stderr)"
    )
    process = subprocess.run([sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True)
    assert "camcal.cli.main" in process.stderr.split()
    assert not heavy & set(process.stderr.split())


def test_inspecting_the_camera_file_of_a_fisheye_loads_only_what_reads_it(tmp_path):
    (tmp_path / "fish.yaml").write_text(
        "format: camcal-calibration\nversion: 1\ncameras:\n  fish:\n    image_size: [1000, 1000]\n"
        "    model: kannala_brandt4\n    intrinsics: {fx: 320.0, fy: 320.0, cx: 499.5, cy: 499.5}\n"
        "    distortion: {k1: 0.002, k2: -0.0005, k3: 0.0, k4: 0.0}\n"
        "    uncertainty: {std: {fx: 0.5, fy: 0.5, cx: 1.0, cy: 1.0, k1: 0.001, k2: 0.001, k3: 0.001, k4: 0.001}}\n"
    )
    program = (
        "import sys\nfrom camcal.cli.main import main\ntry:\n main()\nfinally:\n print(*sys.modules, file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, "inspect", str(tmp_path / "fish.yaml"), "--at", "2m"]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "camcal.tasks.calibration.inspect" in process.stderr.split()
    heavy = {"cv2", "scipy", "matplotlib", "multiprocessing", "pydantic", "camcal.solve.least_squares"}
    assert not heavy & set(process.stderr.split())


def modules_after(program):
    """Return the modules that a program in a process of its own ends with."""
    words = [sys.executable, "-c", f"{program}\nimport sys\nprint(*sys.modules)"]
    return set(subprocess.run(words, capture_output=True, text=True, check=True).stdout.split())


def test_calibrating_imports_what_it_needs_and_no_scipy():
    found = modules_after("import camcal.tasks.calibration.calibrate, camcal.targets.checker.chessboard")
    assert "camcal.calibrate.fit" in found
    assert not {"scipy", "matplotlib", "rich", "rawpy", "jinja2"} & found


def test_no_command_imports_the_core_before_it_is_run():
    found = modules_after(
        "from camcal.cli.main import COMMANDS, Commands\n"
        "for group in ('', 'stereo', 'transform'):\n"
        "    for each in Commands(group).values():\n"
        "        each.get_params"
    )
    assert "camcal.cli.stereo" in found
    assert not {"numpy", "scipy", "cv2", "yaml", "matplotlib"} & found


@pytest.mark.parametrize("group", ["stereo", "transform"])
def test_a_group_alone_prints_its_help(run, group):
    code, out, err = run(group, app=camcal_app)
    assert (code, out) == (2, "")
    assert err.startswith(f"Usage: camcal {group} [OPTIONS] COMMAND")


def test_no_line_of_the_list_of_commands_is_cut(run):
    out = run("--help", app=camcal_app)[1]
    assert all(f"  {entry.name} " in out and entry.summary in out for entry in COMMANDS if " " not in entry.name)
    assert "…" not in out


def test_the_options_of_a_command_stand_under_the_titles_of_their_groups(run):
    out = run("calibrate", "--help", app=camcal_app)[1]
    titles = [line.rstrip(":") for line in out.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert titles == ["Input", "Board", "Lens", "Raw frames", "Method", "Checks", "Output", "General", "Examples"]


def test_the_usage_names_arguments_as_they_are_written(run):
    assert run("pnp", "--help", app=camcal_app)[1].startswith("Usage: camcal pnp [OPTIONS] [CAMERA] [IMAGES")
    assert run("inspect", "--help", app=camcal_app)[1].startswith("Usage: camcal inspect [OPTIONS] FILE\n")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_is_told_how_to_complete_commands(shell, start_python):
    variables = {"_CAMCAL_COMPLETE": f"complete_{shell}", "COMP_WORDS": "camcal cal", "COMP_CWORD": "1"}
    program = "from camcal.cli.main import main; main()"
    variables |= {"_TYPER_COMPLETE_ARGS": "camcal cal", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    process = start_python("-c", program, env=os.environ | variables, stdout=subprocess.PIPE)
    assert "calibrate" in process.communicate()[0]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("calibrate --model kan", ["kannala_brandt4", "kannala_brandt5t", "kannala_brandt4_tilted"]),
        ("rig --model opencv1", ["opencv12", "opencv14"]),
        ("calibrate --board ch", ["chessboard:", "charuco:"]),
        ("convert a.yaml b.yaml --to k", ["kalibr"]),
        ("smooth track.csv --model c", ["cv", "ca"]),
    ],
)
def test_a_shell_completes_values(line, offered, start_python):
    words = f"camcal {line}"
    variables = {"_CAMCAL_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    program = "from camcal.cli.main import main; main()"
    process = start_python("-c", program, env=os.environ | variables, stdout=subprocess.PIPE)
    assert process.communicate()[0].split() == offered


@pytest.mark.parametrize(
    ("name", "meant"),
    [("rectify", "stereo rectify"), ("stereo-cloud", "stereo cloud"), ("average", "transform average"), ("xyz", "")],
)
def test_a_command_of_a_group_is_found_by_its_name_alone(run, name, meant):
    code, _, err = run(name, "a.png", app=camcal_app)
    assert code == 2
    said = f". Did you mean {meant!r}?" if meant else ""
    assert err.splitlines()[0] == f"camcal: error: No such command {name!r}{said}; see 'camcal --help'"


def test_a_settings_file_that_was_written_says_all_and_changes_nothing(run, tmp_path):
    path = tmp_path / "work.yaml"
    code, out, _ = run("work", "--write-config", str(path), "--name", "a", "--name", "b: c", "--square-mm", "2.5")
    assert (code, out) == (0, f"wrote {path}\n")
    content = path.read_text()
    assert content.startswith("# camcal work [KIND] --config work.yaml\n")
    assert "\n# A label.\n# label: none\n" in content
    document = run("work", "--json", "--config", str(path))[1]
    assert json.loads(document)["names"] == ["a", "b: c"]
    assert json.loads(document)["square"] == 2.5
    again = tmp_path / "again" / "work.yaml"
    again.parent.mkdir()
    run("work", "--config", str(path), "--write-config", str(again))
    assert again.read_text() == content
    run("work", "--write-config", str(path))
    assert run("work", "--config", str(path)) == (0, "", "")


def test_settings_are_written_as_quietly_as_asked_for_and_over_no_input(run, tmp_path):
    path = tmp_path / "work.yaml"
    assert run("work", "--write-config", str(path), "--quiet") == (0, "", "")
    code, out, _ = run("work", "--write-config", str(path), "--json")
    assert (code, json.loads(out)) == (0, {"schema": "camcal/work/1", "output": str(path), "warnings": []})
    before = path.read_bytes()
    for named in (str(path), f"{path}#left"):
        code, out, err = run("work", named, "--write-config", str(path))
        assert (code, out) == (2, "")
        assert err == f"camcal: error: {path}: is an input and is not overwritten; choose another output\n"
    assert path.read_bytes() == before


def test_an_argument_keeps_to_its_line_of_the_settings_file(run, tmp_path):
    path = tmp_path / "my work.yaml"
    run("work", "a b\nlabel: injected", "--write-config", str(path))
    assert path.read_text().splitlines()[0] == "# camcal work 'a b\\nlabel: injected' --config 'my work.yaml'"
    assert json.loads(run("work", "--json", "--config", str(path))[1])["label"] == "none"


def test_a_value_that_yaml_would_read_in_another_way_is_quoted(run, tmp_path):
    path = tmp_path / "work.yaml"
    texts = ["on", "0:128", "1e3", "007", "#", "a, b", "- x", "null", "é"]
    run("work", "--write-config", str(path), *(word for text in texts for word in ("--name", text)))
    assert json.loads(run("work", "--json", "--config", str(path))[1])["names"] == texts
