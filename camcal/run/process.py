"""Resources of a process: its cores and threads, signals that stop it, and the environment of workers.

A process may use the cores of its CPU affinity and of the quota of its control group. Threads share the work on one
item; OpenCV is kept to one thread of its own then. A worker finds one BLAS and OpenCV thread, no Ctrl-C, no main script
to run again.
"""

import ctypes
import math
import os
import platform
import signal
import sys
import threading
import types
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import copy_context
from importlib import import_module
from pathlib import Path

from camcal.errors import EXIT_SIGNAL, FileError
from camcal.progress import Item

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

BLAS_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)

_MOUNT = Path("/sys/fs/cgroup")
_MEMBERSHIP = Path("/proc/self/cgroup")
_PROCESSORS = Path("/proc/cpuinfo")
STOPPING = ("SIGTERM", "SIGHUP")
_UNHEARD_S = 1.5
_SIGNALS = "camcal signals"  # the thread that waits for them
_TASKS = Path("/proc/self/task")
_ADDRESS_SPACE = 704 << 20  # bytes: `calibrate` of some views maps 680 MB, most of them libraries and their buffers
_LIBRARIES = ("cv2", "rawpy")
_BLOCK = 256  # columns of matrices that BLAS takes a buffer for
_MMAP_MAX, _TRIM_THRESHOLD = -4, -1  # of mallopt(3): blocks that are mapped one by one, and what is given back
_ONE_THREAD = (*BLAS_THREADS, "OPENCV_FOR_THREADS_NUM")


def available_cores() -> int:
    """Return the number of cores this process may use, at least 1."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, quota_cores(_MEMBERSHIP, _MOUNT)))


def keep_freed_memory() -> None:
    """Have large arrays made in memory that was freed before, which otherwise goes back to the system: new pages are
    zeroed when they are first written to, a quarter of the time of matching a pair. Without glibc nothing changes.
    """
    with suppress(OSError, TypeError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_MAX, 0)
        library.mallopt(_TRIM_THRESHOLD, 2**31 - 1)


def processor_name() -> str:
    """Return the name of the processor, "unknown" where the system does not say it."""
    lines = [line for line in _text(_PROCESSORS).splitlines() if line.startswith("model name")]
    return lines[0].partition(":")[2].strip() if lines else platform.processor() or "unknown"


def quota_cores(membership: Path, mount: Path) -> int:
    """Return the cores the tightest CPU quota of a control group allows, rounded up; a huge number without one.

    membership: a file as /proc/self/cgroup, lines `id:controllers:path`. mount: the folder of the control groups.
    Source: Linux documentation, cgroup-v2 (cpu.max) and sched-bwc (cpu.cfs_quota_us).
    """
    shares = [share for folder in _folders(membership, mount) if (share := _share(folder)) is not None]
    return math.ceil(min(shares, default=1 << 20))


def _folders(membership: Path, mount: Path) -> list[Path]:
    """Return the folders that may limit the process; a parent's quota holds for its children too."""
    result = []
    for line in _text(membership).splitlines():
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root = mount
        elif "cpu" in controllers.split(","):
            root = mount / controllers if (mount / controllers).is_dir() else mount / "cpu"
        else:
            continue
        # Inside a container the path may be the host's; its own group is then the root of the mount.
        group = root / path.lstrip("/")
        result += [group, *(parent for parent in group.parents if parent.is_relative_to(root))]
    return result


def _share(folder: Path) -> float | None:
    """Return quota / period of one group, None where it has no limit."""
    words = _text(folder / "cpu.max").split() or [
        *_text(folder / "cpu.cfs_quota_us").split(),
        *_text(folder / "cpu.cfs_period_us").split(),
    ]
    if len(words) != 2 or not all(word.isdigit() for word in words) or int(words[1]) == 0:
        return None  # "max 100000" and "-1" mean no limit
    return int(words[0]) / int(words[1])


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return ""


def require_address_space() -> None:
    """Raise FileError if this process may not map what the libraries need: they would hang, or end in a traceback.

    OpenBLAS, of which numpy and scipy have one each, asks for a buffer again and again where it gets none, without
    Python, so that no signal is heard: under a limit both take theirs here, while there is room.
    """
    limit = -1 if resource is None else resource.getrlimit(resource.RLIMIT_AS)[0]
    if resource is None or limit == resource.RLIM_INFINITY:
        return
    least = f"camcal needs at least {_ADDRESS_SPACE >> 10} kB, and more for large inputs"
    small = FileError(f"out of memory: the address space is limited to {limit >> 10} kB (ulimit -v); {least}")
    if limit < _ADDRESS_SPACE:
        raise small
    try:
        for name in _LIBRARIES:
            import_module(name)
        square = import_module("numpy").eye(_BLOCK)
        import_module("scipy.linalg").cho_solve((square, True), square @ square)
    except (ImportError, MemoryError) as error:
        raise small from error


class Stopped(BaseException):
    """A signal asks this process to end; raised where the main thread is, so that temporary files are removed."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.signal = signal.Signals(number)


def stop_on_signals() -> None:
    """Let SIGTERM and SIGHUP raise Stopped; a second one ends the process at once, and one ignored stays so.

    Python hears signals between its own instructions: one that comes while a library works longer than _UNHEARD_S ends
    the process then.
    """
    stopping = [number for name in STOPPING if (number := getattr(signal, name, None)) is not None]
    stopping = [number for number in stopping if signal.getsignal(number) == signal.SIG_DFL]
    heard = threading.Event()

    def stop(number: int, _: types.FrameType | None) -> None:
        heard.set()
        signal.signal(number, signal.SIG_DFL)
        raise Stopped(number)

    for number in stopping:
        signal.signal(number, stop)
    if stopping and hasattr(signal, "pthread_sigmask"):  # elsewhere signals are no bytes of a pipe
        ours, theirs = os.pipe()
        os.set_blocking(theirs, False)
        signal.set_wakeup_fd(theirs, warn_on_full_buffer=False)
        threading.Thread(target=_end_unheard, name=_SIGNALS, args=(ours, stopping, heard), daemon=True).start()


def _end_unheard(pipe: int, stopping: Collection[int], heard: threading.Event) -> None:
    """End the process by one of some signals, whose numbers come through a pipe, unless the main thread hears it."""
    while numbers := os.read(pipe, 1):
        if numbers[0] in stopping and not heard.wait(_UNHEARD_S):
            os._exit(EXIT_SIGNAL + numbers[0])


def forks_safely() -> bool:
    """Return whether a fork of this process finds nothing that a thread was at: it has the main thread only, and the
    one that waits for signals; libraries have started none.
    """
    names = {thread.name for thread in threading.enumerate() if thread is not threading.main_thread()}
    if threading.current_thread() is not threading.main_thread() or not names <= {_SIGNALS} or not _TASKS.is_dir():
        return False
    return sum(1 for _ in _TASKS.iterdir()) == 1 + len(names)


def heed_parent() -> None:
    """Let Ctrl-C be the business of the process that started this one, and SIGTERM end it by way of `finally`."""
    signal.set_wakeup_fd(-1)  # of a process that was forked: signals would be heard by its parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {getattr(signal, name) for name in STOPPING})


def ended_by(code: int) -> str | None:
    """Return the name of the signal that ended a process, by its exit code; None if none did."""
    return signal.Signals(-code).name if code < 0 else None


@contextmanager
def worker_environment(*, needs_main: bool) -> Iterator[None]:
    """Start processes inside this block: they find one BLAS thread, no Ctrl-C and no main script to run again."""
    environment = {name: os.environ.get(name) for name in _ONE_THREAD}
    main = sys.modules["__main__"]
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    if not needs_main:  # spawn runs the file of __main__ again in the child; only functions defined there need that
        sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        with signals_held("SIGINT"):
            yield
    finally:
        sys.modules["__main__"] = main
        for name, value in environment.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def signals_held(*names: str) -> Iterator[None]:
    """Hold signals back for the block: they reach this process afterwards. A process that is started inside hears none
    of them unless it wants to, see `heed_parent`.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {getattr(signal, name) for name in names})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
