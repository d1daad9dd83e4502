"""Bags as ROS writes them, by rosbags' own writers: images, compressed ones and camera_info with their time stamps."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

STEP_NS = 33_333_333
START_NS = 1_700_000_000_123_456_789
KINDS = ("bag", "db3", "mcap")
_STORES = {True: get_typestore(Stores.ROS1_NOETIC), False: get_typestore(Stores.LATEST)}
_CODES = {
    "rgb8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_BGR2RGBA,
    "bgra8": cv2.COLOR_BGR2BGRA,
    "mono8": cv2.COLOR_BGR2GRAY,
}


def write_bag(
    folder: Path, kind: str, topics: Mapping[str, Iterable[Any]], offset_ns: int = 0, stamped: bool = True
) -> Path:
    """Write messages of topics and return the bag: a file for ROS 1, a folder for ROS 2.

    topics: messages as (type, fields), the fields without the header; messages of one place in their topics have one
    time. They are recorded offset_ns after their stamps, which are 0 where they are not stamped.
    """
    first = kind == "bag"
    store = _STORES[first]
    path = folder / ("run.bag" if first else f"run_{kind}")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = rosbag1.Writer(path) if first else rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with writer:
        streams, connections = {name: iter(messages) for name, messages in topics.items()}, {}
        index = 0
        while streams:
            for name, stream in list(streams.items()):
                told = next(stream, None)
                if told is None:
                    del streams[name]
                    continue
                message_type, fields = told
                if name not in connections:
                    connections[name] = writer.add_connection(name, message_type, typestore=store)
                stamp_ns = START_NS + index * STEP_NS
                message = made(message_type, fields, stamp_ns if stamped else 0, first=first)
                data = (store.serialize_ros1 if first else store.serialize_cdr)(message, message_type)
                writer.write(connections[name], stamp_ns + offset_ns, data)
            index += 1
    return path


def made(message_type: str, fields: Mapping[str, Any], stamp_ns: int, *, first: bool) -> Any:
    """Return a message with a header; first: of ROS 1."""
    types = _STORES[first].types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    header = {"stamp": stamp, "frame_id": "camera", **({"seq": 0} if first else {})}
    return types[message_type](header=types["std_msgs/msg/Header"](**header), **fields)


def image(pixels: np.ndarray, encoding: str, padding: int = 0, big: bool = False) -> tuple[str, dict[str, Any]]:
    """Return an Image of pixels as its encoding has them; padding: bytes after each row."""
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")))
    rows = rows.view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    height, width = pixels.shape[:2]
    told = {"height": height, "width": width, "encoding": encoding, "is_bigendian": int(big), "step": rows.shape[1]}
    return "sensor_msgs/msg/Image", {**told, "data": rows.ravel()}


def encoded(bgr: np.ndarray, encoding: str) -> tuple[str, dict[str, Any]]:
    """Return an Image of a colour image (H, W, 3) in an encoding of 8 bits."""
    return image(cv2.cvtColor(bgr, _CODES[encoding]) if encoding in _CODES else bgr, encoding)


def compressed(pixels: np.ndarray, kind: str, words: str = "") -> tuple[str, dict[str, Any]]:
    """Return a CompressedImage; kind: png or jpg. words: its format."""
    data = cv2.imencode(f".{kind}", pixels)[1].ravel()
    return "sensor_msgs/msg/CompressedImage", {"format": words or kind, "data": data}


def camera_info(
    size: tuple[int, int], K: np.ndarray, D: np.ndarray, model: str = "plumb_bob", *, first: bool = False
) -> tuple[str, dict[str, Any]]:
    """Return the CameraInfo of a camera that is not rectified; first: of ROS 1."""
    width, height = size
    region = _STORES[first].types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
    matrices = {"D": D, "K": K.ravel(), "R": np.eye(3).ravel(), "P": np.column_stack([K, np.zeros(3)]).ravel()}
    named = {name if first else name.lower(): np.asarray(each, float) for name, each in matrices.items()}
    told = {"height": height, "width": width, "distortion_model": model, "binning_x": 0, "binning_y": 0, "roi": region}
    return "sensor_msgs/msg/CameraInfo", {**told, **named}
