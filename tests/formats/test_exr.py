"""OpenEXR files of one channel: what the reference library was seen to write and read is what stands here."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from camcal.errors import FileError
from camcal.formats.exr import read_exr, write_exr

VALUES = np.array([[0.5, np.nan, 3.0], [np.inf, -1.0, 1e30]], np.float32)


@pytest.fixture
def file(tmp_path):
    write_exr(tmp_path / "map.exr", VALUES)
    return tmp_path / "map.exr"


@settings(max_examples=15)
@given(values=arrays.arrays(np.float32, st.tuples(st.integers(1, 5), st.integers(1, 5)), elements=st.floats(width=32)))
def test_what_is_written_is_read_to_the_bit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("exr") / "map.exr"
    write_exr(path, values)
    np.testing.assert_array_equal(read_exr(path), values)


def test_the_rows_are_where_the_table_says(file):
    content = file.read_bytes()
    rows = len(VALUES)
    row_bytes = 8 + 4 * VALUES.shape[1]
    table = len(content) - rows * row_bytes - 8 * rows
    for y, place in enumerate(struct.unpack_from(f"<{rows}Q", content, table)):
        assert struct.unpack_from("<ii", content, place) == (y, 4 * VALUES.shape[1])
        np.testing.assert_array_equal(np.frombuffer(content, "<f4", VALUES.shape[1], place + 8), VALUES[y])


def test_the_header_begins_as_the_file_layout_says(file):
    # Magic number 20000630, version 2 without flags, then the list of channels: Y, float, not linear, sampled 1 by 1.
    channels = b"Y\0" + struct.pack("<iiii", 2, 0, 1, 1) + b"\0"
    start = struct.pack("<ii", 20000630, 2) + b"channels\0chlist\0" + struct.pack("<i", len(channels)) + channels
    assert file.read_bytes().startswith(start)


def test_a_file_cut_off_anywhere_is_a_file_error(file):
    content = file.read_bytes()
    for length in range(1, len(content)):
        file.write_bytes(content[:length])
        with pytest.raises(FileError, match=r"map\.exr"):
            read_exr(file)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"compression\0compression\0\x01\0\0\0\0", b"compression\0compression\0\x01\0\0\0\x03"),
        (struct.pack("<iB", 2, 0), struct.pack("<iB", 1, 0)),
        (b"\x76\x2f\x31\x01\x02\0", b"\x76\x2f\x31\x01\x02\x02"),
        (struct.pack("<4i", 0, 0, 2, 1), struct.pack("<4i", 0, 0, -2, 1)),
    ],
    ids=["compressed", "half floats", "tiles", "no width"],
)
def test_any_other_kind_of_exr_is_refused_with_advice(file, old, new):
    content = file.read_bytes()
    assert old in content
    file.write_bytes(content.replace(old, new, 1))
    with pytest.raises(FileError, match="convert it to PFM or TIFF"):
        read_exr(file)


def test_a_size_that_no_file_could_hold_is_refused(file):
    content = file.read_bytes()
    huge = struct.pack("<4i", -(2**31), -(2**31), 2**31 - 1, 2**31 - 1)
    file.write_bytes(content.replace(struct.pack("<4i", 0, 0, 2, 1), huge, 1))
    with pytest.raises(FileError, match="pixels take"):
        read_exr(file)
