"""A lens model needs one file and one line: once it is registered, everything that concerns lenses knows it.

What every registered model promises stands in tests/contracts/test_models.py, where the same model is among them.
"""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from formats_page import PAGE, with_models
from toy_model import TOY

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.validity import folds_inside
from camcal.cli.main import app
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board
from camcal.tasks.options import lens_models

SIZE = (1280, 960)
TRUTH = Camera(TOY, SIZE, [420.0, 421, 642, 476, 0.6, 1.15, -0.02, 0.0])
BOARD = Board("chessboard", 9, 6, 0.040)
RIGID = ShapeOptions(smooth=False)


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    monkeypatch.setitem(sys.modules, "camcal.cameras.toy_model", SimpleNamespace(MODELS=(TOY,)))
    monkeypatch.setitem(MODELS.files, TOY.name, "toy_model")


@pytest.fixture(scope="module")
def seen():
    poses = views(TRUTH, BOARD, 20, rng=np.random.default_rng(5))
    return observe(TRUTH, BOARD, poses, rng=np.random.default_rng(6), noise_px=0.1)[0].views


@pytest.fixture(scope="module")
def calibrated(seen):
    return calibrate(seen, BOARD, Options(TOY, shape=RIGID))


def test_it_is_found_by_name_and_alias():
    assert model_named("toy") is model_named("plaything") is TOY
    with pytest.raises(InvalidInput, match="did you mean 'plaything'"):
        model_named("playthin")


def test_a_camera_is_calibrated_without_a_hint(calibrated):
    errors = calibrated.camera.parameters - TRUTH.parameters
    assert np.abs(errors / np.sqrt(np.diag(calibrated.camera.covariance))).max() < 4
    assert calibrated.sigma_px == pytest.approx(0.1, rel=0.1)
    # α, β and k1 do nearly the same to a lens; what they do together is known
    corners = np.array([[100.0, 100], [1180, 100], [640, 60], [100, 480]])
    rays = TRUTH.unproject(corners).directions
    np.testing.assert_allclose(calibrated.camera.unproject(corners).directions, rays, atol=1e-3)


def test_its_parameters_can_be_held_where_its_start_has_them(seen):
    found = calibrate(seen, BOARD, Options(TOY, fixed=("k2",), shape=RIGID)).camera
    assert (found.value("k2"), found.std("k2")) == (0.0, None)
    assert abs(found.value("alpha") - 0.6) < 4 * found.std("alpha")


def test_its_priors_are_about_its_start(seen):
    spread = TOY.prior_std(SIZE, 420.0)
    problem = BoardProblem(TOY, BOARD, Observations.of(seen), np.arange(8), lens_spread=spread)
    start = State(TOY.start(SIZE, 420.0), np.zeros((20, 3, 3)), np.zeros((20, 3)), np.zeros(0), np.zeros((54, 3)))
    assert not problem.priors(start)[0].residuals.any()
    moved = replace(start, parameters=start.parameters + np.array([9.0, 9, 9, 9, 0.25, -0.5, 0, 0]))
    # half a standard deviation each; focal lengths and principal point have no prior
    np.testing.assert_allclose(problem.priors(moved)[0].residuals[:, 0], [0, 0, 0, 0, 0.5, -0.5, 0, 0])


def test_its_camera_file_says_the_same_when_read_back(tmp_path, calibrated):
    path = tmp_path / "toy.yaml"
    native.write(path, CameraFile({"camera": CameraEntry(calibrated.camera)}))
    back = native.read(path).cameras["camera"].camera
    assert back.model is TOY
    np.testing.assert_allclose(back.parameters, calibrated.camera.parameters, rtol=1e-11)
    np.testing.assert_allclose(back.covariance, calibrated.camera.covariance, rtol=1e-9)


def test_a_file_with_a_value_outside_its_limits_is_refused(tmp_path):
    path = tmp_path / "toy.yaml"
    native.write(path, CameraFile({"camera": CameraEntry(TRUTH)}))
    path.write_text(path.read_text().replace("alpha: 0.6", "alpha: 1.6"))
    with pytest.raises(InvalidInput, match=r"distortion\.alpha: 1\.6 is outside \[0, 1\]"):
        native.read(path)


def test_a_typical_one_is_simulated():
    camera = make_camera(TOY, SIZE, np.radians(150))
    assert (camera.value("alpha"), camera.value("k1")) == (0.55, -0.01)
    edges = camera.unproject(np.array([[-0.5, camera.value("cy")], [SIZE[0] - 0.5, camera.value("cy")]]))
    assert edges.valid.all()
    assert not folds_inside(camera).folds


def test_the_commands_take_it_and_their_help_names_it(tmp_path, capsys):
    assert "toy (plaything)" in lens_models()
    output = tmp_path / "scene"
    words = ["simulate", "chessboard:9x6:25mm", "-o", str(output), "--model", "toy", "--size", "160x120"]
    with pytest.raises(SystemExit) as ended:
        app([*words, "--views", "2", "--jobs", "1", "--quiet"])
    assert ended.value.code == 0, capsys.readouterr().err
    assert native.read(output / "truth.yaml").cameras["camera"].camera.model is TOY


def test_the_page_of_formats_has_its_row():
    page = with_models(PAGE.read_text(encoding="utf-8"), MODELS.values())
    assert "| `toy` | alpha beta k1 k2 | a model of the tests | `plaything` |" in page
