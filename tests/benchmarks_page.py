"""docs/benchmarks.md from its text and the results that the scripts of benchmarks/ printed.

generated_pages.py writes the page; with --record NAME -- COMMAND it runs a command and keeps its output first.
"""

import os
import platform
import re
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"
TEMPLATE = PAGE.with_suffix("") / "template.md.in"
RESULTS = PAGE.with_suffix("") / "results"
_MARK = re.compile(r"^\{(commands|result) ([\w ]+)\}$", flags=re.MULTILINE)
_LIST = "{list of results}"


@dataclass(frozen=True)
class Result:
    """What a script printed, with its command (lines of the shell) and the versions that it ran with."""

    commands: tuple[str, ...]
    versions: str
    output: str


def parsed(text: str) -> Result:
    """Return the result that a file holds: lines with `$ ` or `> ` and one with `# `, an empty line, the output."""
    head, _, output = text.partition("\n\n")
    lines = head.split("\n")
    commands = tuple(line[2:] for line in lines[:-1] if line.startswith(("$ ", "> ")))
    if not commands or len(commands) + 1 < len(lines) or not lines[-1].startswith("# ") or not output.strip():
        message = f"not a result: {lines[0]!r}; wanted are `$ COMMAND`, `# VERSIONS`, an empty line, and the output"
        raise ValueError(message)
    return Result(commands, lines[-1][2:], output.rstrip("\n"))


def results() -> dict[str, Result]:
    """Return all results by the names of their files."""
    return {path.stem: parsed(path.read_text(encoding="utf-8")) for path in sorted(RESULTS.glob("*.txt"))}


def page(template: str, found: dict[str, Result]) -> str:
    """Return the page: the template with commands and outputs, and the list of all results."""
    rows = [f"| [{name}](benchmarks/results/{name}.txt) | {each.versions} |" for name, each in found.items()]
    filled = _MARK.sub(lambda mark: _block(mark[1], [found[name] for name in mark[2].split()]), template)
    return filled.replace(_LIST, "\n".join(rows))


def _block(kind: str, chosen: list[Result]) -> str:
    """Return commands as a block of the shell, or an output as the table or the text that it is."""
    if kind == "commands":
        return "\n".join(["```sh", *(line for each in chosen for line in each.commands), "```"])
    (result,) = chosen
    return result.output if result.output.startswith("|") else f"```text\n{result.output}\n```"


def used(template: str) -> set[str]:
    """Return the names of the results whose output a template shows."""
    return {name for kind, name in _MARK.findall(template) if kind == "result"}


def record(name: str, command: list[str], versions: str) -> None:
    """Run a command and write its output, with the versions of the libraries, as a result."""
    import cv2
    import numpy as np

    environment = os.environ | {"PYTHONIOENCODING": "utf-8"}
    printed = subprocess.run(command, check=True, capture_output=True, env=environment).stdout.decode()
    libraries = [f"Python {platform.python_version()}", f"OpenCV {cv2.__version__}", f"numpy {np.__version__}"]
    head = [f"$ {shlex.join(command)}", f"# {', '.join(libraries + [versions] * bool(versions))}"]
    (RESULTS / f"{name}.txt").write_text("\n".join([*head, "", printed.rstrip("\n"), ""]), encoding="utf-8")


def generated() -> dict[Path, str | None]:
    """Return the text of the page."""
    return {PAGE: page(TEMPLATE.read_text(encoding="utf-8"), results())}
