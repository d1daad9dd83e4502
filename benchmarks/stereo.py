"""Disparities by camcal and by OpenCV against the truth: quality and time, then the same with what goes wrong.

Folders hold pairs in the layout of Middlebury 2001 and 2003 (im2, im6, disp2, disp6), of Middlebury 2014 and ETH3D
(im0, im1, disp0GT.pfm), of scikit-image (motorcycle_left, …), or of `camcal simulate --stereo`; or folders of such.
Everybody gets gray images and the range of disparities in multiples of 16, from 0 to what the truth or calib.txt says;
camcal fills what it cannot match. Bad-t counts a pixel without a disparity as bad; it is of the pixels that both
cameras see unless `all` says otherwise; avg is over those with a disparity. Times are the least of the repeats, by the
clock and of the processor.
Then bad1 / bad2 / bad2 all, with
  noise 5      Gaussian noise of sigma 5 gray levels in both images
  dy 0.5 …     the right image moved down by so many pixels
  exposure     the right image as 255 (i / 255)^1.4 x 0.8 + 10
Last, on the largest pair: seconds with one OpenCV thread and with all, millions of disparities weighed per second of
the processor, and the memory taken beyond the images.

    python benchmarks/stereo.py FOLDER [FOLDER …] [--repeats 3] [--each] [--only camcal] [--shift 0.5] [--range auto]
    python benchmarks/stereo.py --slanted 200:222 --clean
    python benchmarks/stereo.py [FOLDER …] --boxes 11:19 --noise
    python benchmarks/stereo.py [FOLDER …] --boxes 1:6 --exposures
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from box_scenes import box_scenes
from peers.opencv_stereo import MATCHERS, Matcher
from slanted_scenes import slanted_scenes
from stereo_pairs import Pair, pairs_in

from camcal.stereo.matching.match import match
from camcal.stereo.options import MatchOptions
from camcal.stereo.truth import evaluate

NOISE = 5.0
GAMMA, GAIN, OFFSET = 1.4, 0.8, 10
DIGITS = {"avg": 2, "avg all": 2}
COLUMNS = (
    *("density", "bad1", "bad2", "bad3", "avg", "bad1 all", "bad2 all", "bad3 all", "avg all"),
    *("wall ms/MP", "CPU ms/MP"),
)
BRIEF = "bad1", "bad2", "bad2 all"


Figures = Mapping[str, float]  # by column
Change = Callable[[Pair], Pair]
QUALITIES = "fast", "balanced", "best"


def ours(left: np.ndarray, right: np.ndarray, count: int, *, quality: str, auto: bool = False) -> np.ndarray:
    searched = None if auto else (0, count - 1)
    return match(left, right, MatchOptions(quality=quality, search=searched, fill="all")).values


def everybody(*, auto: bool) -> dict[str, Matcher]:
    return {**MATCHERS, **{f"camcal {quality}": partial(ours, quality=quality, auto=auto) for quality in QUALITIES}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--slanted", default="", metavar="FIRST:LAST", help="seeds of generated slanted scenes")
    parser.add_argument(
        "--boxes", default="", metavar="FIRST:LAST", help="seeds of plates with textures of three scales"
    )
    parser.add_argument("--exposures", action="store_true", help="only exposures of the right image, with and without")
    parser.add_argument("--noise", action="store_true", help="only as they are and with noise 5, in short")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--each", action="store_true", help="the figures of every pair too")
    parser.add_argument("--only", default="", help="methods with this in their name")
    parser.add_argument(
        "--shift", type=float, default=0.0, help="added to truths in whole pixels; Middlebury 2014's: 0.5"
    )
    parser.add_argument("--range", choices=("given", "auto"), default="given", help="for camcal; OpenCV has no auto")
    parser.add_argument("--clean", action="store_true", help="leave out the other tables")
    arguments = parser.parse_args()
    pairs = [gray(pair) for folder in arguments.folders for pair in pairs_in(folder, arguments.shift)]
    if arguments.slanted:
        pairs += [gray(pair) for pair in slanted_scenes(range(*map(int, arguments.slanted.split(":"))))]
    if arguments.boxes:
        pairs += [gray(pair) for pair in box_scenes(range(*map(int, arguments.boxes.split(":"))))]
    if not pairs:
        raise SystemExit("no pairs found")
    if arguments.exposures:
        print_exposures(pairs)
        return
    if arguments.noise:
        print_noise(pairs)
        return
    known = everybody(auto=arguments.range == "auto")
    methods = {name: matches for name, matches in known.items() if arguments.only in name}
    print_pairs(pairs)
    scores = {name: [score(pair, matches, arguments.repeats) for pair in pairs] for name, matches in methods.items()}
    means = {name: mean(each) for name, each in scores.items()}
    print_table("mean over the pairs", means)
    if arguments.each:
        for place, pair in enumerate(pairs):
            print_table(pair.name, {name: each[place] for name, each in scores.items()})
    if not arguments.clean:
        print_conditions(pairs, methods, means)
        print_resources(max(pairs, key=lambda pair: pair.truth.size * pair.count), methods, arguments.repeats)


def gray(pair: Pair) -> Pair:
    """Return the pair as everybody gets it: textbooks read images in gray, and OpenCV takes 8 bits only."""
    left, right = (
        image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (pair.left, pair.right)
    )
    if left.dtype == np.uint16:
        left, right = (cv2.convertScaleAbs(image, alpha=1 / 257) for image in (left, right))
    return replace(pair, left=left, right=right)


def quality(pair: Pair, matches: Matcher) -> Figures:
    """Return how good the disparities of a pair are."""
    figures = evaluate(matches(pair.left, pair.right, pair.count), pair.truth, pair.visible).figures
    nocc, whole = figures["nocc"], figures["all"]
    return {
        "density": nocc["density"],
        **{name: nocc[name] for name in ("bad1", "bad2", "bad3")},
        "avg": figures["nocc-valid"]["avg"],
        **{f"{name} all": whole[name] for name in ("bad1", "bad2", "bad3")},
        "avg all": figures["all-valid"]["avg"],
    }


def score(pair: Pair, matches: Matcher, repeats: int) -> Figures:
    """Return how good the disparities of a pair are, and what time they take."""
    figures = quality(pair, matches)
    taken = timed(pair, matches, repeats, cv2.getNumThreads())
    per_megapixel = 1e9 / pair.truth.size
    return {**figures, "wall ms/MP": per_megapixel * taken.clock, "CPU ms/MP": per_megapixel * taken.processor}


def mean(figures: Sequence[Figures]) -> Figures:
    return {column: float(np.mean([each[column] for each in figures])) for column in figures[0]}


def noisy(pair: Pair) -> Pair:
    rng = np.random.default_rng(5)
    left, right = (
        np.clip(np.rint(image + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)
        for image in (pair.left, pair.right)
    )
    return replace(pair, left=left, right=right)


def lowered(pair: Pair, rows: float) -> Pair:
    move = np.array([[1, 0, 0], [0, 1, rows]], float)
    size = pair.right.shape[::-1]
    moved = cv2.warpAffine(pair.right, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return replace(pair, right=moved)


def exposed(pair: Pair) -> Pair:
    brightness = 255 * (pair.right / 255) ** GAMMA * GAIN + OFFSET
    return replace(pair, right=np.rint(brightness).astype(np.uint8))


CONDITIONS: Mapping[str, Change] = {
    "noise 5": noisy,
    **{f"dy {rows:g}": partial(lowered, rows=rows) for rows in (0.5, 1.0, 2.0)},
    "exposure": exposed,
}


def print_conditions(pairs: Sequence[Pair], methods: Mapping[str, Matcher], clean: Mapping[str, Figures]) -> None:
    print(
        f"\nbad1/bad2 nocc/bad2 all, mean over the pairs\n{'':24}", *(f"{name:>16}" for name in ("clean", *CONDITIONS))
    )
    for name, matches in methods.items():
        print(f"{name:24} {brief(clean[name]):>16}", end="", flush=True)
        for change in CONDITIONS.values():
            cell = brief(mean([quality(change(pair), matches) for pair in pairs]))
            print(f" {cell:>16}", end="", flush=True)
        print()


def print_noise(pairs: Sequence[Pair]) -> None:
    """Print bad2 with and without noise, its means by the first words of the names, and who is worse than whom."""
    methods = {name: matches for name, matches in everybody(auto=False).items() if "filled" in name or "camcal" in name}
    groups: dict[str, list[list[list[float]]]] = {}
    for pair in pairs:
        both = pair, noisy(pair)
        found = [[quality(each, matches)["bad2"] for each in both] for matches in methods.values()]
        groups.setdefault(pair.name.split()[0], []).append(found)
    print(
        "bad2 nocc, as they are / noise 5" + "".join(f"{f'{name} ({len(each)})':>18}" for name, each in groups.items())
    )
    for place, name in enumerate(methods):
        means = [np.mean(each, axis=0)[place] for each in groups.values()]
        print(f"{name:32}" + "".join(f"{'{:.2f} / {:.2f}'.format(*mean):>18}" for mean in means))
    every = np.array([found for each in groups.values() for found in each])[:, :, 1]
    rival, own = (every[:, list(methods).index(name)] for name in ("HH 3, padded, filled", "camcal best"))
    print(f"noise 5: best is worse than HH in {(own > rival).sum()} of {len(every)}")


def print_exposures(pairs: Sequence[Pair]) -> None:
    print(f"bad2 nocc, exposure corrected / not\n{'':24}", *(f"{name:>16}" for name in EXPOSURES))
    cells = []
    for pair in pairs:
        found = [[quality(change(pair), partial(exposed_as, expose=on))["bad2"] for on in (True, False)]
                 for change in EXPOSURES.values()]  # fmt: skip
        cells.append(found)
        print(f"{pair.name:24}", *(f"{'{:.2f} / {:.2f}'.format(*each):>16}" for each in found), flush=True)
    means = np.mean(cells, axis=0)
    print(f"{'mean':24}", *(f"{'{:.2f} / {:.2f}'.format(*each):>16}" for each in means))


def exposed_as(left: np.ndarray, right: np.ndarray, count: int, *, expose: bool) -> np.ndarray:
    options = MatchOptions(quality="fast", search=(0, count - 1), fill="all", expose_alike=expose)
    return match(left, right, options).values


def graded(pair: Pair, grade: Callable[[np.ndarray], np.ndarray]) -> Pair:
    """Return the pair with another exposure of its right image; grade: of gray levels 0 … 1."""
    return replace(pair, right=np.clip(np.rint(255 * grade(pair.right / 255)), 0, 255).astype(np.uint8))


EXPOSURES: Mapping[str, Change] = {
    "as it is": lambda pair: pair,
    "gamma 1.5": partial(graded, grade=lambda light: light**1.5),
    "x 0.7": partial(graded, grade=lambda light: 0.7 * light),
    "+ 8": partial(graded, grade=lambda light: light + 8 / 255),
}


def print_resources(pair: Pair, methods: Mapping[str, Matcher], repeats: int) -> None:
    columns = "1 thread s", "all s", "MDE/s", "extra MB"
    print(f"\n{pair.name}\n{'':24}", *(f"{column:>10}" for column in columns))
    threads = cv2.getNumThreads()
    for name, matches in methods.items():
        alone, together = timed(pair, matches, repeats, 1), timed(pair, matches, repeats, threads)
        speed = pair.truth.size * pair.count / 1e6 / together.processor
        with get_context("spawn").Pool(1) as pool:  # a process of its own: nobody else's memory is in the peak
            extra = pool.apply(extra_megabytes, (pair, name))
        print(f"{name:24} {alone.clock:10.2f} {together.clock:10.2f} {speed:10.0f} {extra:10.0f}", flush=True)


class Seconds(NamedTuple):
    clock: float
    processor: float


def timed(pair: Pair, matches: Matcher, repeats: int, threads: int) -> Seconds:
    """Return the least seconds of the repeats."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter(), time.process_time()
        matches(pair.left, pair.right, pair.count)
        taken.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    cv2.setNumThreads(before)
    return Seconds(*map(min, zip(*taken, strict=True)))


def extra_megabytes(pair: Pair, name: str) -> float:
    """Return by how much the memory of this process grows at its peak while a pair is matched (Linux)."""
    small = replace(pair, left=pair.left[:40], right=pair.right[:40])
    everybody(auto=False)[name](small.left, small.right, pair.count)  # what is loaded on first use does not count
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak so far
    before = peak_kilobytes()
    everybody(auto=False)[name](pair.left, pair.right, pair.count)
    return (peak_kilobytes() - before) / 1e3


def peak_kilobytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def brief(figures: Figures) -> str:
    return "/".join(f"{figures[column]:.1f}" for column in BRIEF)


def print_pairs(pairs: Sequence[Pair]) -> None:
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}, {cv2.getNumThreads()} threads")
    for pair in pairs:
        height, width = pair.truth.shape
        share = 100 * pair.visible.mean()
        print(f"{pair.name:32} {width}x{height}, disparities 0 … {pair.count - 1}, {share:.1f} % seen by both")


def print_table(title: str, rows: Mapping[str, Figures]) -> None:
    print(f"\n{title}\n{'':24}", *(f"{column:>10}" for column in COLUMNS))
    for name, figures in rows.items():
        print(f"{name:24}", *(f"{figures[column]:10.{DIGITS.get(column, 1)}f}" for column in COLUMNS))


if __name__ == "__main__":
    main()
