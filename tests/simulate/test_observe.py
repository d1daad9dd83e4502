"""Synthetic observations: what is kept, what is disturbed and by how much."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.render import bow
from camcal.simulate.scene import observe
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.03)
CAMERA = Camera(model_named("opencv5"), (640, 480), [500, 500, 320, 240, -0.1, 0.02, 0, 0, 0])
INSIDE = [Pose.from_vector(np.array([0.1 * i, -0.2, 0.05]), [-0.12, -0.075, 0.5 + 0.1 * i]) for i in range(4)]
CUT = Pose.from_vector(np.zeros(3), [0.1, -0.075, 0.5])
AWAY = Pose.from_vector(np.zeros(3), [5.0, 0.0, 0.5])
BEHIND = Pose.from_vector(np.zeros(3), [-0.12, -0.075, -0.5])


def seen(poses, seed=0, **options):
    return observe(CAMERA, BOARD, poses, rng=np.random.default_rng(seed), **options)


def test_without_noise_the_corners_are_the_projections_of_the_bent_board():
    shape = bow(1e-3, 0.5e-3)
    detections, truth = seen(INSIDE, shape=shape)
    for view, pose in zip(detections.views, INSIDE, strict=True):
        assert np.array_equal(view.pixels, CAMERA.project(pose.apply(shape.points(BOARD))).pixels)
    assert truth.poses == tuple(INSIDE)
    assert truth.shape == shape


def test_noise_has_the_standard_deviation_asked_for():
    exact, noisy = (np.stack([v.pixels for v in seen(INSIDE * 50, noise_px=noise)[0].views]) for noise in (0.0, 0.25))
    # 21 600 draws: the standard deviation is known to 0.5 %
    assert np.std(noisy - exact) == pytest.approx(0.25, rel=0.02)
    assert abs(np.mean(noisy - exact)) < 4 * 0.25 / np.sqrt(noisy.size)


def test_outliers_are_displaced_by_their_distance_and_listed():
    exact, _ = seen(INSIDE * 20)
    found, truth = seen(INSIDE * 20, outliers=0.1, outlier_px=6.0)
    away = np.concatenate(
        [np.linalg.norm(a.pixels - b.pixels, axis=1) for a, b in zip(found.views, exact.views, strict=True)]
    )
    mask = np.concatenate(truth.outliers)
    assert away[mask] == pytest.approx(6.0)
    assert np.all(away[~mask] == 0)
    assert 0.08 < mask.mean() < 0.12  # 4 320 draws of 0.1: the share is known to 0.005


def test_corners_outside_the_image_are_dropped_unless_wanted():
    view = seen([CUT])[0].views[0]
    assert 0 < len(view.ids) < BOARD.count
    assert view.pixels[:, 0].max() <= CAMERA.image_size[0] - 0.5
    assert len(seen([CUT], inside=False)[0].views[0].ids) == BOARD.count


def test_a_view_without_corners_says_so():
    for pose in (AWAY, BEHIND):
        view = seen([pose])[0].views[0]
        assert not view.found
        assert "no corner" in view.reason


def test_another_lens_meets_the_same_noise():
    other = Camera(model_named("pinhole"), CAMERA.image_size, [500, 500, 320, 240])
    draws = [
        observe(camera, BOARD, INSIDE, rng=np.random.default_rng(5), noise_px=0.1)[0].views[2].pixels
        - observe(camera, BOARD, INSIDE, rng=np.random.default_rng(5))[0].views[2].pixels
        for camera in (CAMERA, other)
    ]
    assert np.allclose(*draws, atol=1e-12)  # pixels: rounding of sums of some hundred


def test_no_views_give_no_detections():
    assert seen([])[0].views == ()


@pytest.mark.parametrize("options", [{"noise_px": -0.1}, {"outliers": 1.5}])
def test_noise_and_outliers_out_of_range_are_refused(options):
    with pytest.raises(InvalidInput):
        seen(INSIDE, **options)
