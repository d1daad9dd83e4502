"""Functions that worker processes run in the tests of the fan-out; light to import, since every worker does."""

import os
import signal
import sys
import time
from pathlib import Path

from camcal import files
from camcal.errors import FileError

HANG_S = 60.0  # longer than any test waits: only a stop ends it
DEADLY = {"killed": signal.SIGKILL, "crashed": signal.SIGSEGV}


def doubled(number: int) -> int:
    time.sleep(0.02 if number == 0 else 0)  # the first one comes last
    return 2 * number


def own_pid(number: int) -> int:
    return os.getpid()


def refused(number: int) -> int:
    if number == 1:
        raise FileError("is empty", where="b.png")
    return number


def mistaken(number: int) -> int:
    return {}[number]


class Unreadable(Exception):
    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)


def mistaken_beyond_pickling(number: int) -> int:
    raise Unreadable("lost", "property")


def killed(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def deadly(path: Path) -> str:
    if path.stem == "left":
        sys.exit(3)
    if path.stem in DEADLY:
        os.kill(os.getpid(), DEADLY[path.stem])
    return path.stem


def hanging(number: int) -> int:
    time.sleep(HANG_S if number == 1 else 0)
    return number


def threads_of_libraries(number: int) -> tuple[int, str | None]:
    import cv2

    return cv2.getNumThreads(), os.environ.get("OPENBLAS_NUM_THREADS")


def noted(folder: Path, number: int) -> int:
    (folder / str(number)).touch()
    time.sleep(0.05)
    return number


def pid_then_hang(folder: Path, number: int, array=None) -> None:
    (folder / f"{os.getpid()}").touch()
    time.sleep(HANG_S)


class Sum:
    """Adds arrays to an item, and says of every array whether it lies in the memory of a file."""

    def __init__(self, arrays) -> None:
        self.arrays = arrays

    def __call__(self, number: int) -> tuple[float, list[bool]]:
        total = number + sum(float(array.sum()) for array in self.arrays)
        return total, [mapped(array) for array in self.arrays]


def mapped(array) -> bool:
    while array is not None and type(array).__name__ != "memmap":
        array = getattr(array, "base", None) if hasattr(array, "base") else getattr(array, "obj", None)
    return array is not None


def noted_and_refused(folder: Path, number: int) -> int:
    noted(folder, number)
    return refused(number)


def greedy(path: Path) -> int:
    import numpy as np

    if path.name == "b.png":
        np.empty(1 << 60, np.uint8)
    return len(str(path))


def write_image(path: Path) -> None:
    files.write_bytes(path, b"an image")
