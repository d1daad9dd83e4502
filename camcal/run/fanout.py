"""One function over many items on all cores, results in input order.

Threads serve work that is all OpenCV. Worker processes (`run.workers`) serve where Python works, where a crash must be
contained, and where an item may be stopped. Threads that share the work on one item are those of `run.process`.
"""

import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace

from camcal import system
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.progress import SILENT, Item, Outcome, Progress, Value
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.run.process import available_cores, one_opencv_thread, startable
from camcal.run.workers import WorkerPool, attempt

_THREAD_WINDOW = 2  # items submitted per thread: one at work, one waiting; more only holds memory
_TASKS = 3  # of the system that a worker process takes: itself, the thread that watches its parent, one to spare


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
    batch: its timeout takes the place of `timeout`, workers of its scheduler that of those here. With its fail_fast no
    item is begun after one has failed; those at work are finished, the others have no outcome and are counted in a
    warning.
    processes: use worker processes; `function` and the items must then be picklable, and a worker that is killed or
    crashes costs its item only (ItemsFailed) and is replaced.
    timeout: seconds for one item of several; one that takes longer is stopped with its worker, which takes a process.
    OpenCV and BLAS have one thread per worker, so that results do not depend on `jobs`.
    Raises InvalidInput if jobs is less than 1, FileError if a folder that is written into was replaced (`system`).
    """
    if jobs is not None and jobs < 1:
        raise InvalidInput(f"{jobs} jobs, need at least 1", where="jobs")
    total = len(items) if isinstance(items, Sized) else None
    if batch.timeout is not None:
        timeout = batch.timeout
    elif total == 1:  # nothing waits for it, and a process takes a hundred times as long to start as many an item
        timeout = None
    if batch.scheduler is not None:
        from camcal.run import cluster

        sent = cluster.outcomes(function, items, replace(batch, timeout=timeout), jobs, progress)
        return _report(sent, what, total, progress)
    processes = processes or timeout is not None
    count = jobs or available_cores()
    if total is not None:
        count = min(count, max(total, 1))
    possible = startable(_TASKS * count) // _TASKS if processes else startable(count)
    count = min(count, max(possible, 1))
    if possible < 1 or (count == 1 and timeout is None):
        outcomes = _inline(function, items, batch.fail_fast)
    elif processes:
        outcomes = WorkerPool(function, items, count, timeout, fail_fast=batch.fail_fast).outcomes()
    else:
        outcomes = _run_threads(function, items, count, batch.fail_fast)
    return _report(outcomes, what, total, progress)


def only_outcome(
    function: Callable[[Item], Value], item: Item, batch: BatchOptions = DEFAULT_BATCH
) -> Outcome[Item, Value]:
    """Return what becomes of an item that is the only one; raises its error.

    The function may use all cores: it is called here, unless the batch wants it elsewhere.
    """
    if batch.timeout is None and batch.scheduler is None:
        return Outcome(item, function(item))
    [outcome] = fan_out(function, [item], jobs=1, batch=batch)
    if outcome.error is not None:
        raise outcome.error
    return outcome


def _report(
    outcomes: Generator[Outcome[Item, Value]], what: str, total: int | None, progress: Progress
) -> Iterator[Outcome[Item, Value]]:
    progress.start(what, total)
    done = 0
    try:
        for outcome in outcomes:
            done += 1
            progress.advance()
            if outcome.error is not None:
                system.require_all_same()  # what fails for that would fail for all that follow
            yield outcome
    finally:
        outcomes.close()
        progress.finish()
    if total is not None and done < total:
        text = f"stopped at the first failure: {total - done} of {total} not begun"
        progress.warn(Message("stopped_at_failure", text, {"not_begun": total - done}))


def _inline(
    function: Callable[[Item], Value], items: Iterable[Item], fail_fast: bool
) -> Generator[Outcome[Item, Value]]:
    with one_opencv_thread():
        for item in items:
            outcome = attempt(function, item)
            yield outcome
            if fail_fast and outcome.error is not None:
                return


def _run_threads(
    function: Callable[[Item], Value], items: Iterable[Item], count: int, fail_fast: bool
) -> Generator[Outcome[Item, Value]]:
    failed = threading.Event()

    def begin(item: Item) -> Outcome[Item, Value] | None:
        """Return what came of an item, None if it was not begun."""
        if failed.is_set():
            return None
        outcome = attempt(function, item)
        if fail_fast and outcome.error is not None:
            failed.set()
        return outcome

    window: deque[Future[Outcome[Item, Value] | None]] = deque()
    with one_opencv_thread():
        pool = ThreadPoolExecutor(count, thread_name_prefix="camcal")
        try:
            for item in items:
                if failed.is_set():
                    break
                window.append(pool.submit(copy_context().run, begin, item))
                if len(window) >= _THREAD_WINDOW * count and (outcome := window.popleft().result()):
                    yield outcome
            while window:
                if outcome := window.popleft().result():
                    yield outcome
        finally:
            # Items at work are finished, so that no temporary file is left behind; the others are dropped.
            pool.shutdown(wait=True, cancel_futures=True)
