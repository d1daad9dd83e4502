"""A Dask cluster of real processes, for tests: a scheduler that can be killed and started again, and workers."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).parent


class DaskCluster:
    """A scheduler and its workers, one thread each, that find the modules of tests/run."""

    def __init__(
        self, folder: Path, workers: int = 2, protocol: str = "tcp", extra: dict[str, str] | None = None
    ) -> None:
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self.port = found.getsockname()[1]
        self.folder, self.workers, self.protocol = folder, workers, protocol
        paths = [str(TESTS.parent), str(TESTS / "run"), os.environ.get("PYTHONPATH", "")]
        self.environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), **(extra or {})}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def url(self) -> str:
        return f"dask{'+tls' if self.protocol == 'tls' else ''}://127.0.0.1:{self.port}"

    def start(self, *names: str) -> None:
        address = f"{self.protocol}://127.0.0.1:{self.port}"
        calls = {
            "scheduler": ["dask_scheduler", "--host", address, "--no-dashboard"],
            "worker": ["dask_worker", address, "--nthreads", "1", "--nworkers", self.workers, "--no-dashboard"],
        }
        for name in names or calls:
            module, *words = calls[name]
            command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)]
            log = (self.folder / f"{name}.log").open("ab")
            with log:
                self.processes[name] = subprocess.Popen(
                    command, cwd=self.folder, env=self.environment, stdout=log, stderr=log, start_new_session=True
                )

    def kill(self, name: str) -> None:
        process = self.processes.pop(name)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def wait_for_end(self, name: str, within_s: float = 60.0) -> None:
        self.processes.pop(name).wait(within_s)

    def worker_pids(self) -> list[int]:
        """Return the processes that work on items, as their nannies started them."""
        found = []
        for status in Path("/proc").glob("[0-9]*/stat"):
            try:
                session = int(status.read_text().rpartition(")")[2].split()[3])
                command = (status.parent / "cmdline").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if session == self.processes["worker"].pid and "spawn_main" in command:
                found.append(int(status.parent.name))
        return found


@contextmanager
def dask_cluster(folder: Path, **how: object) -> Iterator[DaskCluster]:
    """Yield a running cluster; its processes are gone after the block."""
    cluster = DaskCluster(folder, **how)  # type: ignore[arg-type]
    cluster.start()
    try:
        yield cluster
    finally:
        for name in list(cluster.processes):
            cluster.kill(name)


def wait_until(holds: object, within_s: float = 60.0) -> None:
    """Wait until a function returns something true; raises TimeoutError if it does not in time."""
    until = time.monotonic() + within_s
    while not holds():  # type: ignore[operator]
        if time.monotonic() > until:
            raise TimeoutError
        time.sleep(0.05)
