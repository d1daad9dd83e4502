"""Damaged files through every reader of every command: a documented exit, lines of our own, little memory, no litter.

`python benchmarks/fuzz.py` runs more of them; a violation names the seed that repeats it.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import untrusted_run
import untrusted_seeds
from untrusted_readers import READERS

HARNESS = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
CASES = 206  # every reader once
SEED = 10  # of cases with every kind of damage
NUMBERS = 2  # of the absurd ones, for each reader of a text
QUICK = ("inspect", "optics", "transform check", "transform eval", "transform invert", "transform chain")


def test_damaged_texts_end_in_one_line_and_a_documented_exit(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = tmp_path / "good"
    good.mkdir()
    untrusted_seeds.make_texts(good)
    readers = [reader for reader in READERS if reader.verb in QUICK and (good / reader.file).exists()]
    assert len(readers) > 8
    for number in range(200):
        case = untrusted_run.case(good, readers[number % len(readers)], number)
        Path(case.reader.file).write_bytes(case.content)
        code = untrusted_run.command(case.reader.arguments(Path(case.reader.file), good, Path("out")))
        printed = capsys.readouterr()
        ended = untrusted_run.Ended(code, printed.out, printed.err, (), 0, 0.0, "out of memory" in printed.err)
        assert untrusted_run.violations(ended) == [], f"{case.reader.name} | {case.mutation} | seed {case.seed}"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited as Linux does")
def test_damaged_files_absurd_numbers_and_a_full_disk_end_in_one_line_and_a_documented_exit():
    """A case of each reader, two absurd numbers of each text, and each output on a disk that takes no more.

    One process runs them all: half of the time of few cases is that of imports and of good files.
    """
    words = ("--cases", CASES, "--seed", SEED, "--numbers-each", NUMBERS, "--full-disk")
    done = subprocess.run([sys.executable, HARNESS, *map(str, words)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    last = re.search(r"^(\d+) cases, 0 violations", done.stdout, re.MULTILINE)
    assert last is not None
    assert int(last[1]) > CASES + NUMBERS * 100 + len(untrusted_run.readers_by_output(""))


def test_every_command_that_writes_meets_a_full_disk():
    assert {reader.verb for reader in untrusted_run.readers_by_output("")} == {reader.verb for reader in READERS}


def test_every_reader_of_the_harness_meets_a_case():
    assert len(READERS) <= CASES
