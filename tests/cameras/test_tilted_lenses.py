"""Any lens on a tilted sensor: by its name, through files, and calibrated."""

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.directions import lens_difference
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.nearest import prepared
from camcal.formats.cameras.record import expressed
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board

SIZE = (1280, 960)
BOARD = Board("chessboard", 9, 6, 0.040)
TILT = {"tau_x": 0.05, "tau_y": -0.03}  # rad: 3.3 degrees


def test_a_lens_is_tilted_by_its_name_or_an_alias():
    tilted = model_named("radtan_tilted")
    assert tilted is MODELS["opencv4_tilted"] is model_named("opencv4_tilted")
    assert tilted.parameter_names == (*MODELS["opencv4"].parameter_names, "tau_x", "tau_y")
    assert tilted.opencv == ""
    assert model_named("fisheye_tilted") is not model_named("fisheye")


@pytest.mark.parametrize(
    "name", ["opencv14", "opencv5_tilted", "ocam", "splined_stereographic", "equirectangular", "nothing"]
)
def test_what_is_tilted_sheared_or_no_parametric_lens_has_no_tilted_form(name):
    assert f"{name}_tilted" not in MODELS
    assert f"{name}_tilted" not in list(MODELS)
    with pytest.raises(InvalidInput, match=f"'{name}_tilted' is unknown"):
        model_named(f"{name}_tilted")


def test_a_tilted_lens_is_seen_through_the_homography_of_the_sensor():
    plain = make_camera(MODELS["eucm"], SIZE, np.radians(150))
    tilted = Camera(MODELS["eucm_tilted"], SIZE, np.concatenate([plain.parameters, [*TILT.values()]]))
    of_plane = Camera(MODELS["opencv14"], SIZE, [*plain.parameters[:4], *(0.0,) * 12, *TILT.values()])
    theta, azimuth = np.linspace(0, 1.0, 40), np.linspace(0, 6, 40)
    points = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    places = (plain.project(points).pixels - plain.parameters[2:4]) / plain.parameters[:2]
    expected = of_plane.project(np.column_stack([places, np.ones(40)])).pixels
    np.testing.assert_allclose(tilted.project(points).pixels, expected, atol=1e-9)


def test_a_lens_that_is_tilted_alone_is_no_pinhole():
    for name in ("pinhole", "ucm", "eucm", "double_sphere", "division"):
        model = MODELS[f"{name}_tilted"]
        parameters = model.start(SIZE, 900.0)
        parameters[4:] = 0.0
        assert model.is_pinhole(parameters) == (name != "double_sphere" or MODELS[name].is_pinhole(parameters[:-2]))
        parameters[-2] = 0.1
        assert not model.is_pinhole(parameters)


def test_a_tilted_lens_of_opencv_is_one_of_fourteen_coefficients():
    own = make_camera(MODELS["opencv8_tilted"], SIZE, 1.2, {"k1": -0.1, **TILT})
    found = expressed(own, ("opencv5", "opencv14"))
    assert found.model.name == "opencv14"
    points = np.column_stack([np.random.default_rng(1).uniform(-0.5, 0.5, (20, 2)), np.ones(20)])
    np.testing.assert_allclose(found.project(points).pixels, own.project(points).pixels, atol=1e-9)
    assert expressed(own, ("opencv5", "opencv8")) is None


def test_a_camera_file_has_a_tilted_lens_and_other_formats_refuse_it_with_the_ways_out(tmp_path):
    own = make_camera(MODELS["double_sphere_tilted"], SIZE, np.radians(150), {"xi": -0.2, "alpha": 0.55, **TILT})
    file = CameraFile({"camera": CameraEntry(own)})
    native.write(tmp_path / "camera.yaml", file)
    found = native.read(tmp_path / "camera.yaml").cameras["camera"].camera
    assert found.model is own.model
    np.testing.assert_allclose(found.parameters, own.parameters, rtol=1e-11)
    assert prepared(file, FORMATS["camcal"], "x").file.cameras["camera"].camera.model is own.model
    with pytest.raises(InvalidInput, match=r"tau_x = 0\.05.*--max-error .*camcal undistort"):
        prepared(file, FORMATS["kalibr"], "x")
    text = (tmp_path / "camera.yaml").read_text().replace("double_sphere_tilted", "opencv14_tilted")
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(InvalidInput, match=r"unknown model 'opencv14_tilted'\. Did you mean"):
        native.read(tmp_path / "wrong.yaml")


@pytest.mark.parametrize(
    ("name", "fov"), [("opencv4", 60), ("opencv8", 90), ("kannala_brandt4", 150), ("double_sphere", 150), ("eucm", 120)]
)
def test_a_tilted_lens_is_calibrated_as_well_as_from_the_truth(name, fov):
    model = MODELS[f"{name}_tilted"]
    plain = make_camera(MODELS[name], SIZE, np.radians(fov))
    truth = Camera(model, SIZE, np.concatenate([plain.parameters, [*TILT.values()]]))
    poses = views(truth, BOARD, 20, rng=np.random.default_rng(1))
    seen = observe(truth, BOARD, poses, rng=np.random.default_rng(101), noise_px=0.15)[0].views
    rigid = ShapeOptions(smooth=False)
    found, oracle = (calibrate(seen, BOARD, Options(model, guess=guess, shape=rigid)) for guess in (None, truth))
    pixels = np.concatenate([view.pixels for view in seen])[::10]
    errors = [
        np.sqrt(np.nanmean((lens_difference(truth, each.camera, pixels) ** 2).sum(axis=1))) for each in (found, oracle)
    ]
    assert errors[0] <= 1.1 * errors[1]
    assert found.sigma_px == pytest.approx(0.15, rel=0.1)
    apart = (found.camera.parameters - truth.parameters) / np.sqrt(found.camera.covariance.diagonal())
    assert np.abs(apart).max() < 4.5
