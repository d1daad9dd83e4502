"""Pixels packed across bytes: the bits of a group move into one 16-bit lane per pixel, and back.

A group of pixels is one word. A stage moves its bits: every move shifts the word to the left (to the right when
negative) and keeps what lands on its mask, and the results are or-ed. No two bits that count ever meet, so the same
stages, taken backwards with the opposite shifts, pack what they unpacked. Whole blocks of words move at once.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Array
from camcal.dataclass import dataclass

BLOCK_PIXELS = 1 << 17  # three buffers of words, 2 bytes a pixel, stay in the second cache of a core
_BOTH_HALVES = 1 | 1 << 32
_WORD_BITS = 64
_KEEP_ALL = (1 << _WORD_BITS) - 1


@dataclass(frozen=True)
class Stage:
    """Moves of bits: (shift to the left, mask of where they land). bits: how many the words that come in have."""

    moves: tuple[tuple[int, int], ...]
    bits: int = _WORD_BITS

    def apply(self, words: Array, spare: Sequence[Array], out: Array) -> None:
        """Fill `out` with the moved bits of `words`, which may be the same array; two spare ones are overwritten."""
        if self._copies_stay_apart():
            np.multiply(words, _constant(sum(1 << shift for shift, _ in self.moves), words.dtype), out)
            np.bitwise_and(out, _constant(sum(mask for _, mask in self.moves), words.dtype), out)
            return
        gathered, moved = spare
        *others, last = self.moves
        _move(words, others[0], gathered)
        for move in others[1:]:
            np.bitwise_or(gathered, _move(words, move, moved), gathered)
        np.bitwise_or(gathered, _move(words, last, words), out)

    def reversed(self) -> "Stage":
        return Stage(tuple((-shift, mask >> shift if shift > 0 else mask << -shift) for shift, mask in self.moves))

    def _copies_stay_apart(self) -> bool:
        """Whether one multiplication makes all the moves, because no two of the shifted words overlap."""
        return all(0 <= one <= other - self.bits for (one, _), (other, _) in pairwise(self.moves))


def _move(words: Array, move: tuple[int, int], out: Array) -> Array:
    shift, mask = move
    if shift > 0:
        words = np.left_shift(words, _constant(shift, words.dtype), out)
    elif shift < 0:
        words = np.right_shift(words, _constant(-shift, words.dtype), out)
    return words if mask == _KEEP_ALL else np.bitwise_and(words, _constant(mask, words.dtype), out)


@cache
def _constant(value: int, dtype: np.dtype[Any]) -> Array:
    """Return an array without dimensions: converting a Python number takes as long as moving a thousand words."""
    return np.array(value, dtype)


def _apply_stages(stages: Sequence[Stage], words: Array, spare: Sequence[Array], out: Array) -> None:
    """Fill `out` with `words` after all the stages; `words` and the two arrays of `spare` are overwritten."""
    for stage in stages[:-1]:
        stage.apply(words, spare, words)
    stages[-1].apply(words, spare, out)


def _backwards(stages: Sequence[Stage]) -> list[Stage]:
    return [stage.reversed() for stage in reversed(stages)]


@dataclass(frozen=True)
class WordPacking:
    """Two pixels in a word of 3 bytes, or four in one of 5 … 7; order: of its bytes, "<" little, ">" big endian.

    pixels and size: of a group, in pixels and bytes. by_row: every row of an image starts a new group.
    """

    pixels: int
    size: int
    stages: tuple[Stage, ...]
    order: str = "<"
    by_row: bool = False

    @property
    def stored_bits(self) -> int:
        """The bits that a pixel takes, with its gaps."""
        return self.size * 8 // self.pixels

    @property
    def reach(self) -> int:
        """The bytes that are read from the start of a group."""
        return 2 * self.pixels

    def unpack(self, data: Array, step: int, lanes: Array, scratch: Array) -> None:
        """Fill lanes (rows, groups · pixels) uint16 from bytes, rows beginning `step` bytes apart.

        scratch: (3, rows, groups · pixels) uint16, overwritten.
        """
        out, (words, *spare) = lanes.view(f"u{self.reach}"), scratch.view(f"u{self.reach}")
        np.copyto(words, np.ndarray(out.shape, f"{self.order}u{self.reach}", data, 0, (step, self.size)))
        _apply_stages(self.stages, words, spare, out)

    def pack(self, lanes: Array) -> NDArray[np.uint8]:
        """Return the bytes (rows, groups · size) of lanes (rows, groups · pixels) uint16."""
        words = lanes.copy().view(f"u{self.reach}")
        _apply_stages(_backwards(self.stages), words, [np.empty_like(words), np.empty_like(words)], words)
        content = words.astype(f"{self.order}u{self.reach}").view(np.uint8)
        return content.reshape(*words.shape, self.reach)[:, :, : self.size].reshape(len(words), -1)


@dataclass(frozen=True)
class HighBytesFirst:
    """The high 8 bits of four pixels, a byte each, then their low bits in 1 or 3 bytes, the first pixel lowest."""

    low_bits: int
    stages: tuple[Stage, ...]
    pixels: int = 4
    by_row: bool = True

    @property
    def size(self) -> int:
        return 4 + self.low_bits // 2

    @property
    def stored_bits(self) -> int:
        """The bits that a pixel takes."""
        return 8 + self.low_bits

    @property
    def reach(self) -> int:
        """The bytes that are read from the start of a group."""
        return 4 + np.dtype(self._low_word).itemsize

    @property
    def _low_word(self) -> str:
        return "u1" if self.size == 5 else "<u4"

    def unpack(self, data: Array, step: int, lanes: Array, scratch: Array) -> None:
        """Fill lanes (rows, groups · 4) uint16 from bytes, rows beginning `step` bytes apart.

        scratch: (3, rows, groups · 4) uint16, overwritten.
        """
        out, (low, *spare) = lanes.view(np.uint64), scratch.view(np.uint64)
        high = spare[0].ravel().view(np.uint32)[: out.size].reshape(out.shape)
        np.copyto(high, np.ndarray(out.shape, np.uint32, data, 0, (step, self.size)))
        np.copyto(lanes, high.view(np.uint8))
        np.left_shift(out, _constant(self.low_bits, out.dtype), out)
        np.copyto(low, np.ndarray(out.shape, self._low_word, data, 4, (step, self.size)))
        _apply_stages(self.stages, low, spare, low)
        np.bitwise_or(out, low, out)

    def pack(self, lanes: Array) -> NDArray[np.uint8]:
        """Return the bytes (rows, groups · size) of lanes (rows, groups · 4) uint16."""
        low = lanes.copy().view(np.uint64)
        _apply_stages(_backwards(self.stages), low, [np.empty_like(low), np.empty_like(low)], low)
        low_bytes = low.view(np.uint8).reshape(*low.shape, 8)[:, :, : self.size - 4]
        high = (lanes >> self.low_bits).astype(np.uint8).reshape(*low.shape, 4)
        return np.concatenate([high, low_bytes], axis=2).reshape(len(low), -1)


Packing = WordPacking | HighBytesFirst


def lsb_first(bits: int) -> WordPacking:
    """Return the packing without gaps whose first pixel has the lowest bits: PFNC's "p", USB3 Vision."""
    if bits == 12:
        return WordPacking(2, 3, (Stage(((4, _ones(12) << 16), (0, _ones(12)))),))
    return WordPacking(4, bits // 2, _spread(bits))


def msb_first(bits: int) -> WordPacking:
    """Return the packing without gaps whose first pixel has the highest bits: PFNC's "pmsb", CoaXPress."""
    if bits == 12:
        return WordPacking(2, 3, (Stage(((8, _ones(12) << 16), (-20, _ones(12)))),), ">")
    apart = Stage(((4 * bits - 32, _ones(2 * bits) << 32), (2 * bits - 64, _ones(2 * bits))))
    lanes = Stage(((16, (_ones(bits) << 16) * _BOTH_HALVES), (-bits, _ones(bits) * _BOTH_HALVES)))
    return WordPacking(4, bits // 2, (apart, lanes), ">")


def gige_vision(bits: int) -> WordPacking:
    """Return the packing of 10 or 12 bits with the low bits of two pixels in the byte between: PFNC's "Packed"."""
    if bits == 12:
        return WordPacking(2, 3, (Stage(((-8, 0xF), (4, 0xFF0 | 0xFFF << 16))),))
    return WordPacking(2, 3, (Stage(((-8, 0x3), (4, 0x3 << 16), (2, 0x3FC | 0x3FC << 16))),))


def mipi(bits: int) -> Packing:
    """Return the packing RAW10, RAW12 or RAW14 of MIPI CSI-2."""
    if bits == 12:
        # with the first byte on top, the high and the low bits of the second pixel touch
        return WordPacking(2, 3, (Stage(((4, 0xFFF << 16), (-20, 0xFF0), (-8, 0xF))),), ">", by_row=True)
    if bits == 14:
        # the words have 32 bits, and `lanes` leaves out what they shed above the first two fields
        apart, lanes = Stage(((20, _KEEP_ALL), (0, _KEEP_ALL))), _spread(6)[1]
        return HighBytesFirst(6, (apart, lanes))
    return HighBytesFirst(2, (Stage(tuple((14 * pixel, 0x3 << 16 * pixel) for pixel in range(4)), bits=8),))


def _spread(bits: int) -> tuple[Stage, Stage]:
    """Return the stages for four fields of `bits`, the lowest first: two into each half of the word, then lanes."""
    apart = Stage(((32 - 2 * bits, _ones(2 * bits) << 32), (0, _ones(2 * bits))))
    return apart, Stage(((16 - bits, (_ones(bits) << 16) * _BOTH_HALVES), (0, _ones(bits) * _BOTH_HALVES)))


def _ones(count: int) -> int:
    return (1 << count) - 1


def unpack_rows(packing: Packing, data: Array, rows: int, groups: int, step: int) -> Array:
    """Return the lanes (rows, groups · pixels) uint16 of rows that begin `step` bytes apart; zeros follow the data."""
    width = groups * packing.pixels
    lanes = np.empty((rows, width), np.uint16)
    extent = (groups - 1) * packing.size + packing.reach
    inside = min(max((len(data) - extent) // step + 1, 0), rows)
    at_once = min(max(1, BLOCK_PIXELS // width), rows)
    scratch = np.empty((3, at_once, width), np.uint16)
    for first in range(0, inside, at_once):
        block = lanes[first : min(first + at_once, inside)]
        packing.unpack(data[first * step :], step, block, scratch[:, : len(block)])
    if inside < rows:
        rest = np.zeros((rows - inside - 1) * step + extent, np.uint8)
        held = data[inside * step :][: len(rest)]
        rest[: len(held)] = held
        packing.unpack(rest, step, lanes[inside:], np.empty((3, rows - inside, width), np.uint16))
    return lanes
