"""Image topics of recorded data as videos: ROS 1 bags, ROS 2 bags (folders, .db3) and MCAP, by the package rosbags.

A topic has the path BAG#TOPIC, such as run.mcap#/left/image_raw, which is taken wherever a video is. Messages are read
one by one in the order of the bag. Their times are those of their headers.
Source: ROS, sensor_msgs/Image and sensor_msgs/image_encodings; compressed_image_transport for the words of a format.
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput, reason
from camcal.images.files import load
from camcal.images.image import Image
from camcal.images.options import require_pixels
from camcal.images.videos import address_of, file_of
from camcal.urls import local

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_BAYER = re.compile(r"bayer_(rggb|bggr|gbrg|grbg)(8|16)\b")
_ENCODINGS = {  # channels, bytes of one, OpenCV's conversion to blue, green, red
    **dict.fromkeys(("mono8", "8UC1"), (1, 1, None)),
    **dict.fromkeys(("mono16", "16UC1"), (1, 2, None)),
    **dict.fromkeys(("bgr8", "8UC3"), (3, 1, None)),
    **dict.fromkeys(("bgr16", "16UC3"), (3, 2, None)),
    **dict.fromkeys(("bgra8", "8UC4"), (4, 1, None)),
    "rgb8": (3, 1, cv2.COLOR_RGB2BGR),
    "rgb16": (3, 2, cv2.COLOR_RGB2BGR),
    "rgba8": (4, 1, cv2.COLOR_RGBA2BGRA),
    **dict.fromkeys(("yuv422", "uyvy"), (2, 1, cv2.COLOR_YUV2BGR_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, 1, cv2.COLOR_YUV2BGR_YUYV)),
    **{f"bayer_{each}{bits}": (1, bits // 8, None) for each in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)},
}
_FOREIGN = re.compile(rb"foxglove(?:_msgs/msg/|\.)(?:Raw|Compressed)(?:Image|Video)")
_ENDS = 1 << 20  # bytes at either end of a file in which the names of message types are
_REPAIRS = {".bag": "rosbag reindex", ".mcap": "mcap recover"}
_Messages = Callable[..., Iterator[tuple[int, Any]]]


def addressed(path: Path) -> Path:
    """Return the path of the topic with images that a path stands for; any other path is itself.

    Raises InvalidInput for a bag with several, with all of them, and as `topics_of` does.
    """
    found = [path] if address_of(path) is None else topics_of(path)
    if len(found) == 1:
        return found[0]
    listed = ", ".join(f"{(address_of(each) or '')[1]} ({_in_words(each)})" for each in found)
    raise InvalidInput(f"holds {len(found)} image topics, {listed}: choose one, such as {found[0]}", where=str(path))


def topics_of(path: Path) -> list[Path]:
    """Return the paths of the topics with images that a bag holds, or of the one that is addressed.

    Raises InvalidInput for a topic without images, with those that have some; FileError for a bag without any.
    """
    bag, topic = address_of(path) or (path, "")
    with _open(bag) as (topics, _):
        images = [name for name, each in topics.items() if each.msgtype in (_IMAGE, _COMPRESSED)]
        if not images:
            kinds = ", ".join(sorted({str(each.msgtype) for each in topics.values()})) or "it is empty"
            raise FileError(f"holds no images of ROS ({kinds})", where=str(bag))
        if topic and topic not in images:
            what = f"topic {topic} has {topics[topic].msgtype}" if topic in topics else f"no topic {topic}"
            raise InvalidInput(f"{what}; with images: {', '.join(images)}", where=str(bag))
    return [Path(f"{bag}#{name}") for name in ([topic] if topic else images)]


def _in_words(topic: Path) -> str:
    """Return how many images a topic has and of which size."""
    try:
        return f"{count(topic)} of {'{}x{}'.format(*next(frames(topic)).size)}"
    except FileError as error:
        return error.message


@contextmanager
def _open(path: Path) -> Iterator[tuple[Mapping[str, Any], _Messages]]:
    """Give the topics of a bag, as rosbags has them, and what yields the messages of one from a time on, if there is
    one, each with the time at which it was recorded, ns.

    Raises InvalidInput if rosbags is not installed, FileError for what rosbags raises of damaged ones within the block.
    """
    if not path.exists() or not path.stat().st_size:
        raise FileError("is empty" if path.exists() else "no such file", where=str(path))
    try:
        from apsw import Error as SqliteError
        from rosbags import rosbag1, rosbag2
        from rosbags.rosbag2.reader import zstd  # type: ignore[attr-defined]
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise InvalidInput("bags need the extra [bags]: pip install 'camcal[bags]'", where=str(path)) from error
    is_first = path.suffix.lower() == ".bag"
    damage = (rosbag1.ReaderError, rosbag2.ReaderError, SerdeError, SqliteError, zstd.ZstdError, *_DAMAGE)
    try:
        with (rosbag1.Reader if is_first else rosbag2.Reader)(local(path)) as reader:
            store = get_typestore(Stores.ROS1_NOETIC if is_first else Stores.LATEST)
            topics = {f"/{name.lstrip('/')}": each for name, each in reader.topics.items()}
            decode = store.deserialize_ros1 if is_first else store.deserialize_cdr

            def messages(topic: str, from_ns: int | None = None) -> Iterator[tuple[int, Any]]:
                for connection, recorded_ns, content in reader.messages(topics[topic].connections, from_ns):
                    yield recorded_ns, decode(content, connection.msgtype)

            yield topics, messages
    except damage as error:
        raise _unreadable(path, error) from error


_DAMAGE = (  # what else rosbags and what it uses raise of damaged bags
    *(AssertionError, AttributeError, EOFError, LookupError, MemoryError, OSError, OverflowError, RuntimeError),
    *(TypeError, ValueError, struct.error),
)


def _unreadable(path: Path, error: Exception) -> FileError:
    """Return the error of a bag that rosbags does not read: of another program's messages, or damaged."""
    with suppress(OSError), local(path).open("rb") as stream:
        start = stream.read(_ENDS)
        stream.seek(max(0, stream.seek(0, 2) - _ENDS))
        if found := _FOREIGN.search(start + stream.read()):
            advice = "record or convert them to sensor_msgs/msg/Image or CompressedImage"
            return FileError(f"holds {found[0].decode()} messages, which are not read: {advice}", where=str(path))
    words = reason(error) if isinstance(error, OSError) else " ".join(str(error).split()).rstrip(".")
    repair = _REPAIRS.get(path.suffix.lower())
    advice = f"; '{repair}' may repair it" if repair else ""
    return FileError(f"not a readable bag, or truncated ({words or type(error).__name__}){advice}", where=str(path))


def frames(path: Path) -> Iterator[Image]:
    """Yield the images of a topic in the order of the bag; mosaics are demosaiced, by the mean of nearest samples.

    Raises FileError if the bag cannot be read, a message is no image or of an encoding that is not read, or there is
    none.
    """
    for _, message in _messages(path):
        image, pattern = _decoded(message, path), _pattern(message)
        yield Image(opencv.demosaiced(image.pixels, opencv.BILINEAR[pattern])) if pattern else image


def mosaic(frame: Path) -> tuple[Image, str]:
    """Return an image of a topic as it was recorded, and its Bayer pattern, empty for none; see `frames`.

    frame: its path, as `video.frame_name` makes it. Raises FileError as `frames` does.
    """
    path, number = frame.with_name(frame.name.rpartition("_")[0]), int(frame.name.rpartition("_")[2])
    times = _recorded_ns(path, file_of(path).stat().st_mtime_ns)
    if number >= len(times):
        raise FileError(f"ends after {len(times)} messages; the bag may be truncated", where=str(path))
    same = int(np.searchsorted(times[:number], times[number]))  # messages of that time come before it
    [message] = [message for _, message in islice(_messages(path, times[number]), number - same, number - same + 1)]
    return _decoded(message, path), _pattern(message)


@lru_cache(maxsize=4)
def _recorded_ns(path: Path, _changed_ns: int) -> tuple[int, ...]:
    return tuple(recorded_ns for recorded_ns, _ in _messages(path))


def count(path: Path) -> int:
    """Return how many images a topic has."""
    bag, topic = address_of(path) or (path, "")
    with _open(bag) as (topics, _):
        return int(topics[topic].msgcount)


def stamps(path: Path) -> Array:
    """Return the times (N,) s of a topic's images: of their headers, or at which they were recorded where these have
    none.
    """
    told = ((message.header.stamp, recorded_ns) for recorded_ns, message in _messages(path))
    both = np.array([(stamp.sec * 10**9 + stamp.nanosec, recorded_ns) for stamp, recorded_ns in told])
    return both[:, 0 if both[:, 0].any() else 1] / 1e9


def camera_infos(path: Path) -> list[tuple[str, Any]]:
    """Return the topics of a bag that have a sensor_msgs/CameraInfo, with the first of each; raises FileError."""
    with _open(path) as (topics, messages):
        names = [name for name, each in topics.items() if each.msgtype == _CAMERA_INFO]
        found = [(name, message) for name in names for _, message in islice(messages(name), 1)]
    if not found:
        raise FileError("holds no sensor_msgs/CameraInfo", where=str(path))
    return found


def _messages(path: Path, from_ns: int | None = None) -> Iterator[tuple[int, Any]]:
    bag, topic = address_of(path) or (path, "")
    found = False
    with _open(bag) as (topics, messages):
        for message in messages(topic, from_ns) if topic in topics else ():
            found = True
            yield message
    if not found:
        raise FileError("holds no messages", where=str(path))


def _pattern(message: Any) -> str:
    """Return the Bayer pattern of a message, empty for none; what a format was compressed from comes first in it."""
    told = _BAYER.match(getattr(message, "encoding", None) or message.format)
    return told[1].upper() if told and "compressed bgr" not in getattr(message, "format", "") else ""


def _decoded(message: Any, path: Path) -> Image:
    """Return the image of a message as it was recorded; raises FileError."""
    if not hasattr(message, "encoding"):
        return _decompressed(message, path)
    if message.encoding not in _ENCODINGS:
        raise FileError(f"images of encoding {message.encoding[:40]!r} are not read", where=str(path))
    channels, depth, code = _ENCODINGS[message.encoding]
    require_pixels((message.width, message.height), path)
    row = message.width * channels * depth
    step = message.step or row
    if step < row or len(message.data) < step * (message.height - 1) + row:
        words = f"{message.width}x{message.height} {message.encoding} in {len(message.data)} bytes, {step} a row"
        raise FileError(f"a damaged image: {words}", where=str(path))
    rows = np.ndarray((message.height, row), np.uint8, message.data, strides=(step, 1))
    kind = np.dtype("u1" if depth == 1 else ">u2" if message.is_bigendian else "<u2")
    pixels = np.ascontiguousarray(rows).view(kind).reshape(message.height, message.width, channels)
    pixels = pixels.astype(kind.newbyteorder("="), copy=False)
    return Image(pixels if code is None else np.asarray(cv2.cvtColor(pixels, code)))


def _decompressed(message: Any, path: Path) -> Image:
    if "compressedDepth" in message.format:
        raise FileError("images of depth (compressedDepth) are not read", where=str(path))
    image = load(path.with_suffix(""), content=bytes(message.data))
    # image_transport names what the channels were before compression, which takes them for blue, green, red
    if image.channels == 3 and "compressed rgb" in message.format:
        return Image(np.asarray(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2BGR)), image.orientation)
    return image
