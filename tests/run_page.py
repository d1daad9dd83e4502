"""Run the commands of a page of the documentation as they stand, one block after another, in an empty folder.

python tests/run_page.py docs/tutorial.md FOLDER runs a page and prints what its commands print.
"""

import os
import re
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).parents[1]
README = PROJECT / "README.md"
PAGES = [PROJECT / "docs" / "tutorial.md", *sorted((PROJECT / "docs" / "recipes").glob("*.md"))]

_FENCE = re.compile(r"^```(sh|python|text)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Runs every command as a copy of itself, so that libraries are imported once for all pages: it takes the arguments, the
# environment, the folder and the three streams of a call from a socket, and gives back the exit code.
_SERVER = """
import importlib, json, os, socket, sys
from camcal.cli.main import main
from camcal.run.process import BLAS_THREADS
os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
for module in ("calibration.calibrate", "calibration.undistort", "simulation.simulate", "rigs.calibrate_rig", "plot",
               "poses.track", "stereo.stereo_run", "reports.pages"):
    importlib.import_module(f"camcal.tasks.{module}")
server = socket.socket(socket.AF_UNIX)
server.bind(sys.argv[1])
server.listen()
print("ready", flush=True)
running = []
while True:
    call, _ = server.accept()
    text, streams, _, _ = socket.recv_fds(call, 1 << 20, 3)
    running = [child for child in running if os.waitpid(child, os.WNOHANG)[0] == 0]
    if child := os.fork():
        call.close()
        for stream in streams:
            os.close(stream)
        running.append(child)
        continue
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    words, environment, folder = json.loads(text)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.argv = ["camcal", *words]
    code = 1
    try:
        main()
    except SystemExit as leaving:
        code = leaving.code or 0
    finally:
        sys.stdout.flush()
        call.send(bytes([code]))
        os._exit(code)
"""
_CLIENT = """
import json, os, socket, sys
call = socket.socket(socket.AF_UNIX)
call.connect(sys.argv[1])
socket.send_fds(call, [json.dumps([sys.argv[2:], dict(os.environ), os.getcwd()]).encode()], [0, 1, 2])
sys.exit((call.recv(1) or b"\\x01")[0])
"""
_INSTALLATION = "-m venv"  # blocks that install camcal are run by .ci/run


@dataclass(frozen=True)
class Step:
    """A block of commands or of Python, and the lines of its output that the page shows."""

    language: str
    code: str
    shown: str = ""


def steps(page: str) -> list[Step]:
    """Return the blocks of a page that are run, each with the text block that follows it before the next."""
    found: list[Step] = []
    for language, code in _FENCE.findall(page):
        if language == "text" and found and not found[-1].shown:
            found[-1] = Step(found[-1].language, found[-1].code, code)
        elif language != "text" and _INSTALLATION not in code:
            found.append(Step(language, code))
    return found


def run(page: str, folder: Path, program: Path) -> list[str]:
    """Return the output of every step of a page, run in a folder; a command that fails ends it with its output.

    program: that `command` gives.
    """
    with tempfile.TemporaryDirectory() as kept:
        outputs, script = [], ["set -euo pipefail"]
        for number, step in enumerate(steps(page)):
            outputs.append(Path(kept) / f"{number}.txt")
            script.append(_script(step, outputs[-1]))
        path = f"{program.parent}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "COLUMNS": "80"}
        ended = subprocess.run(["bash", "-c", "\n".join(script)], cwd=folder, env=environment, check=False)
        printed = [output.read_text(encoding="utf-8") for output in outputs if output.exists()]
        if ended.returncode:
            message = f"exit {ended.returncode} in\n{steps(page)[len(printed) - 1].code}\n{printed[-1]}"
            raise RuntimeError(message)
        return printed


@contextmanager
def command() -> Iterator[Path]:
    """Yield a program `camcal` that is the package of this tree, while the process that runs it is there.

    The libraries are imported once for all pages that are run with it.
    """
    with tempfile.TemporaryDirectory() as kept:
        program, calls = Path(kept) / "camcal", Path(kept) / "calls"
        client = f"exec {sys.executable} -I -S -c '{_CLIENT}' {calls} \"$@\"\n"
        program.write_text(f"#!/bin/sh\n{client}", encoding="utf-8")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        words = [sys.executable, "-c", _SERVER, str(calls)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, start_new_session=True) as server:
            try:
                server.stdout.readline()
                yield program
            finally:
                server.kill()


def _script(step: Step, output: Path) -> str:
    if step.language == "python":
        return f"python - > {output} 2>&1 <<'END_OF_PYTHON'\n{step.code}END_OF_PYTHON"
    return f"{{\n{step.code}}} > {output} 2>&1"


def missing(shown: str, printed: str) -> list[str]:
    """Return the lines of a page that an output does not have in this order, whatever their numbers are."""
    left = iter(map(masked, printed.splitlines()))
    return [line for line in shown.splitlines() if line.strip() not in {"", "…"} and masked(line) not in left]


def masked(line: str) -> str:
    """Return a line with every number as # and single blanks."""
    return " ".join(_NUMBER.sub("#", line).split())


if __name__ == "__main__":
    page, folder = Path(sys.argv[1]), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    text = page.read_text(encoding="utf-8")
    with command() as program:
        outputs = run(text, folder.resolve(), program)
    for step, printed in zip(steps(text), outputs, strict=True):
        lost = "".join(f"*** not printed: {line}\n" for line in missing(step.shown, printed))
        sys.stdout.write(f"{step.code}---\n{printed}{lost}")
