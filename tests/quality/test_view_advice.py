"""Suggested views: sensible poses, the forecast by plain matrices, better than views at random; views left out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import direction_displacements, grid_pixels
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData
from camcal.quality.forecast import calibration_std, view_information
from camcal.quality.view_advice import Known, advise, candidates
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board, Surface

BOARD = Board("chessboard", 9, 6, 0.025)
CAMERA = make_camera(model_named("opencv5"), (1280, 960), np.radians(65))
PIXELS = grid_pixels(np.linspace(0, 1279, 31), np.linspace(0, 959, 23))
FEW = views(CAMERA, BOARD, 6, rng=np.random.default_rng(3))


def seen(poses, noise=0.1):
    return observe(CAMERA, BOARD, poses, rng=np.random.default_rng(1), noise_px=noise)[0].views


@cache
def known(count=6):
    how = Options(CAMERA.model, shape=ShapeOptions(smooth=False, offsets=False))
    found = calibrate(seen(FEW[:count]), BOARD, how)
    return Known(found.camera, found.surface, found.sigma_px, (0.25, 0.6))


def information(camera, poses):
    exact = Observations.of(observe(camera, BOARD, poses, rng=np.random.default_rng(0))[0].views)
    return view_information(camera, Surface.flat(BOARD), exact, poses, known().noise_px)


def std_px(camera, covariance):
    moved = direction_displacements(camera, PIXELS)
    return np.sqrt(np.mean(np.einsum("nik,kl,nil->n", moved, covariance, moved)) / 2)


def test_views_tell_of_the_lens_what_their_calibration_knows_of_it():
    prior = np.diag(CAMERA.model.prior_std(CAMERA.image_size, CAMERA.value("fx")) ** -2.0)
    covariance = np.linalg.inv(information(CAMERA, FEW).sum(axis=0) + prior)
    exact = seen(FEW, 0.0)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(calibration_std(CAMERA, BOARD, exact, FEW, known().noise_px))


def test_suggested_views_show_all_of_the_board_at_the_distances_of_the_others():
    advice = advise(known(), 4)
    assert len(advice.views) == 4
    for view in advice.views:
        pixels = known().camera.project(view.pose.apply(BOARD.points())).pixels
        assert ((pixels > 0) & (pixels < [1279, 959])).all()
        assert 0.25 / 1.15 <= view.distance * (1 + 1e-9) <= 1.15 * 0.6 * (1 + 1e-6)
        middle = view.pose.apply(np.array([[*BOARD.extent, 0.0]]) / 2)[0]
        assert np.linalg.norm(middle) == pytest.approx(view.distance)
        line = middle / view.distance
        assert np.arccos(abs(view.pose.rotation[:, 2] @ line)) == pytest.approx(view.tilt, abs=1e-6)
        assert view.tilt < np.radians(50.1)


def test_the_side_that_is_called_nearer_is_nearer():
    found = [view for view in advise(known(), 6).views if view.tilt]
    assert found
    for view in found:
        placed = view.pose.apply(BOARD.points())
        line = view.pose.apply(np.array([[*BOARD.extent, 0.0]]) / 2)[0] / view.distance
        across = np.column_stack([placed[:, :2] / placed[:, 2:]]) - line[:2] / line[2]
        side = across @ view.lean
        depth = placed @ line
        assert np.corrcoef(side, depth)[0, 1] < -0.8


def test_the_forecast_is_that_of_the_joint_normal_equations():
    advice, own = advise(known()), known().camera
    precision = np.linalg.inv(own.covariance)
    assert advice.std_px == pytest.approx(std_px(own, own.covariance), rel=1e-6)
    gained = information(own, [view.pose for view in advice.views])
    for index, view in enumerate(advice.views):
        expected = std_px(own, np.linalg.inv(precision + gained[: index + 1].sum(axis=0)))
        assert view.std_px == pytest.approx(expected, rel=1e-4)
    stds = [advice.std_px, *(view.std_px for view in advice.views)]
    assert stds == sorted(stds, reverse=True)


def test_suggested_views_are_expected_to_be_better_than_the_best_of_views_at_random():
    rng = np.random.default_rng(8)
    prior = np.diag(CAMERA.model.prior_std(CAMERA.image_size, CAMERA.value("fx")) ** -2.0)
    start = prior + information(CAMERA, FEW).sum(axis=0)

    def expected(poses):
        return std_px(CAMERA, np.linalg.inv(start + information(CAMERA, poses).sum(axis=0)))

    own = expected([view.pose for view in advise(known()).views])
    assert own < min(expected(views(CAMERA, BOARD, 3, rng=rng)) for _ in range(20))


def test_errors_within_views_make_a_view_worth_less():
    noisy = replace(known(), noise_share=0.1)
    assert advise(noisy).std_px == advise(known()).std_px
    assert advise(noisy).views[-1].std_px > 1.5 * advise(known()).views[-1].std_px


def test_views_that_repeat_one_another_may_be_left_out():
    once = views(CAMERA, BOARD, 14, rng=np.random.default_rng(4))
    poses = [*once, *[once[0]] * 6]
    pairs = list(zip(seen(poses), poses, strict=True))
    advice = advise(known(), 1, pairs)
    assert len(advice.spared) >= 3
    assert advice.spared_share <= 0.02
    same = {pairs[0][0].image, *(view.image for view, _ in pairs[14:])}
    assert len(same & set(advice.spared)) >= 2
    assert advise(known(), 1, pairs[:10]).spared == ()  # ten are kept


def test_what_cannot_be_suggested_is_said():
    with pytest.raises(InsufficientData, match="no covariance of the lens is known"):
        advise(replace(known(), camera=replace(CAMERA, covariance=None)))
    with pytest.raises(InsufficientData, match=r"no view of the whole board \(chessboard of 9x6 .* fits the image"):
        advise(replace(known(), distances=(0.05, 0.06)))


def test_a_board_whose_distances_are_not_known_takes_much_of_the_image():
    found = candidates(replace(known(), distances=None))
    heights = np.ptp(found.pixels[..., 0], axis=1) / 1280
    assert 0.3 < np.median(heights) < 0.8
