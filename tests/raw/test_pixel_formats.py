"""Pixel formats against bits placed one by one, published vectors, and their own inverse.

The slow reader below follows the published tables of bytes and bits and shares nothing with the package. What this does
not prove: that cameras keep to those tables.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.raw.packing import BLOCK_PIXELS
from camcal.raw.pixel_formats import FAMILIES, FORMATS, frame_bytes, pack, pixel_format_named, row_bytes, unpack

TEN = [0x2A5, 0x13C, 0x3FF, 0x001]
TWELVE = [0xABC, 0x123]
FOURTEEN = [0x2ABC, 0x1234, 0x3FFF, 0x0001]
VECTORS = [
    ("Mono10p", TEN, "a5f2f47f00"),
    ("Mono12p", TWELVE, "bc3a12"),
    ("Mono14p", FOURTEEN, "bc2a8df4ff0700"),
    ("Mono10Packed", TEN[:2], "a9014f"),
    ("Mono12Packed", TWELVE, "ab3c12"),
    ("pRAA", TEN, "a94fff0071"),
    ("pRCC", TWELVE, "ab123c"),
    ("pREE", FOURTEEN, "aa48ff003cfd07"),
    ("BayerRG10pmsb", TEN, "a953cffc01"),
    ("BayerRG12pmsb", TWELVE, "abc123"),
    ("BayerRG14pmsb", FOURTEEN, "aaf1234fffc001"),
    ("Mono8", [0xAB, 0x01], "ab01"),
    ("Mono10", TEN[:2], "a5023c01"),
    ("Mono16", [0xABCD], "cdab"),
]
packed_families = st.sampled_from([each for each in FAMILIES if each.packing])
all_families = st.sampled_from(FAMILIES)
widths, heights = st.integers(1, 14), st.integers(1, 5)


def place_of_bit(family, pixel, bit):
    """Return the byte and the bit in it of one bit of one pixel, counted from the start of a run of pixels."""
    low = family.bits - 8
    if family.name.endswith("pmsb"):
        position = pixel * family.bits + family.bits - 1 - bit
        return position // 8, 7 - position % 8
    if family.name.endswith("p"):
        position = pixel * family.bits + bit
        return position // 8, position % 8
    if family.name.endswith("Packed"):
        pair, second = divmod(pixel, 2)
        return (3 * pair + 2 * second, bit - low) if bit >= low else (3 * pair + 1, 4 * second + bit)
    pixels, size = {"RAW10": (4, 5), "RAW12": (2, 3), "RAW14": (4, 7)}[family.name]
    group, inside = divmod(pixel, pixels)
    if bit >= low:
        return group * size + inside, bit - low
    position = inside * low + bit
    return group * size + pixels + position // 8, position % 8


def slow_unpack(content, family, size, stride):
    width, height = size
    by_row = family.name.startswith("RAW") or stride is not None
    values = np.zeros((height, width), np.uint16)
    for row, column in np.ndindex(height, width):
        start = row * (stride or row_bytes(family, width)) if by_row else 0
        pixel = column if by_row else row * width + column
        for bit in range(family.bits):
            byte, shift = place_of_bit(family, pixel, bit)
            values[row, column] |= (content[start + byte] >> shift & 1) << bit
    return values


def random_samples(family, shape, seed=0):
    dtype = np.uint8 if family.bits == 8 else np.uint16
    return np.random.default_rng(seed).integers(0, family.white, shape, dtype, endpoint=True)


@pytest.mark.parametrize(("name", "samples", "content"), VECTORS)
def test_the_published_bytes_are_read_and_written(name, samples, content):
    pixel_format = pixel_format_named(name)
    values = unpack(bytes.fromhex(content), pixel_format, (len(samples), 1))
    assert values.tolist() == [samples]
    assert pack(values, pixel_format).hex() == content


@settings(deadline=None)  # the first call of a format pays for its constants
@given(packed_families, widths, heights, st.none() | st.integers(0, 9), st.integers(0, 2**32))
def test_every_bit_of_random_bytes_lands_where_the_tables_say(family, width, height, padding, seed):
    stride = None if padding is None else row_bytes(family, width) + padding
    count = frame_bytes(family, (width, height), stride)
    content = np.random.default_rng(seed).integers(0, 256, count, np.uint8)
    expected = slow_unpack(content.tolist(), family, (width, height), stride)
    np.testing.assert_array_equal(unpack(content, family, (width, height), stride=stride), expected)


@settings(deadline=None)
@given(all_families, widths, heights, st.none() | st.integers(0, 9), st.integers(0, 2**32))
def test_samples_that_are_packed_come_back(family, width, height, padding, seed):
    values = random_samples(family, (height, width), seed)
    stride = None if padding is None else row_bytes(family, width) + padding
    content = pack(values, family, stride=stride)
    back = unpack(content, family, (width, height), stride=stride)
    np.testing.assert_array_equal(back, values)
    assert back.dtype == values.dtype
    assert len(content) == (frame_bytes(family, (width, height)) if stride is None else stride * height)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@pytest.mark.parametrize("padding", [None, 0, 5])
def test_frames_of_several_blocks_come_back(family, padding):
    width = BLOCK_PIXELS // 7 + 3  # nearly seven rows fill a block; the width is odd
    values = random_samples(family, (16, width))
    stride = None if padding is None else row_bytes(family, width) + padding
    content = pack(values, family, stride=stride)
    np.testing.assert_array_equal(unpack(content, family, (width, 16), stride=stride), values)


@pytest.mark.parametrize("name", ["Mono10", "BayerGB12", "BayerRG14", "Mono16"])
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("align", ["lsb", "msb"])
def test_byte_order_and_alignment_of_unpacked_samples_come_back(name, endian, align):
    pixel_format = pixel_format_named(name)
    values = random_samples(pixel_format, (5, 7))
    content = pack(values, pixel_format, endian=endian, align=align)
    back = unpack(content, pixel_format, (7, 5), endian=endian, align=align)
    np.testing.assert_array_equal(back, values)
    assert back.dtype.isnative


def test_big_endian_and_upper_bits_are_what_they_say():
    mono10 = pixel_format_named("Mono10")
    values = np.array([[0x2A5]], np.uint16)
    assert pack(values, mono10, endian="big").hex() == "02a5"
    assert pack(values, mono10, align="msb").hex() == "40a9"


def test_pixels_of_pfnc_run_on_across_rows_and_those_of_mipi_do_not():
    values = np.full((2, 3), 0x3FF, np.uint16)
    assert len(pack(values, pixel_format_named("Mono10p"))) == 8  # 60 bits
    assert len(pack(values, pixel_format_named("RAW10"))) == 10  # a group of four for every row


def test_rows_are_padded_with_zeros():
    content = pack(np.full((2, 2), 0xFFF), pixel_format_named("Mono12p"), stride=4)
    assert content.hex() == "ffffff00ffffff00"


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, lambda content: np.frombuffer(content, np.uint8)])
def test_any_kind_of_bytes_is_read_and_never_changed(kind):
    content = bytes.fromhex("bc3a12bc3a12")
    values = unpack(kind(content), pixel_format_named("Mono12p"), (2, 2))
    values += 1
    assert content.hex() == "bc3a12bc3a12"
    assert values.tolist() == [[0xABD, 0x124], [0xABD, 0x124]]


def test_bytes_after_the_last_pixel_are_not_read():
    assert unpack(bytes.fromhex("bc3a12ffff"), pixel_format_named("Mono12p"), (2, 1)).tolist() == [TWELVE]


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ("BA81 BG10 BG12 BG14 BYR2 pBAA pBCC pBEE SBGGR8 SBGGR16 SBGGR12_CSI2P BayerBG10Packed", "BGGR"),
        ("GBRG GB10 GB12 GB14 GB16 pGAA pGCC pGEE SGBRG10 SGBRG10_CSI2P BayerGB14p", "GBRG"),
        ("GRBG BA10 BA12 GR14 GR16 pgAA pgCC pgEE SGRBG12 SGRBG14_CSI2P BayerGR12pmsb", "GRBG"),
        ("RGGB RG10 RG12 RG14 RG16 pRAA pRCC pREE SRGGB14 SRGGB10_CSI2P BayerRG10p", "RGGB"),
        ("GREY Y10 Y12 Y14 Y16 Y10P R8 R10_CSI2P Mono12Packed mono14PMSB", "MONO"),
        ("Bayer8 Bayer12p RAW10 raw14 bayer10packed", None),
    ],
)
def test_the_names_of_all_vocabularies_say_their_pattern(names, pattern):
    assert [pixel_format_named(name).pattern for name in names.split()] == [pattern] * len(names.split())


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("0x01080008", "BayerGR8"),
        ("0x0108000B", "BayerBG8"),
        ("0x0110000D", "BayerRG10"),
        ("0x01100012", "BayerGB12"),
        ("0x01100031", "BayerBG16"),
        ("0x010c0026", "BayerGR10Packed"),
        ("0x010C002D", "BayerBG12Packed"),
        ("0x010A0052", "BayerBG10p"),
        ("0x010A0056", "BayerGR10p"),
        ("0x010C0055", "BayerGB12p"),
        ("0x010C0059", "BayerRG12p"),
        ("0x010E0106", "BayerRG14p"),
        ("0x010A0046", "Mono10p"),
        ("0x010C0047", "Mono12p"),
        ("0x010C0004", "Mono10Packed"),
        ("0x010C0006", "Mono12Packed"),
    ],
)
def test_the_numbers_of_the_convention_find_their_format(code, name):
    assert pixel_format_named(code).name == name


def test_every_name_leads_to_its_own_format_whatever_the_case_of_its_letters():
    for pixel_format in FORMATS:
        for name in pixel_format.names:
            assert pixel_format_named(f" {name} ") is pixel_format
            if name[:2] not in {"pg", "pG"}:
                assert pixel_format_named(name.swapcase()) is pixel_format


def test_numbers_say_the_bits_that_a_pixel_takes():
    for pixel_format in FORMATS:
        if pixel_format.code is not None:  # bits 16 … 23 of a number of the convention
            assert pixel_format.code >> 16 & 0xFF == frame_bytes(pixel_format, (8, 1))
    assert len({each.code for each in FORMATS if each.code}) == sum(each.code is not None for each in FORMATS)


def test_white_is_the_largest_sample():
    whites = {name: pixel_format_named(name).white for name in ("Mono8", "RAW10", "BayerRG12Packed", "Y14", "Mono16")}
    assert whites == {"Mono8": 255, "RAW10": 1023, "BayerRG12Packed": 4095, "Y14": 16383, "Mono16": 65535}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("BayerRG12x", "did you mean BayerRG12"),
        ("zzzz", "there are Mono and BayerRG|GR|GB|BG with 8|10|12"),
        ("pgaa", "SGRBG10_CSI2P (GRBG) or SGBRG10_CSI2P (GBRG)"),
    ],
)
def test_an_unknown_name_is_refused_with_what_there_is(name, expected):
    with pytest.raises(InvalidInput) as caught:
        pixel_format_named(name)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("name", "size", "options", "message"),
    [
        ("Mono12p", (3, 1), {}, "Mono12p 3x1 needs 5 bytes, found 3"),
        ("Mono8", (2, 2), {}, "Mono8 2x2 needs 4 bytes, found 3"),
        ("Mono8", (2, 1), {"stride": 1}, "stride of 1 bytes is too short: 2 pixels of Mono8 take 2"),
        ("Mono8", (0, 1), {}, "0x1 pixels"),
        ("Mono12p", (2, 1), {"endian": "big"}, "Mono12p has a fixed layout; endian big"),
        ("Mono8", (2, 1), {"align": "msb"}, "Mono8 has a fixed layout; align msb"),
        ("Mono16", (1, 1), {"endian": "middle"}, "endian 'middle' is unknown; use little or big"),
    ],
)
def test_what_does_not_belong_together_is_refused(name, size, options, message):
    with pytest.raises(InvalidInput) as caught:
        unpack(b"\0\0\0", pixel_format_named(name), size, **options)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((1, 2), 1024), "holds 0 … 1023, found 1024 … 1024"),
        (np.full((1, 2), -1), "holds 0 … 1023, found -1"),
        (np.zeros((1, 2)), "whole numbers, found float64 (1, 2)"),
        (np.zeros(2, int), "whole numbers, found int64 (2,)"),
        (np.zeros((0, 2), int), "2x0 pixels"),
    ],
)
def test_samples_that_the_format_cannot_hold_are_not_packed(values, message):
    with pytest.raises(InvalidInput) as caught:
        pack(values, pixel_format_named("RAW10"))
    assert message in str(caught.value)
