"""When frames were taken: every source of times, and what is said where they are wrong."""

import struct

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.images import video
from camcal.images.exif import insert_exif
from camcal.images.video import frame_name
from camcal.progress import Silent
from camcal.tasks.poses.frame_times import Timing, frame_times

FRAMES = ["a/img_0010.png", "a/img_0011.png", "a/img_0013.png"]


class Listener(Silent):
    def __init__(self):
        self.warnings = []

    def warn(self, message):
        self.warnings.append(message)


def times(timing, frames=FRAMES, videos=(), progress=None):
    return frame_times(frames, videos, timing, progress or Listener())


@pytest.fixture(scope="module")
def video_path(tmp_path_factory):
    """A video of five frames at 20 a second."""
    path = tmp_path_factory.mktemp("video") / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for level in range(5):
        writer.write(np.full((48, 64, 3), 40 * level, np.uint8))
    writer.release()
    return path


def test_a_rate_counts_frames_and_warns_where_names_have_holes():
    listener = Listener()
    np.testing.assert_allclose(times(Timing(fps=10.0), progress=listener), [0.0, 0.1, 0.2])
    assert listener.warnings[0].code == "missing_frame_numbers"


def test_names_tell_times_or_with_a_rate_frames():
    np.testing.assert_allclose(times(Timing(source="name", unit="ms")), [0.010, 0.011, 0.013])
    np.testing.assert_allclose(times(Timing(fps=10.0, source="name")), [1.0, 1.1, 1.3])
    named = ["t1.5_cam2.png", "t1.75_cam2.png"]
    np.testing.assert_allclose(times(Timing(source=r"name:t(\d+\.\d+)"), named), [1.5, 1.75])


def test_nanoseconds_in_names_stay_apart():
    names = ["1403636579763555584.png", "1403636579813555456.png"]
    assert np.diff(times(Timing(source="name", unit="ns"), names))[0] == pytest.approx(0.05, abs=1e-6)  # double


@pytest.mark.parametrize(
    "text",
    [
        "0.1\n0.2\n0.4\n",
        "# t name\n0.4 img_0013.png\n0.1 a/img_0010.png\n0.2 img_0011.png\n",
        "image,t\nimg_0010.png,0.1\nimg_0011.png,0.2\nimg_0013.png,0.4\n",
    ],
)
def test_a_file_of_times_goes_by_order_or_by_names(tmp_path, text):
    path = tmp_path / "times.txt"
    path.write_text(text)
    np.testing.assert_allclose(times(Timing(source=str(path))), [0.1, 0.2, 0.4])


def test_a_video_has_its_own_times(video_path):
    np.testing.assert_allclose(video.stamps(video_path), np.arange(5) / 20, atol=1e-9)
    frames = [frame_name(video_path, number) for number in (0, 1, 3)]
    np.testing.assert_allclose(times(Timing(), frames, [video_path]), [0.0, 0.05, 0.15], atol=1e-9)


def test_a_stream_of_pictures_has_none(video_path, tmp_path):
    bare = tmp_path / "video.mjpeg"
    bare.write_bytes(video_path.read_bytes())
    assert video.stamps(bare) is None
    with pytest.raises(InvalidInput, match="No timestamps in the video; set --fps"):
        times(Timing(), [frame_name(bare, 0)], [bare])


def photograph(path, taken, fraction):
    """Write an image whose EXIF says when it was taken."""
    texts = [text.encode() + b"\0" for text in (taken, fraction)]
    places = 8 + 2 + 12 + 4, 8 + 2 + 12 + 4 + 2 + 24 + 4
    directory = struct.pack("<HHHIII", 1, 0x8769, 4, 1, places[0], 0)
    entries = struct.pack("<HHHII", 2, 0x9003, 2, len(texts[0]), places[1])
    entries += struct.pack("<HHI", 0x9291, 2, len(texts[1])) + texts[1].ljust(4, b"\0") + bytes(4)
    block = b"II*\0" + struct.pack("<I", 8) + directory + entries + texts[0]
    _, content = cv2.imencode(".jpg", np.zeros((16, 16), np.uint8))
    path.write_bytes(insert_exif(content.tobytes(), block))
    return str(path)


def test_exif_tells_times_to_the_fraction_of_a_second(tmp_path):
    frames = [
        photograph(tmp_path / f"{index}.jpg", taken, fraction)
        for index, (taken, fraction) in enumerate([("2024:05:01 10:00:59", "75"), ("2024:05:01 10:01:00", "25")])
    ]
    assert np.diff(times(Timing(source="exif"), frames)) == pytest.approx([0.5], abs=1e-6)


def test_images_without_a_time_in_their_exif_are_named(tmp_path):
    cv2.imwrite(str(tmp_path / "a.jpg"), np.zeros((16, 16), np.uint8))
    with pytest.raises(InvalidInput, match=r"a\.jpg: no time in EXIF"):
        times(Timing(source="exif"), [str(tmp_path / "a.jpg")])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0.1\n0.2\n", "2 times for 3 frames"),
        ("0.1\nsoon\n0.3\n", "times.txt:2: 'soon' is not a time"),
        ("0.1\n0.1\n0.3\n", "0011.png: 0.1 s is the time of the frame before"),
        ("0.3\n0.1\n0.4\n", "0011.png: 0.1 s is a time before the frame before"),
        ("0.1\nnan\n0.3\n", "times.txt:2: a time of nan s"),
        ("0.1\n0.2\n1e13\n", "times.txt:3: a time of 1e+13 s"),
        ("0.1 img_0010.png\n0.2 img_0011.png\n0.3 x.png\n", "has no time of img_0013.png"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_with_its_place(tmp_path, text, words):
    path = tmp_path / "times.txt"
    path.write_text(text)
    with pytest.raises(InvalidInput) as caught:
        times(Timing(source=str(path)))
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Timing(fps=0.0), "--fps must be more than 0"),
        (lambda: Timing(unit="min"), "'--time-unit': 'min' is not one of s, ms, us, ns"),
        (lambda: Timing(fps=30.0, source="exif"), "are redundant, except with frame numbers in names"),
        (lambda: times(Timing()), "unknown times of the frames: set --fps, or --timestamps with a file, name or exif"),
        (lambda: times(Timing(source="name:img")), "put the number in parentheses"),
        (lambda: times(Timing(source="name:(")), "invalid regular expression"),
        (lambda: times(Timing(source="name:shot(\\d+)")), "has no time in its name"),
    ],
)
def test_sources_that_say_nothing_are_refused(make, words):
    with pytest.raises(InvalidInput) as caught:
        make()
    assert words in str(caught.value)
