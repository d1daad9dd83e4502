"""docs/benchmarks.md is its text filled with the results of the scripts, and nothing else."""

import re
import sys
from pathlib import Path

import benchmarks_page
import pytest
from benchmarks_page import PAGE, TEMPLATE, Result, page, parsed, record, results, used
from generated_pages import WRITE

PROJECT = Path(__file__).parents[1]
TEXT = TEMPLATE.read_text(encoding="utf-8")


def test_the_page_is_the_text_with_the_results():
    found = results()
    changed = found | {"rig_faults": Result(("true",), "", "nothing")}
    assert page(TEXT, changed) != PAGE.read_text(encoding="utf-8")
    assert page(TEXT, found) == PAGE.read_text(encoding="utf-8"), WRITE


def test_every_result_is_shown_and_no_table_stands_in_the_text():
    assert set(results()) - used(TEXT.replace("{result rig_faults}", "")) == {"rig_faults"}
    assert used(TEXT) == set(results())
    tables = re.findall(r"^\|---.*\n\|? ?(.*)$", TEXT, flags=re.MULTILINE)
    assert [row.partition("]")[0] for row in tables] == ["[From images to a camera", "{list of results}"]
    assert "```text" not in TEXT


def missing_scripts(found):
    scripts = {name: re.findall(r"benchmarks/(\w+\.py)", " ".join(each.commands)) for name, each in found.items()}
    return [name for name, used in scripts.items() if any(not (PROJECT / "benchmarks" / one).exists() for one in used)]


def test_every_command_is_one_of_a_script_that_exists():
    assert missing_scripts({"planted": Result(("python benchmarks/none.py",), "", "x")}) == ["planted"]
    assert missing_scripts(results()) == []


def test_a_table_is_shown_as_it_is_and_other_output_as_text():
    found = {"a": parsed("$ x \\\n>   y\n# Python 3.11\n\n| b |\n|---|\n"), "c": parsed("$ z\n# v\n\n 1  2\n\n3\n")}
    filled = page("{commands a c}\n{result a}\n{result c}\n{list of results}\n", found)
    assert filled.startswith("```sh\nx \\\n  y\nz\n```\n| b |\n|---|\n```text\n 1  2\n\n3\n```\n")
    assert "| [a](benchmarks/results/a.txt) | Python 3.11 |" in filled


@pytest.mark.parametrize("text", ["no head\n\nx\n", "$ x\n\n1\n", "$ x\n# v\n\n", "# v\n\n1\n", "$ x\ny\n# v\n\n1\n"])
def test_a_file_that_is_no_result_is_refused(text):
    with pytest.raises(ValueError, match="not a result"):
        parsed(text)


def test_a_command_is_run_and_its_output_kept_with_the_versions(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmarks_page, "RESULTS", tmp_path)
    record("small", [sys.executable, "-c", "print(' 1  2')"], "mrcal 2.2")
    (found,) = results().values()
    assert found.output == " 1  2"
    assert re.search(r"^Python 3\.\d+\.\d+, OpenCV \d.*, numpy \d.*, mrcal 2\.2$", found.versions)
    assert found.commands[0].endswith("""-c 'print('"'"' 1  2'"'"')'""")


def rows(text):
    """Return the cells of the tables under `On real images`, by the first one."""
    section = text.partition("## On real images\n")[2].partition("\n## ")[0]
    lines = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


def differing(shown):
    """Return the programs and sets whose figures are not those of the results."""
    found = results()
    programs = {line.split()[0]: line.split()[1:5] for line in found["split_halves_programs"].output.splitlines()[2:]}
    wanted = {name: [sets, best, held, lenses] for name, (sets, best, lenses, held) in programs.items()}
    wanted["OpenCV"] = wanted.pop("cv2")
    return [name for name, figures in wanted.items() if shown.get(name) != figures]


def test_the_readme_has_the_figures_of_the_results():
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    assert differing(rows(text.replace("2.283", "2.383"))) == ["mrcal"]
    assert differing(rows(text)) == []
    assert {"camcal", "OpenCV", "mrcal", "lensboy"} <= set(rows(text))
