"""What a worker of a Dask cluster does with items, as the processes of this machine would.

It works in the folder in which the command was called, on one item at a time, and with the versions, limits and URLs of
the process that sent the item. A file goes into no folder that both do not share: nobody would find it.
"""

import os
import platform
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as OutOfTime
from contextlib import ExitStack, chdir, contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from pathlib import Path
from typing import Any

from camcal import files, system, urls
from camcal.dataclass import dataclass
from camcal.errors import CamcalError, FileError, InvalidInput, ItemsFailed
from camcal.images.options import max_pixels, set_max_pixels
from camcal.progress import Item, Outcome, Value
from camcal.run import fingerprint
from camcal.run.process import one_opencv_thread
from camcal.run.workers import attempt, item_name

Answer = tuple[Value | None, CamcalError | None] | None
Answers = tuple[list[Answer[Value]], float]

_LEFT_S = 2.0  # for the answer to be fetched, before a worker whose item hangs is replaced
_ONE_TASK = threading.Lock()  # of a process: the working folder and OpenCV's threads are those of the whole process


@dataclass(frozen=True)
class RunTerms:
    """What a worker has to know of a run.

    folder: where the command was called. shared: folders that get outputs, each with the name of a hidden file in it,
    by which a worker sees that it is the same folder. versions: of camcal and its libraries. max_pixels: of an image.
    remote: the URLs of the run, None without any. timeout: seconds for one item. failure: the name of Dask's event that
    an item has failed, after which none is begun; None if the others go on.
    """

    folder: str
    shared: Mapping[str, str]
    versions: Mapping[str, str]
    max_pixels: int
    remote: urls.Remote | None
    timeout: float | None = None
    failure: str | None = None


def answers(function: Callable[[Item], Value], items: Sequence[Item], terms: RunTerms) -> Answers[Value]:
    """Return the values of items or their errors, None of those not begun after a failure, and the seconds of one.

    Raises InvalidInput if this worker has other versions than the process that sent the items.
    """
    _require_versions(tuple(sorted(terms.versions.items())))
    failure = _event(terms.failure)
    with _ONE_TASK, _terms_kept(terms):
        began = time.monotonic()
        found = [_answer(function, item, terms, failure) for item in items]
        return found, (time.monotonic() - began) / len(items)


def _answer(function: Callable[[Item], Value], item: Item, terms: RunTerms, failure: Any) -> Answer[Value]:
    if failure is not None and failure.is_set():
        return None
    outcome = attempt(function, item) if terms.timeout is None else _within(terms.timeout, function, item)
    if failure is not None and outcome.error is not None:
        failure.set()
    return outcome.value, outcome.error


def _event(name: str | None) -> Any:
    """Return an event that all workers of a run know, None without a name."""
    if name is None:
        return None
    import distributed

    return distributed.Event(name)  # type: ignore[no-untyped-call]


@cache
def _require_versions(sent: tuple[tuple[str, str], ...]) -> None:
    wanted, here = dict(sent), fingerprint.versions()
    other = [name for name in sorted(wanted | here) if wanted.get(name) != here.get(name)]
    if other:
        names = ", ".join(f"{name} {here.get(name, 'missing')} instead of {wanted.get(name, 'none')}" for name in other)
        raise InvalidInput(f"has {names}; install the same versions", where=f"worker on {platform.node()}")


@contextmanager
def _terms_kept(terms: RunTerms) -> Iterator[None]:
    """Work in the folder of the run and by its limits during the block."""
    folder = Path(terms.folder)
    with ExitStack() as stack:
        if not folder.is_dir():  # relative paths must lead nowhere then, and not to files of the worker's own
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(chdir(folder))
        stack.enter_context(_set(files.LEDGER, SharedFolders(terms)))
        stack.enter_context(_set(system.KNOWN, {}))  # a part of the run, on a machine with its own numbers of folders
        stack.enter_context(_set(urls.REMOTE, terms.remote))
        stack.enter_context(one_opencv_thread())
        before = max_pixels()
        set_max_pixels(terms.max_pixels)
        try:
            yield
        finally:
            set_max_pixels(before)


@contextmanager
def _set(variable: ContextVar[Any], value: object) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


class SharedFolders:
    """The ledger of a worker: it refuses to write where the process that sent the item would not find the file."""

    def __init__(self, terms: RunTerms) -> None:
        self.shared = {Path(folder): name for folder, name in terms.shared.items()}
        self.has_folder = Path(terms.folder).is_dir()

    def reads(self, path: Path, file: os.stat_result) -> None:
        pass

    def writes(self, path: Path) -> None:
        """Raise FileError for a file in a folder that is not shared."""
        if urls.holder(path) is not None:
            return
        place = path.absolute()
        folder = max(
            (each for each in self.shared if each in place.parents), key=lambda each: len(each.parts), default=None
        )
        if (folder is None and self.has_folder) or (folder is not None and (folder / self.shared[folder]).exists()):
            return
        message = f"cannot be written: its folder is not shared with the worker on {platform.node()}"
        raise FileError(f"{message}; use a shared folder or a URL", where=str(path))

    def completes(self, path: Path, temporary: Path) -> bool:  # noqa: ARG002 - as ledgers have it
        """Let every file take its place."""
        return True

    def wrote(self, file: os.stat_result) -> None:
        pass


def _within(seconds: float, function: Callable[[Item], Value], item: Item) -> Outcome[Item, Value]:
    """Return the outcome of an item, or the error of one that takes too long; the worker is replaced then.

    A thread cannot be stopped, so the process that it is in has to end.
    """
    outcome: Future[Outcome[Item, Value]] = Future()

    def work() -> None:
        try:
            outcome.set_result(attempt(function, item))
        except Exception as bug:  # noqa: BLE001 - raised where the result is asked for
            outcome.set_exception(bug)

    threading.Thread(target=copy_context().run, args=(work,), daemon=True).start()
    try:
        return outcome.result(seconds)
    except OutOfTime:
        _replace_worker()
        return Outcome(
            item, error=ItemsFailed(f"took longer than {seconds:g} s and was stopped", where=item_name(item))
        )


def _replace_worker() -> None:
    """Let the process of this worker end, and its nanny start another, once its results are fetched."""
    from distributed import get_worker

    worker = get_worker()

    def end() -> None:
        worker.loop.add_callback(worker.close_gracefully, restart=True)

    worker.loop.add_callback(worker.loop.call_later, _LEFT_S, end)
