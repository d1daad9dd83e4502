"""Raw files without a header: what is read, and what their length gives away."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.raw import headerless
from camcal.raw.headerless import (
    COMMON_SIZES,
    Layout,
    detect_alignment,
    fitting_layouts,
    missing_layout,
    read_headerless,
)
from camcal.raw.pixel_formats import FAMILIES, frame_bytes, pack, pixel_format_named, unpack

SIZE = (10, 6)
FRAMES = np.random.default_rng(3).integers(0, 4096, (3, *SIZE[::-1]), np.uint16)


def layout(name="BayerRG12p", size=SIZE, **more):
    return Layout(pixel_format_named(name), size, **more)


def written(tmp_path, content):
    path = tmp_path / "frame.raw"
    path.write_bytes(content)
    return path


def recording(name="BayerRG12p", **options):
    return b"".join(pack(frame, pixel_format_named(name), **options) for frame in FRAMES)


@pytest.mark.parametrize("name", ["BayerRG12p", "BayerRG12Packed", "BayerRG12pmsb", "pRCC", "BayerRG12"])
def test_a_frame_is_read_with_the_pattern_of_its_format(tmp_path, name):
    path = written(tmp_path, pack(FRAMES[0], pixel_format_named(name)))
    values, pattern = read_headerless(path, layout(name))
    np.testing.assert_array_equal(values, FRAMES[0])
    assert pattern == "RGGB"


@pytest.mark.parametrize("cut", [0, 5])
def test_the_padding_of_the_last_row_may_be_missing(tmp_path, cut):
    content = pack(FRAMES[0], pixel_format_named("pRCC"), stride=20)
    path = written(tmp_path, content[: len(content) - cut])
    np.testing.assert_array_equal(read_headerless(path, layout("pRCC", stride=20))[0], FRAMES[0])


def test_byte_order_alignment_and_offset_are_followed(tmp_path):
    order = {"endian": "big", "align": "msb"}
    path = written(tmp_path, b"head" + pack(FRAMES[0], pixel_format_named("Bayer12"), **order))
    values, pattern = read_headerless(path, layout("Bayer12", offset=4, pattern="GBRG", **order))
    np.testing.assert_array_equal(values, FRAMES[0])
    assert pattern == "GBRG"


@pytest.mark.parametrize("frame", [0, 1, 2])
@pytest.mark.parametrize("stride", [None, 20])
def test_one_frame_of_several_is_read(tmp_path, frame, stride):
    path = written(tmp_path, b"header" + recording(stride=stride))
    values, _ = read_headerless(path, layout(offset=6, stride=stride, frame=frame))
    np.testing.assert_array_equal(values, FRAMES[frame])


def test_several_frames_are_not_taken_for_one(tmp_path):
    path = written(tmp_path, recording())
    with pytest.raises(InvalidInput, match=r"holds 3 frames if it is BayerRG12p 10x6; give --frame 0 … 2"):
        read_headerless(path, layout())
    with pytest.raises(InvalidInput, match="has no frame 3; it holds 3, counted from 0"):
        read_headerless(path, layout(frame=3))


def test_a_file_that_is_too_short_is_refused_with_what_would_fit(tmp_path):
    path = written(tmp_path, bytes(640 * 480))
    with pytest.raises(FileError) as caught:
        read_headerless(path, layout(size=(640, 480)))
    assert str(caught.value).endswith(
        "frame.raw: BayerRG12p 640x480 needs 460800 bytes, found 307200; fits Bayer8 640x480"
    )


def test_bytes_left_over_are_refused(tmp_path):
    path = written(tmp_path, recording() + b"x")
    with pytest.raises(FileError, match="leaves surplus bytes after 3 frames of 90 bytes: found 271"):
        read_headerless(path, layout(frame=0))
    with pytest.raises(FileError, match="needs 90 bytes, found 0 after an offset of 1000"):
        read_headerless(path, layout(offset=1000))


@pytest.mark.parametrize(
    ("stored", "asked", "message"),
    [
        ({"endian": "big"}, {}, "--endian big would fit"),
        ({}, {"endian": "big"}, "--endian little would fit"),
        ({"align": "msb"}, {}, "12 bits in the upper part of their bytes: --align msb"),
    ],
)
def test_samples_above_white_are_refused_with_the_likely_reason(tmp_path, stored, asked, message):
    path = written(tmp_path, pack(FRAMES[0], pixel_format_named("Mono12"), **stored))
    with pytest.raises(InvalidInput, match="Mono12 ends at 4095") as caught:
        read_headerless(path, layout("Mono12", **asked))
    assert message in str(caught.value)


def test_samples_of_more_bits_than_the_format_says_are_refused(tmp_path):
    path = written(tmp_path, pack(FRAMES[0], pixel_format_named("Mono12")))
    with pytest.raises(InvalidInput, match="Mono10 ends at 1023; they need 12 bits"):
        read_headerless(path, layout("Mono10"))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("Bayer12p", {}, "has no colour pattern; give --pattern RGGB|"),
        ("BayerRG12p", {"pattern": "GRBG"}, "by --pattern; --format Bayer12p accepts any"),
        ("Bayer12p", {"pattern": "RGBG"}, "pattern 'RGBG' is unknown"),
        ("BayerRG12p", {"offset": -1}, "offset -1 is negative"),
        ("BayerRG12p", {"frame": -1}, "frame -1 is negative"),
        ("BayerRG12p", {"stride": 14}, "stride of 14 bytes is too short: 10 pixels of BayerRG12p take 15"),
        ("BayerRG12p", {"size": (10, 0)}, "10x0 pixels"),
        ("BayerRG12p", {"align": "msb"}, "has a fixed layout; "),
    ],
)
def test_a_layout_that_contradicts_itself_is_refused(name, options, message):
    with pytest.raises(InvalidInput) as caught:
        layout(name, **options)
    assert message in str(caught.value)


def test_a_file_that_is_not_there_a_folder_and_an_empty_one_are_refused(tmp_path):
    for path, message in (
        (tmp_path / "none.raw", "No such file"),
        (tmp_path, "is a folder"),
        (written(tmp_path, b""), "is empty"),
    ):
        with pytest.raises(FileError, match=message):
            read_headerless(path, layout())


@given(st.sampled_from(FAMILIES), st.sampled_from(COMMON_SIZES))
def test_the_length_of_a_common_frame_offers_its_format_and_size(family, size):
    fits = fitting_layouts(frame_bytes(family, size))
    assert any(family in fit.formats and fit.size == size and fit.stride is None for fit in fits)


@given(st.integers(1, 200_000_000) | st.sampled_from([1920 * 1080 * 2, 4128 * 2464, 2448 * 2048]))
def test_everything_offered_has_exactly_the_length(length):
    for fit in fitting_layouts(length):
        for each in fit.formats:
            step = fit.stride * fit.size[1] if fit.stride else frame_bytes(each, fit.size)
            assert step == length


def test_common_sizes_are_named_once():
    assert len(set(COMMON_SIZES)) == len(COMMON_SIZES)


def test_padded_rows_of_a_mipi_sensor_are_recognised():
    (fit,) = fitting_layouts(4128 * 2464)  # 3280 pixels of 10 bits take 4100 bytes
    assert str(fit) == "RAW10 3280x2464 stride 4128"


def test_a_given_format_or_size_leaves_only_what_completes_it():
    length = 4147200
    assert [str(fit) for fit in fitting_layouts(length, size=(1920, 1080))] == [
        "Bayer10|Bayer12|Bayer14|Bayer16 1920x1080"
    ]
    assert [str(fit) for fit in fitting_layouts(length, pixel_format_named("BayerRG12p"))] == ["BayerRG12p 1920x1440"]
    assert [str(fit) for fit in fitting_layouts(66, size=(6, 11))] == ["Bayer8 6x11"]


def test_the_error_for_a_missing_layout_offers_what_fits(tmp_path):
    path = written(tmp_path, bytes(1920 * 1080 * 2))
    assert str(missing_layout(path)).endswith(
        "frame.raw: 4147200 bytes without a header: fits Bayer10|Bayer12|Bayer14|Bayer16 1920x1080, "
        "Bayer12p|Bayer10Packed|Bayer12Packed|Bayer12pmsb|RAW12 1920x1440; give --format and --size"
    )
    assert str(missing_layout(path, size=(1920, 1080))).endswith("1920x1080; give --format")
    assert str(missing_layout(path, pixel_format_named("Mono8"))).endswith(
        "no common format and size fits with Mono8; give --size"
    )


@pytest.mark.parametrize(("bits", "shift"), [(10, 6), (12, 4), (14, 2)])
def test_samples_in_the_upper_bits_are_recognised(bits, shift):
    samples = np.random.default_rng(1).integers(0, 1 << bits, (20, 20), np.uint16)
    assert detect_alignment(samples << shift) == (bits, shift)
    assert detect_alignment(samples) == (bits, 0)


def test_samples_of_all_sixteen_bits_and_black_frames_stay_where_they_are():
    assert detect_alignment(np.array([[1, 65535]], np.uint16)) == (16, 0)
    assert detect_alignment(np.zeros((2, 2), np.uint16)) == (10, 0)
    # twelve bits whose last two are never used, as of a 10-bit converter: not in the upper bits
    assert detect_alignment(np.array([[0xFFC, 4]], np.uint16)) == (12, 0)


def test_samples_in_the_lower_bits_are_not_taken_for_those_in_the_upper_ones(tmp_path):
    path = written(tmp_path, pack(FRAMES[0], pixel_format_named("Mono12")))
    with pytest.raises(InvalidInput, match=r"words go up to .*: Mono12 in their lower bits; leave out --align msb"):
        read_headerless(path, layout("Mono12", align="msb"))
    filled = FRAMES[0] << 4 | FRAMES[0] >> 8  # some cameras fill the low bits
    path.write_bytes(filled.astype("<u2").tobytes())
    np.testing.assert_array_equal(read_headerless(path, layout("Mono12", align="msb"))[0], FRAMES[0])


PACKED_12 = ["BayerRG12p", "BayerRG12Packed", "BayerRG12pmsb", "pRCC"]


def scene(bits=12, noise=8.0):
    """A frame of a smooth scene of some contrast, as a sensor counts it."""
    y, x = np.mgrid[:96, :160] / 40
    light = 0.45 + 0.35 * np.sin(3 * x + y) * np.cos(2 * y)
    counts = (2**bits - 1) * light + np.random.default_rng(4).normal(0, noise, light.shape)
    return np.clip(counts, 0, 2**bits - 1).astype(np.uint16)


@pytest.mark.parametrize("written_as", PACKED_12)
@pytest.mark.parametrize("noise", [0.0, 8.0, 300.0])
def test_a_frame_that_is_read_as_it_was_packed_is_accepted_whatever_its_noise(tmp_path, written_as, noise):
    for values in (scene(noise=noise), np.full((96, 160), 64, np.uint16), scene(noise=noise) // 40):
        path = written(tmp_path, pack(values, pixel_format_named(written_as)))
        np.testing.assert_array_equal(read_headerless(path, layout(written_as, (160, 96)))[0], values)


@pytest.mark.parametrize(
    ("written_as", "read_as"),
    [
        ("BayerRG12Packed", "BayerRG12p"),
        ("BayerRG12p", "BayerRG12Packed"),
        ("BayerRG12p", "pRCC"),
        ("pRCC", "BayerRG12p"),
    ],
)
def test_a_frame_of_another_packing_is_refused_with_the_one_that_fits(tmp_path, written_as, read_as):
    path = written(tmp_path, pack(scene(), pixel_format_named(written_as)))
    name = pixel_format_named(written_as).name
    with pytest.raises(InvalidInput, match=rf"pixels of one colour are unlike each other; --format {name} fits"):
        read_headerless(path, layout(read_as, (160, 96)))


@pytest.mark.parametrize("written_as", PACKED_12)
@pytest.mark.parametrize("seed", range(4))
def test_clean_pictures_that_use_all_bits_are_read_in_their_packing_only(tmp_path, written_as, seed):
    """Of smooth pictures without noise, also the lower bits of neighbours are alike: all are less so when mixed up."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:240, :320]
    across, down, turn = rng.uniform(40, 160, 3)
    values = np.rint(4095 * (0.5 + 0.45 * np.sin(x / across + turn) * np.cos(y / down))).astype(np.uint16)
    path = written(tmp_path, pack(values, pixel_format_named(written_as)))
    np.testing.assert_array_equal(read_headerless(path, layout(written_as, (320, 240)))[0], values)
    for other in PACKED_12:
        mixed = unpack(np.frombuffer(path.read_bytes(), np.uint8), pixel_format_named(other), (320, 240))
        if not np.array_equal(mixed, values):
            with pytest.raises(InvalidInput, match="--format"):
                read_headerless(path, layout(other, (320, 240)))


@pytest.mark.parametrize("read_as", PACKED_12)
@pytest.mark.parametrize("written_as", PACKED_12)
@pytest.mark.parametrize("bits", [8, 10])
def test_samples_of_fewer_bits_than_their_file_has_tell_its_packing_by_the_bits_that_are_zero(
    tmp_path, written_as, read_as, bits
):
    """Of a smooth scene without noise, pixels that are mixed up are alike all the same."""
    values = scene(bits, noise=0.5) << (12 - bits)
    path = written(tmp_path, pack(values, pixel_format_named(written_as)))
    if read_as == written_as:
        np.testing.assert_array_equal(read_headerless(path, layout(read_as, (160, 96)))[0], values)
    else:
        with pytest.raises(InvalidInput, match=rf"--format {pixel_format_named(written_as).name} fits"):
            read_headerless(path, layout(read_as, (160, 96)))


@pytest.mark.parametrize("written_as", PACKED_12)
@pytest.mark.parametrize("largest", [3, 15, 16, 255, 511])
def test_dark_frames_are_read_though_their_highest_bits_are_zero(tmp_path, written_as, largest):
    values = (scene(noise=8.0) / 4095 * largest).astype(np.uint16)
    path = written(tmp_path, pack(values, pixel_format_named(written_as)))
    np.testing.assert_array_equal(read_headerless(path, layout(written_as, (160, 96)))[0], values)


def test_samples_of_sixteen_bits_in_the_other_byte_order_are_refused(tmp_path):
    path = written(tmp_path, pack(scene(16, noise=30.0), pixel_format_named("BayerRG16"), endian="big"))
    with pytest.raises(InvalidInput, match="unlike each other; --endian big fits"):
        read_headerless(path, layout("BayerRG16", (160, 96)))
    assert read_headerless(path, layout("BayerRG16", (160, 96), endian="big"))[0].max() > 40_000


@pytest.mark.parametrize(
    ("likeness", "other", "refused"), [(0.29, 0.61, True), (0.6, 0.75, True), (0.6, 0.72, False), (0.975, 1.0, False)]
)
def test_pixels_are_mixed_up_if_another_order_leaves_less_than_two_thirds_of_the_roughness(
    tmp_path, likeness, other, refused, monkeypatch
):
    path = written(tmp_path, pack(scene(), pixel_format_named("BayerRG12Packed")))
    found = iter([likeness, 0.0, other, other])  # of the format that is given, then of the others
    monkeypatch.setattr(headerless, "_likeness", lambda values: next(found))
    if refused:
        with pytest.raises(InvalidInput, match=r"alike|unlike each other"):
            read_headerless(path, layout("BayerRG12p", (160, 96)))
    else:
        read_headerless(path, layout("BayerRG12p", (160, 96)))
