"""PCD as the Point Cloud Library has it."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError
from camcal.formats.pointclouds import pcd, read, write
from camcal.formats.pointclouds.pcd import lzf_decompressed

POINT = b"\x00\x00\x80\x3f\x00\x00\x00\x40\x00\x00\x40\x40"  # 1, 2, 3


def pcd_of(body, data="binary", **changes):
    words = {"VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": "1"}
    words |= {"HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": "1"}
    lines = [f"{key} {value}" for key, value in (words | changes).items() if value is not None]
    return "\n".join(["# .PCD v0.7", *lines, f"DATA {data}", ""]).encode() + body


def lzf_literals(content):
    """Return content as LZF of nothing but literals."""
    pieces = [content[start : start + 32] for start in range(0, len(content), 32)]
    return b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)


def test_colour_is_packed_into_one_float_as_pcl_wants_it(tmp_path, vertices, stream):
    cloud = vertices(1, colour=True)
    cloud["red"], cloud["green"], cloud["blue"] = 1, 2, 3
    write(tmp_path / "cloud.pcd", stream(cloud))
    header, body = (tmp_path / "cloud.pcd").read_bytes().split(b"DATA binary\n")
    for line in (b"FIELDS x y z rgb", b"SIZE 4 4 4 4", b"TYPE F F F F", b"COUNT 1 1 1 1", b"VIEWPOINT 0 0 0 1 0 0 0"):
        assert line in header.splitlines()
    assert body == struct.pack("<3fI", *cloud[["x", "y", "z"]][0], 0x010203)


def test_text_has_colour_as_an_integer(tmp_path, vertices, stream):
    cloud = vertices(2, colour=True)
    cloud["red"], cloud["green"], cloud["blue"] = 1, 2, 3
    write(tmp_path / "cloud.pcd", stream(cloud), ascii_text=True)
    header, body = (tmp_path / "cloud.pcd").read_text().split("DATA ascii\n")
    assert "TYPE F F F U" in header.splitlines()
    assert [row.split()[3] for row in body.splitlines()] == [str(0x010203)] * 2
    np.testing.assert_array_equal(read(tmp_path / "cloud.pcd").vertices, cloud)


def test_an_organised_cloud_says_its_width_and_height(tmp_path, vertices, stream):
    write(tmp_path / "cloud.pcd", stream(vertices(12), grid=(4, 3)))
    header = (tmp_path / "cloud.pcd").read_bytes().split(b"DATA")[0].splitlines()
    assert {b"WIDTH 4", b"HEIGHT 3", b"POINTS 12"} <= set(header)


def test_normals_have_the_names_of_pcl(tmp_path, vertices, stream):
    write(tmp_path / "cloud.pcd", stream(vertices(2, normals=True)))
    assert b"FIELDS x y z normal_x normal_y normal_z\n" in (tmp_path / "cloud.pcd").read_bytes()


def test_fields_of_other_programs_are_passed_over():
    fields = {"FIELDS": "_ x y z histogram", "SIZE": "1 8 8 8 4", "TYPE": "U F F F F", "COUNT": "4 1 1 1 5"}
    body = bytes(4) + struct.pack("<3d", 1, 2, 3) + bytes(20)
    assert pcd.read(pcd_of(body, **fields)).vertices.tolist() == [(1, 2, 3)]
    text = b"0 0 0 0 1 2 3 9 9 9 9 9\n"
    assert pcd.read(pcd_of(text, "ascii", **fields)).vertices.tolist() == [(1, 2, 3)]


def test_a_file_without_counts_and_points_is_read():
    assert pcd.read(pcd_of(POINT, COUNT=None, POINTS=None)).vertices.tolist() == [(1, 2, 3)]


def test_a_compressed_file_has_its_fields_one_after_the_other():
    columns = np.arange(6, dtype="<f4").reshape(3, 2).tobytes()
    packed = lzf_literals(columns)
    body = struct.pack("<2I", len(packed), len(columns)) + packed
    found = pcd.read(pcd_of(body, "binary_compressed", WIDTH="2", POINTS="2"))
    assert found.vertices.tolist() == [(0, 2, 4), (1, 3, 5)]


@given(st.binary(min_size=1, max_size=300))
def test_lzf_literals_come_back(content):
    assert lzf_decompressed(lzf_literals(content), len(content)) == content


def test_lzf_repeats_what_stands_already_there_even_what_it_is_writing():
    short = b"\x02abc" + bytes([4 << 5, 2])  # three bytes, then six from three bytes back
    assert lzf_decompressed(short, 9) == b"abcabcabc"
    long = b"\x00a" + bytes([7 << 5, 91, 0])  # one byte, then 7 + 91 + 2 from one byte back
    assert lzf_decompressed(long, 101) == b"a" * 101


@pytest.mark.parametrize(
    ("packed", "size"), [(b"\x05ab", 6), (bytes([1 << 5, 0]), 3), (b"\x00a", 2), (b"\x01ab", 1), (b"\x00a\xe0", 9)]
)
def test_damaged_lzf_is_a_file_error(packed, size):
    with pytest.raises(FileError, match="compressed data"):
        lzf_decompressed(packed, size)


@given(packed=st.binary(max_size=100), size=st.integers(0, 1000))
def test_lzf_of_any_bytes_gives_the_size_promised_or_an_error(packed, size):
    try:
        found = lzf_decompressed(packed, size)
    except FileError:
        found = bytes(size)
    assert len(found) == size


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"ply\n", "not a PCD file"),
        (pcd_of(POINT, "base64"), "data of the kind base64; use one of binary"),
        (pcd_of(POINT, SIZE="4 4"), "fit together"),
        (pcd_of(POINT, TYPE="F F O"), "fit together"),
        (pcd_of(POINT, COUNT="1 1 0"), "fit together"),
        (pcd_of(POINT, WIDTH="one"), "fit together"),
        (pcd_of(POINT, POINTS="2"), "1 × 1, and 2 points"),
        (pcd_of(POINT, FIELDS="x y w"), "no x, y and z; its columns are x, y, w"),
        (pcd_of(POINT[:-1]), "1 × 1 points take 12 bytes, found 11"),
        (pcd_of(b"1 2 3\n", "ascii", WIDTH="2", POINTS="2"), "promises 2 points, there are 1 lines"),
        (pcd_of(b"1 2\n", "ascii"), "3 numbers by the header, a row has 2"),
        (pcd_of(b"\0\0", "binary_compressed"), "begin with their two sizes"),
        (pcd_of(struct.pack("<2I", 9, 12), "binary_compressed"), "take 9 bytes, found 0"),
        (pcd_of(struct.pack("<2I", 0, 11), "binary_compressed"), "take 12 bytes, found 11"),
    ],
)
def test_a_file_that_is_none_says_what_was_expected_and_found(content, message):
    with pytest.raises(FileError, match=message):
        pcd.read(content)
