"""A process without the names that only POSIX systems have: importing this module hides them.

Run as a script, it imports all of camcal and runs commands, and writes to stderr what it found.
"""

import importlib
import multiprocessing
import multiprocessing.connection  # and what it starts processes with: they choose by the system when they are imported
import multiprocessing.popen_spawn_posix
import multiprocessing.resource_tracker
import os
import pkgutil
import signal
import subprocess
import sys

import cv2
import matplotlib.pyplot as plt  # libraries may use what their own system has
import rawpy
import scipy.ndimage
import scipy.sparse.linalg
import scipy.spatial
import scipy.stats
import typer

LIBRARIES = (cv2, plt, rawpy, scipy, subprocess, typer)

_MODULES = ("fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty")
_OS = (
    *("O_NOFOLLOW", "O_NONBLOCK", "chown", "fchmod", "fchown", "fork", "forkpty", "geteuid", "getgid", "getpgid"),
    *(
        "getuid",
        "killpg",
        "mkfifo",
        "nice",
        "sched_getaffinity",
        "set_blocking",
        "setsid",
        "statvfs",
        "sync",
        "sysconf",
    ),
    *("uname", "wait3", "wait4"),
)
_SIGNALS = (
    "SIGHUP",
    "SIGUSR1",
    "SIGUSR2",
    "SIGCHLD",
    "SIGPIPE",
    "SIGALRM",
    "alarm",
    "pthread_sigmask",
)  # multiprocessing needs SIGKILL


def hide() -> None:
    """Take away modules, functions and signals, and the other ways to start processes."""
    for name in _MODULES:
        sys.modules[name] = None  # importing it raises ImportError
    for module, names in ((os, _OS), (signal, _SIGNALS)):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    multiprocessing.resource_tracker._HAVE_SIGMASK = False
    for name in ("fork", "forkserver"):
        multiprocessing.context._concrete_contexts.pop(name, None)
    sys.platform = "win32"


def doubled(number: int) -> tuple[int, int, bool]:
    """Return twice the number, the process that worked it out, and whether it could import fcntl."""
    try:
        importlib.import_module("fcntl")
    except ImportError:
        return 2 * number, os.getpid(), False
    return 2 * number, os.getpid(), True


def call(*arguments: object) -> int:
    """Return the exit code of a command."""
    from camcal.cli.main import app

    try:
        app([*map(str, arguments), "--quiet"])
    except SystemExit as left:
        return int(left.code or 0)
    return 0


def say(line: str) -> None:
    """Write a line to stderr."""
    sys.stderr.write(f"{line}\n")


def main() -> None:
    """Import, spread work, run commands."""
    import camcal
    from camcal.run.fanout import fan_out
    from camcal.run.process import stop_on_signals

    names = [each.name for each in pkgutil.walk_packages(camcal.__path__, "camcal.")]
    for name in names:
        importlib.import_module(name)
    say(f"{len(names)} modules imported")
    stop_on_signals()
    found = [outcome.value for outcome in fan_out(doubled, range(5), jobs=2, processes=True)]
    doubles = [double for double, *_ in found]
    where = "here" if os.getpid() in {process for _, process, _ in found} else "in worker processes"
    without = "with" if any(has for *_, has in found) else "without"
    say(f"fan-out: {doubles}, {where} {without} fcntl")
    codes = {
        "simulate": call("simulate", "chessboard:9x6:25mm", "-o", "scene", "--size", "640x480", "--views", 8, "-j", 2),
        "detect": call("detect", "scene/images", "--board", "scene/board.yaml", "-o", "corners.csv", "-j", 2),
        "calibrate": call("calibrate", "corners.csv", "-o", "camera.yaml", "-j", 2),
        "undistort": call("undistort", "camera.yaml", "scene/images", "-o", "straight", "-j", 2),
    }
    say(f"commands: {', '.join(f'{name} {code}' for name, code in codes.items())}")


hide()
if __name__ == "__main__":
    from without_posix import main as run  # by its name, so that worker processes find it

    run()
