"""Raw frames without a header: the layout is given, and checked against the file length."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.raw.mosaic import require_pattern
from camcal.raw.pixel_formats import FAMILIES, FORMATS, PixelFormat, frame_bytes, require_byte_order, row_bytes, unpack

# Of the sensors and the modes that cameras for measuring have, (width, height); the most common ones first.
COMMON_SIZES = (
    (1920, 1080), (1920, 1200), (2448, 2048), (1280, 1024), (640, 480), (4056, 3040), (1440, 1080), (1280, 720),
    (2592, 1944), (3840, 2160), (1936, 1216), (1280, 960), (1280, 800), (1456, 1088), (2048, 1536), (2464, 2056),
    (3280, 2464), (4608, 2592), (2304, 1296), (2028, 1520), (2028, 1080), (1640, 1232), (1296, 972), (1332, 990),
    (4096, 3000), (4024, 3036), (4000, 3000), (4096, 2160), (5472, 3648), (5496, 3672), (3088, 2064), (3072, 2048),
    (2048, 2048), (2592, 2048), (2464, 2048), (1624, 1240), (1600, 1200), (1600, 1300), (1292, 964), (1288, 964),
    (1280, 1080), (1024, 1024), (1024, 768), (1936, 1464), (1920, 1440), (2560, 1440), (2688, 1520), (2880, 1860),
    (4112, 3008), (4504, 4504), (4512, 4512), (5120, 5120), (5320, 4600), (5328, 4608), (6576, 4384), (6480, 4860),
    (8192, 5460), (9152, 6944), (9248, 6944), (9344, 7000), (14192, 10640), (800, 600), (752, 480), (728, 544),
    (720, 540), (640, 512), (640, 400), (656, 492), (320, 240),
)  # fmt: skip
_ROW_UNITS = (16, 32, 64)  # bytes that drivers pad rows to
_OFFERS = 6  # candidates in one message
# Correlation of neighbouring samples of one colour, below which they are unlike, above which alike; of so many rows.
_UNLIKE, _ALIKE, _ROWS = 0.3, 0.6, 200
_SURELY = 0.97  # correlation that wrong orders do not reach
# How many times less of what they leave open another order leaves: of clean pictures that use all bits, wrong ones are
# rougher by 2.3 at least, right ones smoother by as much.
_ROUGHER = 1.5
_SPARE, _DARK, _AS_ALIKE = 2, 3, 0.05  # zero bits that tell their order; of dark frames; loss of likeness
_GROUPS = 15  # bytes, that packed groups of 3 or 5 fill
_LEAST, _GROUP, _BYTE = 32, 4, 8  # pixels of the smallest frame that shows it; of a packed group; bits


@dataclass(frozen=True, eq=False)
class Layout:
    """The layout of the file. size: (width, height) pixels. stride: bytes from row to row, None without padding.

    offset: bytes before the first frame. endian and align: see `unpack`. pattern: four letters or MONO; None takes that
    of the pixel format. frame: which of several, from 0; None is for a file with one.
    Raises InvalidInput if these contradict each other, or neither pixel format nor pattern names the colours.
    """

    pixel_format: PixelFormat
    size: tuple[int, int]
    stride: int | None = None
    offset: int = 0
    endian: str = "little"
    align: str = "lsb"
    pattern: str | None = None
    frame: int | None = None

    def __post_init__(self) -> None:
        require_byte_order(self.pixel_format, self.endian, self.align)
        frame_bytes(self.pixel_format, self.size, self.stride)
        for name, value in (("offset", self.offset), ("frame", self.frame or 0)):
            if value < 0:
                raise InvalidInput(f"{name} {value} is negative; it counts from the start of the file")
        require_pattern(self.colours)

    @property
    def colours(self) -> str:
        """The colour pattern, four letters or MONO, of the pixel format or as given."""
        stated = self.pixel_format.pattern
        if self.pattern is None and stated is None:
            choices = "|".join((*PATTERNS, MONO))
            raise InvalidInput(f"{self.pixel_format.name} has no colour pattern; give --pattern {choices}")
        if stated is not None and self.pattern not in (None, stated):
            conflict = f"pattern {stated} by {self.pixel_format.name}, {self.pattern} by --pattern"
            raise InvalidInput(f"{conflict}; --format {self.pixel_format.family} accepts any pattern")
        return stated or str(self.pattern)

    @property
    def frame_bytes(self) -> int:
        """Bytes from the start of a frame to its last pixel."""
        return frame_bytes(self.pixel_format, self.size, self.stride)

    @property
    def frame_step(self) -> int:
        """Bytes from frame to frame."""
        return self.frame_bytes if self.stride is None else self.stride * self.size[1]

    def __str__(self) -> str:
        stride = "" if self.stride is None else f" with a stride of {self.stride}"
        return f"{self.pixel_format.name} {_times(self.size)}{stride}"


def read_headerless(path: Path, layout: Layout) -> tuple[Array, str]:
    """Return the samples (H, W) of one frame, uint8 or uint16 counts, and the colour pattern.

    Raises FileError if the file cannot be read or its length is no whole number of frames; InvalidInput if it holds
    several and the layout names none, or samples are larger than the format allows.
    """
    length = length_of(path)
    frame = _choose_frame(path, length, layout)
    start = layout.offset + frame * layout.frame_step
    try:  # nothing else of what may be a long recording
        content = np.fromfile(path, np.uint8, layout.frame_bytes, offset=start)
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}", where=str(path)) from error
    order = {"endian": layout.endian, "align": layout.align}
    values = unpack(content, layout.pixel_format, layout.size, stride=layout.stride, **order)
    _require_below_white(path, values, layout)
    if layout.align == "msb":
        words = unpack(content, layout.pixel_format, layout.size, stride=layout.stride, endian=layout.endian)
        _require_upper_bits(path, words, layout)
    _require_likely_bits(path, content, values, layout)
    return values, layout.colours


def _choose_frame(path: Path, length: int, layout: Layout) -> int:
    """Return the frame to read of a file of `length` bytes, which must hold a whole number of them."""
    length_of_frames, needed = length - layout.offset, layout.frame_bytes
    padding = layout.frame_step - needed  # of the last row, which many writers leave out
    count, rest = divmod(length_of_frames + padding, layout.frame_step)
    if count < 1:
        raise FileError(f"{layout} needs {needed} bytes, found {_count_bytes(length, layout)}", where=str(path))
    if rest not in (0, padding):
        whole = f"{count} frame{'s' * (count > 1)} of {needed} bytes"
        raise FileError(
            f"{layout} leaves surplus bytes after {whole}: found {_count_bytes(length, layout)}", where=str(path)
        )
    if layout.frame is None and count > 1:
        message = f"holds {count} frames if it is {layout}; give --frame 0 … {count - 1}, or the format and size it has"
        raise InvalidInput(f"{message}: {_offer(length - layout.offset)}", where=str(path))
    if (layout.frame or 0) >= count:
        raise InvalidInput(f"has no frame {layout.frame}; it holds {count}, counted from 0", where=str(path))
    return layout.frame or 0


def _count_bytes(length: int, layout: Layout) -> str:
    after = f" after an offset of {layout.offset}" if layout.offset else ""
    return f"{max(length - layout.offset, 0)}{after}; {_offer(length - layout.offset)}"


def _require_below_white(path: Path, values: Array, layout: Layout) -> None:
    """Raise InvalidInput if unpacked samples are larger than their bits: the layout is not that of the file."""
    white, largest = layout.pixel_format.white, int(values.max())
    if largest <= white:
        return
    bits, shift = detect_alignment(values)
    if int(values.byteswap().max()) <= white:
        hint = f"--endian {'big' if layout.endian == 'little' else 'little'} would fit"
    elif shift:
        hint = f"they look like {bits} bits in the upper part of their bytes: --align msb"
    else:
        hint = f"they need {bits} bits"
    raise InvalidInput(
        f"samples go up to {largest}, {layout.pixel_format.name} ends at {white}; {hint}", where=str(path)
    )


def _require_upper_bits(path: Path, words: Array, layout: Layout) -> None:
    """Raise InvalidInput if 16-bit words that are to hold samples in their upper bits hold them in their lower ones."""
    white, largest = layout.pixel_format.white, int(words.max())
    if largest <= white and np.bitwise_or.reduce(words, axis=None) % (1 << (16 - layout.pixel_format.bits)):
        raise InvalidInput(
            f"words go up to {largest}: {layout.pixel_format.name} in their lower bits; leave out --align msb",
            where=str(path),
        )


def _require_likely_bits(path: Path, content: Array, values: Array, layout: Layout) -> None:
    """Raise InvalidInput if pixels of one colour are unlike each other, or much less alike than with another order of
    the bits.

    Of samples with fewer bits than the format has, as an 8-bit sensor's in a 12-bit file, the lowest bits are zero in
    the right order of the bits, and in no other one: wrong ones may look alike. Of dark frames, the highest are zero.
    """
    stated, bits = layout.pixel_format, layout.pixel_format.bits
    likeness = _likeness(values)
    groups = content[: len(content) // _GROUPS * _GROUPS].reshape(-1, _GROUPS)
    filled = stated.packing is not None and int(values.max()) > stated.white >> _DARK and _zero_bits(values) < _SPARE
    filled = filled and bool((np.bitwise_or.reduce(groups, axis=0) != 0xFF).any())
    surely = _SURELY if stated.packing is not None else _UNLIKE
    if likeness >= surely and not filled:
        return
    other = {"little": "big", "big": "little"}[layout.endian]
    readings = [
        (each, layout.endian, f"--format {each.name}" + ("" if layout.stride is None else f" --stride {layout.stride}"))
        for each in FORMATS
        if each.bits == bits and (each.pattern, each.packing is None) == (stated.pattern, stated.packing is None)
        if each is not stated and frame_bytes(each, layout.size, layout.stride) == layout.frame_bytes
    ]
    if stated.packing is None and bits > _BYTE:
        readings.append((stated, other, f"--endian {other}"))
    found = []
    for each, endian, words in readings:
        samples = unpack(content, each, layout.size, stride=layout.stride, endian=endian, align=layout.align)
        zeros = _zero_bits(samples) if filled else 0
        found.append((zeros if zeros >= _SPARE else 0, _likeness(samples), words))
    zeros, alike, words = max(found, default=(0, 0.0, ""))
    if zeros and alike > max(_ALIKE, likeness - _AS_ALIKE):
        text = f"as {layout}, pixels are mixed up; {words} fits: there, the lowest {zeros} bits of all are zero"
        raise InvalidInput(text, where=str(path))
    rougher = (1 - likeness) / max(1 - alike, 1e-9) if stated.packing is not None else 1.0
    if alike > _ALIKE and (likeness < _UNLIKE or rougher > _ROUGHER):
        how = "unlike each other" if likeness < _UNLIKE else "less alike than in another order of the bits"
        text = f"as {layout}, neighbouring pixels of one colour are {how}; {words} fits"
        raise InvalidInput(text, where=str(path))


def _zero_bits(values: Array) -> int:
    """Return how many of the lowest bits are zero in all samples."""
    used = int(np.bitwise_or.reduce(values, axis=None))
    return (used & -used).bit_length() - 1 if used else 0


def _likeness(values: Array) -> float:
    """Return the correlation of samples with those two rows below, the least of the columns that are packed alike.

    Of noise it is about 0, of pictures above 0.8. Of wrongly unpacked pixels some columns of a group are right.
    """
    rows = np.unique(np.linspace(0, max(len(values) - 3, 0), _ROWS).astype(int))
    if len(values) < _LEAST or values.shape[1] < _LEAST:
        return 1.0
    above, below = (values[rows + step].astype(float) for step in (0, 2))
    likenesses = []
    for start in range(_GROUP):
        one, other = above[:, start::_GROUP], below[:, start::_GROUP]
        variance = float(one.var() + other.var())
        likenesses.append(
            1 - float(np.mean((one - one.mean() - other + other.mean()) ** 2)) / variance if variance else 1.0
        )
    return min(likenesses)


def length_of(path: Path) -> int:
    """Return the bytes of a file; raises FileError if it is missing, a folder or empty."""
    try:
        length = path.stat().st_size
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if path.is_dir():
        raise FileError("is a folder, not a file", where=str(path))
    if not length:
        raise FileError("is empty", where=str(path))
    return length


class CandidateLayout(NamedTuple):
    """A layout that has exactly the length of a file: all the formats that share it, the most likely first."""

    formats: tuple[PixelFormat, ...]
    size: tuple[int, int]
    stride: int | None

    def __str__(self) -> str:
        stride = "" if self.stride is None else f" stride {self.stride}"
        return f"{'|'.join(each.name for each in self.formats)} {_times(self.size)}{stride}"


def fitting_layouts(
    length: int, pixel_format: PixelFormat | None = None, size: tuple[int, int] | None = None
) -> list[CandidateLayout]:
    """Return what a frame of `length` bytes may be, the most likely first; a given format or size is kept.

    Sizes are COMMON_SIZES. Rows without padding come before rows padded to 16, 32 or 64 bytes, which only drivers of
    MIPI sensors write.
    """
    formats = FAMILIES if pixel_format is None else (pixel_format,)
    sizes = COMMON_SIZES if size is None else (size,)
    found: dict[tuple[int | None, tuple[int, int]], list[PixelFormat]] = {}
    for candidate in sizes:
        for each in formats:
            for stride in _strides_that_fit(length, each, candidate):
                found.setdefault((stride, candidate), []).append(each)
    fits = [CandidateLayout(tuple(sharing), candidate, stride) for (stride, candidate), sharing in found.items()]
    return sorted(fits, key=lambda fit: (fit.stride is not None, sizes.index(fit.size)))


def _strides_that_fit(length: int, pixel_format: PixelFormat, size: tuple[int, int]) -> Iterator[int | None]:
    if frame_bytes(pixel_format, size) == length:
        yield None
    row = row_bytes(pixel_format, size[0])
    for stride in sorted({-(-row // unit) * unit for unit in _ROW_UNITS} - {row}):
        if pixel_format.rows_start_groups and stride * size[1] == length:
            yield stride


def missing_layout(
    path: Path, pixel_format: PixelFormat | None = None, size: tuple[int, int] | None = None, offset: int = 0
) -> InvalidInput:
    """Return the error for a file whose format or size, or both, were not given: it offers what fits the length.

    Raises FileError if there is no such file or it is empty.
    """
    length = length_of(path)
    given = [name for name, value in (("--format", pixel_format), ("--size", size)) if value is None]
    message = f"{length} bytes without a header: {_offer(length - offset, pixel_format, size)}"
    return InvalidInput(f"{message}; give {' and '.join(given)}", where=str(path))


def _offer(length: int, pixel_format: PixelFormat | None = None, size: tuple[int, int] | None = None) -> str:
    fits = fitting_layouts(length, pixel_format, size)
    if not fits:
        kept = [pixel_format.name] if pixel_format else []
        kept += [_times(size)] if size else []
        return f"no common format and size fits{' with ' + ' '.join(kept) if kept else ''}"
    more = f" and {len(fits) - _OFFERS} more" if len(fits) > _OFFERS else ""
    return f"fits {', '.join(map(str, fits[:_OFFERS]))}{more}"


def _times(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def detect_alignment(values: Array) -> tuple[int, int]:
    """Return a guess at the bits of the samples of a 16-bit container, and how far down they have to be shifted.

    bits: 10, 12, 14 or 16. shift: 16 - bits when the samples lie in the upper bits and zeros fill the rest, else 0;
    then bits are the fewest that hold the largest sample, too few for a dark frame.
    """
    used = int(np.bitwise_or.reduce(values, axis=None))
    for bits in (10, 12, 14):
        shift = 16 - bits
        if used >> bits and used % (1 << shift) == 0:
            return bits, shift
    return next(bits for bits in (10, 12, 14, 16) if used < 1 << bits), 0
