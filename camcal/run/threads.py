"""Threads: how many may start, several at work on one item, and OpenCV kept to one of its own."""

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from camcal.progress import Item
from camcal.run.cores import available_cores


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
            for done in [pool.submit(work, item) for item in items]:
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
