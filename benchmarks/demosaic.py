"""Quality and speed of camcal's demosaicing and of others': one table; then from a raw file to a 16-bit TIFF.

Quality: the images of a folder (Kodak's 24), sampled as RGGB, 5 pixels of the border left out. CPSNR over all three
channels; SSIM with a Gaussian window (11 x 11, sigma 1.5), the mean of the channels. Both are means over the images.
  8 bit        the images as they are, which is gamma-encoded
  balanced     16 bits of linear light; the result is compared sRGB-encoded, in 8-bit units
  unbalanced   the same with red and blue at 0.5 and 0.6 of it; the gains are divided out of the result
  noisy        balanced, of a sensor with 2000 electrons at full scale and 4 of read noise
Speed: a mosaic of 6 MP made of the same images, on one thread, everybody in turn, in milliseconds of the processor,
which a busy machine disturbs least. `ri` on one thread and on two, and raw file to TIFF, by the clock.

    python benchmarks/demosaic.py KODAK [--peer-python PYTHON] [--dng FILE.dng] [--repeats 5] [--images 24]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import statistics
import subprocess
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from camcal.raw.demosaic import demosaic
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Mosaic, sites
from camcal.raw.options import Development
from camcal.run.process import over_threads
from camcal.tasks.raw.demosaic import demosaic as demosaic_files
from camcal.tasks.raw.options import DemosaicOptions

PEERS = Path(__file__).parent / "peers" / "demosaic_peers.py"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
PATTERN, BORDER, WIDE = "RGGB", 5, 65535
OURS = ("ri", "malvar", "bilinear", "ea", "vng")  # auto is ri here
MENON = "colour Menon2007"
PYTHON_PEERS = ("colour bilinear", "colour Malvar2004", MENON)
OPENCV_PEERS = ("cv2 bilinear", "cv2 EA", "cv2 VNG")
LIBRAW_PEERS = ("LibRaw PPG", "LibRaw AHD", "LibRaw DHT", "LibRaw AAHD")
BY_THE_CLOCK = {"ri, 1 thread": 1, "ri, 2 threads": 2}
FULL_SCALE_E, READ_NOISE_E = 2000, 4
LARGE = 4, 4  # images down and across in the mosaic for the speed


class Score(NamedTuple):
    """CPSNR in dB, and SSIM where it was asked for."""

    decibels: float
    similarity: float


Ask = Callable[..., float]  # algorithm, source, output
Scores = dict[str, dict[str, Score]]  # by case and algorithm
Rounds = dict[str, list[float]]  # what every round took, by algorithm
Times = dict[str, Rounds]  # milliseconds per megapixel, by depth


class Case(NamedTuple):
    """How an image becomes a mosaic: in linear light or as it is, the gains of blue, green, red, and with noise."""

    linear: bool
    gains: tuple[float, float, float] = (1, 1, 1)
    noise: bool = False


CASES = {
    "8 bit": Case(linear=False),
    "balanced": Case(linear=True),
    "unbalanced": Case(linear=True, gains=(0.6, 1, 0.5)),
    "noisy": Case(linear=True, noise=True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kodak", type=Path, help="folder of PNG images with three channels of 8 bits")
    parser.add_argument("--peer-python", help="interpreter for peers/demosaic_peers.py; without it camcal is alone")
    parser.add_argument("--dng", type=Path, help="raw file to develop, by camcal and by LibRaw's AHD")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--images", type=int)
    arguments = parser.parse_args()
    interpreter = arguments.peer_python
    images = [cv2.imread(str(path)) for path in sorted(arguments.kodak.glob("*.png"))[: arguments.images]]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        ask = stack.enter_context(peers_of(interpreter, ONE_THREAD)) if interpreter else None
        bench = Bench(Path(folder), ask)
        scored, times = quality(bench, images), speed(bench, images, arguments.repeats)
    print_table(scored, times)
    print_wanted(scored, times)
    if arguments.dng:
        print_development(arguments.dng, interpreter, arguments.repeats)


@contextmanager
def peers_of(interpreter: str, environment: Mapping[str, str]) -> Iterator[Ask]:
    """Lend a function that asks the process of the other environment, see peers/, and returns the seconds."""
    command = [interpreter, "-W", "ignore", PEERS]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, env=os.environ | environment, text=True, **pipes) as process:

        def ask(algorithm: str, source: Path, output: Path | None = None) -> float:
            request = {"algorithm": algorithm, "source": str(source), "output": output and str(output)}
            print(json.dumps(request), file=process.stdin, flush=True)
            return float(process.stdout.readline())

        yield ask


class Bench:
    """Who takes part, the mosaic before them, and the folder through which the peers get it."""

    def __init__(self, folder: Path, ask: Ask | None) -> None:
        self._ask = ask
        self._source, self._output = folder / "mosaic", folder / "colour.npy"
        self._mosaic = np.empty((0, 0), np.uint8)

    @property
    def algorithms(self) -> tuple[str, ...]:
        """The names of the algorithms that can do the mosaic: OpenCV's VNG does 8 bits only."""
        if not self._ask:
            return OURS
        opencv = OPENCV_PEERS if self._mosaic.dtype == np.uint8 else OPENCV_PEERS[:-1]
        return (*OURS, *PYTHON_PEERS, *opencv, *LIBRAW_PEERS)

    def put(self, mosaic: np.ndarray) -> None:
        """Lay a mosaic before everybody; LibRaw gets all in 16 bits, which is what it works in."""
        self._mosaic = mosaic
        np.save(self._source.with_suffix(".npy"), mosaic)
        write_dng(self._source.with_suffix(".dng"), Mosaic(widened(mosaic), PATTERN, np.zeros((2, 2)), WIDE))

    def colour(self, algorithm: str) -> np.ndarray:
        """Return blue, green, red in the units and the type of the mosaic."""
        if algorithm in OURS:
            return demosaic(self._mosaic, PATTERN, algorithm)
        self._ask(algorithm, self._source, self._output)
        colour, dtype = np.load(self._output), self._mosaic.dtype
        if algorithm in LIBRAW_PEERS and dtype == np.uint8:
            colour = colour / 257
        return np.clip(np.rint(colour), 0, np.iinfo(dtype).max).astype(dtype)

    def seconds(self, algorithm: str) -> float:
        """Return the seconds from an array in memory to another, of the processor or by the clock."""
        if algorithm not in (*OURS, *BY_THE_CLOCK):
            return self._ask(algorithm, self._source)
        clock = time.perf_counter if algorithm in BY_THE_CLOCK else time.process_time
        with over_threads(BY_THE_CLOCK.get(algorithm, 1)) as each:  # OpenCV has one thread meanwhile
            begin = clock()
            demosaic(self._mosaic, PATTERN, algorithm.partition(",")[0], each=each)
            return clock() - begin


def quality(bench: Bench, images: list[np.ndarray]) -> Scores:
    """Return the scores by case and algorithm, means over the images."""
    return {
        name: {key: Score(*np.mean(each, axis=0)) for key, each in scores(bench, images, case).items()}
        for name, case in CASES.items()
    }


def scores(bench: Bench, images: list[np.ndarray], case: Case) -> dict[str, list[Score]]:
    """Return the scores of every image by algorithm."""
    rng = np.random.default_rng(1)
    found: dict[str, list[Score]] = {}
    for image in images:
        bench.put(sampled(image, case, rng))
        for name in bench.algorithms:
            score = compare(displayed(bench.colour(name), case), image, structure=not case.linear)
            found.setdefault(name, []).append(score)
    return found


def sampled(image: np.ndarray, case: Case, rng: np.random.Generator) -> np.ndarray:
    """Return the mosaic (H, W) that a sensor sees of an image."""
    if not case.linear:
        return mosaic_of(image)
    light = mosaic_of(linear_light(image / 255) * case.gains)
    if case.noise:
        electrons = rng.poisson(light * FULL_SCALE_E) + rng.normal(0, READ_NOISE_E, light.shape)
        light = np.clip(electrons / FULL_SCALE_E, 0, 1)
    return np.rint(light * WIDE).astype(np.uint16)


def widened(mosaic: np.ndarray) -> np.ndarray:
    return mosaic if mosaic.dtype == np.uint16 else mosaic.astype(np.uint16) * 257


def mosaic_of(image: np.ndarray) -> np.ndarray:
    mosaic = np.empty(image.shape[:2], image.dtype)
    for channel, colour in enumerate("BGR"):
        for site in sites(PATTERN, colour):
            mosaic[site] = image[site][..., channel]
    return mosaic


def displayed(colour: np.ndarray, case: Case) -> np.ndarray:
    """Return colours as the image has them, 0 to 255."""
    if not case.linear:
        return colour.astype(np.float32)
    light = np.clip(colour / np.float32(WIDE) / np.float32(case.gains), 0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)


def linear_light(value: np.ndarray) -> np.ndarray:
    """Return the light behind sRGB values 0 … 1 (IEC 61966-2-1)."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def compare(seen: np.ndarray, truth: np.ndarray, *, structure: bool) -> Score:
    inside = slice(BORDER, -BORDER), slice(BORDER, -BORDER)
    a, b = seen[inside], truth[inside].astype(np.float32)
    decibels = 10 * np.log10(255**2 / np.mean((a - b) ** 2, dtype=float))
    return Score(decibels, similarity(a, b) if structure else np.nan)


def similarity(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean SSIM of the channels (Wang et al. 2004), where the window is whole."""

    def local(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values, (11, 11), 1.5)[5:-5, 5:-5]

    mean_a, mean_b = local(a), local(b)
    variances = local(a * a) - mean_a**2 + local(b * b) - mean_b**2
    covariance = local(a * b) - mean_a * mean_b
    low, high = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    structure = (2 * covariance + high) / (variances + high)
    return float(np.mean(structure * (2 * mean_a * mean_b + low) / (mean_a**2 + mean_b**2 + low), dtype=float))


def speed(bench: Bench, images: list[np.ndarray], repeats: int) -> Times:
    """Return milliseconds per megapixel by depth and algorithm, of every round."""
    mosaic = mosaic_of(large(images))
    found: Times = {}
    for depth, values in {"u8": mosaic, "u16": widened(mosaic)}.items():
        bench.put(values)
        # LibRaw has 16 bits only.
        names = [*BY_THE_CLOCK, *(name for name in bench.algorithms if depth == "u16" or name not in LIBRAW_PEERS)]
        rounds = in_turn({name: partial(bench.seconds, name) for name in names}, repeats)
        found[depth] = {name: [1e9 * each / mosaic.size for each in taken] for name, taken in rounds.items()}
    return found


def large(images: list[np.ndarray]) -> np.ndarray:
    """Return the images side by side, the upright ones laid down."""
    rows, columns = LARGE
    lying = cycle(image if image.shape[0] < image.shape[1] else cv2.transpose(image) for image in images)
    return np.vstack([np.hstack(list(islice(lying, columns))) for _ in range(rows)])


def in_turn(works: Mapping[str, Callable[[], float]], repeats: int) -> Rounds:
    """Return what works report, forwards and backwards in turn, without the first round."""
    order = list(works)
    rounds = []
    for _ in range(repeats + 1):
        rounds.append({name: works[name]() for name in order})
        order.reverse()
    return {name: [each[name] for each in rounds[1:]] for name in works}


def ratio(rounds: Rounds, numerator: str, denominator: str) -> float:
    """Return the median of the ratios within the rounds."""
    return statistics.median(a / b for a, b in zip(rounds[numerator], rounds[denominator], strict=True))


def print_table(scored: Scores, times: Times) -> None:
    print(
        f"OpenCV {cv2.__version__}, numpy {np.__version__}; dB; ms/MP on one thread: medians (least) of rounds in turn"
    )
    linear = list(CASES)[1:]
    print(f"{'':18} {'8 bit':>7} {'SSIM':>6}", *(f"{case:>10}" for case in linear), end="")
    print("".join(f"{f'ms/MP {depth}':>18} {'x Menon':>8}" for depth in times))
    for name, score in scored["8 bit"].items():
        decibels = (f"{scored[case][name].decibels:.2f}" if name in scored[case] else "-" for case in linear)
        print(f"{name:18} {score.decibels:7.2f} {score.similarity:6.4f}", *(f"{cell:>10}" for cell in decibels), end="")
        print(speed_cells(name, times))
    for name in BY_THE_CLOCK:
        print(f"{name + ', by the clock':66}{speed_cells(name, times)}")


def speed_cells(name: str, times: Times) -> str:
    """Return, by depth, the time per megapixel, and how many times as long Menon's algorithm took in the same round."""
    cells = ""
    for rounds in times.values():
        mine = rounds.get(name)
        cell = f"{statistics.median(mine):.2f} ({min(mine):.2f})" if mine else "-"
        factor = f"{ratio(rounds, MENON, name):.1f}" if mine and MENON in rounds else "-"
        cells += f"{cell:>18} {factor:>8}"
    return cells


def print_wanted(scored: Scores, times: Times) -> None:
    """Print what camcal is to reach, and what it has reached; of the times, the least."""
    narrow, best = times["u8"], scored["8 bit"]["ri"]
    print()
    wanted = [
        ("ri, 8 bit, dB", best.decibels, ">=", 40.4),
        ("ri, 8 bit, SSIM", best.similarity, ">=", 0.985),
        ("ri, unbalanced, dB", scored["unbalanced"]["ri"].decibels, ">=", 33.8),
        ("ri, one thread over two", ratio(narrow, *BY_THE_CLOCK), ">=", 1.75),
        ("ri, ms/MP", min(narrow["ri"]), "<=", 25),
        *((f"malvar {depth}, ms/MP", min(rounds["malvar"]), "<=", 6) for depth, rounds in times.items()),
    ]
    if MENON in narrow:
        wanted.append(("Menon over ri", ratio(narrow, MENON, "ri"), ">=", 20))
        wanted.append(("bilinear over OpenCV's", ratio(narrow, "bilinear", "cv2 bilinear"), "<=", 1.1))
    for what, value, sign, bound in wanted:
        reached = value >= bound if sign == ">=" else value <= bound
        print(f"{what:24} {value:8.4g} {sign} {bound:<6g} {'yes' if reached else 'NO'}")


def print_development(source: Path, interpreter: str | None, repeats: int) -> None:
    """Print the time from a raw file to a TIFF of 16 bits, everybody with all threads."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        ours, theirs = Path(folder) / "camcal.tiff", Path(folder) / "libraw.tiff"
        options = DemosaicOptions((str(source),), ours, development=Development(depth="16"))
        camcal = [Path(sysconfig.get_path("scripts")) / "camcal", "demosaic", source, "-o", ours, "--depth", "16", "-q"]
        compiled = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": folder}  # as after pip install
        run = partial(subprocess.run, check=True, env=os.environ | compiled)
        works = {"camcal, in process": partial(demosaic_files, options), "camcal, command": partial(run, camcal)}
        if interpreter:
            ask = stack.enter_context(peers_of(interpreter, {}))
            works["LibRaw AHD, in process"] = partial(ask, "develop", source, theirs)
            works["LibRaw AHD, command"] = partial(run, [interpreter, PEERS, source, theirs])
        rounds = in_turn({name: partial(seconds_of, work) for name, work in works.items()}, repeats)
    print(f"\n{source.name} to a 16-bit TIFF, ms: medians (least) of rounds in turn, and over LibRaw's AHD")
    for name, seconds in rounds.items():
        peer = name.replace("camcal", "LibRaw AHD")
        over = f"{ratio(rounds, name, peer):6.2f}" if peer in rounds else ""
        print(f"{name:22} {1e3 * statistics.median(seconds):8.1f} ({1e3 * min(seconds):.1f}) {over}")


def seconds_of(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
