"""The orientation tag in EXIF blocks and TIFF files. Pillow, which shares no code with us, reads what we write."""

import io
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow

from camcal.images import exif

ORIENTATION = 0x0112


def pillow_block(orientation=None, byte_order="<"):
    """An EXIF block as Pillow writes it: a maker, an orientation, and the capture directory with a size."""
    tags = Pillow.Exif()
    tags.endian = byte_order
    tags[0x010F] = "Maker of cameras"
    if orientation is not None:
        tags[ORIENTATION] = orientation
    capture = tags.get_ifd(0x8769)
    capture[0xA002], capture[0xA003] = 4000, 3000
    capture[0x829A] = 0.01
    return tags.tobytes()[6:]


def read_by_pillow(block):
    tags = Pillow.Exif()
    tags.load(b"Exif\0\0" + block)
    return tags


@pytest.mark.parametrize("value", range(1, 9))
@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_the_orientation_of_a_block_is_read(value, byte_order):
    assert exif.orientation(pillow_block(value, byte_order)) == value


@pytest.mark.parametrize("value", [0, 9, 255])
def test_an_orientation_that_does_not_exist_counts_as_upright(value):
    assert exif.orientation(pillow_block(value)) == exif.UPRIGHT


def test_a_block_without_the_tag_is_upright():
    assert exif.orientation(pillow_block()) == exif.UPRIGHT


@pytest.mark.parametrize("before", [None, 1, 8])
@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_a_block_carries_an_orientation_once_and_keeps_the_rest(before, byte_order):
    block = exif.with_orientation(pillow_block(before, byte_order), 6)
    tags = read_by_pillow(block)
    assert tags[ORIENTATION] == 6
    assert tags[0x010F] == "Maker of cameras"
    assert tags.get_ifd(0x8769)[0x829A] == 0.01
    assert tag_numbers(block).count(ORIENTATION) == 1


def tag_numbers(block):
    order = {b"II": "<", b"MM": ">"}[block[:2]]
    (start,) = struct.unpack_from(order + "I", block, 4)
    (count,) = struct.unpack_from(order + "H", block, start)
    return [struct.unpack_from(order + "H", block, start + 2 + 12 * entry)[0] for entry in range(count)]


def test_tags_stay_sorted_as_the_standard_demands():
    numbers = tag_numbers(exif.with_orientation(pillow_block(), 3))
    assert numbers == sorted(numbers)


def test_nothing_gives_a_block_of_the_orientation_alone():
    assert dict(read_by_pillow(exif.with_orientation(b"", 8))) == {ORIENTATION: 8}


def test_a_block_for_another_size_tells_that_size_and_has_no_thumbnail():
    block = bytearray(pillow_block(6))
    (start,) = struct.unpack_from("<I", block, 4)
    (count,) = struct.unpack_from("<H", block, start)
    struct.pack_into("<I", block, start + 2 + 12 * count, len(block))  # a second directory, as for a thumbnail
    block += struct.pack("<HHHIII", 1, 0x0201, 4, 1, 0, 0)
    result = exif.of_image(bytes(block), (640, 480))
    capture = read_by_pillow(result).get_ifd(0x8769)
    assert (capture[0xA002], capture[0xA003]) == (640, 480)
    assert struct.unpack_from("<I", result, start + 2 + 12 * count) == (0,)


def test_a_tiff_file_is_given_an_orientation_and_stays_a_picture():
    stream = io.BytesIO()
    Pillow.new("RGB", (7, 5), (10, 20, 30)).save(stream, "TIFF")
    content = exif.with_orientation(stream.getvalue(), 6)
    assert exif.orientation(content) == 6
    picture = Pillow.open(io.BytesIO(content))
    assert picture.getexif()[ORIENTATION] == 6
    assert picture.getpixel((3, 2)) == (10, 20, 30)


@given(st.binary(max_size=200), st.sampled_from([b"", b"II*\0", b"MM\0*", b"II*\0\x08\0\0\0"]))
def test_no_bytes_whatever_are_a_traceback(tail, head):
    assert exif.orientation(head + tail) in range(1, 9)


@given(st.integers(0, 400))
def test_a_block_that_is_cut_off_is_upright_or_read(length):
    assert exif.orientation(pillow_block(6)[:length]) in (1, 6)
