"""Tracks: how near they come to the truth, what they leave out, and whether they know how good they are.

The scenes have the noise that is claimed; how well PnP claims it is not tested here.
"""

from dataclasses import replace
from types import SimpleNamespace

import motion
import numpy as np
import pytest
from moving_objects import NOISE, errors, glances

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.estimate.tracking import flips
from camcal.estimate.tracking.measurements import GateOptions
from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import GAP, MEASURED, PREDICTED, REJECTED, TrackOptions, track_poses, track_views
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, Trajectory

STAMPS = np.arange(90) / 30
MIDDLE = Pose(so3.about_x(np.pi - 0.5), np.array([0.05, -0.02, 1.0]))
Q = ProcessNoise(0.02, 0.5)


def drift(seed=1, stamps=STAMPS):
    rng = np.random.default_rng(seed)
    return motion.drifting(stamps, MIDDLE, (Q.translation, Q.rotation), rng), rng


def follow(truth, seen, **changes):
    return track_poses(truth.stamps, seen, TrackOptions(**({"noise": Q} | changes)))


def rms(truth, track, since=0):
    there = track.posed & (np.arange(len(truth)) >= since)
    off = errors(truth, np.where(there[:, None, None], track.rotations, np.eye(3)), track.translations)[there]
    return np.sqrt((off[:, :3] ** 2).sum(1).mean()), np.sqrt((off[:, 3:] ** 2).sum(1).mean())


def test_a_smoothed_pose_is_nearer_to_the_truth_than_a_filtered_one_and_that_than_a_single_one():
    found = []
    for seed in range(2):
        truth, rng = drift(seed)
        seen = glances(truth, rng)
        found.append([rms(truth, follow(truth, seen, lag=lag), since=30) for lag in (0, 5, None)])
    causal, lagged, smooth = np.mean(found, axis=0)
    single = np.array([np.linalg.norm(NOISE[:3]), np.linalg.norm(NOISE[3:])])
    for worse, better in ((single, causal), (causal, lagged), (lagged, smooth)):
        assert (better < worse).all()
    assert smooth[1] < 0.6 * single[1]


def test_covariances_are_as_large_as_the_errors():
    nees = []
    for seed in range(3):
        truth, rng = drift(seed)
        track = follow(truth, glances(truth, rng))
        off = errors(truth, track.rotations, track.translations)
        nees.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(track.covariances), off).mean() / 6)
    assert np.mean(nees) == pytest.approx(1.0, abs=0.2)  # errors of neighbours hang together: some 40 independent ones


def test_innovations_are_white_and_of_the_size_that_is_claimed():
    truth, rng = drift(2, np.arange(180) / 30)
    judged = follow(truth, glances(truth, rng, dropped=0.1)).consistency
    assert judged.verdict == "consistent"
    assert judged.mean_nis == pytest.approx(1.0, abs=0.14)  # 3 standard errors of 1000 squares
    assert abs(judged.autocorrelation) < 0.1


def small_tag(seed, frames=150, reach=0.3, noise_px=0.5):
    """Return stamps, rotations, camera, views and single poses of a tag of 22 px at 4 m, with both of its poses.

    reach: rad, by which it sways.
    """
    rng, stamps, focal = np.random.default_rng(seed), np.arange(frames) / 30, 880.0
    camera = Camera(model_named("pinhole"), (1280, 960), np.array([focal, focal, 640.0, 480.0]))
    corners = 0.05 * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    waves = np.sin(stamps[:, None] * rng.uniform(0.3, 1.5, 6) + rng.uniform(0, 6, 6))
    rotations = so3.exp(waves[:, :3] * reach) @ so3.about_x(np.pi - 0.2)
    seen = np.einsum("nij,pj->npi", rotations, corners) + (waves[:, 3:] * [0.5, 0.3, 0.2] + [0, 0, 4.0])[:, None]
    pixels = focal * seen[..., :2] / seen[..., 2:] + [640, 480] + rng.normal(0, noise_px, (frames, 4, 2))
    views = [Correspondences(str(frame), corners, each) for frame, each in enumerate(pixels)]
    poses = [one.value for one in estimate_poses(camera, views, PoseOptions(noise_px=noise_px))]
    return stamps, rotations, camera, views, poses


def off(track, rotations):
    return so3.angle_between(track.rotations, rotations) > np.radians(10)


@pytest.mark.parametrize("seed", [6, 7, 8])
def test_poses_of_a_small_tag_are_followed_along_the_right_branch(seed):
    stamps, rotations, _, _, poses = small_tag(seed)
    assert off(track_poses(stamps, poses), rotations).mean() < 0.05
    singles = np.array([each.transform.rotation for each in poses])
    assert np.mean(so3.angle_between(singles, rotations) > np.radians(10)) > 0.2  # what the frames alone say


def test_a_wrong_branch_of_poses_that_hardly_move_is_stated():
    wrong, said, unsaid = [], [], []
    for seed in range(4):
        stamps, rotations, _, _, poses = small_tag(seed, frames=90, reach=0.05)
        track = track_poses(stamps, poses)
        wrong.append(off(track, rotations))
        said.append(track.p_wrong)
        unsaid.append(wrong[-1] & (track.p_wrong < 0.05))
        assert track.consistency.verdict == "ambiguous" or track.p_wrong.mean() < 0.03
    assert np.mean(unsaid) < 0.05
    assert np.mean(said) > 0.3 * np.mean(wrong)


def test_a_rival_of_many_frames_counts_more_where_they_show_the_object_from_one_side():
    """A difference Δ of the evidence is one of noise, 4 Δ, and of an error that frames of one side share."""
    for turned_deg, repeated, divisor in ((0.0, 0.2, 13.0), (180.0, 0.2, 2.2), (0.0, 0.0, 1.0)):
        track = SimpleNamespace(
            states=SimpleNamespace(
                rotations=so3.exp(np.linspace(0, np.radians(turned_deg), 60)[:, None] * [1.0, 0, 0])
            ),
            chains=SimpleNamespace(frames=SimpleNamespace(repeated=repeated)),
        )
        [(_, weight)] = flips._rival(SimpleNamespace(track=track), np.arange(60), 9.0)
        assert weight == pytest.approx(np.exp(-9.0 / (2 * divisor)))


def test_poses_a_second_apart_are_no_wrong_ones_because_nothing_foretells_them():
    rng = np.random.default_rng(5)
    stamps = np.arange(8.0)
    turns = so3.exp(rng.normal(0, 0.4, (8, 3))) @ MIDDLE.rotation
    truth = Trajectory("camera_T_object", stamps, turns, MIDDLE.translation + rng.normal(0, 0.15, (8, 3)))
    track = follow(truth, glances(truth, rng, scale=1e-2), noise=ProcessNoise(1.0, 1.0))
    assert track.count(MEASURED) >= 7


@pytest.mark.slow
def test_a_pass_that_starts_on_the_wrong_branch_is_corrected_by_the_one_in_reverse():
    stamps, rotations, camera, views, poses = small_tag(1, frames=90)
    assert off(track_views(camera, stamps, views, poses), rotations).mean() < 0.05


def test_a_track_of_poses_without_a_doubt_is_not_called_ambiguous():
    truth, rng = drift()
    track = follow(truth, glances(truth, rng))
    assert track.ambiguous == []
    assert track.consistency.verdict != "ambiguous"


def test_noise_larger_than_claimed_is_found_as_vibration():
    truth, rng = drift()
    track = follow(truth, glances(truth, rng, scale=1.6))
    assert track.jitter_std.any
    assert track.consistency.mean_nis == pytest.approx(1.0, abs=0.15)


def test_missing_frames_and_outliers_are_survived_and_outliers_named():
    truth, rng = drift(3)
    seen = glances(truth, rng, dropped=0.1, outliers=0.05)
    track = follow(truth, seen, fill=True)
    assert track.segments.max() == 0
    assert 1 <= track.count(REJECTED) <= 12
    assert track.posed.sum() > 80
    assert max(rms(truth, track)) < 0.02


def test_mirrored_poses_are_told_apart_by_the_motion():
    truth, rng = drift(4)
    seen = glances(truth, rng, mirrored=0.4)
    track = follow(truth, seen)
    assert track.count(REJECTED) == 0
    assert (track.candidates == 1).sum() > 25
    assert rms(truth, track)[1] < 0.02  # a mirrored pose is 0.8 rad off
    assert track.before.rotation > 10 * track.after.rotation


def test_a_track_does_not_begin_with_a_mirrored_pose_or_an_outlier():
    for seed in range(3):
        truth, rng = drift(seed, STAMPS[:40])
        seen = glances(truth, rng, mirrored=0.2)
        seen[0] = glances(truth, rng, mirrored=1.0)[0]
        track = follow(truth, seen)
        assert track.states[0] == MEASURED
        assert rms(truth, track)[1] < 0.02


def test_frames_without_a_detection_have_a_pose_only_on_request():
    truth, rng = drift()
    seen = glances(truth, rng)
    seen[40:45] = [None] * 5
    plain, filled = (follow(truth, seen, fill=fill) for fill in (False, True))
    assert set(plain.states[40:45]) == {GAP}
    assert not plain.posed[40:45].any()
    assert set(filled.states[40:45]) == {PREDICTED}
    assert filled.posed.all()
    assert np.abs(filled.translations[40:45] - truth.translations[40:45]).max() < 0.01
    assert filled.covariances[42, 0, 0] > 1.5 * filled.covariances[30, 0, 0]


def test_a_jerk_costs_a_detection_at_most_and_no_break():
    truth, rng = drift(5)
    struck = truth.translations + np.maximum(STAMPS - STAMPS[50], 0)[:, None] * [0.9, -0.6, 0.0]  # m/s, from rest
    truth = replace(truth, translations=struck)
    track = follow(truth, glances(truth, rng))
    assert track.segments.max() == 0
    assert track.count(REJECTED) <= 1
    assert len(track.jerks) == 1
    assert 51 <= track.jerks[0] <= 53
    assert rms(truth, track)[0] < 0.005
    # Before the jerk nothing of the velocity after it is believed: smoothing does not round the corner off.
    np.testing.assert_allclose(track.translations[45:51], truth.translations[45:51], atol=0.01)
    assert track.consistency.verdict == "consistent"


def test_outliers_one_after_another_are_no_jerk():
    truth, rng = drift(6)
    seen = glances(truth, rng)
    seen[40:44] = [glances(truth, rng, outliers=1.0)[index] for index in range(40, 44)]
    track = follow(truth, seen)
    assert track.jerks == ()
    assert set(track.states[40:44]) == {REJECTED}


def test_an_object_in_the_middle_of_the_camera_is_followed_like_any_other():
    still = Trajectory(motion.FRAMES, STAMPS, np.tile(np.eye(3), (len(STAMPS), 1, 1)), np.zeros((len(STAMPS), 3)))
    track = follow(still, glances(still, np.random.default_rng(8)), noise=None)
    assert track.posed.all()
    assert np.isfinite(track.noise.densities).all()


def test_a_start_tells_nothing_of_the_noise():
    truth, rng = drift(7)
    track = follow(truth, glances(truth, rng))
    assert track.consistency.innovations == len(STAMPS) - 2


def test_a_long_gap_is_not_bridged():
    truth, rng = drift()
    seen = glances(truth, rng)
    seen[30:65] = [None] * 35
    track = follow(truth, seen, fill=True)
    assert track.segments[29] == 0
    assert track.segments[65] == 1
    assert set(track.segments[30:65]) == {-1}
    assert set(track.states[30:65]) == {GAP}
    longer = follow(truth, seen, following=GateOptions(max_gap=2.0))
    assert longer.segments.max() == 0


def test_an_object_that_is_moved_by_a_jump_is_followed_anew():
    truth, rng = drift()
    seen = glances(truth, rng)
    for index in range(60, 90):
        pose = seen[index].transform
        seen[index] = replace(seen[index], transform=Pose(pose.rotation, pose.translation + 0.3))
    track = follow(truth, seen)
    assert track.segments.max() == 1
    assert track.states[60] == MEASURED
    assert track.segments[60] == 1


def test_what_all_frames_share_is_added_once_and_not_averaged_away():
    truth, rng = drift()
    common = np.diag([1e-4, 1e-4, 4e-4, 1e-6, 1e-6, 1e-6])
    seen = glances(truth, rng, common=common)
    with_it = follow(truth, seen)
    without = follow(truth, [replace(each, covariance=each.noise_covariance) for each in seen])
    np.testing.assert_allclose(with_it.covariances - without.covariances, np.tile(common, (90, 1, 1)), atol=1e-15)
    np.testing.assert_array_equal(with_it.translations, without.translations)


def test_a_causal_track_does_not_change_when_frames_are_added():
    truth, rng = drift()
    seen = glances(truth, rng, dropped=0.1)
    short, long = (track_poses(STAMPS[:n], seen[:n], TrackOptions(Q, lag=0)) for n in (60, 90))
    np.testing.assert_allclose(short.translations, long.translations[:60], rtol=1e-12)
    np.testing.assert_allclose(short.covariances, long.covariances[:60], rtol=1e-9)
    assert long.posed[:20].sum() > 10


def test_a_lag_longer_than_the_track_is_the_smoother():
    truth, rng = drift()
    seen = glances(truth, rng)
    lagged, smooth = follow(truth, seen, lag=200), follow(truth, seen)
    np.testing.assert_allclose(lagged.translations, smooth.translations, atol=1e-6)
    assert so3.angle_between(lagged.rotations, smooth.rotations).max() < 1e-3  # linear about the filter's rotations


def test_a_lag_changes_nothing_that_lies_further_back():
    truth, rng = drift()
    seen = glances(truth, rng)
    short = track_poses(STAMPS[:60], seen[:60], TrackOptions(Q, lag=10))
    long = follow(truth, seen, lag=10)
    np.testing.assert_allclose(short.translations[20:50], long.translations[20:50], atol=1e-12)


def test_the_inverse_maps_the_other_way_with_its_velocity_and_covariance():
    truth, rng = drift()
    track = follow(truth, glances(truth, rng), fill=True)
    back = track.inverse()
    assert back.frames == "object_T_camera"
    again = back.inverse()
    for name in ("rotations", "translations", "velocities", "covariances"):
        np.testing.assert_allclose(getattr(again, name), getattr(track, name), atol=1e-12)
    dt = 1e-6
    v, w = track.velocities[50, :3], track.velocities[50, 3:]
    later = Pose(so3.exp(w * dt) @ track.rotations[50], track.translations[50] + v * dt).inverse()
    np.testing.assert_allclose((later.translation - back.translations[50]) / dt, back.velocities[50, :3], atol=1e-5)
    turn = so3.log(later.rotation @ back.rotations[50].T) / dt
    np.testing.assert_allclose(turn, back.velocities[50, 3:], atol=1e-5)


def test_two_detections_are_too_few():
    truth, rng = drift()
    seen = glances(truth, rng)
    with pytest.raises(InsufficientData, match="found in 2 of 90 frames"):
        follow(truth, [*seen[:2], *[None] * 88])


def test_three_detections_far_apart_are_no_track():
    truth, rng = drift()
    seen = glances(truth, rng)
    kept = [each if index in (0, 45, 89) else None for index, each in enumerate(seen)]
    with pytest.raises(InsufficientData, match="no 3 of 3 detections are successive"):
        follow(truth, kept)


def test_a_causal_track_gives_the_first_poses_at_once():
    truth, rng = drift()
    seen = glances(truth, rng)
    seen[4:] = [None] * (len(seen) - 4)
    assert follow(truth, seen, lag=0).posed[:4].all()


def test_three_detections_are_a_track():
    truth, rng = drift()
    track = track_poses(STAMPS[:3], glances(truth, rng)[:3], TrackOptions())
    assert track.states == (MEASURED,) * 3


@pytest.mark.parametrize("later", [0.1, 0.09])
def test_times_that_do_not_increase_are_refused(later):
    truth, rng = drift()
    stamps = np.array([0.0, 0.1, later, *(1.0 + STAMPS[3:])])
    with pytest.raises(InvalidInput, match=r"frame 2 at .* s is not later than the one before, 0.1 s"):
        track_poses(stamps, glances(truth, rng), TrackOptions())


def test_a_still_object_is_followed_with_hardly_any_noise():
    rng = np.random.default_rng(5)
    truth = motion.drifting(STAMPS[:30], MIDDLE, (1e-16, 1e-16), rng)
    track = track_poses(truth.stamps, glances(truth, rng), TrackOptions())
    assert track.noise.translation * (track.noise.fading or 1) ** 2 < 1e-4  # m²/s³
    assert rms(truth, track)[1] < 0.6 * np.linalg.norm(NOISE[3:])


def test_poses_without_any_noise_are_followed():
    rng = np.random.default_rng(5)
    truth = motion.swaying(STAMPS, MIDDLE, 0.05, 0.2, rng)
    track = follow(truth, glances(truth, rng, scale=0.0))
    assert max(rms(truth, track)) < 1e-3


@pytest.mark.parametrize("changes", [{"translation": 0.0}, {"rotation": -1.0}, {"translation": np.nan}])
def test_process_noise_that_is_none_is_refused(changes):
    with pytest.raises(InvalidInput, match="process noise of"):
        ProcessNoise(**({"translation": 1.0, "rotation": 1.0} | changes))


@pytest.mark.parametrize("following", [{"confidence": 1.0}, {"confidence": 0.0}, {"max_gap": 0.0}])
def test_gates_and_gaps_that_make_no_sense_are_refused(following):
    with pytest.raises(InvalidInput):
        GateOptions(**following)
