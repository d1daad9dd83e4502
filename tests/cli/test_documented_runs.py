"""The tutorial, the recipes and the README run as they stand in an empty folder, and print what they say they print.

Numbers are not compared: they differ in the last digit between processors. That a page's figures are plausible is held
by the tests of the commands.
"""

import re
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
sys.path.insert(0, str(PROJECT / "tests"))

from documentation_pictures import PICTURES as MADE  # noqa: E402
from run_page import PAGES, README, command, masked, missing, run, steps  # noqa: E402

PICTURES = PROJECT / "docs" / "pictures"
LARGEST = 150_000  # bytes


@pytest.fixture(scope="module")
def program():
    """The command of this tree, in one process for all pages."""
    with command() as program:
        yield program


@pytest.mark.slow
@pytest.mark.parametrize("page", [README, *PAGES], ids=lambda page: page.stem)
def test_every_command_of_a_page_runs_in_an_empty_folder_and_prints_what_is_shown(page, tmp_path, program):
    text = page.read_text(encoding="utf-8")
    found = steps(text)
    assert len(found) >= 2
    printed = run(text, tmp_path, program)
    assert {
        step.code: lost for step, out in zip(found, printed, strict=True) if (lost := missing(step.shown, out))
    } == {}


def test_a_step_that_fails_ends_the_page_with_its_output(tmp_path, program):
    page = "```sh\ntouch before\n```\n\n```sh\ncamcal inspect none.yaml\n```\n\n```sh\ntouch after\n```\n"
    with pytest.raises(RuntimeError, match=r"exit 3 in\ncamcal inspect none\.yaml\n+camcal: error: none\.yaml"):
        run(page, tmp_path, program)
    assert [path.name for path in tmp_path.iterdir()] == ["before"]


def test_steps_share_a_folder_and_python_sees_their_files(tmp_path, program):
    parts = ("sh\nx=7\necho $x > a.txt", "python\nprint(open('a.txt').read())", "text\n8", "sh\necho $x")
    page = "".join(f"```{part}\n```\n" for part in parts)
    assert [step.shown for step in steps(page)] == ["", "8\n", ""]
    assert [out.strip() for out in run(page, tmp_path, program)] == ["", "7", "7"]


def test_a_line_that_is_not_printed_is_found_whatever_the_numbers():
    printed = "fx  638.5 ± 0.01\nverdict good\nwrote a\n"
    assert missing("fx 1.25e-3 ± 2\n…\nwrote a\n", printed) == []
    assert missing("wrote a\nverdict good\n", printed) == ["verdict good"]  # the order counts
    assert missing("verdict bad\n", printed) == ["verdict bad"]
    assert masked("  -0.5 … 1e-05 px") == "# … # px"


def pictures_of(page):
    """Return the pictures of a page by their paths, with what is said for those who do not see them."""
    return {
        (page.parent / path).resolve(): said
        for said, path in re.findall(r"!\[([^\]]*)\]\(([^)\s]+)\)", page.read_text())
    }


def test_every_picture_is_there_small_described_and_shown():
    shown = {}
    for page in [README, *(PROJECT / "docs").rglob("*.md")]:
        shown |= pictures_of(page)
    assert [path.name for path, said in shown.items() if not path.exists() or len(said) < 15] == []
    assert {path for path in shown if path.parent == PICTURES} == set(PICTURES.glob("*.png"))
    assert [path.name for path in PICTURES.glob("*.png") if path.stat().st_size > LARGEST] == []


def test_every_picture_that_the_script_makes_is_there():
    made = {name for pictures in MADE.values() for name in pictures}
    assert made - {path.stem for path in PICTURES.glob("*.png")} == set()
    assert set(MADE) <= {page.stem.lower() for page in (README, *PAGES)}
