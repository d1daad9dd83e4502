"""docs/man/: every command has a manual page that says what its --help says, and that man can set."""

import os
import re
import shutil
import subprocess

import pytest
from command_page import REGISTERED
from generated_pages import text_of
from man_pages import FOLDER, escaped, generated, page, pages, paragraph, title

from camcal.cli.main import COMMANDS


@pytest.fixture(scope="module")
def made():
    return pages()


def test_manual_pages_are_those_of_the_commands(made, tmp_path):
    for file, text in made.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    (tmp_path / "camcal-zap.1").write_text("", encoding="utf-8")
    (tmp_path / "camcal-fit.1").write_text("older", encoding="utf-8")
    (tmp_path / "camcal-rig.1").unlink()
    wanted = generated(tmp_path)
    assert sorted(path.name for path in wanted if wanted[path] != text_of(path)) == [
        *("camcal-fit.1", "camcal-rig.1", "camcal-zap.1")
    ]


def test_every_command_and_group_has_its_page_and_camcal_names_them(made):
    assert set(made) == {f"{title(name)}.1" for name in ("", *(entry.name for entry in COMMANDS))}
    named = set(re.findall(r"\\fB(camcal\S+)\\fR\(1\)", made["camcal.1"]))
    assert {name.replace(r"\-", "-") for name in named} == set(map(title, REGISTERED))
    assert ".TP\n\\fB7\\fR\n" in made["camcal.1"]


@pytest.mark.parametrize("name", REGISTERED)
def test_a_page_has_all_options_and_calls(made, name):
    text = made[f"{title(name)}.1"].replace(r"\-", "-")
    terms = re.findall(r"^\.TP\n\\fB(.*)\\fR$", text, flags=re.MULTILINE)
    spelled = {word for term in terms for word in re.findall(r"(?<!\S)--[\w-]+", term)}
    assert {each.name for each in REGISTERED[name].declared if not each.positional} <= spelled
    assert {"--json", "--config", "--write-config", "--examples", "--help"} <= spelled
    assert text.count(f"\n    camcal {name}") == 3


def test_nothing_in_a_text_is_a_request_of_roff():
    assert escaped(r"C:\x 'a' – -1") == r"C:\ex \(aqa\(aq \[u2013] \-1"
    assert paragraph("so " * 26 + ".TH is a word") == [" ".join(["so"] * 26), r"\&.TH is a word"]
    assert page("demo", REGISTERED["demo"], "Try it.").startswith(".TH CAMCAL\\-DEMO 1 ")


def test_man_sets_all_pages_without_a_warning():
    mandoc = shutil.which("mandoc")
    if mandoc is None:
        pytest.skip("mandoc is not installed")
    planted = subprocess.run(
        [mandoc, "-T", "lint"], check=False, input=".TH x\n.nonsense\n", capture_output=True, text=True
    )
    assert "nonsense" in planted.stdout
    found = subprocess.run(
        [mandoc, "-T", "lint", *sorted(FOLDER.iterdir())], check=False, capture_output=True, text=True
    )
    assert found.stdout == ""


def test_man_finds_a_page_by_the_path_of_the_folder():
    man = shutil.which("man")
    if man is None:
        pytest.skip("man is not installed")
    places = os.environ | {"MANPATH": str(FOLDER.parent)}
    found = subprocess.run([man, "-w", "camcal-calibrate"], check=False, env=places, capture_output=True, text=True)
    assert found.stdout.strip() == str(FOLDER / "camcal-calibrate.1")
