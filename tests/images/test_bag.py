"""Image topics of bags as videos, written by rosbags' own writers."""

from pathlib import Path

import numpy as np
import pytest
from bags import KINDS, START_NS, STEP_NS, image, write_bag

from camcal.errors import InvalidInput
from camcal.images import bag, video

TOPIC = "/camera/image_raw"


@pytest.fixture
def gray():
    return np.random.default_rng(3).integers(0, 256, (24, 36), np.uint8)


def only(path):
    [found] = list(video.frames(path))
    return found.pixels


@pytest.mark.parametrize("kind", KINDS)
def test_frames_and_times_of_a_topic_come_in_order(tmp_path, gray, kind):
    other = [image(np.zeros((8, 9), np.uint8), "mono8")] * 4
    path = write_bag(tmp_path, kind, {TOPIC: [image(gray + n, "mono8") for n in range(3)], "/other": other}, 10**9)
    for each in [path] if kind == "bag" else [path, next(path.glob(f"*.{kind}"))]:
        topic = bag.addressed(Path(f"{each}#camera/image_raw"))
        assert topic.as_posix() == f"{each.as_posix()}#{TOPIC}"
        found = list(video.frames(topic))
        assert [frame.pixels.tolist() for frame in found] == [(gray + n).tolist() for n in range(3)]
        exact = [START_NS + n * STEP_NS for n in range(3)]
        assert np.abs(video.stamps(topic) - np.array(exact) / 1e9).max() < 3e-7  # float64 of seconds since 1970
        with pytest.raises(
            InvalidInput, match=r"2 image topics, /camera/image_raw \(3 of 36x24\), /other \(4 of 9x8\)"
        ):
            bag.addressed(each)
