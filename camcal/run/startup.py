"""What a worker process finds when it starts: one BLAS and OpenCV thread, no Ctrl-C, no main script to run again."""

import os
import signal
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager

BLAS_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)
_STOPPING = ("SIGTERM", "SIGHUP")
_ONE_THREAD = (*BLAS_THREADS, "OPENCV_FOR_THREADS_NUM")


class Stopped(BaseException):
    """A signal asks this process to end; raised where the main thread is, so that temporary files are removed."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.signal = signal.Signals(number)


def stop_on_signals() -> None:
    """Let SIGTERM and SIGHUP raise Stopped; a second one ends the process at once, and one ignored stays so."""
    for name in _STOPPING:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _stop)


def _stop(number: int, _: types.FrameType | None) -> None:
    signal.signal(number, signal.SIG_DFL)
    raise Stopped(number)


@contextmanager
def surroundings_of_a_worker(*, needs_main: bool) -> Iterator[None]:
    """Start processes inside this block: they find one BLAS thread, no Ctrl-C and no main script to run again."""
    environment = {name: os.environ.get(name) for name in _ONE_THREAD}
    main = sys.modules["__main__"]
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    if not needs_main:  # spawn runs the file of __main__ again in the child; only functions defined there need that
        sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        with _interrupt_blocked():
            yield
    finally:
        sys.modules["__main__"] = main
        for name, value in environment.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    """Hold Ctrl-C back for the block: it reaches this process afterwards, and never a process started inside."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
