"""The entrance pupil of a wide lens: found where it moves with the angle, not claimed where it does not.

The truth moves the pupil exactly, by iteration; that real lenses move it by the square of the angle is not shown here.
"""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.report.calibration import as_data, summary
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board

SIZE, NOISE = (1280, 960), 0.15
BOARD = Board("chessboard", 9, 6, 0.04)
WIDE = Camera(MODELS["kannala_brandt4"], SIZE, [420.0, 421.0, 645.0, 472.0, -0.02, -0.003, 0.001, -0.0002])


def seen(seed, moved=0.0, count=25, camera=WIDE):
    """What the lens sees of boards; moved: m, towards the scene, at 80°."""
    poses = views(camera, BOARD, count, rng=np.random.default_rng(seed))
    exact = observe(camera, BOARD, poses, rng=np.random.default_rng(0), noise_px=0.0)[0].views
    rng, found = np.random.default_rng(1000 + seed), []
    for view, pose in zip(exact, poses, strict=True):
        points = BOARD.points()[view.ids] @ pose.rotation.T + pose.translation
        from_pupil = points
        for _ in range(8):
            angles = np.arctan2(np.hypot(*from_pupil.T[:2]), from_pupil[:, 2])
            from_pupil = points - np.outer(moved * (angles / np.radians(80)) ** 2, [0, 0, 1])
        pixels = camera.project(from_pupil).pixels + rng.normal(0, NOISE, view.pixels.shape)
        found.append(replace(view, pixels=pixels))
    return found


def pupil_of(seed, moved=0.0, model="kannala_brandt4", **how):
    how = {"shape": ShapeOptions(smooth=False), **how}
    return calibrate(seen(seed, moved), BOARD, Options(model_named(model), **how)).between_views.pupil


def test_a_moving_pupil_is_found_within_its_standard_deviation():
    apart = []
    for seed in range(8):
        found = pupil_of(seed, 0.0008)
        truth = 0.0008 * (found.angle / np.radians(80)) ** 2
        assert found.seen, seed
        assert found.std < 0.2 * truth
        apart.append((found.shift - truth) / found.std)
    assert np.sqrt(np.mean(np.square(apart))) < 1.5  # 1 is right; 8 normal numbers are within 1.5 in 99 % of the cases


def test_a_spline_does_not_take_it_up():
    found = pupil_of(3, -0.001, "splined")
    truth = -0.001 * (found.angle / np.radians(80)) ** 2
    assert found.seen
    assert found.shift == pytest.approx(truth, abs=3 * found.std)


def test_a_lens_with_one_centre_is_not_said_to_have_more():
    claims = [pupil_of(seed).seen for seed in range(40)]
    assert sum(claims) <= 2  # 5 %


def test_it_is_stated_in_millimetres():
    calibration = calibrate(seen(2, 0.0008), BOARD, Options(WIDE.model))
    [line] = [line for line in summary(calibration) if line.startswith("Entrance pupil")]
    assert " mm to " in line
    data = as_data(calibration)["entrance_pupil"]
    assert data["seen"]
    assert data["shift"] == pytest.approx(0.0008 * (data["angle_deg"] / 80) ** 2, abs=4 * data["std"])
    assert 0.1 < data["moved_px"] < 5


def test_of_a_narrow_lens_nothing_is_asked():
    narrow = make_camera(MODELS["opencv5"], SIZE, np.radians(50))
    calibration = calibrate(seen(1, camera=narrow), BOARD, Options(narrow.model))
    assert calibration.between_views.pupil is None
    assert as_data(calibration)["entrance_pupil"] is None
