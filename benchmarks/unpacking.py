"""Milliseconds per megapixel to unpack and to pack every pixel format, on one thread, warm.

Frames of random bytes as long as those of a 12 MP sensor; medians, and the least beside them: on a busy machine the
least is what the format takes. The first row copies 2 bytes a pixel, for the speed of the memory.

    python benchmarks/unpacking.py [--size 4056x3040] [--repeats 15]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time
from collections.abc import Callable

import numpy as np

from camcal.raw.pixel_formats import FAMILIES, PixelFormat, frame_bytes, pack, unpack


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="4056x3040")
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    width, height = (int(number) for number in arguments.size.split("x"))
    print(f"numpy {np.__version__}, {width}x{height}, {arguments.repeats} repeats; milliseconds per megapixel\n")
    print("| format | unpack, median | unpack, least | pack, median |")
    print("|---|---|---|---|")
    megapixels = width * height / 1e6
    for name, unpacking, packing in works((width, height)):
        taken = times(unpacking, arguments.repeats)
        cells = [statistics.median(taken), min(taken)]
        if packing:
            cells.append(statistics.median(times(packing, 3)))
        print(f"| {name} | {' | '.join(f'{1e3 * seconds / megapixels:.2f}' for seconds in cells)} |", flush=True)


def works(size: tuple[int, int]):
    """Yield the name of every row of the table with what is timed: unpacking, and packing if there is such a thing."""
    memory = np.ones(size[::-1], np.uint16)
    yield "copy of 16 bits", memory.copy, None
    for family in FAMILIES:
        content = random_bytes(family, size)
        values = unpack(content, family, size) & family.white
        yield family.name, lambda f=family, c=content: unpack(c, f, size), lambda f=family, v=values: pack(v, f)


def random_bytes(family: PixelFormat, size: tuple[int, int]) -> bytes:
    return np.random.default_rng(0).bytes(frame_bytes(family, size))


def times(work: Callable[[], object], repeats: int) -> list[float]:
    """Return the seconds of every run after a first one that is not counted."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return taken


if __name__ == "__main__":
    main()
