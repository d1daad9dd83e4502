"""The work of a fan-out on a Dask cluster: one outcome per item, in the order of the items, as on this machine.

Functions, items and results go through Dask, which pickles them; camcal sends nothing else. A worker that is lost costs
no item: Dask gives its items to others. A scheduler that is lost is waited for, and what was not done by then is sent
again.
"""

import itertools
import logging
import queue
import tempfile
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Generic
from uuid import uuid4

from camcal import files, system, urls
from camcal.errors import CamcalError, FileError, InvalidInput, ItemsFailed, reason
from camcal.images.options import max_pixels
from camcal.messages import Message
from camcal.progress import Item, Outcome, Progress, Value
from camcal.run import fingerprint
from camcal.run.cluster_worker import RunTerms, answers
from camcal.run.options import LOCAL, BatchOptions
from camcal.run.outputs import Run
from camcal.run.process import BLAS_THREADS, available_cores, worker_environment
from camcal.run.workers import item_name
from camcal.system import TEMPORARY

_AHEAD = 32  # items that are sent, per worker: some wait at the worker, so that it is never idle
_MOST_TOGETHER = 16  # items in one task of Dask, each of which costs some milliseconds
_TOGETHER_S = 0.5
_SHORTEST_S = 1e-4
_FEWEST_AHEAD = 64  # a cluster that starts workers on demand sees by them that there is work
_LOCAL_SETTINGS = {  # without Dask's limit of malloc, which maps the memory of every image anew, and its measurements
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(BLAS_THREADS, 1),
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
}
_CONNECT_S = 20.0
_PATIENCE_S = 60.0  # for a scheduler that was there and does not answer any more
_CLOSE_S = 2.0
_LOOK_S = 5.0  # between two counts of the workers


def outcomes(
    function: Callable[[Item], Value],
    items: Iterable[Item],
    batch: BatchOptions,
    jobs: int | None,
    progress: Progress,
) -> Generator[Outcome[Item, Value]]:
    """Yield one outcome per item, in the order of the items, worked on by the cluster of batch.scheduler.

    That is dask://HOST:PORT, dask+tls://HOST:PORT, or dask://local for workers on this machine, `jobs` of them. A
    worker that dies costs no item, unless several die with the same one. See `fan_out` for the rest of `batch`.
    Raises InvalidInput without Dask, and for workers with other versions of camcal and its libraries;
    FileError if the scheduler does not answer. An exception that is no CamcalError is a bug, and is raised.
    """
    assert batch.scheduler is not None
    _require_dask()
    address = _dask_address(batch.scheduler, jobs)
    with _terms(batch) as terms:
        work = _Submission(function, items, batch.scheduler, address, terms, progress)
        try:
            yield from work.outcomes()
        finally:
            work.close()


def _dask_address(scheduler: str, jobs: int | None) -> str:
    """Return the address of a scheduler as Dask has it; raises InvalidInput or FileError if it cannot be encrypted."""
    import dask
    from distributed.security import Security

    security = Security()  # type: ignore[no-untyped-call]
    protocol, _, place = scheduler.partition("://")
    if scheduler == LOCAL:
        scheme = "tls" if security.require_encryption else "tcp"
    else:
        scheme = protocol.removeprefix("dask").removeprefix("+")
        scheme = scheme or dask.config.get("distributed.comm.default-scheme", "tcp")
    if scheme == "tls":
        _require_certificates(security, scheduler)
    elif security.require_encryption:
        raise InvalidInput("Dask's configuration requires encryption; use dask+tls://HOST:PORT", where=scheduler)
    if scheduler == LOCAL:
        return str(_local_cluster(jobs or available_cores()).scheduler_address)
    return f"{scheme}://{place}"


def _require_certificates(security: Any, scheduler: str) -> None:
    """Raise InvalidInput or FileError if Dask's configuration names no certificates, or they cannot be read."""
    try:
        has_certificates = security.get_connection_args("client")["ssl_context"] is not None
    except OSError as error:
        text = f"the certificates of Dask's configuration cannot be read: {reason(error)}"
        raise FileError(text, where=scheduler) from error
    if not has_certificates:
        raise InvalidInput("needs certificates: set distributed.comm.tls of Dask's configuration", where=scheduler)


@cache
def _local_cluster(workers: int) -> Any:
    """Return a cluster of processes on this machine; Dask ends them with this process."""
    import dask
    from distributed import LocalCluster

    with dask.config.set(_LOCAL_SETTINGS), worker_environment(needs_main=False):
        return LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # of its HTTP pages; else port 8787, or a warning
            silence_logs=logging.CRITICAL,
        )


def _require_dask() -> None:
    """Raise InvalidInput where Dask is not installed; where it is, keep it from writing to stderr."""
    try:
        import distributed  # noqa: F401 - this sets up its loggers
    except ImportError as error:
        raise InvalidInput("Dask is not installed: pip install 'camcal[cluster]'", where="--scheduler") from error
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def _terms(batch: BatchOptions) -> Iterator[RunTerms]:
    """Yield what workers have to know of this run; the folders of its outputs are marked for them during the block."""
    run, remote = files.LEDGER.get(), urls.REMOTE.get()
    planned = run.planned if isinstance(run, Run) else ()
    local = [path for path in planned if remote is None or not remote.holds(path)]
    folders = {next(each for each in path.parents if each.is_dir()) for path in local}
    with ExitStack() as stack:
        shared = {}
        for folder in folders:
            mark = stack.enter_context(tempfile.NamedTemporaryFile("wb", prefix=TEMPORARY, dir=folder))
            with suppress(OSError):  # a file system without locks, where no unlocked file is removed either
                system.lock(mark.fileno())
            shared[str(folder)] = Path(mark.name).name
        failure = f"camcal-failure-{uuid4().hex}" if batch.fail_fast else None
        yield RunTerms(
            folder=str(Path.cwd()),
            shared=shared,
            versions=fingerprint.versions(),
            max_pixels=max_pixels(),
            remote=remote,
            timeout=batch.timeout,
            failure=failure,
        )


class _Submission(Generic[Item, Value]):
    """The items of one fan-out that a cluster works on, and the outcomes not yet handed on."""

    def __init__(
        self,
        function: Callable[[Item], Value],
        items: Iterable[Item],
        scheduler: str,
        address: str,
        terms: RunTerms,
        progress: Progress,
    ) -> None:
        self.function = function
        self.tasks = enumerate(items)
        self.upcoming = next(self.tasks, None)
        self.scheduler = scheduler
        self.address = address
        self.terms = terms
        self.progress = progress
        self.waiting: deque[tuple[int, Item]] = deque()
        self.suspects: deque[tuple[int, Item]] = deque()
        self.tried: set[int] = set()
        self.at_work: dict[Any, list[tuple[int, Item]]] = {}
        self.together = 1
        self.done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.finished: dict[int, Outcome[Item, Value] | None] = {}
        self.most_ahead = _FEWEST_AHEAD
        self.looked = float("-inf")
        self.has_warned = self.has_failed = self.has_hung = False
        self.client: Any = None

    def outcomes(self) -> Generator[Outcome[Item, Value]]:
        """Yield the outcomes in the order of the items."""
        run = files.LEDGER.get()
        self.connect(_CONNECT_S)
        if isinstance(run, Run):
            run.elsewhere += 1
        yield from self.in_order()
        if isinstance(run, Run) and not self.has_hung:  # an item that hung may still come to its end
            run.elsewhere -= 1

    def in_order(self) -> Generator[Outcome[Item, Value]]:
        """Yield the outcomes of a cluster that was connected to, which is connected to again if that is lost."""
        for position in itertools.count():
            while position not in self.finished:
                try:
                    self.send(position)
                    if not self.at_work:
                        return
                    self.collect()
                except _lost_connection():
                    self.connect_again()
            if (outcome := self.finished.pop(position)) is not None:
                yield outcome

    def connect(self, patience: float, failure: str = "does not answer") -> None:
        """Connect to the scheduler and send it the function, once for all items."""
        from distributed import Client

        try:
            self.client = Client(self.address, timeout=patience, set_as_default=False)  # type: ignore[no-untyped-call]
            self.require_camcal()
        except OSError as error:
            text = f"the scheduler {failure} ({reason(error)})"
            raise FileError(text, where=self.scheduler) from error
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its size: maps are large, and a task can be done again elsewhere
            self.sent_function = self.client.submit(_same, self.function, pure=False)

    def require_camcal(self) -> None:
        """Raise InvalidInput if a worker has another camcal than this process, or none."""
        wanted = self.terms.versions["camcal"]
        for address, found in self.client.get_versions(packages=["camcal"])["workers"].items():
            version = found["packages"]["camcal"]
            if version != wanted:
                raise InvalidInput(
                    f"has camcal {version or 'missing'} instead of {wanted}; install the same version",
                    where=f"worker {address}",
                )

    def send(self, position: int) -> None:
        """Send items, up to so many ahead of the one that is waited for that all workers are busy."""
        self.count_workers()
        while tasks := self.next_tasks(position + self.most_ahead):
            future = self.client.submit(
                answers, self.sent_function, [item for _, item in tasks], self.terms, pure=False
            )
            self.at_work[future] = tasks
            future.add_done_callback(self.done.put)

    def next_tasks(self, limit: int) -> list[tuple[int, Item]]:
        """Return the next items to send together, with their indices, as far as they are before the index `limit`."""
        if self.waiting:
            return [self.waiting.popleft()]
        tasks: list[tuple[int, Item]] = []
        while self.upcoming is not None and self.upcoming[0] < limit and len(tasks) < self.together:
            tasks.append(self.upcoming)
            self.upcoming = next(self.tasks, None)
        if not tasks and not self.at_work and self.suspects:
            tasks.append(self.suspects.popleft())
            self.tried.add(tasks[0][0])
        return [] if self.has_failed else tasks

    def count_workers(self) -> None:
        """See from time to time how many workers there are, and warn once if there is none."""
        if time.monotonic() - self.looked < _LOOK_S:
            return
        first, self.looked = self.looked == float("-inf"), time.monotonic()
        workers = self.client.scheduler_info(n_workers=-1).get("workers")
        if workers is None:  # the scheduler is lost, as futures will tell
            return
        count = len(workers)
        self.most_ahead = max(_AHEAD * count, _FEWEST_AHEAD)
        if not count and not first and not self.has_warned:
            self.has_warned = True
            text = "the scheduler has no workers; the items wait until some are started"
            self.progress.warn(Message("no_workers", text, where=self.scheduler))

    def collect(self) -> None:
        """Wait until items are done, and note what came of them; but no longer than until workers are counted again."""
        try:
            done = [self.done.get(timeout=_LOOK_S)]
        except queue.Empty:
            return
        while not self.done.empty():
            done.append(self.done.get())
        done = [future for future in done if future in self.at_work]
        if any(future.status in ("cancelled", "lost") for future in done):
            self.connect_again()
            return
        self.note(done)

    def note(self, done: list[Any]) -> None:
        """Keep the outcomes of items that are done; raises what is no outcome."""
        good = [future for future in done if future.status == "finished"]
        for future, (found, seconds) in zip(good, self.client.gather(good), strict=True):
            self.together = max(1, min(_MOST_TOGETHER, int(_TOGETHER_S / max(seconds, _SHORTEST_S))))
            for (index, item), reply in zip(self.at_work.pop(future), found, strict=True):
                outcome = self.finished[index] = None if reply is None else Outcome(item, *reply)
                self.has_failed |= self.terms.failure is not None and (outcome is None or outcome.error is not None)
                self.has_hung |= outcome is not None and isinstance(outcome.error, ItemsFailed)
        for future in (future for future in done if future.status == "error"):
            self.fail(future)

    def fail(self, future: Any) -> None:
        """Note an item that no worker survived alone; raises any other exception.

        Several items sent together are sent again one by one, and one that others were beside once more by itself:
        Dask blames whatever lay at a worker that died.
        """
        from distributed import KilledWorker

        error = future.exception()
        if not isinstance(error, KilledWorker):
            if not isinstance(error, CamcalError):
                self.require_camcal()
            raise error
        tasks = self.at_work.pop(future)
        if len(tasks) > 1:
            self.waiting.extend(tasks)
            return
        ((index, item),) = tasks
        if index not in self.tried:
            self.suspects.append((index, item))
            return
        text = f"{error.allowed_failures + 1} workers died with it; the input may be damaged, or memory short"
        self.finished[index] = Outcome(item, error=ItemsFailed(text, where=item_name(item) or f"item {index + 1}"))

    def connect_again(self) -> None:
        """Wait for a scheduler that was lost, and let all items that were with it be sent again."""
        self.waiting.extend(sorted(itertools.chain(*self.at_work.values()), key=lambda task: task[0]))
        self.at_work.clear()
        self.close()
        kept = "what is done is kept, and --resume goes on from there"
        self.connect(_PATIENCE_S, f"was lost and did not come back in {_PATIENCE_S:g} s; {kept}")

    def close(self) -> None:
        """Take back what is not done, and leave the cluster."""
        client, self.client = self.client, None
        if client is not None:
            with suppress(*_lost_connection()):
                client.cancel(list(self.at_work))
            client.close(timeout=_CLOSE_S)


def _lost_connection() -> tuple[type[Exception], ...]:
    """Return the exceptions of a client whose scheduler is gone."""
    from distributed.client import ClosedClientError, FutureCancelledError, FuturesCancelledError
    from distributed.comm.core import CommClosedError

    return ClosedClientError, CommClosedError, FutureCancelledError, FuturesCancelledError


def _same(function: Callable[..., Any]) -> Callable[..., Any]:
    return function
