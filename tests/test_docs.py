"""The pages, `--help` and the package say the same.

Every rule first meets a planted violation, to show that it can fail. What the sentences between examples and tables
claim is not tested here.
"""

import json
import re
import shlex
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import typer
from command_page import EVERYWHERE, INDEX, REGISTERED, ROOT, commands, listed, page_of, pages, stale
from generated_pages import WRITE
from run_page import PAGES as RUN
from run_page import steps as steps_of
from typer.core import TyperGroup
from typer.main import get_command

from camcal import errors
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.command import parameter_name
from camcal.cli.main import app
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.simulate.scene import observe, views
from camcal.targets.board import parse_board
from camcal.tasks.simulation.options import SimulateOptions
from camcal.tasks.simulation.simulate import simulate

PROJECT = Path(__file__).parents[1]
README = PROJECT / "README.md"
PAGES = [README, PROJECT / "CHANGELOG.md", *sorted((PROJECT / "docs").rglob("*.md"))]

OTHER_TOOLS = {  # of mrcal, pip, mkdocs; of Dask; of helm and kubectl
    *("--object-width-n", "--wheel-dir", "--no-index", "--find-links", "--yes", "--strict", "--no-cache-dir"),
    *("--nthreads", "--nworkers", "--port", "--lifetime", "--lifetime-stagger"),
    *("--repo", "--create-namespace", "--generate-name", "--rm", "--restart", "--env", "--command", "--replicas"),
}

_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
_SUBSTITUTION = re.compile(r"\$\(([^()]*)\)")
_CODE = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"(?<!!)\[[^\]]+\]\(([^)\s]+)\)")


@cache
def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def name_of(page: Path) -> str:
    return page.relative_to(PROJECT).as_posix()


def without_help(group: Any) -> list[str]:
    found = [name for name, command in group.commands.items() if not command.help]
    for name, command in commands(group).items():
        found += [f"{name} {parameter.name}" for parameter in command.params if not parameter.help]
    return found


def test_every_command_and_option_has_help():
    def bare(size: int = 0, named: Annotated[int, typer.Option(help="Here.")] = 0) -> None: ...

    planted = typer.Typer()
    planted.command("bare")(bare)
    planted.command("other")(lambda: None)
    assert without_help(get_command(planted)) == ["bare", "other", "bare size"]
    assert without_help(ROOT) == []


def test_the_list_of_commands_is_that_of_the_help():
    assert listed() not in text_of(INDEX).replace("Show a camera file", "Show a lens")
    assert listed() in text_of(INDEX), WRITE


def test_the_page_of_a_command_has_every_option_as_the_help_says_it():
    found = pages()
    assert stale(found | {"inspect": found["inspect"].replace("`--get KEY`", "`--git KEY`")}) == ["inspect"]
    assert stale({name: text for name, text in found.items() if name != "inspect"}) == ["inspect"]
    assert stale(found) == [], WRITE


def test_every_command_has_a_page_and_there_are_no_others():
    assert sorted(pages()) == sorted(REGISTERED)
    assert {page.name for page in INDEX.with_suffix("").iterdir()} == {page_of(name).name for name in REGISTERED}


def without_example(found: dict[str, str]) -> list[str]:
    return [name for name, page in found.items() if f"\ncamcal {name}" not in page.partition("```sh")[2]]


def test_every_command_has_an_example_its_exit_codes_and_its_schema():
    found = pages()
    assert without_example({"doctor": found["doctor"].replace("\ncamcal doctor\n", "\n")}) == ["doctor"]
    assert without_example(found) == []
    for name, page in found.items():
        assert f"`camcal/{name.replace(' ', '-')}/1`" in page, name
        assert "Exit codes:" in page, name


def test_the_options_of_every_command_are_described_once():
    described = text_of(INDEX).partition("## Options of every command")[2].partition("\n## ")[0]
    every = [each for command in REGISTERED.values() for each in command.declared]
    shared = {option for each in every if each.key in EVERYWHERE for option in each.spellings}
    shared |= {"--config", "--write-config", "--examples"}
    assert missing(shared, described.replace("`--jobs N`", "")) == {"--jobs"}
    assert missing(shared, described) == set()


def missing(options: set[str], page: str) -> set[str]:
    return {option for option in options if not re.search(rf"`{option}[ `]", page)}


def command_lines(page: str) -> Iterator[list[str]]:
    """Yield every `camcal …` of a page's shell examples, as words after the program's name."""
    for language, block in _FENCE.findall(page):
        if language == "sh":
            for line in block.replace("\\\n", " ").splitlines():
                bare = re.sub(r"(^|\s)#.*$", "", line)
                for part in (_SUBSTITUTION.sub("x", bare), *_SUBSTITUTION.findall(bare)):
                    yield from _calls(part)


def _calls(line: str) -> Iterator[list[str]]:
    lexer = shlex.shlex(line, posix=True, punctuation_chars="();<>|&")
    lexer.whitespace_split, lexer.commenters = True, ""
    words: list[str] = []
    for word in [*lexer, ";"]:
        if set(word) <= set("();<>|&"):
            if words and words[0].removeprefix(".venv/bin/") == "camcal":
                yield words[1:]
            words = []
        else:
            words.append(word)


def refused(words: list[str]) -> str | None:
    """Return why a command line would be refused before any work, None if it would not."""
    command, names = ROOT, []
    while isinstance(command, TyperGroup) and words and words[0] in command.commands:
        names.append(words[0])
        command, words = command.commands[words[0]], words[1:]
    try:
        if isinstance(command, TyperGroup):
            command.parse_args(command.context_class(command), list(words))
            return None if words and words[0].startswith("-") else f"no command: {' '.join([*names, *words])}"
        given = command.make_context(" ".join(names), list(words)).params
        for each in command.declared:
            if given[parameter_name(each)]:
                each.read(given[parameter_name(each)])
    except (typer.TyperException, errors.CamcalError) as error:
        return f"{' '.join(names)}: {error}"
    except typer.Exit:
        return None
    return None


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_shell_example_would_be_accepted(page, monkeypatch):
    monkeypatch.chdir(PROJECT)  # examples name sample_configs/
    refusals = {" ".join(words): reason for words in command_lines(text_of(page)) if (reason := refused(words))}
    assert refusals == {}


@pytest.mark.parametrize(
    "line",
    [
        "camcal callibrate photos -o a.yaml",
        "camcal calibrate photos --bord x -o a.yaml",
        "x=$(camcal inspect)",
        'test "$(camcal inspect a.yaml --got b)" = true',
        "true && camcal stereo cluod a -o b",
        "camcal undistort a.yaml b -o c --quality best",
    ],
)
def test_a_wrong_shell_example_would_be_noticed(line):
    assert [words for words in command_lines(f"```sh\n{line}\n```") if refused(words)]


def strangers(page: str) -> list[str]:
    """Return the commands and long options in a page's code that do not exist."""
    options, verbs = known_options(), {name.split()[0] for name in REGISTERED} | {"COMMAND"}
    fenced = [block for language, block in _FENCE.findall(page) if language not in ("python", "text")]
    found = []
    for part in (*_CODE.findall(_FENCE.sub("", page)), *fenced):
        named = re.findall(r"(?<![\w-])--[a-z][a-z-]*", part)
        found += [option for option in named if option not in options]
        called = re.findall(r"(?:^|bin/|\$\(|&& )camcal ([A-Za-z]+)", part, flags=re.MULTILINE)
        found += [verb for verb in called if verb not in verbs]
    return found


@cache
def known_options() -> set[str]:
    """Return the options of all commands, of the scripts of benchmarks, and of other tools that pages speak of."""
    parameters = [parameter for command in REGISTERED.values() for parameter in command.params]
    found = {spelling for each in parameters for spelling in (*each.opts, *each.secondary_opts)}
    for script in (PROJECT / "tests" / "generated_pages.py", *(PROJECT / "benchmarks").glob("*.py")):
        found |= set(re.findall(r'add_argument\("(--[a-z-]+)"', text_of(script)))
    return found | OTHER_TOOLS | {"--help", "--version", "--install-completion"}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_page_names_a_command_or_an_option_that_does_not_exist(page):
    assert strangers("`camcal zap --zip`, `--jobs 2`") == ["--zip", "zap"]
    assert strangers(text_of(page)) == []


def first_screen(page: str) -> list[str]:
    """Return the commands of the two shell blocks that stand first."""
    return [block.strip() for language, block in _FENCE.findall(page) if language == "sh"][:2]


def steps(script: str) -> list[str]:
    """Return the steps of a shell script that make, fill and use a virtual environment, wherever it lies."""
    found = []
    for line in re.split(r"&&|\n|[()]", script):
        words = [word for word in shlex.split(line, comments=True) if word != "--quiet"] if _is_step(line) else []
        if words[:3] == ["python3", "-m", "venv"]:
            found.append("make")
        elif words and "/bin/" in words[0]:
            found.append(" ".join([words[0].rpartition("/bin/")[2], *words[1:]]))
    return found


def _is_step(line: str) -> bool:
    return "/bin/" in line or "python3 -m venv" in line


def is_within(wanted: list[str], script: list[str]) -> bool:
    """Return whether the wanted steps stand in the script, in their order; it may say more, such as an output."""
    left = iter(script)
    return all(any(step == want or step.startswith(f"{want} -") for step in left) for want in wanted)


def test_the_first_screen_has_two_commands_and_the_checks_of_a_change_run_both():
    script = steps((PROJECT / ".ci" / "run").read_text(encoding="utf-8"))
    demonstration, tests = first_screen(text_of(README))
    assert demonstration == "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/camcal demo"
    assert tests == "python3 -m venv .venv && .venv/bin/pip install -e '.[dev]' && .venv/bin/pytest -n auto"
    assert is_within(steps(demonstration), script)
    assert is_within(steps(tests), script)
    assert not is_within(steps(demonstration.replace("install .", "install camcal")), script)
    assert len(text_of(README).partition("bin/pytest")[0].splitlines()) < 25  # they stand on the first screen
    assert text_of(README).index("camcal calibrate photos/ --board") < text_of(README).index(demonstration)
    assert len(text_of(README).splitlines()) <= 120


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    """A folder with what the examples read: detections of a board, and the camera they belong to."""
    folder = tmp_path_factory.mktemp("docs")
    rng = np.random.default_rng(5)
    board = parse_board("chessboard:9x6:25mm")
    camera = Camera(model_named("opencv5"), (1280, 960), np.array([900, 902, 640, 478, -0.2, 0.05, 1e-4, -2e-4, 0.0]))
    seen, _ = observe(camera, board, views(camera, board, 8, rng=rng), rng=rng, noise_px=0.1)
    detections.write(folder / "detections.csv", seen)
    found = calibrate(seen.views, board, Options(camera.model)).camera
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(found)}))
    scene = SimulateOptions(folder / "scene", "chessboard:9x6:25mm", views=8, size=(320, 240), jobs=1)
    simulate(scene).images[0].parent.rename(folder / "photos")
    return folder


def python_examples() -> list[tuple[str, str]]:
    return [
        (f"{name_of(page)} {number}", block)
        for page in PAGES
        if page not in (README, *RUN)  # these are run whole
        for number, (language, block) in enumerate(_FENCE.findall(text_of(page)))
        if language == "python"
    ]


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(block, id=name, marks=[pytest.mark.slow] if "calibrate_camera(" in block else [])
        for name, block in python_examples()
    ],
)
def test_every_python_example_runs(example, workplace, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(shutil.copytree(workplace, tmp_path / "work"))  # an example may write over a file of another's
    with pytest.raises(AttributeError):
        exec(example.replace("camcal.", "camcal.un"), {})  # a wrong name would be noticed
    exec(example, {})
    assert capsys.readouterr().out


RUNS = """\
board chessboard:5x4:30mm -o sheet.pdf
simulate chessboard:5x4:30mm -o scene --views 1 --size 320x240 --jobs 1
detect scene/images --board chessboard:5x4:30mm -o found.csv --jobs 1
calibrate detections.csv -o again.yaml --model opencv5
inspect camera.yaml
plot camera.yaml -o figures
convert camera.yaml camera.xml
inspect mosaic.npy --pattern RGGB
undistort scene/truth.yaml scene/images -o straight --jobs 1
pnp camera.yaml detections.csv
demosaic mosaic.npy -o colour.tiff --pattern RGGB
simulate chessboard:5x4:30mm -o raw_scene --views 1 --size 320x240 --raw RGGB --flats 3 --darks 2 --jobs 1
sensor raw_scene/flats --dark raw_scene/darks --pattern RGGB -o sensor.yaml --jobs 1
simulate --stereo -o pairs --size 160x120 --objects 3 --jobs 1
stereo check pairs/left/000.png pairs/right/000.png --jobs 1
stereo disparity pairs/left/000.png pairs/right/000.png pairs/rig.yaml -o disparity.pfm --jobs 1
stereo run pairs/rig.yaml pairs/left pairs/right -o result --quality fast --jobs 1
stereo cloud disparity.pfm -o cloud.ply
stereo eval disparity.pfm pairs/disparity/000.pfm --jobs 1
view cloud.ply -o cloud.html
pnp camera.yaml detections.csv -o poses.json
track poses.json --fps 1 --process-noise 1,1 -o track.json
smooth positions.csv -o smoothed.csv
fit positions.csv --model "a*t + b" --start a=1,b=0 --y x
transform chain frames.yaml --to base --from tag
transform eval "base_T_cam * cam_T_tag" -f frames.yaml
transform compose "1 0 0 0 0 0" "0 1 0 0 0 0" --form rvec
transform invert "1 0 0 0 0 0" --form rvec
transform convert "Rx(90deg)" --as quat:wxyz
transform average "1 0 0 0 0 0" "0 1 0 0 0 0" --form rvec
transform check "Rx(90deg)"
transform points places.csv --with "1 0 0 0 0 0" --form rvec -o moved.csv
optics --f 8 --sensor 1/1.8 --size 640x480
"""


def test_every_key_of_a_json_document_is_named_on_the_page_of_its_command(workplace, monkeypatch, capsys):
    """`demo` takes too long for it; what `doctor` finds depends on the machine."""
    monkeypatch.chdir(workplace)
    np.save("mosaic.npy", np.full((8, 8), 100, np.uint8))
    Path("positions.csv").write_text("t,x\n" + "".join(f"{t},{t % 3}\n" for t in range(20)))
    Path("places.csv").write_text("x,y,z\n1,2,3\n")
    Path("frames.yaml").write_text(
        "transforms:\n  base_T_cam: {rotation_vector: [0.0, 0.0, 0.0], t: [1.0, 0.0, 0.0]}\n"
        "  cam_T_tag: {rotation_vector: [0.0, 0.1, 0.0], t: [0.0, 0.0, 1.0]}\n"
    )
    found = pages()
    for line in RUNS.splitlines():
        with pytest.raises(SystemExit) as leaving:
            app([*shlex.split(line), "--json"])
        document = json.loads(capsys.readouterr().out)
        assert not leaving.value.code, document
        assert document.pop("warnings") is not None  # described once, for all commands
        name = document.pop("schema").split("/")[1].replace("stereo-", "stereo ").replace("transform-", "transform ")
        assert unnamed({*document, "zap"}, found[name]) == ["zap"]
        assert unnamed(set(document), found[name]) == []


def unnamed(keys: set[str], page: str) -> list[str]:
    said = page.partition("JSON,")[2]
    return sorted(key for key in keys if f"`{key}`" not in said)


def test_the_readme_has_an_example_of_the_library():
    assert [step.language for step in steps_of(text_of(README))].count("python") == 1


def exit_codes(page: str) -> dict[int, str]:
    """Return the kinds of error by exit code in the tables `| code | kind | …`."""
    rows = re.findall(r"^\| (\d+) \| (?:`(\w+)`)? ?\|", page, flags=re.MULTILINE)
    return {int(code): kind for code, kind in rows}


def test_the_exit_codes_are_those_of_the_errors():
    known = {error.exit_code: error.kind for error in [errors.CamcalError, *errors.CamcalError.__subclasses__()]}
    known |= {0: "", errors.EXIT_INTERRUPTED: "interrupted"}
    assert exit_codes(text_of(INDEX).replace("| 4 |", "| 8 |")) != known
    assert exit_codes(text_of(INDEX)) == known
    order = ", ".join(str(code) for code in errors.EXIT_PRECEDENCE if code)
    assert f"the first of {order} is the exit" in text_of(INDEX)


def test_the_page_of_the_demo_names_what_it_leaves():
    from camcal.tasks.calibration import demo

    left = re.findall(r"^([\w.]+/?)  +", demo._README, flags=re.MULTILINE)
    assert "camera.yaml" in left
    assert [name for name in left if f"`{name}`" not in pages()["demo"]] == []


def anchors(page: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", _FENCE.sub("", page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def broken_links(page: Path, content: str) -> list[str]:
    found = []
    for link in _LINK.findall(_FENCE.sub("", content)):
        target, _, anchor = link.partition("#")
        path = (page.parent / target) if target else page
        if "://" in link:
            continue
        if not path.exists() or (anchor and anchor not in anchors(text_of(path) if target else content)):
            found.append(link)
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_leads_somewhere(page):
    planted = "# A b\n[x](nowhere.md) [y](#a-b) [z](#c)"
    assert broken_links(page, planted) == ["nowhere.md", "#c"]
    assert broken_links(page, text_of(page)) == []


def reached(start: Path) -> set[Path]:
    """Return the pages that links lead to from a page, directly or over others."""
    found, left = {start}, [start]
    while left:
        page = left.pop()
        targets = {(page.parent / link.partition("#")[0]).resolve() for link in _LINK.findall(text_of(page))}
        new = {target for target in targets if target.suffix == ".md" and target.exists()} - found
        found |= new
        left += new
    return found


def test_every_page_is_reached_from_the_readme():
    found = reached(README)
    assert reached(PROJECT / "CHANGELOG.md") < found
    assert {name_of(page) for page in PAGES if page not in found} == set()


def test_a_decision_fits_on_a_page():
    decisions = [page for page in PAGES if page.parent.name == "adr" and page.name != "README.md"]
    assert decisions
    assert [name_of(page) for page in decisions if len(text_of(page).splitlines()) > 40] == []
