"""Another version of camcal beside the one at hand: a process of a benchmark's own script that imports it."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any


def answer_of(script: Path, folder: Path, request: str) -> dict[str, Any]:
    """Return what a script that was started with --worker answers to a line, with the package camcal of a folder."""
    worker = _worker(script, folder)
    worker.stdin.write(request + "\n")
    worker.stdin.flush()
    line = worker.stdout.readline()
    if not line:
        raise RuntimeError(f"camcal of {folder} ended with code {worker.wait()}")
    return json.loads(line)


@cache
def _worker(script: Path, folder: Path) -> subprocess.Popen:
    """Return the process, which prints where its camcal is as its first line."""
    environment = dict(os.environ, PYTHONPATH=str(folder))
    command = [sys.executable, str(script.resolve()), "--worker"]
    worker = subprocess.Popen(
        command, env=environment, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    home = Path(worker.stdout.readline().strip())
    if home != folder:
        raise RuntimeError(f"base: found the package camcal in {home}, not in {folder}")
    return worker
