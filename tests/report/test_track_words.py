"""A track in words: what is remarked on, and what is not."""

import motion
import numpy as np
import pytest
from moving_objects import glances

from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import TrackOptions, track_poses
from camcal.formats.trajectories.tracked import TrackedObject
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.report.track_words import consistency_line, lines, warnings


@pytest.fixture
def seen():
    rng = np.random.default_rng(1)
    middle = Pose(so3.about_x(2.6), np.array([0.0, 0.0, 1.0]))
    truth = motion.drifting(np.arange(60) / 30, middle, (0.02, 0.5), rng)
    return truth, glances(truth, rng), glances(truth, rng, outliers=1.0)


def told(truth, poses):
    track = track_poses(truth.stamps, poses, TrackOptions(ProcessNoise(0.02, 0.5)))
    item = TrackedObject(track, poses)
    return "\n".join([*lines(item), consistency_line(item.track.consistency)]), {
        warning.code: warning for warning in warnings(item)
    }


def test_a_row_of_detections_left_out_is_remarked_on(seen):
    truth, good, bad = seen
    _, found = told(truth, [*good[:40], *bad[40:45], *good[45:]])
    assert dict(found["successive_rejections"].values) == {"frames": 5, "start_s": 40 / 30}


def test_single_outliers_are_not(seen):
    truth, good, bad = seen
    text, found = told(truth, [*good[:40], bad[40], *good[41:50], bad[50], *good[51:]])
    assert "rejected 2 (3.3 %)" in text
    assert found == {}
    assert "consistent: mean NIS" in text


def test_poses_with_covariances_wider_than_their_errors_lead_to_the_images(seen):
    truth, _, _ = seen
    poses = glances(truth, np.random.default_rng(2), scale=0.5)
    item = TrackedObject(track_poses(truth.stamps, poses, TrackOptions(ProcessNoise(0.02, 0.5))), poses)
    (found,) = warnings(item, of_poses=True)
    assert found.text.endswith("track the images, not their poses")
