"""The choice of frames: what a calibration gains by it, and what keeps a frame from being chosen.

Corners are observed, not rendered: whether blur and motion are measured rightly is shown in tests/targets and in
tests/images.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from moving_board import between

from camcal.calibrate.frames import (
    BLURRED,
    CHOSEN,
    MOVING,
    SAME,
    SURPLUS,
    choose_frames,
    lens_information,
)
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.quality.forecast import calibration_std
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.025)
SIZE = (1280, 1024)
CAMERA = Camera(model_named("opencv5"), SIZE, np.array([1000.0, 1000, 640, 512, -0.1, 0.03, 0, 0, 0]))
NOISE = 0.1


def video(stops, seed=0, lingering=1):
    """Return poses of a board that is moved from stop to stop in ten frames, and rests at the first ones."""
    keys = views(CAMERA, BOARD, stops, rng=np.random.default_rng(seed))
    poses = [between(*pair, share) for pair in pairwise(keys) for share in np.arange(10) / 10]
    return [pose for index, pose in enumerate(poses) for _ in range(lingering if index < 10 else 1)]


def looks_of(poses, seed=1, blur=1.0, motion=2.0, board=BOARD):
    seen, _ = observe(CAMERA, board, poses, rng=np.random.default_rng(seed), noise_px=NOISE)
    return [replace(view, blur_px=blur, motion_px=motion) for view in seen.views]


def chosen(choices):
    return [index for index, choice in enumerate(choices) if choice.chosen]


def forecast(poses, indices):
    """Return the standard deviations that a calibration from some frames will have."""
    some = [poses[index] for index in indices]
    exact, _ = observe(CAMERA, BOARD, some, rng=np.random.default_rng(0))
    return calibration_std(CAMERA, BOARD, exact.views, some, NOISE)


@pytest.mark.parametrize("lingering", [1, 20])
def test_chosen_frames_tell_more_of_the_lens_than_as_many_evenly_spaced_ones(lingering):
    """Standard deviations are 0.8 times as large, whether a video moves all the time or rests."""
    poses = video(16, lingering=lingering)
    picked = chosen(choose_frames(looks_of(poses), BOARD, 20))
    even = np.linspace(0, len(poses) - 1, 20).astype(int)
    ratio = forecast(poses, picked) / forecast(poses, even)
    assert len(picked) == 20
    assert np.exp(np.log(ratio).mean()) < 0.9  # 0.74 to 0.86 over seeds and numbers of frames


def test_the_first_frames_chosen_are_worth_more_than_the_next_ones():
    poses = video(12)
    choices = choose_frames(looks_of(poses), BOARD, 30)
    ranked = sorted(chosen(choices), key=lambda index: choices[index].rank)
    better = forecast(poses, ranked[:15]) < forecast(poses, ranked[15:])
    assert better.mean() > 0.8  # one of nine parameters may go the other way


def test_the_same_frames_are_chosen_from_the_same_video():
    assert choose_frames(looks_of(video(4)), BOARD, 8) == choose_frames(looks_of(video(4)), BOARD, 8)


@pytest.mark.parametrize("limit", [1, 7, 500])
def test_no_more_frames_are_chosen_than_asked_for(limit):
    choices = choose_frames(looks_of(video(4)), BOARD, limit)
    ranks = sorted(choice.rank for choice in choices if choice.chosen)
    assert ranks == list(range(min(limit, len(ranks))))
    assert all(choice.why == CHOSEN for choice in choices if choice.chosen)


def test_of_frames_alike_one_is_chosen_as_long_as_there_are_others():
    """The board rests in frames 0 to 19; its corners scatter by a tenth of a pixel."""
    poses = video(6, lingering=20)[:20] + video(6)[10:]
    choices = choose_frames(looks_of(poses), BOARD, 15)
    resting = [choice.why for choice in choices[:20]]
    assert resting.count(CHOSEN) <= 1
    assert resting.count(SAME) + resting.count(SURPLUS) >= 19
    assert all(choices[choice.like].chosen for choice in choices if choice.why == SAME)


def test_frames_that_repeat_one_another_to_the_pixel_are_not_chosen_however_few_there_are():
    poses = [video(4)[0]] * 10 + [video(4)[25]] * 10
    choices = choose_frames(looks_of(poses), BOARD, 10)
    assert len(chosen(choices)) == 2
    assert {choice.like for choice in choices if choice.why == SAME} == set(chosen(choices))


def test_more_frames_are_chosen_from_a_slow_video_than_stand_far_apart():
    """Over 30 frames the board moves by 1 % of the image's diagonal: 16 px."""
    first, last = video(4)[0], video(4)[1]
    poses = [between(first, last, share) for share in np.linspace(0, 0.4, 30)]
    picked = chosen(choose_frames(looks_of(poses), BOARD, 5))
    assert len(picked) > 1
    assert min(np.diff(picked)) > 1


def test_blurred_and_fast_frames_are_left_out_and_told_apart():
    looks = looks_of(video(5))
    looks[3] = replace(looks[3], blur_px=9.0)
    looks[5] = replace(looks[5], motion_px=80.0)
    looks[6] = replace(looks[6], blur_px=np.nan, motion_px=np.nan)
    looks[7] = replace(looks[7], motion_px=np.inf)
    choices = choose_frames(looks, BOARD, 500)
    assert [choices[index].why for index in (3, 5, 7)] == [BLURRED, MOVING, MOVING]
    assert not choices[3].chosen
    assert choices[3].error_px > 5 * choices[0].error_px
    # what is not known is taken to be as good as usual
    assert choices[6].error_px == pytest.approx(choices[0].error_px)


def test_pictures_that_were_taken_one_by_one_are_chosen_for_what_they_tell():
    looks = looks_of(video(6))
    one_by_one, still = ([replace(look, motion_px=motion) for look in looks] for motion in (np.inf, 0.0))
    assert choose_frames(one_by_one, BOARD, 8) == choose_frames(still, BOARD, 8)


def test_the_sharper_one_of_two_frames_of_one_view_is_chosen():
    pose = video(3)[0]
    looks = looks_of([pose] * 2, motion=0.0)
    choices = choose_frames([replace(looks[0], blur_px=2.0), looks[1]], BOARD, 2)
    assert [choice.why for choice in choices] == [SAME, CHOSEN]
    assert choices[0].like == 1


def test_a_view_numbered_from_the_other_end_is_the_same_view():
    board = Board("chessboard", 10, 8, 0.02)
    pose = views(CAMERA, board, 1, rng=np.random.default_rng(0))[0]
    looks = looks_of([pose] * 2, board=board)
    both = [looks[0], looks[1].renumbered(board.symmetries()[1])]
    assert not np.allclose(both[0].pixels[0], both[1].pixels[both[1].ids == 0])
    choices = choose_frames(both, board, 2)
    assert sorted(choice.why for choice in choices) == [SAME, CHOSEN]


def test_twice_the_error_is_a_quarter_of_the_information():
    seen = looks_of(video(3)[:4])
    once, twice = (lens_information(seen, BOARD, np.full(4, error)) for error in (0.1, 0.2))
    np.testing.assert_allclose(once, 4 * twice, rtol=1e-12)  # the same sums
    eigenvalues = np.linalg.eigvalsh(once)
    assert (eigenvalues > -1e-9 * eigenvalues.max()).all()  # rounding, of a matrix that is none but semi-definite


def test_one_view_alone_says_less_than_two_together_that_differ():
    seen = looks_of([video(6)[0], video(6)[40]])
    information = lens_information(seen, BOARD, np.full(2, NOISE))
    gains = [np.linalg.slogdet(np.eye(8) + each)[1] for each in (*information, information.sum(axis=0))]
    assert gains[2] > max(gains[:2]) + 1.0
    assert gains[2] < sum(gains[:2])  # as it must be: each tells in part what the other does


def test_frames_are_alike_whose_points_are_within_a_fiftieth_of_the_diagonal():
    """The second frame is 1 % of the diagonal beside the first, the third 3 % and more; the third is not as sharp."""
    first, diagonal = looks_of(views(CAMERA, BOARD, 1, rng=np.random.default_rng(3)), motion=0.0)[0], np.hypot(*SIZE)
    places = ((0.0, 1.0), (0.01, 1.0), (0.04, 2.0))
    moved = [(first.pixels + np.array([share * diagonal, 0]), blur) for share, blur in places]
    beside = [replace(first, pixels=pixels, blur_px=blur) for pixels, blur in moved]
    choices = choose_frames(beside, BOARD, 1)
    assert sorted(choice.why for choice in choices[:2]) == sorted([CHOSEN, SAME])
    assert choices[2].why == SURPLUS
