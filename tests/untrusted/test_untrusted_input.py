"""Damaged files through every reader of every command: a documented exit, lines of our own, little memory, no litter.

`python benchmarks/fuzz.py` runs more of them; a violation names the seed that repeats it.
"""

import subprocess
import sys
from pathlib import Path

import pytest
import untrusted_run
import untrusted_seeds
from untrusted_readers import READERS

HARNESS = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
CASES = 206  # every reader once
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
def test_damaged_files_end_in_one_line_and_a_documented_exit():
    done = subprocess.run(
        [sys.executable, HARNESS, "--cases", str(2 * CASES), "--seed", "11"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{2 * CASES} cases, 0 violations" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited as Linux does")
def test_absurd_numbers_in_texts_are_refused_with_their_line_or_do_no_harm():
    done = subprocess.run([sys.executable, HARNESS, "--numbers", "71"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 violations" in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited as Linux does")
def test_a_disk_that_takes_no_more_is_told_by_every_command_and_nothing_is_half_written():
    done = subprocess.run([sys.executable, HARNESS, "--full-disk"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{len(READERS)} cases, 0 violations" in done.stdout


def test_every_reader_of_the_harness_meets_a_case():
    assert len(READERS) <= CASES
