"""Poses in words: units, places and counts as a person reads them."""

import numpy as np

from camcal.estimate.poses.records import Alternative
from camcal.formats.poses.record import PixelNoise, PoseKey, PoseRecord, Poses
from camcal.geometry.pose import Pose
from camcal.report import track_words

POSE = Pose.from_vector(np.array([0.0, 0.0, np.pi / 2]), np.array([0.1, -0.02, 0.7]))
RECORD = PoseRecord(POSE, 1e-6 * np.eye(6), np.zeros((6, 6)), "ok", 0.2, 0.5, 54, 54, tilt_rad=np.radians(38.2))


IMAGE = PoseKey("a.png")


def poses(record=RECORD, pose_key=IMAGE, unit="m", scale=None, dof=102):
    return Poses("camera_T_object", unit, PixelNoise(0.25, scale, dof), {pose_key: record})


def test_a_row_is_in_millimetres_and_degrees():
    found = poses()
    heads = [column.head for column in track_words.columns(found)]
    row = dict(zip(heads, track_words.row(found, PoseKey("a.png"), RECORD), strict=True))
    assert row["image"] == "a.png"
    assert row["points"] == "54"
    assert row["x y z, mm"] == "100.0 -20.0 700.0"
    assert row["± std, mm"] == "1.0 1.0 1.0"
    assert row["rotation vector, deg"] == "0.000 0.000 90.000"
    assert row["seen from"] == "0.707 m away, 38° oblique"
    assert row["status"] == "ok"


def test_squares_stay_squares_and_objects_have_a_column():
    found = poses(pose_key=PoseKey("a.png", "tag_3"), unit="squares")
    columns = [column.head for column in track_words.columns(found)]
    assert columns[:2] == ["image", "object"]
    assert "x y z, squares" in columns
    row = track_words.row(found, PoseKey("a.png", "tag_3"), RECORD)
    assert len(row) == len(columns)
    assert row[1] == "tag_3"
    assert "0.1000 -0.0200 0.7000" in row
    assert "0.707 squares away, 38° oblique" in row


def test_points_that_are_left_out_are_counted():
    record = PoseRecord(POSE, np.eye(6), np.eye(6), "ok", 0.2, 0.5, 54, 50)
    assert track_words.points(record) == "50 of 54"
    assert track_words.standpoint(poses(record), record) == "0.707 m away"


def test_the_noise_says_where_it_is_known_from():
    assert track_words.noise(poses()) == "noise 0.25 px, from the residuals, 102 degrees of freedom"
    assert track_words.noise(poses(dof=None)) == "noise 0.25 px, as given"
    near = "noise 0.25 px, by the corner standard deviations, consistent with the residuals"
    assert [track_words.noise(poses(scale=scale)) for scale in (0.7, 1.4)] == [near, near]
    far = "noise 0.25 px: the residuals are 6.6 x the corner standard deviations (a-posteriori scale, 102 degrees"
    assert track_words.noise(poses(scale=6.6)) == f"{far} of freedom)"


def test_other_poses_have_a_row_each():
    others = (Alternative(POSE.inverse(), 3.5, 0.15), Alternative(POSE, 9.0, 0.01))
    record = PoseRecord(POSE, np.eye(6), np.eye(6), "ok", 0.2, 0.5, 4, 4, 0.16, 0.9, others)
    rows = track_words.alternative_rows(poses(record), PoseKey("a.png"), record)
    assert [row[-2:] for row in rows] == [[3.5, "0.15"], [9.0, "0.01"]]
    assert rows[1][1] == "100.000 -20.000 700.000"


def test_a_caption_has_plain_letters_only():
    caption = track_words.caption(poses(), PoseKey("a.png", "tag_3"), RECORD)
    assert caption == "tag_3: 0.707 m away, 38 deg oblique; RMS 0.20 px, 54 points; ok"
    assert caption.isascii()
