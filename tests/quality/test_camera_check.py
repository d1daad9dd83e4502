"""Checks of a calibration by new views, whose truth is known: still valid, drifted and by what, or not shown."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ncx2

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.known_cameras import KnownBoard, examine
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.camera_check import (
    BOARD,
    DRIFTED,
    IMAGE,
    LENS,
    NOT_SHOWN,
    OTHER,
    PLACE,
    VALID,
    CheckedCamera,
    check_lens,
    check_mount,
    check_place,
)
from camcal.quality.camera_drift import Drift, Estimated, lens_drift
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

SIZE = (1280, 960)
LENS_OF = np.array([1000.0, 1002.0, 645.0, 474.0, -0.12, 0.06, 5e-4, -3e-4, 0.01])
PRINTED = Board("charuco", 9, 7, 0.030, 0.022, "DICT_5X5_100")
CHECKER = Board("chessboard", 9, 6, 0.030)
NOISE = 0.03


def lens(model="opencv5", **steps):
    made = model_named(model)
    return Camera(
        made, SIZE, LENS_OF[: len(made.parameter_names)] + [steps.get(name, 0.0) for name in made.parameter_names]
    )


def seen(camera, seed, count=20, board=PRINTED, noise=NOISE):
    rng = np.random.default_rng(seed)
    return observe(camera, board, views(camera, board, count, rng=rng), noise_px=noise, rng=rng)[0].views


def calibrated(camera, seed, count=20, board=PRINTED):
    found = calibrate(seen(camera, seed, count, board), board, Options(camera.model, max_rejected=1.0))
    return CheckedCamera(found.camera, found.sigma_px, np.zeros((0, 2)), count), KnownBoard(found.surface, count)


@pytest.fixture(scope="module")
def known():
    return calibrated(lens(), 1)


def test_a_camera_that_is_as_it_was_is_still_valid(known):
    own, board = known
    found = [check_lens(own, seen(lens(), seed, 14), board) for seed in range(2, 14)]
    assert Counter(each.verdict for each in found) == {VALID: 12}
    assert all(each.drift.rms_px.value < 4 * each.drift.rms_px.std for each in found)
    assert all(each.limit_px == 0.5 and not each.notes for each in found)
    assert "would have shown" in found[0].reason


def test_small_chances_without_a_drift_are_as_rare_as_they_say(known):
    # calibrations are drawn anew as well: their errors are part of what is seen
    chances = []
    for seed in range(100, 112):
        own, board = calibrated(lens("opencv4"), seed, 12)
        chances += [check_lens(own, seen(lens("opencv4"), 1000 * seed + k, k), board).drift.chance for k in (1, 2, 4)]
    # the smallest one of three chances, times three: fewer are small than if it were one
    assert 0.15 < np.mean(np.array(chances) < 0.5) < 0.6
    assert np.mean(np.array(chances) < 0.02) < 0.1


def test_a_lens_that_moved_is_told_with_its_parts(known):
    own, board = known
    found = check_lens(own, seen(lens(fx=8.0, fy=8.0, cx=6.0), 30, 8), board)
    assert (found.verdict, found.cause) == (DRIFTED, LENS)
    drift = found.drift
    assert abs(drift.focal.value - 0.008) < 4 * drift.focal.std < 0.001
    assert abs(drift.shift[0].value - 6) < 4 * drift.shift[0].std
    assert abs(drift.shift[1].value) < 4 * drift.shift[1].std
    assert drift.distortion_px < 0.5
    assert 2 < drift.rms_px.value < 6 < drift.worst_px.value < 12  # of the 0.8 % and 6 px, without a rotation
    assert "the lens moved" in found.reason


def test_another_camera_is_told_from_a_lens_that_moved(known):
    own, board = known
    found = check_lens(own, seen(lens(fx=60.0, fy=60.0), 31, 6), board)
    assert (found.verdict, found.cause) == (DRIFTED, OTHER)
    far = check_lens(own, seen(replace(lens(fx=900.0, fy=900.0), covariance=None), 32, 6), board)
    assert (far.verdict, far.cause) == (DRIFTED, OTHER)


def test_images_that_could_not_show_a_drift_say_which_they_would_have(known):
    own, board = known
    found = check_lens(own, seen(lens(), 33, 1), board, most_px=0.05)
    assert found.verdict == NOT_SHOWN
    assert found.drift.smallest_px > 0.05
    assert f"{found.drift.smallest_px:.2g} px or more" in found.reason
    assert check_lens(own, [], board).verdict == NOT_SHOWN
    few = [replace(view, ids=view.ids[:3], pixels=view.pixels[:3], covariance=None) for view in seen(lens(), 33, 1)]
    assert "none of 1 image shows 4 corners" in check_lens(own, few, board).reason


def test_the_view_that_is_named_shows_more_than_others(known):
    own, board = known
    rng = np.random.default_rng(41)
    poses = views(lens(), PRINTED, 8, rng=rng)

    def smallest(*chosen):
        new = observe(lens(), PRINTED, chosen, noise_px=NOISE, rng=np.random.default_rng(42))[0].views
        return check_lens(own, new, board, most_px=0.01)

    first = smallest(poses[0])
    assert first.verdict == NOT_SHOWN
    named = smallest(poses[0], first.next_view.pose).drift.smallest_px
    others = [smallest(poses[0], pose).drift.smallest_px for pose in poses[1:]]
    assert named < min(others)
    assert check_lens(own, seen(lens(), 43, 10), board).next_view is None


def test_the_smallest_drift_that_is_stated_is_found_in_nine_of_ten_cases():
    found, poses = [], views(lens("opencv4"), PRINTED, 2, rng=np.random.default_rng(40))
    for seed in range(15):
        own, board = calibrated(lens("opencv4"), 500 + seed, 12)
        rng = np.random.default_rng(900 + seed)
        still = observe(lens("opencv4"), PRINTED, poses, noise_px=NOISE, rng=rng)[0].views
        stated = check_lens(own, still, board).drift
        one = check_lens(own, observe(lens("opencv4", fx=1.0, fy=1.002), PRINTED, poses, rng=rng)[0].views, board, 0.0)
        step = stated.smallest_px / (one.drift.rms_px.value / (one.drift.focal.value * 1000))
        new = observe(lens("opencv4", fx=step, fy=1.002 * step), PRINTED, poses, noise_px=NOISE, rng=rng)[0].views
        found.append(check_lens(own, new, board, 0.0).drift.chance < 1e-3)
    assert np.mean(found) >= 0.7


def test_images_of_another_size_are_explained_where_they_can_be(known):
    own, board = known
    whole = seen(lens(), 50, 5)
    half = [replace(view, size=(640, 480), pixels=(view.pixels + 0.5) / 2 - 0.5, covariance=None) for view in whole]
    found = check_lens(own, half, board)
    assert (found.verdict, found.cause) == (DRIFTED, IMAGE)
    assert "640x480" in found.reason
    assert "scaled by 0.5 it still holds" in found.reason
    inside = [np.all(view.pixels[:, 1] > 121) and np.all(view.pixels[:, 1] < 838) for view in whole]
    cut = [
        replace(view, size=(1280, 720), pixels=view.pixels - (0, 120), covariance=None)
        for view, chosen in zip(whole, inside, strict=True)
        if chosen
    ]
    found = check_lens(own, cut, board)
    assert "cropped in the middle" in found.reason
    odd = [replace(view, size=(1000, 720)) for view in whole]
    assert check_lens(own, odd, board).cause == OTHER


def test_images_that_are_turned_or_mirrored_are_named():
    camera = lens(cx=30.0, cy=-25.0)
    own, board = calibrated(camera, 4)
    new = seen(camera, 60, 8)
    turned = [replace(view, pixels=np.array(SIZE) - 1 - view.pixels) for view in new]
    found = check_lens(own, turned, board)
    assert (found.verdict, found.cause) == (DRIFTED, IMAGE)
    assert "upside down" in found.reason
    own, board = calibrated(camera, 5, board=CHECKER)
    across = np.arange(54).reshape(6, 9)[:, ::-1].ravel()
    mirrored = [
        replace(view, ids=across[view.ids], pixels=(SIZE[0] - 1, 0) + view.pixels * (-1, 1), covariance=None)
        for view in seen(camera, 61, 8, CHECKER)
    ]
    found = check_lens(own, mirrored, board)
    assert (found.verdict, found.cause) == (DRIFTED, IMAGE)
    assert "mirrored" in found.reason


def test_noisy_images_are_noisy_and_not_a_drift(known):
    own, board = known
    found = check_lens(own, seen(lens(), 70, 8, noise=5 * NOISE), board)
    assert found.verdict != DRIFTED
    assert any("times as noisy" in note for note in found.notes)
    assert not check_lens(own, seen(lens(), 70, 8, noise=2 * NOISE), board).notes


def test_another_board_than_that_of_the_calibration_does_as_well(known):
    own, _ = known
    found = check_lens(own, seen(lens(), 71, 8, CHECKER), KnownBoard(type(known[1].surface).flat(CHECKER)))
    assert found.verdict == VALID


PAIR = Pose(so3.exp(np.array([0.01, -0.03, 0.005])), np.array([-0.12, 0.002, 0.004]))


def pair_views(pose, seed, count=8):
    """Return views of the same captures by two cameras, of which the second stands at `pose`."""
    rng = np.random.default_rng(seed)
    left, right = lens(), lens(cx=4.0, cy=-6.0)
    poses = views(left, PRINTED, 4 * count, rng=rng)
    rows = []
    for each in poses:
        both = [
            observe(camera, PRINTED, [at], noise_px=NOISE, rng=rng)[0].views[0]
            for camera, at in ((left, each), (right, pose @ each))
        ]
        if all(len(view.ids) >= 20 for view in both):
            rows.append(tuple(both))
    return rows[:count]


@pytest.fixture(scope="module")
def pair():
    own = [calibrated(lens(), 6), calibrated(lens(cx=4.0, cy=-6.0), 7)]
    return (own[0][0], own[1][0]), own[0][1]


COVARIANCE = np.diag([1e-5, 1e-5, 1e-5, 2e-5, 2e-5, 2e-5]) ** 2


def joint(pair):
    result = np.zeros((24, 24))
    result[:9, :9], result[9:18, 9:18], result[18:, 18:] = (
        pair[0].camera.covariance,
        pair[1].camera.covariance,
        COVARIANCE,
    )
    return result


def placed(pair, board, pose, seed, most_px=None):
    return check_place(pair, pair_views(pose, seed, 14), PAIR, joint(pair), board, most_px)


def test_a_camera_of_a_rig_that_stands_where_it_did_is_still_valid(pair):
    cameras, board = pair
    assert placed(cameras, board, PAIR, 80).verdict == VALID


def test_a_camera_of_a_rig_that_was_pushed_is_told_by_how_much(pair):
    cameras, board = pair
    step = np.array([0.0, 0.002, 0.0, 0.0, np.radians(0.2), 0.0])
    found = placed(cameras, board, PAIR.retract(step), 81)
    assert (found.verdict, found.cause) == (DRIFTED, PLACE)
    assert np.all(np.abs(found.drift.turn - step[3:]) < 4 * found.drift.turn_std)
    assert np.all(np.abs(found.drift.shift - step[:3]) < 4 * found.drift.shift_std)
    assert found.drift.scale is None
    assert "turned by 0.2" in found.reason


def test_a_distance_of_two_cameras_that_changed_alone_may_be_the_board_as_well(pair):
    cameras, board = pair
    found = placed(cameras, board, Pose(PAIR.rotation, 1.03 * PAIR.translation), 82)
    assert (found.verdict, found.cause) == (DRIFTED, BOARD)
    assert found.drift.scale.value == pytest.approx(0.03, abs=4 * found.drift.scale.std)


@pytest.mark.parametrize(
    ("chance", "sigmas", "beyond"),
    [
        (5e-4, 4.0, True),
        (2e-3, 4.0, False),
        (5e-4, 2.0, False),
        (5e-6, 2.0, True),
        (2e-5, 2.0, False),
        (5e-4, 2.5, False),
    ],
)
def test_a_drift_is_no_chance_and_well_above_its_deviation_or_certain(chance, sigmas, beyond):
    drift = Drift(Estimated(2.0, 2.0 / sigmas), Estimated(2.0, 1.0), chance, 0.1, 0.1)
    assert drift.beyond(None) is beyond
    assert not drift.beyond(2.1)


def test_the_drift_that_counts_is_half_a_pixel_or_three_deviations_of_the_calibration():
    def limit(std):
        return Drift(Estimated(1.0, 0.1), Estimated(1.0, 0.1), 1e-9, 0.1, std).limit

    assert limit(0.1)(None) == 0.5
    assert limit(0.3)(None) == pytest.approx(0.9)
    assert limit(0.3)(0.2) == 0.2


def test_corners_far_from_where_a_camera_images_the_board_are_of_another_one(known):
    own, board = known
    rng = np.random.default_rng(90)
    scattered = [
        replace(view, pixels=view.pixels + rng.normal(0, 3.0, view.pixels.shape), covariance=None)
        for view in seen(lens(), 91, 6)
    ]
    found = check_lens(own, scattered, board)
    assert (found.verdict, found.cause) == (DRIFTED, OTHER)
    assert "px from where this camera images the board" in found.reason


OLD, STILL = (
    Pose(so3.exp(np.array([0.2, -0.1, 0.05])), np.array([0.1, -0.05, 0.8])),
    np.diag([1e-4] * 3 + [1e-4] * 3) ** 2,
)


def mounted(step, spread=1.0):
    moved = Pose.identity().retract(np.array(step))  # before_T_now
    now = moved.inverse() @ OLD
    return check_mount([(OLD, spread * STILL)], [(now, spread * STILL)], 2e-3, np.radians(0.2))


def test_a_camera_that_was_pushed_is_told_the_way_back():
    found = mounted([5e-3, 0, -3e-3, 0, np.radians(0.5), 0])
    assert (found.verdict, found.cause) == (DRIFTED, PLACE)
    assert "move it 5 mm left, 3 mm forward and turn it 0.5° left to undo it" in found.reason
    assert found.movement.shift.value == pytest.approx(np.hypot(5e-3, 3e-3))


def test_small_movements_of_a_mount_are_accepted_and_poor_poses_show_none():
    assert mounted([1.5e-3, 0, 0, 0, 0, 0]).verdict == VALID
    assert mounted([2.5e-3, 0, 0, 0, 0, 0]).verdict == DRIFTED
    assert mounted([0, 0, 0, np.radians(0.15), 0, 0]).verdict == VALID
    assert mounted([0, 0, 0, np.radians(0.25), 0, 0]).verdict == DRIFTED
    assert mounted([0, 0, 0, 0, 0, 0], spread=100.0).verdict == NOT_SHOWN
    assert mounted([2.5e-3, 0, 0, 0, 0, 0], spread=100.0).verdict == NOT_SHOWN


def test_mounts_of_several_images_scatter_as_they_do():
    rng = np.random.default_rng(5)

    def poses(spread):
        return [(OLD.retract(spread * rng.normal(0, 1e-4, 6)), STILL) for _ in range(12)]

    calm, shaking = (check_mount(poses(each), poses(each), 2e-3, 4e-3).movement for each in (1, 6))
    assert shaking.shift.std > 2.5 * calm.shift.std
    assert calm.chance > 1e-3


def test_new_views_alone_say_as_much_as_a_calibration_from_them(known):
    # what is taken out again is the prior: the information is that of the views
    own, board = known
    new = seen(lens(), 95, 20)
    found = examine([own.known(new)], [Pose.identity()], board)
    again = calibrate(new, PRINTED, Options(lens().model, max_rejected=1.0)).noise_covariance
    ratio = np.sqrt(np.diag(np.linalg.inv(found.information)) / np.diag(again))
    assert np.all(np.abs(np.log(ratio)) < 0.5)
    assert lens_drift(own.known(new), found, None, 20).calibration_px < 0.2


def test_noncentral_chi_square_is_scipys():
    # the power of the test that states the smallest drift
    from scipy.special import chdtri, chndtrinc

    needed = chndtrinc(chdtri(1, 1e-3 / 3), 1, 0.03)
    assert ncx2.sf(chdtri(1, 1e-3 / 3), 1, needed) == pytest.approx(0.97, abs=1e-6)
