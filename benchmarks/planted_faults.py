"""Planted faults: how many of the errors on a list the fast tests find.

The list is in tests/faults, one file a package and one table a fault: the text that stands once in the package, what
takes its place, and the tests that most likely find it. The tree is copied and every fault is planted in the copy by
itself: the likely tests are run first, the other fast ones where those pass.

With --thresholds the faults are the constants of tests/faults/thresholds, each at half and at twice its value: a table
a module, with the names of its constants and the likely tests.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).parents[1]
LISTS = PROJECT / "tests" / "faults"
THRESHOLDS = LISTS / "thresholds" / "decisions.toml"
PARTS = ("camcal", "tests", "docs", "benchmarks", "sample_configs", "pyproject.toml", "README.md", "CHANGELOG.md")
LONGEST_S = 1800.0  # of one run of tests; a fault that lets one go on for ever is found


@dataclass(frozen=True)
class Fault:
    """A text of the package and what takes its place."""

    package: str
    name: str
    find: str
    put: str
    tests: tuple[str, ...] = ()
    module: str = ""  # by its path in the package, where the text may stand in others too


def thresholds(path: Path = THRESHOLDS, package: Path = PROJECT / "camcal") -> list[Fault]:
    """Return the constants of a list at half and at twice their values; ends where one is no number of its module."""
    found = []
    for module, own in tomllib.loads(path.read_text(encoding="utf-8")).items():
        text = (package / module).read_text(encoding="utf-8")
        for name in own["names"]:
            numbers = re.findall(rf"^{name} = ([-\d.e_ /]+?)(?:  #.*)?$", text, re.MULTILINE)
            if len(numbers) != 1:
                raise SystemExit(f"{module}: {name} is not defined once, by a number")
            halved = "//" if numbers[0].isdigit() else "/"
            for way, change in (("half", f"{halved} 2"), ("twice", "* 2")):
                line = f"{name} = {numbers[0]}"
                found.append(Fault(module, f"{name} at {way}", line, f"{line} {change}", tuple(own["tests"]), module))
    return found


def faults(folder: Path = LISTS) -> list[Fault]:
    """Return the faults of the lists in a folder, in the order of their names."""
    found = []
    for path in sorted(folder.glob("*.toml")):
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
        found += [
            Fault(path.stem, name, own["find"], own["put"], tuple(own.get("tests", ()))) for name, own in tables.items()
        ]
    return found


def plant(fault: Fault, tree: Path) -> tuple[Path, str]:
    """Write a fault into the package below `tree`; return the module that has it now, and what it was before."""
    paths = [tree / "camcal" / fault.module] if fault.module else sorted((tree / "camcal").rglob("*.py"))
    modules = ((path, path.read_text("utf-8")) for path in paths)
    places = [(path, text) for path, text in modules if fault.find in text]
    if len(places) != 1 or places[0][1].count(fault.find) != 1:
        raise SystemExit(f"{fault.name}: its text does not stand once in the package: {fault.find!r}")
    path, text = places[0]
    write(path, text.replace(fault.find, fault.put))
    return path, text


def write(path: Path, text: str) -> None:
    """Write a module and forget what was compiled of it."""
    path.write_text(text, encoding="utf-8")
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        compiled.unlink()


def found_by(tree: Path, tests: list[str], *options: str) -> str | None:
    """Return the first of the fast tests that fails, None where all pass."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "--tb=no",
        "-rfE",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
    ]
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [*command, *options, *tests],
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as run:
        try:
            output = run.communicate(timeout=LONGEST_S)[0]
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            return "no end"
    if run.returncode == 0:
        return None
    named = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(.*?)(?: - .*)?$", output, re.MULTILINE)
    return named[1] if named else f"exit {run.returncode}"


def main() -> None:
    """Plant the faults that are asked for and print which test finds each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of the names of faults, by default all")
    parser.add_argument("--package", help="of one list only, such as calibrate")
    parser.add_argument("--likely", action="store_true", help="run the likely tests only")
    parser.add_argument("--lists", type=Path, default=LISTS, help="the folder of the lists")
    parser.add_argument("--thresholds", action="store_true", help="constants at half and at twice their values instead")
    options = parser.parse_args()
    chosen = [
        fault
        for fault in (thresholds() if options.thresholds else faults(options.lists))
        if (not options.names or any(name in fault.name for name in options.names))
        and options.package in {None, fault.package}
    ]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for part in PARTS:
            copy = shutil.copytree if (PROJECT / part).is_dir() else shutil.copy
            copy(PROJECT / part, tree / part)
        by_module: dict[str, list[str | None]] = {}
        if not options.thresholds:
            print("| package | fault | found by | s |\n|---|---|---|---|")
        for fault in chosen:
            start = time.monotonic()
            path, text = plant(fault, tree)
            likely = [f"tests/{each}" for each in fault.tests]
            by = found_by(tree, likely, "-p", "no:randomly", "-p", "no:xdist", "-o", "addopts=") if likely else None
            if by is None and not options.likely:
                by = found_by(tree, ["tests"], "-n", "2")
            write(path, text)
            survivors += by is None
            by_module.setdefault(fault.package, []).append(None if by else fault.name)
            if not options.thresholds:
                seconds = time.monotonic() - start
                print(f"| {fault.package} | {fault.name} | {by or '**survives**'} | {seconds:.0f} |", flush=True)
    if options.thresholds:
        print("| module | constants | survive |\n|---|---|---|")
        for module, alive in by_module.items():
            print(f"| {module} | {len(alive) // 2} | {', '.join(filter(None, alive)) or 'none'} |")
    else:
        print(f"\n{len(chosen)} faults, {survivors} survive")


if __name__ == "__main__":
    main()
