"""Tags followed on their pixels: mirrored poses, vibration, bounded look-ahead, and what is said of doubt."""

from functools import cache

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.estimate.smoothing.kalman import AMBIGUOUS
from camcal.estimate.tracking.frames import PixelFrames
from camcal.estimate.tracking.hypotheses import Hypotheses
from camcal.estimate.tracking.motion import MotionState
from camcal.estimate.tracking.pixel_track import look_ahead
from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import TrackOptions, track_poses, track_views
from camcal.geometry import rotation as so3

CAMERA = Camera(model_named("pinhole"), (1280, 960), np.array([800.0, 800.0, 639.5, 479.5]))
TAG = np.array([[-0.05, 0.05, 0.0], [0.05, 0.05, 0.0], [0.05, -0.05, 0.0], [-0.05, -0.05, 0.0]])
STAMPS = np.arange(120) / 30


@cache
def swaying(distance, seed, shake=0.0, frames=120):
    """Return a tag that sways through the pose that faces the camera: poses, views and single poses."""
    rng = np.random.default_rng([seed, 77])
    stamps = STAMPS[:frames]
    angles = np.stack(
        [0.5 * np.sin(2.1 * stamps + rng.uniform(0, 6)), 0.4 * np.sin(1.7 * stamps + rng.uniform(0, 6)), 0.2 * stamps],
        axis=1,
    )
    rotations = so3.exp(angles) @ so3.about_x(np.pi)
    places = np.array([0.0, 0.0, distance]) + 0.1 * np.sin(np.outer(stamps, [1.0, 1.5, 0.7]))
    shakes = so3.exp(shake * rng.normal(size=(frames, 3)))
    rotations, places = shakes @ rotations, (shakes @ places[..., None])[..., 0]
    views = []
    for index in range(frames):
        pixels = CAMERA.project(TAG @ rotations[index].T + places[index]).pixels
        views.append(Correspondences(str(index), TAG, pixels + 0.3 * rng.normal(size=(4, 2))))
    poses = [each.value for each in estimate_poses(CAMERA, views, PoseOptions(noise_px=0.3))]
    return rotations, places, views, poses


def wrong(rotations, track):
    return np.degrees(so3.angle_between(track.rotations, rotations)) > 10


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_small_tag_is_not_followed_by_its_mirrored_poses(seed):
    rotations, _, views, poses = swaying(2.5, seed)
    single = np.array([pose.transform.rotation for pose in poses])
    assert (np.degrees(so3.angle_between(single, rotations)) > 10).mean() > 0.05
    track = track_views(CAMERA, STAMPS, views, poses, TrackOptions())
    assert not wrong(rotations, track).any()
    assert track.consistency.verdict == "consistent"


@pytest.mark.slow
def test_the_forward_pass_alone_and_a_short_look_ahead_keep_to_the_right_pose():
    rotations, _, views, poses = swaying(1.5, 3)
    for lag, most in ((0, 0.05), (15, 0.02)):
        track = track_views(CAMERA, STAMPS, views, poses, TrackOptions(ProcessNoise(0.1, 3.0), lag=lag))
        assert wrong(rotations, track).mean() <= most


def test_a_frame_is_not_changed_by_frames_beyond_the_look_ahead():
    _, _, views, poses = swaying(1.5, 3)
    options = TrackOptions(ProcessNoise(0.1, 3.0), lag=5)
    whole, part = (
        track_views(CAMERA, STAMPS[:count], views[:count], poses[:count], options, 0.3) for count in (60, 40)
    )
    np.testing.assert_allclose(whole.translations[:35], part.translations[:35], atol=1e-7)  # usual distance


@pytest.mark.slow
def test_with_a_look_ahead_costs_count_by_half_of_what_they_would_if_all_was_known():
    states = MotionState(np.array([np.eye(3), so3.about_x(1.0)]), np.zeros((2, 3)), np.zeros((2, 1, 6)))
    spread, nothing = np.tile(np.eye(12), (2, 1, 1)), np.zeros((2, 12, 12))
    both = Hypotheses(
        states,
        spread,
        np.array([0.0, 4.0]),
        states,
        spread,
        nothing,
        np.zeros(2, int),
        np.zeros(2, int),
        np.zeros((2, 6)),
    )
    chance = look_ahead((both,), 0, 0.1, PixelFrames.overstated_ahead)[2]
    assert chance == pytest.approx([1 / (1 + np.e)])


def test_vibration_is_found_and_its_regions_hold():
    rotations, places, views, poses = swaying(0.8, 4, shake=3e-3)
    track = track_views(CAMERA, STAMPS, views, poses, TrackOptions())
    assert track.jitter_std.camera_turn == pytest.approx(3e-3, rel=0.35)
    steps = np.concatenate([track.translations - places, so3.log(track.rotations @ rotations.swapaxes(-1, -2))], axis=1)
    distances = np.einsum("ni,nij,nj->n", steps, np.linalg.inv(track.covariances), steps)
    assert 0.85 < np.mean(distances < 12.59) <= 1.0  # χ² of 6 degrees of freedom, 120 frames


@pytest.mark.slow
def test_poses_that_shake_by_many_deviations_keep_their_frames():
    board = np.array([(x, y, 0.0) for y in np.linspace(-0.075, 0.075, 6) for x in np.linspace(-0.12, 0.12, 9)])
    rotations, places, _, _ = swaying(0.8, 4, shake=4e-3)
    rng, views = np.random.default_rng(5), []
    for index, (rotation, place) in enumerate(zip(rotations, places, strict=True)):
        pixels = CAMERA.project(board @ rotation.T + place).pixels + 0.3 * rng.normal(size=(54, 2))
        views.append(Correspondences(str(index), board, pixels))
    poses = [each.value for each in estimate_poses(CAMERA, views, PoseOptions(noise_px=0.3))]
    track = track_poses(STAMPS, poses)
    assert track.posed.all()
    assert track.jitter_std.camera_turn == pytest.approx(4e-3, rel=0.15)


def test_without_vibration_none_is_found():
    _, _, views, poses = swaying(0.8, 5)
    assert not track_views(CAMERA, STAMPS, views, poses, TrackOptions()).jitter_std.any


@pytest.mark.slow
def test_wrong_frames_are_left_out():
    rotations, _, views, poses = swaying(1.0, 6)
    views, poses = list(views), list(poses)
    rng = np.random.default_rng(1)
    wrong_frames = [20, 21, 50, 90]
    for index in wrong_frames:
        views[index] = Correspondences("wrong", TAG, views[index].pixels + 20 * rng.normal(size=(4, 2)))
        poses[index] = estimate_poses(CAMERA, [views[index]], PoseOptions(noise_px=0.3))[0].value
    track = track_views(CAMERA, STAMPS, views, poses, TrackOptions())
    assert {index for index, state in enumerate(track.states) if state == "rejected"} == set(wrong_frames)
    assert not wrong(rotations, track)[np.isfinite(track.nis)].any()


@pytest.mark.slow
def test_a_wrong_corner_does_not_cost_its_frame():
    rotations, _, views, poses = swaying(1.0, 7)
    views, poses = list(views), list(poses)
    pixels = np.array(views[40].pixels)
    pixels[2] += [15.0, -9.0]
    views[40] = Correspondences("40", TAG, pixels)
    poses[40] = estimate_poses(CAMERA, [views[40]], PoseOptions(noise_px=0.3))[0].value
    track = track_views(CAMERA, STAMPS, views, poses, TrackOptions())
    assert track.states[40] == "measured"
    assert np.degrees(so3.angle_between(track.rotations[40], rotations[40])) < 5


def test_a_tag_that_stands_still_far_away_is_called_ambiguous():
    rng = np.random.default_rng(8)
    rotation, place = so3.exp(np.array([0.25, 0.1, 0.0])) @ so3.about_x(np.pi), np.array([0.0, 0.0, 6.0])
    pixels = CAMERA.project(TAG @ rotation.T + place).pixels
    views = [Correspondences(str(index), TAG, pixels + 0.3 * rng.normal(size=(4, 2))) for index in range(20)]
    poses = [each.value for each in estimate_poses(CAMERA, views, PoseOptions(noise_px=0.3))]
    track = track_views(CAMERA, STAMPS[:20], views, poses, TrackOptions(), 0.3)
    assert track.consistency.verdict == AMBIGUOUS
