"""What every test may use: the shared real data, processes that do not outlive it, and quick randomised searches."""

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from camcal.run.process import BLAS_THREADS

PROJECT = Path(__file__).parents[1]
TESTS = PROJECT / "tests"
DETECTORS = TESTS / "targets", TESTS / "calibrate" / "test_intrinsics.py"

os.environ.pop("GITHUB_ACTIONS", None)  # its annotations are tested by name
# as the command line has it, and before numpy is there: on small matrices many threads wait for each other
for _name in BLAS_THREADS:
    os.environ.setdefault(_name, "1")

# Each of the processes that share the tests keeps to a core of its own: a command then starts no worker processes
# unless it is told how many, and what it starts does not take the cores of the others.
if (_worker := os.environ.get("PYTEST_XDIST_WORKER", "")).startswith("gw") and hasattr(os, "sched_setaffinity"):
    _cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {_cores[int(_worker[2:]) % len(_cores)]})

EXAMPLES = int(os.environ.get("CAMCAL_EXAMPLES", "25"))  # that a randomised search tries; hundreds find more
settings.register_profile("camcal", max_examples=EXAMPLES, deadline=None, derandomize=True)
settings.load_profile("camcal")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Count every test of real data among the slow ones, and put files with these first: no process ends with one.

    The tests of a file stay together, for its fixtures are then made once.
    """
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
        if any(item.path.is_relative_to(each) for each in DETECTORS):
            item.add_marker(pytest.mark.detectors)
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in long)


def pytest_collection_finish() -> None:
    """Spare the collector of garbage what stays to the end: modules and thousands of tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real images, CAMCAL_TEST_DATA or ../shared/data; the test is skipped where there is none."""
    folder = Path(os.environ.get("CAMCAL_TEST_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        message = f"no real data: {folder} is not a folder (set CAMCAL_TEST_DATA)"
        if os.environ.get("CAMCAL_REQUIRE_DATA"):
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture
def start_python() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """A function that starts Python with arguments, in a process group of its own.

    Ctrl-C interrupts it even where it is ignored here, as in a job in the background, which children inherit. The whole
    group is killed at the end of the test, also of one that fails.
    """
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: object, **extra: Any) -> subprocess.Popen[str]:
        command = [sys.executable, *map(str, arguments)]
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True, **extra)
        finally:
            signal.signal(signal.SIGINT, before)
        started.append(process)
        return process

    yield start
    for process in started:
        with process, suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.fixture
def local_cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs of this process with `--scheduler dask://local` share a cluster, which ends with the test.

    A program keeps it to its end, and later tests would find its processes among their own.
    """
    from camcal.run import cluster

    started = []

    @cache
    def start(workers: int) -> Any:
        started.append(original.__wrapped__(workers))
        return started[-1]

    original = cluster._local_cluster
    monkeypatch.setattr(cluster, "_local_cluster", start)
    yield
    for each in started:
        each.close()
