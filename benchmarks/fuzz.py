"""Damaged files through every command: exit codes by command and by kind of file, peak memory, longest time.

A damaged file is a good one with flipped bits, a piece cut off or doubled, other numbers, sizes, types or bytes, deep
nesting, or damage inside of its checksums and archives. Each goes through the command line in a process of its own,
limited in memory and time. Every violation is printed with the seed that repeats it: another exit code than the
documented ones, a traceback, lines that are not camcal's own, a file left behind, too much memory or time.

With --numbers N every N-th case of another kind is run: each number of the text files is 0, ±1e-300 … ±1e300; with
--numbers-each N every command that reads a text file has N of these cases. Then a usage error that does not name the
file, and more than 5 s of the processor, are violations too. With --full-disk every command that writes gets good
files, and no file grows beyond 600 B.

    python benchmarks/fuzz.py [--cases 10000] [--seed 1] [--only "stereo cloud"] [--keep FOLDER] [--jobs 1]
    python benchmarks/fuzz.py --numbers 7
    python benchmarks/fuzz.py --cases 206 --numbers-each 2 --full-disk
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "untrusted"))

import untrusted_run
from untrusted_readers import Reader
from untrusted_run import Case, Ended

FULL = 600  # bytes
EXITS = (0, 2, 3, 4, 5, 6, 7)


Runner = Callable[[Any], tuple[Case, Ended]]
Judge = Callable[[Case, Ended], list[str]]


def outcome(folder: Path, seed: int, only: str, number: int) -> tuple[Case, Ended]:
    """Return a case by its number and how its command ended."""
    readers = untrusted_run.readers_of(only)
    each = untrusted_run.case(folder / "good", readers[number % len(readers)], seed * 1_000_003 + number)
    return each, untrusted_run.run(each, folder / "good", _room(folder))


def outcome_of_full_disk(folder: Path, reader: Reader) -> tuple[Case, Ended]:
    """Return the case of a good file, and how its command ended on a full disk."""
    each = Case(reader, "full disk", 0, (folder / "good" / reader.file).read_bytes())
    return each, untrusted_run.run(each, folder / "good", _room(folder), FULL)


def outcome_of_number(folder: Path, work: tuple[int, Reader, tuple[int, int], float]) -> tuple[Case, Ended]:
    """Return a case of an absurd number and how its command ended."""
    each = untrusted_run.case_of_number(folder / "good", *work)
    return each, untrusted_run.run(each, folder / "good", _room(folder))


def _room(folder: Path) -> Path:
    """Return the folder of this process for its cases; the one above it exists."""
    room = folder / str(os.getpid()) / "case"
    room.parent.mkdir(exist_ok=True)
    return room


def kind(name: str) -> str:
    """Return the suffix of a file, or its name where it has none."""
    return Path(name).suffix or name


def table(title: str, runs: Iterable[tuple[str, Ended]]) -> str:
    """Return a table of exit codes, with a row for each name and one for all."""
    rows: dict[str, list[Ended]] = defaultdict(list)
    for name, ended in runs:
        rows[name].append(ended)
    everything = [ended for group in rows.values() for ended in group]
    head = [title, "cases", *(f"exit {code}" for code in EXITS), "others", "longest, s", "peak, MB"]
    lines = [_row(head), _row("---" if not k else "---:" for k in range(len(head)))]
    return "\n".join(
        lines + [_row(_cells(name, group)) for name, group in [*sorted(rows.items()), ("all", everything)]]
    )


def _cells(name: str, group: list[Ended]) -> list[str]:
    codes = Counter(ended.code for ended in group)
    counts = [codes[code] for code in EXITS]
    longest, peak = max(ended.seconds for ended in group), max(ended.peak for ended in group)
    return [
        name,
        *(str(count) for count in (len(group), *counts, len(group) - sum(counts))),
        f"{longest:.1f}",
        str(peak >> 20),
    ]


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def planned(options: argparse.Namespace, folder: Path) -> Iterator[tuple[Runner, Judge, Iterable[Any]]]:
    """Yield for each kind of cases how one is run, how it is judged, and what to run."""
    if options.cases:
        run = partial(outcome, folder, options.seed, options.only)
        yield run, lambda _, ended: untrusted_run.violations(ended), range(options.cases)
    if options.numbers or options.numbers_each:
        every, good = options.numbers or 1, folder / "good"
        cases = untrusted_run.cases_of_numbers(good, options.only, options.numbers_each, options.seed)
        numbered = [(number, *each) for number, each in enumerate(cases)][options.seed % every :: every]
        yield partial(outcome_of_number, folder), untrusted_run.violations_of_number, numbered
    if options.full_disk:
        run = partial(outcome_of_full_disk, folder)
        readers = untrusted_run.readers_by_output(options.only)
        yield run, lambda _, ended: untrusted_run.violations_of_full_disk(ended), readers


def main() -> int:
    """Run cases, print what is wrong and the tables, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, help="of damaged files, 10 000 if no other kind is asked for")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="readers or command lines that hold this text")
    parser.add_argument("--keep", type=Path, help="folder for the damaged files of violations")
    parser.add_argument("--full-disk", action="store_true", help="good files, and no file grows beyond 600 B")
    parser.add_argument("--numbers", type=int, metavar="N", help="every N-th of the cases of absurd numbers in texts")
    parser.add_argument("--numbers-each", type=int, metavar="N", help="N of these for each file and command")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    if not (options.cases or options.numbers or options.numbers_each or options.full_disk):
        options.cases = 10_000
    started = time.monotonic()
    untrusted_run.load_everything()
    runs: list[tuple[Reader, Ended]] = []
    wrong = 0
    with (
        tempfile.TemporaryDirectory() as folder,
        multiprocessing.get_context("fork").Pool(options.jobs, os.setsid) as pool,
    ):
        untrusted_run.make_good_files(Path(folder) / "good")
        for run, judge, cases in planned(options, Path(folder)):
            for each, ended in pool.imap(run, cases):
                runs.append((each.reader, ended))
                for fault in judge(each, ended):
                    wrong += 1
                    words = f"{each.reader.name} | {each.mutation} | seed {each.seed}: {fault}"
                    print(words, file=sys.stderr, flush=True)
                    if options.keep:
                        options.keep.mkdir(parents=True, exist_ok=True)
                        (options.keep / f"{each.seed}-{each.reader.file}").write_bytes(each.content)
    print(table("command", ((reader.verb, ended) for reader, ended in runs)), end="\n\n")
    print(table("file", ((kind(reader.file), ended) for reader, ended in runs)), end="\n\n")
    print(f"{len(runs)} cases, {wrong} violations, {(time.monotonic() - started) / 60:.0f} minutes.")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
