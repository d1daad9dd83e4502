"""What stands for a video: a file by its suffix, or an image topic of a bag by the path BAG#TOPIC.

A bag without a topic stands for the one that it has with images, see `bag`.
"""

from contextlib import suppress
from pathlib import Path

BAG_SUFFIXES = frozenset({".bag", ".db3", ".mcap"})
SUFFIXES = BAG_SUFFIXES | {".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm", ".mjpeg", ".mjpg"}

_METADATA, _SIGN = "metadata.yaml", b"rosbag2_bagfile_information"
_HEAD = 4096  # bytes


def is_video(path: Path) -> bool:
    """Return whether a path stands for a video: by its suffix, or as a bag or one of its topics."""
    return path.suffix.lower() in SUFFIXES or address_of(path) is not None


def file_of(path: Path) -> Path:
    """Return the file with the frames of a video: itself, or the bag of a topic."""
    return (address_of(path) or (path, ""))[0]


def title(path: Path) -> str:
    """Return how messages name a video: the name of its file, with a topic."""
    bag_and_topic = address_of(path)
    return f"{bag_and_topic[0].name}#{bag_and_topic[1]}" if bag_and_topic else path.name


def address_of(path: Path) -> tuple[Path, str] | None:
    """Return the bag and the topic of a path, the topic empty where it is of a bag alone; None for any other path."""
    if _is_bag(path):
        return path, ""
    head, mark, topic = path.as_posix().partition("#")
    bag = Path(head)
    return (bag, f"/{topic.lstrip('/')}" if topic else "") if mark and head and _is_bag(bag) else None


def _is_bag(path: Path) -> bool:
    """Return whether a path is named as a bag, or is a folder of ROS 2 with one."""
    if path.suffix.lower() in BAG_SUFFIXES:
        return True
    with suppress(OSError), (path / _METADATA).open("rb") as stream:
        return _SIGN in stream.read(_HEAD)
    return False
