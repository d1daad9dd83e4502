"""A run with one result is not repeated while inputs, settings, what is asked for and what it wrote are the same."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pytest

from camcal import files
from camcal.options import OUTPUT, Argument, Option, OptionsRecord, Written
from camcal.run.journal import Finished
from camcal.run.outputs import writes
from camcal.tasks.options import output_option


@dataclass(frozen=True)
class Options(OptionsRecord):
    inputs: Annotated[tuple[str, ...], Argument("Files.", metavar="FILES…")]
    output: Annotated[Path, output_option("Where.", Written((".txt",)))]
    table: Annotated[Path | None, Option("More.", group=OUTPUT, recorded=False, written=Written((".csv",)))] = None
    scale: Annotated[float, Option("A number.")] = 1.0


def worked(options):
    """Run a task unless it is finished; return whether it did anything."""
    finished = Finished("count", options, options.output)
    if finished.document() is not None:
        return False
    count(options, finished)
    return True


@writes
def count(options, finished):
    """Write how many inputs there are to every output."""
    for path in (options.output, options.table):
        if path is not None:
            files.write_text(path, f"{finished.inputs}\n")
    finished.keep({"inputs": finished.inputs})


@pytest.fixture
def options(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    for name in ("a", "b"):
        Path("in", name).write_text(name)
    return Options(("in",), Path("in/count.txt"), Path("table.csv"))


def test_a_finished_run_is_not_repeated_and_repeats_its_document(options):
    assert worked(options)
    assert not worked(options)
    assert Finished("count", options, options.output).document() == {"inputs": 2}


@pytest.mark.parametrize(
    "change",
    [
        lambda: Path("in/a").write_text("c"),
        lambda: Path("in/c").write_text("c"),
        lambda: Path("in/b").unlink(),
        lambda: Path("table.csv").unlink(),
        lambda: Path("table.csv").write_text("3\n"),
    ],
    ids=["changed", "new", "gone", "output gone", "output changed"],
)
def test_a_run_is_repeated_after_a_change_of_any_of_its_files(options, change):
    worked(options)
    change()
    assert Finished("count", options, options.output).document() is None


def test_a_run_is_repeated_for_another_setting_or_file_that_is_asked_for(options):
    worked(options)
    for other in (replace(options, scale=2.0), replace(options, table=None), replace(options, table=Path("b.csv"))):
        assert Finished("count", other, other.output).document() is None


def test_hidden_files_and_those_that_camcal_listed_are_no_inputs(options):
    worked(options)
    Path("in/.hidden").write_text("c")
    assert not worked(options)
    other = replace(options, output=Path("count.txt"))
    assert Finished("count", other, other.output).inputs == 2
