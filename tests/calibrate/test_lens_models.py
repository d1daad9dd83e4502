"""Every lens model is calibrated from its ordinary start: as well as from the truth, and parameters stay in limits."""

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import Captures, RigOptions
from camcal.cameras.catalogue import MODELS
from camcal.cameras.directions import lens_difference
from camcal.cameras.model import Rig
from camcal.geometry.pose import Pose
from camcal.simulate.scene import captures, make_camera, observe, views
from camcal.targets.board import Board

SIZE, NOISE = (1280, 960), 0.15
BOARD = Board("chessboard", 9, 6, 0.040)
RIGID = ShapeOptions(smooth=False)
NARROW, WIDE = 60, 190
LESS_THAN_180 = {"fov": 150, "division": 150, "orthographic": 150, "ptlens": 120}
NEW = [name for name, model in MODELS.items() if not model.is_view and not model.opencv and name != "kannala_brandt5t"]
NEW.remove("splined_stereographic")  # its calibration is not one from an ordinary start
NEW.remove("telecentric")  # has no field of view, and its own tests: tests/cameras/test_telecentric.py


def seen_by(truth, count=16, seed=1):
    poses = views(truth, BOARD, count, rng=np.random.default_rng(seed))
    return observe(truth, BOARD, poses, rng=np.random.default_rng(seed + 100), noise_px=NOISE)[0].views


def map_error(found, truth, views):
    """RMS px at every tenth corner, after the best rotation."""
    pixels = np.concatenate([view.pixels for view in views])[::10]
    apart = lens_difference(truth, found, pixels)
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1))))


@pytest.mark.parametrize("fov", [NARROW, WIDE])
@pytest.mark.parametrize("name", NEW)
def test_a_lens_is_found_without_a_hint_as_well_as_from_the_truth(name, fov):
    model = MODELS[name]
    truth = make_camera(model, SIZE, np.radians(min(fov, LESS_THAN_180.get(name, fov))))
    seen = seen_by(truth)
    ordinary, oracle = (calibrate(seen, BOARD, Options(model, guess=guess, shape=RIGID)) for guess in (None, truth))
    assert map_error(ordinary.camera, truth, seen) <= 1.1 * map_error(oracle.camera, truth, seen)
    assert ordinary.sigma_px == pytest.approx(NOISE, rel=0.1)
    known = ordinary.camera.covariance.diagonal() > 0
    errors = (ordinary.camera.parameters - truth.parameters)[known]
    assert np.abs(errors / np.sqrt(ordinary.camera.covariance.diagonal()[known])).max() < 4.5
    assert (ordinary.camera.projection_std(np.array([[640.0, 480.0], [900.0, 700.0]])) < 0.5).all()


@pytest.mark.parametrize("xi", [-0.3, 0.3])
def test_both_kinds_of_double_spheres_are_found(xi):
    truth = make_camera(MODELS["double_sphere"], SIZE, np.radians(WIDE), {"xi": xi, "alpha": 0.55})
    found = calibrate(seen_by(truth), BOARD, Options(MODELS["double_sphere"], shape=RIGID)).camera
    assert abs(found.value("xi") - xi) < 4 * found.std("xi")


@pytest.mark.parametrize("name", ["ucm", "eucm"])
def test_a_parameter_beyond_its_limits_is_held_there(name):
    truth = make_camera(MODELS["opencv4"], SIZE, np.radians(60), {"k1": 0.03})
    found = calibrate(seen_by(truth), BOARD, Options(MODELS[name], shape=RIGID)).camera
    assert (found.value("alpha"), found.std("alpha")) == (0.0, None)
    assert found.fixed == ("alpha",)


def test_a_lens_whose_focal_length_is_a_quotient_is_not_refused_for_one_of_its_two_parts():
    truth = make_camera(MODELS["mei"], SIZE, np.radians(40))
    found = calibrate(seen_by(truth, 20), BOARD, Options(MODELS["mei"], shape=RIGID)).camera
    assert found.std("fx") > 0.05 * found.value("fx")
    lengths, stds = found.focal_lengths()
    assert (stds < 0.01 * lengths).all()
    assert (np.abs(lengths - truth.focal_lengths()[0]) < 4 * stds).all()


def test_a_rig_has_cameras_of_different_models():
    left, right = (make_camera(MODELS[name], SIZE, np.radians(150)) for name in ("double_sphere", "eucm"))
    right_T_left = Pose.from_vector(np.array([0.01, -0.03, 0.005]), np.array([-0.12, 0.002, 0.004]))
    rig = Rig({"left": left, "right": right}, {"left": Pose.identity(), "right": right_T_left.inverse()})
    rng = np.random.default_rng(3)
    poses = captures(rig, BOARD, 16, rng=rng)
    rows = [
        observe(own, BOARD, [rig.rig_T_camera[name].inverse() @ pose for pose in poses], rng=rng, noise_px=NOISE)[
            0
        ].views
        for name, own in rig.cameras.items()
    ]
    seen = Captures(("left", "right"), tuple(map(str, range(16))), tuple(zip(*rows, strict=True)))
    models = {name: own.model for name, own in rig.cameras.items()}
    found = calibrate_rig(seen, BOARD, RigOptions(models, shape=RIGID))
    for name, own in rig.cameras.items():
        camera = found.calibrations[name].camera
        errors = (camera.parameters - own.parameters) / np.sqrt(camera.covariance.diagonal())
        assert camera.model is own.model
        assert np.abs(errors).max() < 4.5
    np.testing.assert_allclose(found.poses["right"].translation, right_T_left.translation, atol=5e-4)
