"""Image topics of bags as videos: messages written by rosbags' own writers, and files that are no such thing."""

import struct
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from bags import KINDS, START_NS, STEP_NS, camera_info, compressed, encoded, image, write_bag

from camcal import opencv
from camcal.errors import FileError, InvalidInput
from camcal.images import bag, video

TOPIC = "/camera/image_raw"


@pytest.fixture
def gray():
    return np.random.default_rng(3).integers(0, 256, (24, 36), np.uint8)


@pytest.fixture
def colour():
    """Return an image whose colours change slowly, as those between which YUV 4:2:2 and JPEG take the mean."""
    x, y = np.meshgrid(np.arange(36), np.arange(24))
    return np.stack([4 * x + 40, 5 * y + 90, 200 - 3 * x], axis=-1).astype(np.uint8)


def topic_of(path, name=TOPIC):
    return bag.addressed(Path(f"{path}#{name}"))


def only(folder, message, kind="mcap"):
    [found] = list(video.frames(topic_of(write_bag(folder, kind, {TOPIC: [message]}))))
    return found.pixels


@pytest.mark.parametrize("kind", KINDS)
def test_frames_and_times_of_a_topic_come_in_order(tmp_path, gray, kind):
    other = [image(np.zeros((8, 9), np.uint8), "mono8")] * 4
    path = write_bag(tmp_path, kind, {TOPIC: [image(gray + n, "mono8") for n in range(3)], "/other": other}, 10**9)
    for each in [path] if kind == "bag" else [path, next(path.glob(f"*.{kind}"))]:
        topic = topic_of(each, "camera/image_raw")
        assert topic.as_posix() == f"{each.as_posix()}#{TOPIC}"
        assert [frame.pixels.tolist() for frame in video.frames(topic)] == [(gray + n).tolist() for n in range(3)]
        told = np.array([START_NS + n * STEP_NS for n in range(3)]) / 1e9
        assert np.abs(video.stamps(topic) - told).max() < 3e-7  # float64 of seconds since 1970
        with pytest.raises(
            InvalidInput, match=r"2 image topics, /camera/image_raw \(3 of 36x24\), /other \(4 of 9x8\)"
        ):
            bag.addressed(each)


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_is_found_by_its_number(tmp_path, gray, kind):
    path = write_bag(tmp_path, kind, {TOPIC: [image(gray + n, "mono8") for n in range(5)], "/other": []})
    topic = bag.addressed(path)
    assert bag.count(topic) == 5
    for number in (3, 0, 4):
        found, pattern = bag.mosaic(Path(video.frame_name(topic, number)))
        assert (found.pixels.tolist(), pattern) == ((gray + number).tolist(), "")


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8", "rgba8", "bgra8", "8UC3"])
def test_colours_come_in_the_order_blue_green_red(tmp_path, colour, encoding, kind):
    found = only(tmp_path, encoded(colour, encoding), kind)
    expected = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY) if encoding == "mono8" else colour
    assert np.array_equal(found[..., :3] if found.ndim == 3 else found, expected)
    assert found.ndim == 2 or found.shape[2] == (4 if "a" in encoding else 3)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_sixteen_bits_are_read_in_either_byte_order_without_what_pads_rows(tmp_path, encoding, big):
    deep = np.random.default_rng(4).integers(0, 65536, (7, 11), np.uint16)
    found = only(tmp_path, image(deep, encoding, padding=6, big=big))
    assert found.dtype == np.uint16
    assert np.array_equal(found, deep)


@pytest.mark.parametrize("pattern", ["RGGB", "GRBG", "GBRG", "BGGR"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bayer_messages_are_demosaiced(tmp_path, colour, pattern, dtype):
    scale = 257 if dtype == np.uint16 else 1
    values = np.zeros(colour.shape[:2], dtype)
    for place, letter in enumerate(pattern):
        at = slice(place // 2, None, 2), slice(place % 2, None, 2)
        values[at] = colour[(*at, "BGR".index(letter))].astype(dtype) * scale
    message = image(values, f"bayer_{pattern.lower()}{8 * values.itemsize}")
    found = only(tmp_path, message)
    assert np.array_equal(found, opencv.demosaiced(values, opencv.BILINEAR[pattern]))
    inside = found[2:-2, 2:-2].astype(float) / scale - colour[2:-2, 2:-2]
    assert np.abs(inside).max() <= 1  # colours change at an even rate
    kept, told = bag.mosaic(Path(video.frame_name(bag.addressed(tmp_path / "run_mcap"), 0)))
    assert (told, np.array_equal(kept.pixels, values)) == (pattern, True)


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")])
def test_two_pixels_share_their_colour_in_yuv_422(tmp_path, colour, encoding, order):
    """The numbers of ITU-R BT.601 with 8 bits, from 16 on; 4 levels are its rounding and the shared colours."""
    b, g, r = np.moveaxis(colour.astype(float), -1, 0)
    y = 16 + 0.257 * r + 0.504 * g + 0.098 * b
    u, v = 128 - 0.148 * r - 0.291 * g + 0.439 * b, 128 + 0.439 * r - 0.368 * g - 0.071 * b
    shared = {"u": (u[:, ::2] + u[:, 1::2]) / 2, "v": (v[:, ::2] + v[:, 1::2]) / 2}
    packed = np.zeros((24, 18, 4), np.uint8)
    ys = iter((y[:, ::2], y[:, 1::2]))
    for place, letter in enumerate(order):
        packed[..., place] = np.rint(next(ys) if letter == "y" else shared[letter])
    found = only(tmp_path, image(packed.reshape(24, 36, 2), encoding))
    assert np.abs(found.astype(int) - colour).max() <= 6


def test_compressed_images_are_those_that_were_compressed(tmp_path, gray, colour):
    assert np.array_equal(only(tmp_path, compressed(gray, "png", "mono8; png compressed ")), gray)
    for number, words in enumerate(["png", "rgb8; png compressed bgr8"]):
        (tmp_path / f"{number}").mkdir()
        assert np.array_equal(only(tmp_path / f"{number}", compressed(colour, "png", words)), colour)
    (tmp_path / "jpeg").mkdir()
    found = only(tmp_path / "jpeg", compressed(colour, "jpg", "bgr8; jpeg compressed bgr8"), "bag")
    assert np.abs(found.astype(int) - colour).max() < 12
    (tmp_path / "swapped").mkdir()
    assert np.array_equal(
        only(tmp_path / "swapped", compressed(colour[..., ::-1], "png", "rgb8; png compressed rgb8")), colour
    )
    (tmp_path / "bayer").mkdir()
    found = only(tmp_path / "bayer", compressed(gray, "png", "bayer_rggb8; png compressed "))
    assert np.array_equal(found, opencv.demosaiced(gray, opencv.BILINEAR["RGGB"]))


def test_without_a_time_in_the_header_the_time_of_recording_counts(tmp_path, gray):
    path = write_bag(tmp_path, "mcap", {TOPIC: [image(gray, "mono8")] * 3}, 5 * 10**8, stamped=False)
    told = np.array([START_NS + 5 * 10**8 + n * STEP_NS for n in range(3)]) / 1e9
    assert np.abs(video.stamps(bag.addressed(path)) - told).max() < 3e-7


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (image(np.zeros((4, 6, 2), np.float32), "32FC2"), "images of encoding '32FC2' are not read"),
        (compressed(np.zeros((4, 6), np.uint16), "png", "16UC1; compressedDepth png"), "of depth"),
        (
            ("sensor_msgs/msg/CompressedImage", {"format": "jpeg", "data": np.arange(9, dtype=np.uint8)}),
            "unknown image",
        ),
    ],
)
def test_messages_that_are_no_images_are_named(tmp_path, message, words):
    path = write_bag(tmp_path, "mcap", {TOPIC: [message]})
    with pytest.raises(FileError, match=words) as caught:
        list(video.frames(bag.addressed(path)))
    assert TOPIC.removesuffix("_raw") in str(caught.value)


def test_an_image_with_fewer_bytes_than_it_needs_is_damaged(tmp_path, gray):
    kind, fields = image(gray, "mono8")
    for changes in ({"data": fields["data"][:-1]}, {"step": 35}, {"width": 0}, {"height": 10**9, "width": 10**9}):
        folder = tmp_path / "_".join(changes)
        folder.mkdir()
        path = write_bag(folder, "mcap", {TOPIC: [(kind, {**fields, **changes})]})
        with pytest.raises(FileError, match=r"damaged|million pixels"):
            list(video.frames(bag.addressed(path)))


def test_bags_without_images_say_what_they_hold(tmp_path):
    info = camera_info((4, 3), np.eye(3), np.zeros(5))
    path = write_bag(tmp_path, "mcap", {"/camera_info": [info]})
    with pytest.raises(FileError, match=r"holds no images of ROS \(sensor_msgs/msg/CameraInfo\)"):
        bag.addressed(path)
    with pytest.raises(FileError, match="no such file"):
        bag.addressed(tmp_path / "none.bag")


def test_messages_of_foxglove_are_named(tmp_path):
    """An MCAP file of another profile, whose records rosbags does not read."""

    def text(words):
        return struct.pack("<I", len(words)) + words

    def record(kind, content):
        return struct.pack("<BQ", kind, len(content)) + content

    schema = struct.pack("<H", 1) + text(b"foxglove.CompressedImage") + text(b"protobuf") + text(b"")
    magic = b"\x89MCAP0\r\n"
    footer = record(2, struct.pack("<QQI", 0, 0, 0))
    for profile in (b"", b"ros2"):
        path = tmp_path / f"f{len(profile)}.mcap"
        channel = struct.pack("<HH", 1, 1) + text(b"/camera") + text(b"protobuf") + text(b"")
        header = record(1, text(profile) + text(b"test"))
        path.write_bytes(magic + header + record(3, schema) + record(4, channel) + footer + magic)
        with pytest.raises(
            FileError, match=r"foxglove.CompressedImage messages, which are not read: record or convert"
        ):
            bag.addressed(path)


def frame_of(path):
    return Path(video.frame_name(path, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bags_end_with_one_line(tmp_path, gray, kind):
    """Cut off anywhere, and with bytes changed anywhere: frames or an error of the file, nothing else."""
    path = write_bag(tmp_path, kind, {TOPIC: [image(gray, "mono8")] * 2})
    path = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    content = path.read_bytes()
    rng = np.random.default_rng(1)
    damaged = tmp_path / f"damaged.{kind}"
    cut = [content[: int(end)] for end in rng.integers(1, len(content), 40)]
    changed = [bytearray(content) for _ in range(120)]
    for each in changed:
        for place in rng.integers(0, len(each), rng.integers(1, 30)):
            each[place] = rng.integers(256)
    refused = []
    for each in [*cut, *changed]:
        damaged.write_bytes(each)
        for read in (lambda path: list(video.frames(path)), video.stamps, lambda path: bag.mosaic(frame_of(path))):
            try:
                read(bag.addressed(damaged))
            except (FileError, InvalidInput) as error:
                refused.append(str(error))
    assert len(refused) > 40
    assert all(len(words.splitlines()) == 1 for words in refused)


def test_rosbags_is_imported_for_bags_only():
    code = "import sys, camcal.images.video, camcal.run.paths; print('rosbags' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_without_rosbags_the_extra_is_named(tmp_path, gray, monkeypatch):
    path = write_bag(tmp_path, "bag", {TOPIC: [image(gray, "mono8")]})
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InvalidInput, match=r"run.bag: bags need the extra \[bags\]: pip install 'camcal\[bags\]'"):
        bag.addressed(path)
