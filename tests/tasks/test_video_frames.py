"""Frames of videos with a known truth: which are searched and taken, where their corners are, and the same every time.

The videos are rendered; a moving frame is the mean over the way of the board while the shutter is open, and MJPG
compresses them.
"""

import re
import shutil
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from moving_board import between

from camcal.calibrate.frames import BLURRED, MOVING
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import detections
from camcal.images.video import frame_name
from camcal.progress import SILENT
from camcal.raw.options import ImageReadOptions
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import Board, parse_board
from camcal.tasks.calibration.board_views import board_views
from camcal.tasks.calibration.detect import detect_images, document
from camcal.tasks.calibration.options import DetectOptions, FrameOptions
from camcal.tasks.calibration.video_frames import survey

BOARD = Board("chessboard", 7, 4, 0.03)
CHARUCO = parse_board("charuco:7x5:40mm:30mm:DICT_4X4_50")
SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([420.0, 420, 239.5, 179.5]))
STOPS = 4
REST, MOVE = 2, 1  # frames at a stop, and on the way to the next one
OPEN = 0.1  # of the time from frame to frame the shutter is open
STEPS = 7  # pictures of which a moving frame is the mean


@dataclass(frozen=True)
class Shot:
    """A video, the poses of its frames in mid exposure (None: no board), and which of them are moving."""

    path: object
    poses: tuple
    moving: tuple

    def pixels(self, number, board=BOARD):
        return CAMERA.project(self.poses[number].apply(board.points())).pixels

    def name(self, number):
        return frame_name(self.path, number)


def shoot(path, board=BOARD, count=STOPS, seed=1):
    """Write a video in which a board rests at several places; two frames in the end show a wall."""
    rng = np.random.default_rng(seed)
    stops = views(CAMERA, board, count, rng=rng, max_tilt=np.radians(35))
    exposure = Exposure(noise_dn=1.0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, SIZE)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    poses, moving = [], []
    for first, last in pairwise([*stops, stops[0]]):
        resting = render(CAMERA, board, first, rng=rng, exposure=exposure)
        for _ in range(REST):
            poses.append(first)
            writer.write(cv2.merge([resting] * 3))
        for step in range(MOVE):
            shares = (step + 1 + OPEN * np.linspace(-0.5, 0.5, STEPS)) / (MOVE + 1)
            way = [render(CAMERA, board, between(first, last, share), rng=rng, exposure=exposure) for share in shares]
            poses.append(between(first, last, shares[STEPS // 2]))
            writer.write(cv2.merge([np.mean(way, axis=0).astype(np.uint8)] * 3))
        moving += [False] * REST + [True] * MOVE
    for _ in range(2):
        writer.write(np.full((SIZE[1], SIZE[0], 3), 110, np.uint8))
    writer.release()
    return Shot(path, (*poses, None, None), (*moving, False, False))


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    return shoot(tmp_path_factory.mktemp("video") / "video.avi")


@pytest.fixture(scope="module")
def report(shot):
    """What is found in the video as by default."""
    return found(shot.path)


def found(*inputs, board=BOARD, jobs=1, **options):
    return detect_images(DetectOptions(inputs, board, jobs=jobs, **options))


def test_resting_frames_are_taken_and_moving_ones_are_not(shot, report):
    records = {record.view.image: record for record in report.frames}
    assert list(records) == [shot.name(number) for number in range(len(shot.poses))]
    shaken = [records[shot.name(number)] for number in np.flatnonzero(shot.moving)]
    assert any(record.view.found for record in shaken)
    assert {record.choice.why for record in shaken if record.view.found} <= {BLURRED, MOVING}
    taken = [number for number in range(len(shot.poses)) if records[shot.name(number)].taken]
    assert [view.image for view in report.detections.views] == [shot.name(number) for number in taken]
    assert sorted(number // (REST + MOVE) for number in taken) == list(range(STOPS))  # one of every stop


def test_corners_of_frames_are_where_the_truth_has_them(shot, report):
    names = {shot.name(number): number for number in range(len(shot.poses))}
    for view in report.detections.views:
        away = view.pixels - shot.pixels(names[view.image])[view.ids]
        assert len(view.ids) == BOARD.count
        assert np.sqrt(np.mean(away**2)) < 0.1  # MJPG moves edges by some hundredths of a pixel


def test_blur_and_motion_of_frames_are_told(shot, report):
    records = report.frames
    blurs = np.array([record.view.blur_px for record in records])
    resting = np.array([number % (REST + MOVE) == 1 for number in range(len(records))])
    resting[-2:] = False
    assert np.isnan(records[0].view.motion_px)  # there is no frame before it
    assert max(record.view.motion_px for record, rests in zip(records, resting, strict=True) if rests) < 0.1
    assert np.nanmax(blurs[resting]) < 1.0  # rendered with 0.7 px
    assert np.nanmin(blurs[np.array(shot.moving)]) > 1.2 * np.nanmax(blurs[resting])


@pytest.mark.slow
def test_the_choice_is_the_same_whatever_the_number_of_jobs(shot, tmp_path):
    for jobs in (1, 2):
        found(shot.path, jobs=jobs, output=tmp_path / f"{jobs}.csv", frames=FrameOptions(3, every=2))
    content = (tmp_path / "1.csv").read_bytes()
    assert content == (tmp_path / "2.csv").read_bytes()
    assert len(detections.read(tmp_path / "1.csv").views) == 3


def test_all_frames_are_taken_if_asked_for(shot):
    report = found(shot.path, frames=FrameOptions(every=2, whole=True))
    numbers = range(0, len(shot.poses), 2)
    assert [view.image for view in report.detections.views] == [shot.name(number) for number in numbers]
    assert report.detections.views[-1].reason
    assert all(record.taken == record.view.found for record in report.frames)


def test_every_kth_frame_is_looked_at_if_asked_for(shot):
    looked = found(shot.path, frames=FrameOptions(every=4)).frames
    assert [record.view.image for record in looked] == [shot.name(number) for number in (0, 4, 8, 12)]
    assert [record.view.found for record in looked] == [True, True, True, False]


def test_of_a_long_video_the_sharpest_frame_of_every_stretch_is_searched(shot):
    """One frame is chosen of eight, which leaves one of every two neighbours in a video of fourteen."""
    video = survey(shot.path, FrameOptions(1), SILENT)
    assert video.count == len(shot.poses)
    assert len(video.numbers) == 8
    assert list(video.numbers) == sorted(set(video.numbers))
    assert sum(shot.moving[number] for number in video.numbers) < sum(shot.moving)


def test_the_line_about_a_video_counts_its_frames(report):
    [line] = [line for line in report.lines if line.startswith("video.avi")]
    assert re.match(r"video\.avi: 4 of 14 frames used; 14 searched, 1\d with the board, \d like these, ", line)


def test_images_and_frames_stand_side_by_side(shot, tmp_path):
    resting = render(CAMERA, BOARD, shot.poses[0], rng=np.random.default_rng(0))
    cv2.imwrite(str(tmp_path / "photo.png"), resting)
    report = found(shot.path, tmp_path, frames=FrameOptions(2))
    images = [view.image for view in report.detections.views]
    assert len(images) == 3
    assert images[0] == f"{tmp_path}/photo.png"
    assert report.used == 3


def test_frames_of_another_size_than_most_images_are_not_taken(shot, tmp_path):
    small = cv2.resize(render(CAMERA, BOARD, shot.poses[0], rng=np.random.default_rng(0)), (320, 240))
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"{number}.png"), small)
    report = found(shot.path, tmp_path, frames=FrameOptions(every=10))
    assert report.used == 12
    assert not any(record.taken for record in report.frames)
    assert report.frames[0].reason == "is 480x360, most images are 320x240"


def test_a_video_that_is_cut_off_gives_its_frames_and_is_one_of_those_that_failed(shot, tmp_path):
    cut = tmp_path / "cut.avi"
    cut.write_bytes(shot.path.read_bytes()[: shot.path.stat().st_size // 2])
    report = found(cut)
    assert report.used > 0
    [failed] = report.failed
    assert "ends after" in failed


def test_a_video_that_is_none_is_an_error(tmp_path):
    (tmp_path / "video.mp4").write_bytes(b"no video")
    with pytest.raises(FileError, match="not a readable video, or truncated"):
        found(tmp_path / "video.mp4")


def test_videos_whose_frames_would_have_one_name_are_refused(shot, tmp_path):
    for suffix in (".avi", ".mkv"):
        shutil.copy(shot.path, tmp_path / f"a{suffix}")
    with pytest.raises(InvalidInput, match=r"a\.mkv: frame names would equal those of a\.avi; rename one"):
        found(tmp_path)


def test_a_board_that_is_in_no_frame_ends_with_advice(shot):
    with pytest.raises(InsufficientData, match="no chessboard of 9x8"):
        found(shot.path, board=Board("chessboard", 9, 8), frames=FrameOptions(every=12))


def test_the_arrangement_of_a_charuco_board_is_found_out_in_a_video(tmp_path):
    shot = shoot(tmp_path / "video.avi", replace(CHARUCO, legacy=False), count=2)
    exchanged = parse_board("charuco:5x7:40mm:30mm:DICT_4X4_50")
    report = found(shot.path, board=exchanged, frames=FrameOptions(2, every=4))
    assert (report.detections.board.columns, report.detections.board.rows) == (6, 4)
    assert [warning.code for warning in report.warnings] == ["board_size_differs"]


def test_a_video_is_no_raw_frame(shot):
    with pytest.raises(FileError, match="is a video, images are needed"):
        found(shot.path, reading=ImageReadOptions("RGGB"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"most": 0}, "'--max-frames': 0 is less than 1"),
        ({"every": -1}, "'--every': -1 is less than 1"),
        ({"most": 3, "whole": True}, "leave --max-frames out"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInput, match=message):
        FrameOptions(**options)


def test_a_calibration_sees_the_frames_that_are_chosen(shot):
    seen = board_views((str(shot.path),), BOARD, False, 1, SILENT, frames=FrameOptions(2, every=3))
    assert sum(record.taken for record in seen.frames) == 2
    assert len(seen.detections.views) == 2


def test_the_document_has_every_frame_that_was_searched(shot, report):
    told = document(report, None)["frames"]
    assert len(told) == len(shot.poses)
    best = next(frame for frame in told if frame["order"] == 1)
    assert best["taken"]
    assert best["reason"] == "adds most"
    assert set(best) == {"frame", "corners", "taken", "reason", "order", "blur_px", "motion_px", "error_px", "gain"}
    assert told[-1]["reason"] == "no chessboard found"
    assert [frame["taken"] for frame in told].count(True) == STOPS
