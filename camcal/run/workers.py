"""Worker processes: each has a pipe of its own and one item in flight.

A worker that dies or hangs so costs that item and no other (a ProcessPoolExecutor fails every pending item when one
worker is killed, and leaves orphans when the parent is). Large arrays of the function reach all workers by one file
that they map into memory.
"""

import itertools
import multiprocessing
import os
import pickle
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from contextvars import Context
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.util import get_temp_dir
from pathlib import Path
from typing import Any, Generic, NamedTuple

import numpy as np

from camcal import system, urls
from camcal.dataclass import dataclass
from camcal.errors import ItemsFailed, translated
from camcal.progress import Item, Outcome, Value
from camcal.run.process import STOPPING, ended_by, forks_safely, heed_parent, signals_held, worker_environment

_PROCESS_WINDOW = 16  # items ahead per worker, so that one slow item does not stop the others
_STARTS = 3  # workers in a row that may die before they are ready, until that is called a bug
_GRACE = 0.5  # seconds a worker has to remove its temporary files when it is told to stop
_LARGE = 1 << 16  # bytes of an array that is mapped and not copied to every worker
_ALIGNMENT = 64  # bytes, a line of the processor's cache
# Processes are forked, from this one where that is safe, else from a server that has imported what this one has: they
# start in no time, and those of a later fan-out too.
_FORKS = "forkserver" in multiprocessing.get_all_start_methods()
_LONGEST_FOLDER = 80  # bytes of the path of temporary files, where the server's socket is: systems take 104 or so
_LONGEST_WAIT = 3600.0  # seconds that a system's call surely takes


def attempt(function: Callable[[Item], Value], item: Item) -> Outcome[Item, Value]:
    """Return the outcome of an item; an exception that is not the user's doing is raised."""
    try:
        with urls.item():
            return Outcome(item, value=function(item))
    except Exception as error:
        known = translated(error)
        if known is None:
            raise
        if known is not error and known.where is None:
            known.where = item_name(item)
        return Outcome(item, error=known)


class _Bug(NamedTuple):
    """An exception in a worker that is not the user's doing."""

    error: Exception
    trace: str


class _WorkerTraceback(Exception):
    """The traceback of a worker process as text, the cause of the exception raised in its parent."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass(frozen=True)
class Payload:
    """A pickled function; its large arrays, of so many bytes each, are in a file, None without any."""

    message: bytes
    sizes: tuple[int, ...] = ()
    file: Path | None = None

    @classmethod
    def of(cls, function: Callable[..., object]) -> "Payload":
        """Return the payload of a function after writing the file, which `remove` removes."""
        large: list[memoryview] = []

        def is_copied(buffer: pickle.PickleBuffer) -> bool:
            if (view := buffer.raw()).nbytes < _LARGE:
                return True
            large.append(view)
            return False

        message = pickle.dumps(function, protocol=5, buffer_callback=is_copied)
        if not large:
            return cls(message)
        handle, name = tempfile.mkstemp(prefix="camcal-")
        payload = cls(message, tuple(view.nbytes for view in large), Path(name))
        try:
            with os.fdopen(handle, "wb") as stream:
                for view in large:
                    stream.write(view)
                    stream.write(bytes(-view.nbytes % _ALIGNMENT))
        except BaseException:
            payload.remove()
            raise
        return payload

    def load(self) -> Any:
        """Return the function; its large arrays are read from the file as they are used."""
        if self.file is None:
            return _load(self.message)
        mapped = np.memmap(self.file, np.uint8, mode="c")  # what a worker writes into its arrays stays with it
        starts = itertools.accumulate((size + -size % _ALIGNMENT for size in self.sizes[:-1]), initial=0)
        places = zip(starts, self.sizes, strict=True)
        return _load(self.message, [mapped[start : start + size].data for start, size in places])

    def remove(self) -> None:
        """Remove the file, if it is there."""
        if self.file is not None:
            with suppress(OSError):
                self.file.unlink()


def _context() -> ForkServerContext | SpawnContext:
    """Return how processes are started."""
    if not _FORKS or len(os.fsencode(get_temp_dir())) > _LONGEST_FOLDER:
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([name for name in sys.modules if name.partition(".")[0] == "camcal"])
    return context


_OPEN: set[Connection] = set()  # the ends of pipes to workers that this process holds


class _Worker:
    """A process, its pipe, and the item it is at."""

    def __init__(self, payload: Payload) -> None:
        forked = _FORKS and forks_safely()
        context = multiprocessing.get_context("fork") if forked else _context()
        self.pipe, theirs = context.Pipe()
        _OPEN.add(self.pipe)
        self.ready = False
        self.task: tuple[int, Any] | None = None
        self.deadline = float("inf")
        if os.name == "posix" and not forked:  # starting it later would unblock Ctrl-C, which is blocked below
            resource_tracker.ensure_running()
        needs_main = b"__main__" in payload.message
        held = signals_held("SIGINT", *STOPPING) if forked else worker_environment(needs_main=needs_main)
        with held, warnings.catch_warnings():
            # Python 3.12 warns of every thread, also of one that only waits for signals
            warnings.simplefilter("ignore", DeprecationWarning)
            own = theirs, payload, dict(os.environ), urls.REMOTE.get(), system.KNOWN.get()
            self.process = context.Process(target=_serve_forked if forked else _serve, args=own, daemon=True)
            self.process.start()
        theirs.close()

    @property
    def idle(self) -> bool:
        return self.ready and self.task is None

    def end(self) -> str:
        """Return how the process ended, in words."""
        self.process.join(_GRACE)
        code = self.process.exitcode or 0
        name = ended_by(code)
        if name is None:
            return f"its worker process ended with code {code}"
        if name == "SIGKILL":
            return "worker process killed (SIGKILL): if out of memory, use fewer --jobs"
        return f"its worker process crashed ({name}); the input may be damaged"


class WorkerPool(Generic[Item, Value]):
    """The worker processes of one fan-out, the items they are at, and the outcomes not yet handed on."""

    def __init__(
        self,
        function: Callable[[Item], Value],
        items: Iterable[Item],
        count: int,
        timeout: float | None,
        *,
        fail_fast: bool = False,
    ) -> None:
        self.function = function
        self.tasks = enumerate(items)
        self.upcoming = next(self.tasks, None)
        self.count = count
        self.timeout = timeout
        self.fail_fast = fail_fast
        self.workers: list[_Worker] = []
        self.finished: dict[int, Outcome[Item, Value]] = {}
        self.failed_starts = 0

    def outcomes(self) -> Generator[Outcome[Item, Value]]:
        """Yield the outcomes in the order of the items; the workers are gone when this ends, however it ends."""
        self.payload = Payload.of(self.function)
        try:
            for position in itertools.count():
                while position not in self.finished:
                    if self.upcoming is None and not any(worker.task for worker in self.workers):
                        return
                    self.hand_out(position + _PROCESS_WINDOW * self.count)
                    self.collect()
                yield self.finished.pop(position)
        finally:
            _stop(self.workers)
            self.payload.remove()

    def hand_out(self, limit: int) -> None:
        """Give every idle worker the next item, up to the index `limit`, and start workers for the rest."""
        for worker in [worker for worker in self.workers if worker.idle]:
            if self.upcoming is None or self.upcoming[0] >= limit:
                return
            self.assign(worker)
        if self.upcoming is not None:
            while len(self.workers) < self.count:  # those that have started are known when the next one cannot
                self.workers.append(_Worker(self.payload))

    def assign(self, worker: _Worker) -> None:
        assert self.upcoming is not None
        try:
            worker.pipe.send_bytes(pickle.dumps(self.upcoming[1]))
        except OSError:  # it died while idle; the item goes to another one
            self.dismiss(worker)
            return
        worker.task, self.upcoming = self.upcoming, next(self.tasks, None)
        worker.deadline = float("inf") if self.timeout is None else time.monotonic() + self.timeout

    def collect(self) -> None:
        """Wait until a worker answers, ends or is out of time, and note what came of its item."""
        deadline = min((worker.deadline for worker in self.workers), default=0.0)
        left = min(max(0.0, deadline - time.monotonic()), _LONGEST_WAIT)
        answering = wait([worker.pipe for worker in self.workers], left)
        for worker in [worker for worker in self.workers if worker.pipe in answering]:
            self.receive(worker)
        for worker in [worker for worker in self.workers if worker.deadline <= time.monotonic()]:
            self.lose(worker, f"took longer than {self.timeout:g} s and was stopped")

    def receive(self, worker: _Worker) -> None:
        try:
            reply = _load(worker.pipe.recv_bytes())
        except (EOFError, OSError):
            self.lose(worker, worker.end())
            return
        if isinstance(reply, _Bug):
            raise reply.error from _WorkerTraceback(reply.trace)
        if worker.task is None:
            worker.ready, self.failed_starts = True, 0
            return
        index, item = worker.task
        self.finish(index, Outcome(item, *reply))
        worker.task, worker.deadline = None, float("inf")

    def lose(self, worker: _Worker, reason: str) -> None:
        """Give up a worker and, if it had one, its item."""
        if not worker.ready:
            self.failed_starts += 1
            if self.failed_starts == _STARTS:
                raise RuntimeError(
                    f"worker processes do not start: {reason}; a script that starts them needs "
                    "`if __name__ == '__main__':` around its work"
                )
        if worker.task is not None:
            index, item = worker.task
            self.finish(index, Outcome(item, error=ItemsFailed(reason, where=item_name(item) or f"item {index + 1}")))
        self.dismiss(worker)

    def finish(self, index: int, outcome: Outcome[Item, Value]) -> None:
        """Note what came of an item; after a failure no further one is begun if so asked for."""
        self.finished[index] = outcome
        if self.fail_fast and outcome.error is not None:
            self.upcoming = None

    def dismiss(self, worker: _Worker) -> None:
        self.workers.remove(worker)
        _stop([worker])


def item_name(item: object) -> str | None:
    """Return the file that an item stands for, None if it is of another kind."""
    first = item[0] if isinstance(item, tuple) and item else item
    return str(first) if isinstance(first, (str, os.PathLike)) else None


def _stop(workers: list[_Worker]) -> None:
    """End worker processes: asked to first, killed after a grace period."""
    for worker in workers:
        _OPEN.discard(worker.pipe)
        worker.pipe.close()
        worker.process.terminate()
    until = time.monotonic() + _GRACE
    for worker in workers:
        worker.process.join(max(0.0, until - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.process.close()


def _serve_forked(*own: Any) -> None:
    """Work in a process that was forked, without what its parent has open and what that is at."""
    for pipe in _OPEN:
        pipe.close()
    system.release_locks()
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    Context().run(_serve, *own)


def _serve(
    pipe: Connection, payload: Payload, environment: dict[str, str], remote: urls.Remote | None, known: system.Known
) -> None:
    """Work in a worker process: take an item from the pipe, answer, until the pipe closes."""
    heed_parent()
    os.environ.clear()  # the server of forks has that of its own start
    os.environ.update(environment)
    urls.REMOTE.set(remote)
    system.KNOWN.set(known)
    threading.Thread(target=_leave_with_parent, args=(payload,), daemon=True).start()
    with suppress(EOFError, OSError):
        try:
            function: Callable[[Any], Any] = payload.load()
        except Exception as error:  # noqa: BLE001 - the parent raises it
            pipe.send_bytes(_bug(error))
            return
        pipe.send_bytes(pickle.dumps(None))
        while True:
            pipe.send_bytes(_answer(function, pipe.recv_bytes()))


def _leave_with_parent(payload: Payload) -> None:
    """End this process when its parent is gone, even in the middle of an item."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    payload.remove()
    os._exit(1)


def _answer(function: Callable[[Any], Any], item: bytes) -> bytes:
    try:
        outcome = attempt(function, _load(item))
        return pickle.dumps((outcome.value, outcome.error))
    except Exception as error:  # noqa: BLE001 - the parent raises it
        return _bug(error)


def _bug(error: Exception) -> bytes:
    trace = "".join(traceback.format_exception(error))
    try:
        message = pickle.dumps(_Bug(error, trace))
        _load(message)  # many exceptions can be written but not read back
    except Exception:  # noqa: BLE001 - whatever it is, its traceback gets through
        return pickle.dumps(_Bug(RuntimeError(f"{type(error).__qualname__}: {error}"), trace))
    return message


def _load(message: bytes, buffers: Iterable[memoryview] = ()) -> Any:
    return pickle.loads(message, buffers=buffers)  # noqa: S301 - it comes from a process of our own, through a pipe nobody else holds
