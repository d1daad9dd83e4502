"""One function over many items on all cores, results in input order; nothing else starts threads or processes.

Threads serve work that is all OpenCV. Worker processes serve where Python works or where a crash must be contained:
each has a pipe of its own and one item in flight, so that a worker that dies or hangs costs that item and no other
(a ProcessPoolExecutor fails every pending item when one worker is killed, and leaves orphans when the parent is).

Threads can also share the work on one item; OpenCV is kept to one thread of its own then.
"""

import itertools
import multiprocessing
import os
import pickle
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import copy_context
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, NamedTuple

from camcal.errors import InvalidInput, ItemsFailed, translated
from camcal.progress import SILENT, Item, Outcome, Progress, Value
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.run.process import available_cores, ended_by, heed_parent, worker_environment

_THREAD_WINDOW = 2  # items submitted per thread: one at work, one waiting; more only holds memory
_PROCESS_WINDOW = 16  # items ahead per worker, so that one slow item does not stop the others
_TASKS = 3  # of the system that a worker process takes: itself, the thread that watches its parent, one to spare
_STARTS = 3  # workers in a row that may die before they are ready, until that is called a bug
_GRACE = 0.5  # seconds a worker has to remove its temporary files when it is told to stop


def fan_out(
    function: Callable[[Item], Value],
    items: Iterable[Item],
    *,
    jobs: int | None = None,
    batch: BatchOptions = DEFAULT_BATCH,
    processes: bool = False,
    what: str = "",
    progress: Progress = SILENT,
    timeout: float | None = None,
) -> Iterator[Outcome[Item, Value]]:
    """Return an iterator with one Outcome per item, in the order of `items`; work starts with the first one asked for.

    A CamcalError of `function` becomes the item's error; any other exception is a bug and is raised here.
    jobs: threads or processes, by default the cores this process may use; 1 works in this thread, as does a process
    that may start no other.
    batch: its timeout takes the place of `timeout`; with its fail_fast the first error is the last outcome.
    processes: use worker processes; `function` and the items must then be picklable, and a worker that is killed,
    crashes or takes longer than `timeout` seconds costs its item only (ItemsFailed) and is replaced.
    OpenCV and BLAS have one thread per worker, so that results do not depend on `jobs`.
    timeout: seconds for one item; it makes all work go to processes.
    Raises InvalidInput if jobs is less than 1.
    """
    if jobs is not None and jobs < 1:
        raise InvalidInput(f"{jobs} jobs, need at least 1", where="jobs")
    timeout = timeout if batch.timeout is None else batch.timeout
    processes = processes or timeout is not None  # a thread cannot be stopped
    total = len(items) if isinstance(items, Sized) else None
    count = jobs or available_cores()
    if total is not None:
        count = min(count, max(total, 1))
    possible = startable(_TASKS * count) // _TASKS if processes else startable(count)
    count = min(count, max(possible, 1))
    if possible < 1 or (count == 1 and timeout is None):
        outcomes = _inline(function, items)
    elif processes:
        outcomes = _WorkerPool(function, items, count, timeout).outcomes()
    else:
        outcomes = _threaded(function, items, count)
    return _reported(outcomes, what, total, progress, batch.fail_fast)


def _reported(
    outcomes: Generator[Outcome[Item, Value]], what: str, total: int | None, progress: Progress, fail_fast: bool
) -> Iterator[Outcome[Item, Value]]:
    progress.start(what, total)
    try:
        for outcome in outcomes:
            progress.advance()
            yield outcome
            if fail_fast and outcome.error is not None:
                return
    finally:
        outcomes.close()
        progress.finish()


def _attempt(function: Callable[[Item], Value], item: Item) -> Outcome[Item, Value]:
    try:
        return Outcome(item, value=function(item))
    except Exception as error:
        known = translated(error)
        if known is None:
            raise
        if known is not error and known.where is None:
            known.where = _name(item)
        return Outcome(item, error=known)


def _inline(function: Callable[[Item], Value], items: Iterable[Item]) -> Generator[Outcome[Item, Value]]:
    with one_opencv_thread():
        for item in items:
            yield _attempt(function, item)


def _threaded(function: Callable[[Item], Value], items: Iterable[Item], count: int) -> Generator[Outcome[Item, Value]]:
    window: deque[Future[Outcome[Item, Value]]] = deque()
    with one_opencv_thread():
        pool = ThreadPoolExecutor(count, thread_name_prefix="camcal")
        try:
            for item in items:
                window.append(pool.submit(copy_context().run, _attempt, function, item))
                if len(window) >= _THREAD_WINDOW * count:
                    yield window.popleft().result()
            while window:
                yield window.popleft().result()
        finally:
            # Items at work are finished, so that no temporary file is left behind; the others are dropped.
            pool.shutdown(wait=True, cancel_futures=True)


class _Bug(NamedTuple):
    """An exception in a worker that is not the user's doing."""

    error: Exception
    trace: str


class _WorkerTraceback(Exception):
    """The traceback of a worker process as text, the cause of the exception raised in its parent."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class _Worker:
    """A process, its pipe, and the item it is at."""

    def __init__(self, payload: bytes) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, payload), daemon=True)
        self.ready = False
        self.task: tuple[int, Any] | None = None
        self.deadline = float("inf")
        if os.name == "posix":  # starting the tracker later would unblock Ctrl-C, which the next line blocks
            resource_tracker.ensure_running()
        with worker_environment(needs_main=b"__main__" in payload):
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


class _WorkerPool(Generic[Item, Value]):
    """The worker processes of one fan-out, the items they are at, and the outcomes not yet handed on."""

    def __init__(
        self, function: Callable[[Item], Value], items: Iterable[Item], count: int, timeout: float | None
    ) -> None:
        self.payload = pickle.dumps(function)
        self.tasks = enumerate(items)
        self.upcoming = next(self.tasks, None)
        self.count = count
        self.timeout = timeout
        self.workers: list[_Worker] = []
        self.finished: dict[int, Outcome[Item, Value]] = {}
        self.failed_starts = 0

    def outcomes(self) -> Generator[Outcome[Item, Value]]:
        """Yield the outcomes in the order of the items; the workers are gone when this ends, however it ends."""
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

    def hand_out(self, limit: int) -> None:
        """Give every idle worker the next item, up to the index `limit`, and start workers for the rest."""
        for worker in [worker for worker in self.workers if worker.idle]:
            if self.upcoming is None or self.upcoming[0] >= limit:
                return
            self.assign(worker)
        if self.upcoming is not None:
            self.workers += [_Worker(self.payload) for _ in range(self.count - len(self.workers))]

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
        left = None if deadline == float("inf") else max(0.0, deadline - time.monotonic())
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
        self.finished[index] = Outcome(item, *reply)
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
            self.finished[index] = Outcome(item, error=ItemsFailed(reason, where=_name(item) or f"item {index + 1}"))
        self.dismiss(worker)

    def dismiss(self, worker: _Worker) -> None:
        self.workers.remove(worker)
        _stop([worker])


def _name(item: object) -> str | None:
    """Return the file that an item stands for, None if it is of another kind."""
    first = item[0] if isinstance(item, tuple) and item else item
    return str(first) if isinstance(first, (str, os.PathLike)) else None


def _stop(workers: list[_Worker]) -> None:
    """End worker processes: asked to first, killed after a grace period."""
    for worker in workers:
        worker.pipe.close()
        worker.process.terminate()
    until = time.monotonic() + _GRACE
    for worker in workers:
        worker.process.join(max(0.0, until - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.process.close()


def _serve(pipe: Connection, payload: bytes) -> None:
    """Work in a worker process: take an item from the pipe, answer, until the pipe closes."""
    heed_parent()
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        try:
            function: Callable[[Any], Any] = _load(payload)
        except Exception as error:  # noqa: BLE001 - the parent raises it
            pipe.send_bytes(_bug(error))
            return
        pipe.send_bytes(pickle.dumps(None))
        while True:
            pipe.send_bytes(_answer(function, pipe.recv_bytes()))


def _leave_with_parent() -> None:
    """End this process when its parent is gone, even in the middle of an item."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _answer(function: Callable[[Any], Any], item: bytes) -> bytes:
    try:
        outcome = _attempt(function, _load(item))
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


def _load(message: bytes) -> Any:
    return pickle.loads(message)  # noqa: S301 - it comes from a process of our own, through a pipe nobody else holds


def startable(count: int) -> int:
    """Return how many of `count` threads the limits of this process, its user and its memory let start at once."""
    end = threading.Event()
    threads = [threading.Thread(target=end.wait, daemon=True) for _ in range(count)]
    started: list[threading.Thread] = []
    try:
        for thread in threads:
            thread.start()
            started.append(thread)
    except RuntimeError:  # "can't start new thread"
        pass
    finally:
        end.set()
        for thread in started:
            thread.join()
    return len(started)


@contextmanager
def over_threads(jobs: int | None = None) -> Iterator[Callable[[Callable[[Item], object], Iterable[Item]], None]]:
    """Lend a function that does one piece of work for every item, on as many threads as there are cores.

    It returns when all are done, in whatever order; so the pieces must not depend on one another. An error of one of
    them is raised when the others are done. OpenCV has one thread per worker meanwhile.
    """
    count = startable(jobs or available_cores())
    with one_opencv_thread(), ThreadPoolExecutor(max(count, 1), thread_name_prefix="camcal") as pool:

        def each(work: Callable[[Item], object], items: Iterable[Item]) -> None:
            if not count:
                for item in items:
                    work(item)
                return
            for done in [pool.submit(copy_context().run, work, item) for item in items]:
                done.result()

        yield each


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Give OpenCV one thread for the block."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
