"""Damaged files through every reader of every command: a documented exit, lines of our own, little memory, no litter.

`python benchmarks/fuzz.py` runs more of them; a violation names the seed that repeats it.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from untrusted_readers import READERS

HARNESS = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"
CASES = 205  # every reader once


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited as Linux does")
def test_damaged_files_end_in_one_line_and_a_documented_exit():
    done = subprocess.run(
        [sys.executable, HARNESS, "--cases", str(CASES), "--seed", "11"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{CASES} cases" in done.stdout
    assert "0 violations" in done.stdout


@pytest.mark.slow
def test_many_damaged_files_end_in_one_line_and_a_documented_exit():
    done = subprocess.run(
        [sys.executable, HARNESS, "--cases", "400", "--seed", "12"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_reader_of_the_harness_meets_a_case():
    assert len(READERS) <= CASES
