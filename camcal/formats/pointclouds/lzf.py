"""LZF, the compression inside compressed PCD files, read only (M. Lehmann, liblzf)."""

from camcal.errors import FileError

_LITERALS = 32  # a control byte below this announces that many bytes less one as they are
_LONG = 7  # a length that another byte adds to


def decompressed(packed: bytes, size: int) -> bytearray:
    """Return the `size` bytes that were packed; raises FileError if it is another number of bytes, or damaged."""
    found = bytearray()
    at = 0
    try:
        while at < len(packed) and len(found) <= size:
            control = packed[at]
            if control < _LITERALS:
                found += packed[at + 1 : at + 2 + control]
                at += 2 + control
            else:
                at = _repeat(found, packed, at)
    except IndexError as error:
        raise FileError(f"compressed data damaged at byte {at}") from error
    if len(found) != size:
        raise FileError(f"compressed data hold {len(found)} bytes or more, the header promises {size}")
    return found


def _repeat(found: bytearray, packed: bytes, at: int) -> int:
    """Append a piece of what stands already in `found`; return where the next control byte is."""
    length, distance = packed[at] >> 5, (packed[at] & 31) << 8
    if length == _LONG:
        at += 1
        length += packed[at]
    distance += packed[at + 1] + 1
    length += 2
    start = len(found) - distance
    if start < 0:
        raise IndexError
    piece = found[start : start + length]
    found += (piece * (length // len(piece) + 1))[:length]  # the piece may run into itself
    return at + 2
