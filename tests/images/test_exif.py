"""The orientation tag in EXIF blocks and TIFF files. Pillow, which shares no code with us, reads what we write."""

import io
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow
from PIL.TiffImagePlugin import IFDRational

from camcal.images import exif

ORIENTATION = 0x0112
ASCII, SHORT = 2, 3


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


CAPTURE = {
    "make": "Acme",
    "model": "Model 1",
    "exposure_s": 0.004,
    "iso": 400,
    "f_number": 2.8,
    "focal_mm": 52.5,
}


def capture_block(byte_order="<", **changes):
    """A block about a capture as Pillow writes it; None leaves a tag out."""
    said = CAPTURE | changes
    tags = Pillow.Exif()
    tags.endian = byte_order
    tags[0x010F], tags[0x0110] = said["make"], said["model"]
    capture = tags.get_ifd(0x8769)
    for name, tag in (("exposure_s", 0x829A), ("f_number", 0x829D), ("focal_mm", 0x920A)):
        if said[name] is not None:
            capture[tag] = IFDRational(said[name])
    for name, tag in (("iso", 0x8827), ("iso_long", 0x8832)):
        if said.get(name) is not None:
            capture[tag] = said[name]
    return tags.tobytes()[6:]


@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_how_an_image_was_taken_is_read(byte_order):
    assert exif.capture_facts(capture_block(byte_order)) == CAPTURE


@pytest.mark.parametrize("magic", [b"II*\0", b"IIU\0", b"IIRO", b"IIRS"])
def test_the_numbers_that_makers_have_in_place_of_tiffs_own_are_accepted(magic):
    assert exif.capture_facts(magic + capture_block()[4:]) == CAPTURE


def test_what_is_zero_or_left_out_is_not_said():
    block = capture_block(make="", exposure_s=0, iso=0, f_number=None)
    assert exif.capture_facts(block) == {"model": "Model 1", "focal_mm": 52.5}


def test_a_speed_beyond_sixteen_bits_is_found_in_the_longer_tag():
    assert exif.capture_facts(capture_block(iso=65535, iso_long=102400))["iso"] == 102400


def test_text_that_is_not_ascii_is_no_traceback():
    block = capture_block().replace(b"Acme", b"\xe9\xe8\0x")
    assert exif.capture_facts(block)["make"] == "\ufffd\ufffd"


def test_numbers_in_place_of_names_and_texts_in_place_of_numbers_are_not_said():
    block = bytearray(capture_block())
    for tag, kind in ((0x010F, SHORT), (0x829A, ASCII)):
        place = block.index(struct.pack("<H", tag))
        block[place + 2 : place + 4] = struct.pack("<H", kind)
    said = exif.capture_facts(bytes(block))
    assert said == {name: value for name, value in CAPTURE.items() if name not in ("make", "exposure_s")}


@given(st.binary(max_size=300), st.sampled_from([b"", b"II*\0", b"MM\0*", b"II*\0\x08\0\0\0", b"IIU\0\x08\0\0\0"]))
def test_no_bytes_whatever_say_anything_but_facts(tail, head):
    assert set(exif.capture_facts(head + tail)) <= set(CAPTURE)
    assert exif.is_cut_off(head + tail) in (True, False)


def tiff(size=(40, 30), **options):
    stream = io.BytesIO()
    Pillow.new("L", size, 100).save(stream, "TIFF", **options)
    return stream.getvalue()


@pytest.mark.parametrize("compression", [None, "tiff_deflate"])
def test_a_tiff_file_is_whole_or_cut_off(compression):
    content = tiff(compression=compression)
    tags = Pillow.open(io.BytesIO(content)).tag_v2
    end = tags[0x0111][0] + tags[0x0117][0]  # of the only strip
    assert not exif.is_cut_off(content)
    assert not exif.is_cut_off(content + b"something behind it")
    assert exif.is_cut_off(content[: end - 1])


@pytest.mark.parametrize("content", [b"", b"II", b"\xff\xd8\xff\xe0 a photograph", b"IIU\0\x08\0\0\0"])
def test_what_is_no_tiff_file_is_not_judged(content):
    assert not exif.is_cut_off(content)


def test_pixels_below_another_directory_are_looked_for_too():
    pages = io.BytesIO()
    page = Pillow.new("L", (40, 30), 100)
    page.save(pages, "TIFF", save_all=True, append_images=[Pillow.new("L", (400, 300), 50)])
    content = pages.getvalue()
    assert not exif.is_cut_off(content)
    assert exif.is_cut_off(content[:-1000])


def test_directories_that_point_at_each_other_come_to_an_end():
    content = bytearray(tiff())
    (start,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, start)
    struct.pack_into("<I", content, start + 2 + 12 * count, start)
    assert not exif.is_cut_off(bytes(content))


@given(st.binary(max_size=200), st.sampled_from([b"", b"II*\0", b"MM\0*", b"II*\0\x08\0\0\0"]))
def test_no_bytes_whatever_are_a_traceback(tail, head):
    assert exif.orientation(head + tail) in range(1, 9)


@given(st.integers(0, 400))
def test_a_block_that_is_cut_off_is_upright_or_read(length):
    assert exif.orientation(pillow_block(6)[:length]) in (1, 6)
