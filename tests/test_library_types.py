"""What a type checker knows of the library: mypy --strict on a user's script finds no Any, nor in what it gets back."""

import dataclasses
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from textwrap import indent

import pytest

import camcal

ROOT = Path(__file__).parents[1]
_LINE = re.compile(r"user\.py:(\d+): (note|error): (.*)")
_SHAPE = "tuple[Any, ...]"  # of arrays, as NumPy has it
_GENERIC = {"Outcome", "Derived"}  # bare classes; what is in them is known where they come from


def members(kind: type) -> list[str]:
    """Return what a class has of its own: fields, properties and methods."""
    fields = {field.name for field in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    inherited = {name for base in (tuple, int, BaseException) if issubclass(kind, base) for name in dir(base)}
    return sorted(name for name in (fields | set(dir(kind))) - inherited if not name.startswith("_"))


def asked(names: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield lines of a script and what each of them asks about."""
    for module in sorted({module for module, _ in names}):
        yield f"import {module}", ""
    for number, (module, name) in enumerate(names):
        found = getattr(import_module(module), name)
        if not inspect.isclass(found):
            yield f"reveal_type({module}.{name})", f"{module}.{name}"
            continue
        yield f"def f{number}(x: {module}.{name}) -> None:", ""
        for member in members(found):
            yield f"    reveal_type(x.{member})", f"{module}.{name}.{member}"
        yield "    return", ""


def results(revealed: str) -> str:
    """Return a revealed type without the arguments of functions: a function may take anything."""
    while True:
        shorter = re.sub(r"def (\[[^\]]*\] )?\([^()]*\)( -> )?", "", revealed)
        if shorter == revealed:
            shorter = re.sub(r"\(([^()]*)\)", r"<\1>", revealed)
        if shorter == revealed:
            return revealed
        revealed = shorter


def is_class(module: str, name: str) -> bool:
    """Return whether a module has a class of that name; a member of an enumeration is none."""
    try:
        return inspect.isclass(getattr(import_module(module), name, None))
    except ModuleNotFoundError:
        return False


def checked(script: str, folder: Path) -> list[tuple[str, str, str]]:
    """Return what mypy says of a user's script: line, note or error, and text."""
    (folder / "user.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(folder / "cache"), "user.py"],
        cwd=folder,
        env=os.environ | {"MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    return [match.group(1, 2, 3) for match in map(_LINE.match, done.stdout.splitlines()) if match]


def revealed(names: list[tuple[str, str]], folder: Path) -> tuple[dict[str, str], list[str]]:
    """Return the types of public names by what was asked, and the errors of mypy."""
    lines = list(asked(names))
    said = checked("\n".join(line for line, _ in lines) + "\n", folder)
    types = {lines[int(line) - 1][1]: text for line, kind, text in said if kind == "note"}
    errors = [text for _, kind, text in said if kind == "error" and not any(name in text for name in _GENERIC)]
    return types, errors


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of scripts, and of what mypy keeps of the package from one to the next."""
    return tmp_path_factory.mktemp("typed")


@pytest.mark.slow
def test_a_type_checker_finds_no_any_in_what_a_program_gets(folder):
    waiting = [("camcal", name) for name in camcal.__all__]
    known: set[str] = set()
    found: dict[str, str] = {}
    while waiting:
        known |= {name for _, name in waiting}
        types, errors = revealed(waiting, folder)
        assert errors == []
        found |= types
        names = {full for text in types.values() for full in re.findall(r"camcal(?:\.\w+)+", results(text))}
        waiting = sorted(
            (module, name)
            for module, _, name in (full.rpartition(".") for full in names)
            if name not in known and is_class(module, name)
        )
    assert len(found) > 300
    untyped = {name for name, text in found.items() if "Any" in results(text).replace(_SHAPE, "")}
    assert {name for name in untyped if name.split(".")[-2] not in _GENERIC} == set()


@pytest.mark.slow
def test_the_examples_of_the_library_page_are_typed(folder):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "library.md").read_text(), re.DOTALL)
    assert len(blocks) >= 5
    assert max(len(block.splitlines()) for block in blocks) <= 15
    functions = [f"def example{number}() -> None:\n{indent(block, '    ')}" for number, block in enumerate(blocks)]
    wrong = "import camcal\ncamcal.read_camera(3)\n"
    said = checked(wrong + "\n".join(functions), folder)
    assert [(line, kind) for line, kind, _ in said] == [("2", "error")]  # the planted one


def test_results_are_told_from_arguments():
    assert results("def (x: Any, y: def (a: Any) -> Any) -> int") == "int"
    assert "Any" in results("def (x: int) -> dict[str, Any]")
