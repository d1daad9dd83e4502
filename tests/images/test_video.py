"""Reading videos frame by frame."""

import cv2
import numpy as np
import pytest

from camcal.errors import FileError
from camcal.images.video import frames


@pytest.fixture
def video(tmp_path):
    """An AVI file of 20 gray frames, each 10 levels brighter than the one before."""
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (320, 240))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for level in range(20):
        writer.write(np.full((240, 320, 3), 10 * level, np.uint8))
    writer.release()
    return path


def test_frames_come_in_order(video):
    found = list(frames(video))
    assert [image.size for image in found] == [(320, 240)] * 20
    np.testing.assert_allclose([image.pixels.mean() for image in found], np.arange(0, 200, 10), atol=2)  # MJPG
    assert {image.orientation for image in found} == {1}


def test_a_video_that_is_cut_off_gives_its_frames_and_says_so(video):
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    seen = []
    with pytest.raises(FileError, match=r"video\.avi: ends after \d+ of 20 frames"):
        seen.extend(frame.size for frame in frames(video))
    assert 0 < len(seen) < 18


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "is empty"), (b"Dear diary", "not a readable video, or truncated"), (None, "no such")]
)
def test_what_is_no_video_is_refused(tmp_path, content, words):
    path = tmp_path / "video.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=words):
        next(frames(path))
