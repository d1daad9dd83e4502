"""A page as a PNG file: every pixel as gray as the share of it that ink covers, and the size it is printed at."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.targets.printing.page import MM_PER_INCH, Page, Text

MAX_PIXELS = 400_000_000

_BAND = 256  # rows of pixels drawn at a time
_CHORDS = 16  # of a disc in every row of pixels: its area is then good to 1e-3 of a pixel
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_STROKE = 0.05  # of the font's size


@dataclass(frozen=True, eq=False)
class _Sides:
    """Upright sides of ink in pixels: at x from y `top` to `bottom`; sign 1 where black begins, -1 where it ends."""

    x: Array
    top: Array
    bottom: Array
    sign: Array


def dots_per_mm(dpi: float) -> float:
    """Return the resolution that a PNG file can state, whole pixels a metre, nearest to `dpi`."""
    return round(dpi / MM_PER_INCH * 1000) / 1000


def size_in_pixels(page: Page, dpi: float) -> tuple[int, int]:
    """Return the width and height of a page; raises InvalidInput for none, or for more than MAX_PIXELS."""
    width, height = (round(side * dots_per_mm(dpi)) for side in page.size)
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InvalidInput(
            f"{dpi:g} dpi makes {width} x {height} pixels; at most {MAX_PIXELS // 10**6} million are drawn"
        )
    return width, height


def png(page: Page, dpi: float) -> bytes:
    """Return the bytes of a PNG file of 8 bits gray that says how many pixels a metre it has.

    Edges are where they are to 1/255 of a pixel: a pixel is as gray as ink covers it, without gamma.
    """
    size, scale = size_in_pixels(page, dpi), dots_per_mm(dpi)
    header = struct.pack(">II", *size) + bytes([8, 0, 0, 0, 0])  # 8 bits gray, not interlaced
    metre = struct.pack(">IIB", round(scale * 1000), round(scale * 1000), 1)
    title = b"Title\0" + page.title.encode("ascii")
    chunks = (
        (b"IHDR", header),
        (b"pHYs", metre),
        (b"tEXt", title),
        (b"IDAT", _packed(page, size, scale)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _packed(page: Page, size: tuple[int, int], scale: float) -> bytes:
    """Return the compressed rows, each as its difference from the one above (PNG's filter 2)."""
    packer = zlib.compressobj()
    above = np.zeros(size[0], np.uint8)
    parts = []
    for rows in _bands(page, size, scale):
        change = rows - np.vstack([above, rows[:-1]])
        parts.append(packer.compress(np.pad(change, ((0, 0), (1, 0)), constant_values=2).tobytes()))
        above = rows[-1]
    return b"".join([*parts, packer.flush()])


def _bands(page: Page, size: tuple[int, int], scale: float) -> Iterator[Array]:
    """Yield the rows (n, width) uint8 of a page from above, a few at a time."""
    sides = _sides(page, scale)
    for top in range(0, size[1], _BAND):
        shape = min(_BAND, size[1] - top), size[0]
        gray = np.rint(255 * (1 - np.clip(_covered(sides, top, shape), 0, 1))).astype(np.uint8)
        for text in page.texts:
            _write(gray, text, top, scale)
        yield gray


def _covered(sides: _Sides, top: int, shape: tuple[int, int]) -> Array:
    """Return the share of ink (rows, columns) of the pixels from row `top` on."""
    rows, columns = shape
    first = np.clip(np.floor(sides.top).astype(int) - top, 0, rows)
    last = np.clip(np.ceil(sides.bottom).astype(int) - top, 0, rows)
    side = np.repeat(np.arange(len(first)), last - first)
    row = np.arange(len(side)) - np.repeat(np.cumsum(last - first) - last, last - first)
    height = np.minimum(sides.bottom[side], row + top + 1) - np.maximum(sides.top[side], row + top)
    begins = np.floor(sides.x[side]).astype(int)
    share = sides.x[side] - begins
    weight = sides.sign[side] * height
    # What a side adds to its own pixel, and from the next one on to all of the row
    place = row * (columns + 2) + begins
    steps = np.bincount(place, weight * (1 - share), rows * (columns + 2))
    steps += np.bincount(place + 1, weight * share, rows * (columns + 2))
    return np.cumsum(steps.reshape(rows, columns + 2), axis=1)[:, :columns]


def _sides(page: Page, scale: float) -> _Sides:
    """Return the upright sides of a page's shapes, and the ends of its discs' chords."""
    ends = [np.stack([outline, np.roll(outline, -1, axis=0)], axis=1) for outline in page.outlines]
    walked = np.concatenate([np.zeros((0, 2, 2)), *ends]) * scale
    walked = walked[walked[:, 0, 1] != walked[:, 1, 1]]
    x, start, end = walked[:, 0, 0], walked[:, 0, 1], walked[:, 1, 1]
    sides = [(x, np.minimum(start, end), np.maximum(start, end), np.sign(start - end))]
    sides += [_chords(disc, scale) for disc in page.discs]
    return _Sides(*(np.concatenate(parts) for parts in zip(*sides, strict=True)))


def _chords(disc: Array, scale: float) -> tuple[Array, Array, Array, Array]:
    x, y, radius = disc[:3] * scale
    edges = np.arange(np.floor((y - radius) * _CHORDS), np.ceil((y + radius) * _CHORDS) + 1) / _CHORDS
    middle = (edges[:-1] + edges[1:]) / 2
    half = np.sqrt(np.maximum(radius**2 - (middle - y) ** 2, 0))
    sign = np.where(disc[3] == 0, 1.0, -1.0)  # white takes the black below it away
    return (
        np.concatenate([x - half, x + half]),
        np.tile(edges[:-1], 2),
        np.tile(edges[1:], 2),
        np.repeat([sign, -sign], len(half)),
    )


def _write(gray: Array, text: Text, top: int, scale: float) -> None:
    """Write a line of text into rows from `top` on, as wide as it is in Helvetica."""
    x, y, size = round(text.x * scale), round(text.y * scale) - top, text.size * scale
    if not -size < y < len(gray) + size:
        return
    thickness = max(1, round(_STROKE * size))
    (width, _), _ = cv2.getTextSize(text.words, _FONT, 1.0, thickness)
    cv2.putText(gray, text.words, (x, y), _FONT, text.width * scale / width, 0, thickness, cv2.LINE_AA)
