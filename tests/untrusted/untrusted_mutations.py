"""How a good file is damaged: by bytes, by the numbers and words of a text, and inside checksums and archives."""

import base64
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping

import numpy as np

Mutation = Callable[[bytes, np.random.Generator], bytes]

NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "-0.0", "0", "-1", "1_0", "１", "٣", "0x10", "1e5000",
    "9" * 5000, "", "1e", "+", "999999999999999999999", "3.4e38", "-3.4e38", "1e-45", "true", "null", "2147483648", ".",
    "4294967295", "-9223372036854775808", "1d3", "1,0", "--1", "1e+", "NaN(1)", "infinity", "=1+1", "'1'", "1j",
    "99999999999", "1e18", "65535", "32768", "-32769", "0.5", "[]", "{}", "[1, 2]", "{a: 1}", '""', '{"a": 1}', "[[1]]",
)  # fmt: skip
WORDS = (
    "\x1b[31mred\x1b[0m", "\u202e", "\u2028", "\x00", "\r", "a\nb", "=cmd|' /C calc'!A0", "@SUM(1)", "../../x", "😀",
    "A" * 300, '"', "'", "#", ":", "- ", "{", "[", "&a", "*a", "!!python/object:os.system", "%", "\ufeff", "\\", ",,,",
)  # fmt: skip
ABSURD = (0.0, *(sign * size for size in (1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300) for sign in (1.0, -1.0)))
_NOT_UTF8 = (b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xc0\x80", b"\xf5\x80\x80\x80", b"\xe2\x82", b"\x80" * 40)
_NUMBER = re.compile(rb"[-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?")
_FIELD = re.compile(r"(?<![\w.])-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")  # a number that stands alone
_NUMBERED_FILE = re.compile(r"\d+(?=\.png)")
_VALUE = re.compile(rb"[:,=][ \t]*([^\s,:=\]}]+)")
_KINDS = ("null", "true", "[]", "{}", "[1, 2]", '["a"]', '{"a": 1}', '""', "text", "1", "-1.5", "2026-11-21", "[[[]]]")
_TEXT_HEADER = 400  # bytes at the start of a binary file in which its numbers may stand as text
_SIZES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 20000, 65535 * 4)


def fields(text: str) -> list[tuple[int, int]]:
    """Return where the numbers of a text file stand: of lines that differ in nothing else, those of the middle one."""
    places: dict[tuple[str, int], list[tuple[int, int]]] = {}
    start = 0
    for line in text.splitlines(keepends=True):
        form = _FIELD.sub("#", _NUMBERED_FILE.sub("", line))
        for index, number in enumerate(_FIELD.finditer(line)):
            places.setdefault((form, index), []).append((start + number.start(), start + number.end()))
        start += len(line)
    return [alike[len(alike) // 2] for alike in places.values()]


def cut_off(content: bytes, rng: np.random.Generator) -> bytes:
    share = float(rng.random()) ** (3 if rng.random() < 0.5 else 0.3)
    return content[: int(len(content) * share)]


def flip_bits(content: bytes, rng: np.random.Generator) -> bytes:
    result = bytearray(content)
    for _ in range(int(rng.integers(1, 9))):
        result[_place(rng, len(result))] ^= 1 << int(rng.integers(8))
    return bytes(result)


def huge_size(content: bytes, rng: np.random.Generator) -> bytes:
    """Write a number as sizes are written, of 2, 4 or 8 bytes in either order, somewhere, mostly near the start."""
    result = bytearray(content)
    code = str(rng.choice(["<H", ">H", "<I", ">I", "<Q", ">Q"]))
    size = int(rng.choice(_SIZES)) & (0xFFFF if code[1] == "H" else 0xFFFFFFFFFFFFFFFF)
    at = min(_place(rng, len(result)), max(0, len(result) - struct.calcsize(code)))
    result[at : at + struct.calcsize(code)] = struct.pack(code, size)
    return bytes(result)


def extreme_floats(content: bytes, rng: np.random.Generator) -> bytes:
    """Write floating-point extremes over some of the bytes, aligned to four."""
    result = bytearray(content)
    values = [np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-45, -0.0, 1e30]
    for _ in range(int(rng.integers(1, 40))):
        at = 4 * int(rng.integers(max(1, len(result) // 4)))
        result[at : at + 4] = np.float32(rng.choice(values)).tobytes()
    return bytes(result[: len(content)])


def move_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Delete, double, blank or shuffle a span."""
    start = _place(rng, len(content))
    end = min(len(content), start + int(rng.integers(1, 200)))
    span = content[start:end]
    choice = rng.integers(4)
    middle = (b"", span * 2, bytes(len(span)), rng.permutation(np.frombuffer(span, np.uint8)).tobytes())[choice]
    return content[:start] + middle + content[end:]


def wrong_numbers(content: bytes, rng: np.random.Generator) -> bytes:
    """Put extremes in the place of numbers that stand as text."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 5]))):
        found = list(_NUMBER.finditer(content if _is_text(content) else content[:_TEXT_HEADER]))
        if not found:
            break
        place = found[int(rng.integers(len(found)))]
        content = content[: place.start()] + str(rng.choice(NUMBERS)).encode() + content[place.end() :]
    return content


def wrong_words(content: bytes, rng: np.random.Generator) -> bytes:
    """Put control characters and markup at the start, the end or somewhere."""
    at = int(rng.choice([0, len(content), _place(rng, len(content))]))
    return content[:at] + str(rng.choice(WORDS)).encode() + content[at:]


def wrong_lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Drop, double, swap or lengthen lines."""
    lines = content.split(b"\n")
    first, second = (int(rng.integers(len(lines))) for _ in range(2))
    choice = rng.integers(5)
    if choice == 0:
        del lines[first]
    elif choice == 1:
        lines.insert(second, lines[first])
    elif choice == 2:
        lines[first], lines[second] = lines[second], lines[first]
    elif choice == 3:
        lines[first] = lines[first] * 500
    else:
        lines[first:first] = [b"\t \r"] * 50
    return b"\n".join(lines)


def deep_nesting(content: bytes, rng: np.random.Generator) -> bytes:
    depth = int(rng.choice([40, 2000, 100_000]))
    opening, closing = ((b"[", b"]"), (b'{"a":', b"}"), (b"(", b")"), (b"- ", b""))[int(rng.integers(4))]
    at = int(rng.choice([0, _place(rng, len(content))]))
    return content[:at] + opening * depth + (closing * depth if rng.random() < 0.5 else b"") + content[at:]


def other_encoding(content: bytes, rng: np.random.Generator) -> bytes:
    text = content.decode("utf-8", "replace")
    code = str(rng.choice(["utf-16", "utf-8-sig", "utf-32", "cp1252", "utf-7"]))
    return text.encode(code, "replace") if rng.random() < 0.7 else content.replace(b"\n", b"\r\n")


def wrong_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Put bytes that are no UTF-8 somewhere: half a letter, a surrogate, a letter written too long."""
    for _ in range(int(rng.integers(1, 4))):
        at = _place(rng, len(content))
        content = content[:at] + _NOT_UTF8[int(rng.integers(len(_NOT_UTF8)))] + content[at:]
    return content


def wrong_types(content: bytes, rng: np.random.Generator) -> bytes:
    """Put a value of another kind in the place of one after a colon or a comma."""
    found = list(_VALUE.finditer(content))
    if not found:
        return content
    place = found[int(rng.integers(len(found)))]
    return content[: place.start(1)] + str(rng.choice(_KINDS)).encode() + content[place.end(1) :]


def doubled(content: bytes, rng: np.random.Generator) -> bytes:
    """Write the file twice, or one block of its lines many times."""
    if rng.random() < 0.5:
        return content * 2
    lines = content.split(b"\n")
    start = int(rng.integers(len(lines)))
    block = lines[start : start + int(rng.integers(1, 20))]
    return b"\n".join([*lines[:start], *(block * int(rng.choice([2, 50]))), *lines[start:]])


def open_quote(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(rng, len(content))
    return content[:at] + b'"' + content[at:] + b"1,2,3\n" * int(rng.choice([1, 10_000]))


def other_kind(content: bytes, rng: np.random.Generator) -> bytes:
    """Nothing of the file: empty, blanks, noise, or another format's first bytes."""
    starts = (b"", b"\n", b"\0" * 100, b"\x89PNG\r\n\x1a\n", b"PK\3\4", b"\x93NUMPY\1\0v\0", b"ply\n", b"%YAML:1.0\n")
    return starts[int(rng.integers(len(starts)))] + (rng.bytes(300) if rng.random() < 0.3 else b"")


def inside_png(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage a chunk of a PNG file and mend its checksum, or its length and nothing else."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + length]))
        at += length + 12
    index = int(rng.integers(len(chunks)))
    kind, data = chunks[index]
    if rng.random() < 0.4:
        kind, data = chunks[index := 0]
        at = int(rng.choice([0, 4]))
        data = data[:at] + int(rng.choice(_SIZES)).to_bytes(4, "big") + data[at + 4 :]
    elif data:
        data = flip_bits(data, rng)
    chunks[index] = (kind, data)
    lengths = [len(data) for _, data in chunks]
    if rng.random() < 0.4:
        lengths[index] = int(rng.choice(_SIZES))
    parts = [
        length.to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")
        for length, (kind, data) in zip(lengths, chunks, strict=True)
    ]
    return content[:8] + b"".join(parts)


def inside_npy(content: bytes, rng: np.random.Generator) -> bytes:
    """Write another header, of the right length, over that of a NumPy file."""
    length = int.from_bytes(content[8:10], "little")
    descr = str(rng.choice(["<f4", "|O", "<U99999", "|V8", "<c16", "<M8[s]", ">f8", "|u1", "('<f4', (2, 3))", "<f2"]))
    shape = str(
        rng.choice(["(999999, 999999)", "(-1, 2)", "(2,)", "()", "(2, 2, 2, 2)", "(0, 5)", "(1e3,)", "(72, 96)"])
    )
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    tail = str(rng.choice(["", "\x00", "(" * 50, "'" * 3, "\\", "\n  x", "9" * 60]))
    return content[:10] + (header + tail).encode("latin1")[:length].ljust(length) + content[10 + length :]


def inside_zip(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage one member of an archive and pack it again."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice(list(members)))
    damage = (inside_npy, inside_npy, flip_bits, cut_off, huge_size, extreme_floats)[int(rng.integers(6))]
    members[name] = damage(members[name], rng)
    if rng.random() < 0.2:
        members["points.npy"] = members.pop(name)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, data in members.items():
            archive.writestr(each, data)
    return packed.getvalue()


def inside_tiff(content: bytes, rng: np.random.Generator) -> bytes:
    """Write another kind, count or value into an entry of the first directory of a TIFF or DNG file."""
    order = "<" if content.startswith(b"II") else ">"
    (at,) = struct.unpack_from(f"{order}I", content, 4)
    (entries,) = struct.unpack_from(f"{order}H", content, at)
    entry = at + 2 + 12 * int(rng.integers(entries))
    result = bytearray(content)
    if rng.random() < 0.3:
        struct.pack_into(f"{order}H", result, entry + 2, int(rng.integers(20)))
    else:
        struct.pack_into(f"{order}I", result, entry + int(rng.choice([4, 8])), int(rng.choice(_SIZES)))
    return bytes(result)


def inside_jpeg(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage a segment of a JPEG file: its length, or what its header says."""
    starts, at = [], 2
    while at + 4 <= len(content) and content[at] == 0xFF and content[at + 1] != 0xDA:
        starts.append(at)
        at += 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    start = starts[int(rng.integers(len(starts)))]
    result = bytearray(content)
    place = start + int(rng.choice([2, 5, 7, int(rng.integers(2, 20))]))
    result[place : place + 2] = (int(rng.choice(_SIZES)) & 0xFFFF).to_bytes(2, "big")
    return bytes(result)


def inside_report(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage what a report carries: its JSON, or its detections, which are packed again."""
    name = b"camcal-run" if rng.random() < 0.5 else b"camcal-detections"
    match = re.search(rb'<script[^>]*id="' + name + rb'"[^>]*>(.*?)</script>', content, re.DOTALL)
    if match is None:
        return content
    text = match[1] if name == b"camcal-run" else zlib.decompress(base64.b64decode(match[1]))
    text = TEXT[int(rng.integers(len(TEXT)))](text, rng)
    packed = text if name == b"camcal-run" else base64.b64encode(zlib.compress(text))
    return content[: match.start(1)] + packed + content[match.end(1) :]


BYTES: tuple[Mutation, ...] = (cut_off, flip_bits, huge_size, extreme_floats, move_bytes, other_kind)
TEXT: tuple[Mutation, ...] = (
    *(wrong_numbers, wrong_numbers, wrong_numbers, wrong_types, wrong_types, wrong_words, wrong_bytes, wrong_lines),
    *(doubled, deep_nesting, other_encoding, open_quote, cut_off, flip_bits, move_bytes, other_kind),
)
_INSIDE: Mapping[str, Mutation] = {
    ".png": inside_png,
    ".npy": inside_npy,
    ".npz": inside_zip,
    ".tiff": inside_tiff,
    ".dng": inside_tiff,
    ".jpg": inside_jpeg,
    ".html": inside_report,
}


def mutations_of(name: str, content: bytes) -> tuple[Mutation, ...]:
    """Return what can be done to a file of this name and content."""
    inside = _INSIDE.get(name[name.rindex(".") :])
    if _is_text(content):
        return (*TEXT, *([inside] * len(TEXT) if inside else []))
    return (*BYTES, wrong_numbers, *([inside] * 3 if inside else []))


def _is_text(content: bytes) -> bool:
    return b"\0" not in content[:2000] and not any(byte > 0xF4 for byte in content[:2000])


def _place(rng: np.random.Generator, length: int) -> int:
    """Return a place in a file, near its start as often as anywhere."""
    reach = length if rng.random() < 0.5 else min(length, 200)
    return int(rng.integers(max(1, reach)))
