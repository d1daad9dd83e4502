"""Figures in letters, for a terminal: where corners were in the image, how residuals spread, a histogram of any values.

The letters are blocks where the encoding of a terminal has them, ASCII otherwise.
"""

from collections.abc import Sequence
from itertools import pairwise, zip_longest

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass
from camcal.quality.assess import coverage
from camcal.report.table import number_text

_FEW_BINS = 8
_WIDEST_BARS = 60
_DIGITS = 3

_CELL = 2.0  # height of a letter over its width
_GAP = 3
_MAP = 0.46  # of the width
_WIDEST = 120
_SIDE_BY_SIDE = 64  # columns that both figures need beside each other
_ROWS = (6, 20)  # of the map
_BINS = (7, 13)
_REACH = 3.25  # standard deviations from the middle to either end of the histogram
_LEVELS = 4


@dataclass(frozen=True)
class Letters:
    """Levels of gray, parts of a bar and of a column from empty to full, the frame, and other marks.

    frame: corners from the top left in reading order, a horizontal and a vertical line.
    """

    grays: str
    bar: str
    column: str
    frame: str
    expected: str
    outside: str = "/"


BLOCKS = Letters(" ░▒▓█", " ▏▎▍▌▋▊▉█", " ▁▂▃▄▅▆▇█", "┌┐└┘─│", "│")


ASCII = Letters(" .:o#", " #", " .:-=+*%#", "++++-|", "|")


def letters(encoding: str | None) -> Letters:
    """Return the letters for a stream of an encoding."""
    try:
        f"{BLOCKS.grays}{BLOCKS.bar}{BLOCKS.column}{BLOCKS.frame}".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return ASCII
    return BLOCKS


def value_histogram(values: Sequence[float], title: str, width: int, encoding: str | None) -> list[str]:
    """Return a title and a bar with the count for each of some equal ranges of values, in at most `width` letters."""
    drawn = letters(encoding)
    counts, ends = np.histogram(values, min(_FEW_BINS, max(1, len(set(values)))))
    names = [f"{low:.{_DIGITS}g} to {high:.{_DIGITS}g}" for low, high in pairwise(ends)]
    label, digits = max(map(len, names)), len(str(counts.max()))
    longest = min(width, _WIDEST_BARS) - label - digits - 2
    lines = []
    for name, count in zip(names, counts.tolist(), strict=True):
        full, rest = divmod(round(count / counts.max() * longest * (len(drawn.bar) - 1)), len(drawn.bar) - 1)
        bar = drawn.bar[-1] * full + (drawn.bar[rest] if rest else "")
        lines.append(f"{name:>{label}} {count:>{digits}} {bar}".rstrip())
    return [title[:width], *lines]


def calibration_figures(
    calibration: Calibration, circle: ImageCircle | None, width: int, encoding: str | None
) -> list[str]:
    """Return a map of the coverage and a histogram of the residuals as lines of at most `width` letters.

    They stand beside each other where the width allows. circle: the image circle, where there is one.
    """
    drawn = letters(encoding)
    width = min(width, _WIDEST)
    if width < _SIDE_BY_SIDE:
        seen = coverage_map(calibration, circle, width, drawn)
        return [*seen, *residual_histogram(calibration, width, _BINS[1], drawn)]
    seen = coverage_map(calibration, circle, int(_MAP * width), drawn)
    taken = max(map(len, seen)) + _GAP
    spread = residual_histogram(calibration, width - taken, len(seen) - 2, drawn)
    return [f"{left:{taken}}{right}".rstrip() for left, right in zip_longest(seen, spread, fillvalue="")]


def coverage_map(calibration: Calibration, circle: ImageCircle | None, width: int, drawn: Letters) -> list[str]:
    """Return the image as a frame whose letters say how many corners were seen there, with a title."""
    columns, rows = _grid(calibration.camera.image_size, width - 2)
    size = np.array(calibration.camera.image_size)
    places = np.clip((calibration.pixels + 0.5) / size * (columns, rows), 0, (columns - 1, rows - 1)).astype(int)
    counts = np.zeros((rows, columns), int)
    np.add.at(counts, (places[:, 1], places[:, 0]), 1)
    steps = _steps(counts)
    level = np.searchsorted(steps, counts, side="right")
    grays = drawn.grays[: len(steps)] + drawn.grays[-1]  # the highest level is always full
    left_top, right_top, left_bottom, right_bottom, across, down = tuple(drawn.frame)
    lines = [
        "".join(drawn.outside if beyond and not own else grays[own] for own, beyond in zip(row, outside, strict=True))
        for row, outside in zip(level.tolist(), _outside(circle, columns, rows, size), strict=True)
    ]
    legend = "  ".join(f"{gray} {step}" for gray, step in zip(grays[1:], steps, strict=True))
    return [
        f"corners: {legend} or more"[:width],
        f"{left_top}{across * columns}{right_top}",
        *(f"{down}{line}{down}" for line in lines),
        f"{left_bottom}{across * columns}{right_bottom}",
    ]


def _grid(size: tuple[int, int], width: int) -> tuple[int, int]:
    """Return columns and rows of square cells for an image, no more than fit."""
    rows = width * size[1] / size[0] / _CELL
    held = min(max(rows, _ROWS[0]), _ROWS[1])
    return max(min(width, round(width * held / rows)), 2), round(held)


def _steps(counts: Array) -> list[int]:
    """Return the least count of every level of gray, at most as many as there are."""
    top = np.quantile(counts[counts > 0], 0.9) if counts.any() else 1.0
    return sorted({round(step) for step in np.geomspace(1, max(top, 1.0), _LEVELS)})


def _outside(circle: ImageCircle | None, columns: int, rows: int, size: Array) -> list[list[bool]]:
    """Return which cells lie outside the image circle."""
    if circle is None:
        return [[False] * columns] * rows
    u, v = (
        (np.arange(count) + 0.5) / count * length - 0.5 for count, length in zip((columns, rows), size, strict=True)
    )
    middles = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    outside: list[list[bool]] = (~circle.contains(middles)).reshape(rows, columns).tolist()
    return outside


def residual_histogram(calibration: Calibration, width: int, rows: int, drawn: Letters) -> list[str]:
    """Return bars of the coordinates of the residuals, where a normal distribution of their noise would end marked."""
    bins = min(max(rows - (rows + 1) % 2, _BINS[0]), _BINS[1])
    sigma = max(calibration.sigma_px, 1e-12)
    ends = np.linspace(-_REACH, _REACH, bins + 1)
    counts = np.histogram(calibration.residuals / sigma, ends)[0]
    expected = calibration.residuals.size * np.diff([_below(end) for end in ends])
    decimals = max(0, 1 - int(np.floor(np.log10(sigma * (ends[1] - ends[0])))))
    names = [f"{middle:z.{decimals}f}" for middle in sigma * (ends[1:] + ends[:-1]) / 2]
    label = max(map(len, names))
    longest = width - label - 2
    scale = longest / max(counts.max(), expected.max(), 1)
    lines = [
        f"{name:>{label}} {_bar(scale * count, scale * normal, drawn)}"
        for name, count, normal in zip(names, counts, expected, strict=True)
    ]
    return [f"residuals, px; {drawn.expected} expected of normal noise"[:width], *lines]


def _below(deviations: float) -> float:
    """Return the share of a normal distribution below so many standard deviations."""
    from scipy.special import ndtr

    return float(ndtr(deviations))


def _bar(length: float, mark: float, drawn: Letters) -> str:
    parts = len(drawn.bar) - 1
    full, rest = divmod(round(length * parts), parts)
    bar = drawn.bar[-1] * full + (drawn.bar[rest] if rest else "")
    place = round(mark)
    return bar[:place].ljust(place) + drawn.expected + bar[place + 1 :]


def coverage_words(calibration: Calibration, circle: ImageCircle | None) -> str:
    """Return how much of the image corners were seen in, in a line."""
    cells, reach = coverage(calibration, circle)
    shown = "the image" if circle is None else "the image circle"
    return f"corners in {100 * cells:.0f} % of {shown}, out to {100 * reach:.0f} % of its diagonal"


def residual_words(calibration: Calibration) -> str:
    """Return how the residuals spread beside a normal distribution, in a line."""
    beyond = 100 * float((np.abs(calibration.residuals) > 2 * calibration.sigma_px).mean())
    largest = float(np.linalg.norm(calibration.residuals, axis=1).max(initial=0.0))
    return f"{beyond:.1f} % beyond 2 sigma (normal: 4.6 %), the largest {number_text(largest, 2)} px"
