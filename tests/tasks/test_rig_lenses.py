"""Lens models of a rig: one for all cameras of a kind, and what is said of lenses that are given."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import CandidateModel
from camcal.calibrate.rigs.record import Captures
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.progress import SILENT
from camcal.quality.lens_choice import better_model
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_lenses import GivenLens, given_lenses, require_sizes, rig_models, starting, together

BOARD = Board("chessboard", 8, 6, 0.03)
NARROW = Camera(model_named("opencv5"), (640, 480), [600.0, 600, 320, 240, -0.1, 0.05, 1e-4, -1e-4, 0.0])
FISHEYE = Camera(model_named("kannala_brandt4"), (640, 480), [180.0, 180, 320, 240, 0.02, -0.01, 1e-3, -1e-4])
FLAT = ShapeOptions(smooth=False, offsets=False)


def captures(**cameras):
    rng = np.random.default_rng(4)
    found = [
        observe(camera, BOARD, views(camera, BOARD, 10, rng=rng), rng=rng, noise_px=0.1)[0]
        for camera in cameras.values()
    ]
    return Captures(tuple(cameras), tuple(map(str, range(10))), tuple(zip(*found, strict=True)))


@pytest.mark.slow
def test_a_fisheye_beside_narrow_lenses_gets_a_model_of_its_own():
    similar = replace(NARROW, parameters=NARROW.parameters * 1.01)
    seen = captures(left=NARROW, right=similar, top=FISHEYE)
    found = rig_models(seen, BOARD, RigSettings(), {}, FLAT, {})
    assert found.models["left"] is found.models["right"]
    assert found.models["top"].name.startswith("kannala_brandt")
    assert found.models["left"].name == "opencv5"
    assert set(found.candidates) == {("left", "right"), ("top",)}


def test_models_that_are_asked_for_are_taken_and_compared_with_the_usual_ones():
    seen = captures(left=NARROW, right=NARROW)
    found = rig_models(seen, BOARD, RigSettings(models=("opencv5", "right=fisheye")), {}, FLAT, {})
    assert {name: model.name for name, model in found.models.items()} == {
        "left": "opencv5",
        "right": "kannala_brandt4",
    }
    assert not found.candidates
    assert {own.name for own in found.candidates_of("left")} == {"opencv5", "kannala_brandt4"}
    assert better_model("opencv5", found.candidates_of("left")) is None
    assert better_model("kannala_brandt4", found.candidates_of("right")) is None


def test_a_model_that_was_asked_for_and_predicts_much_worse_is_told_by_a_usual_one():
    seen = captures(left=FISHEYE, right=FISHEYE)
    found = rig_models(seen, BOARD, RigSettings(models=("left=opencv12",)), {}, FLAT, {})
    assert better_model("opencv12", found.candidates_of("left")).name == "kannala_brandt4"
    assert better_model(found.models["right"].name, found.candidates_of("right")) is None


def test_lenses_that_are_held_are_compared_with_none():
    seen, known = captures(left=NARROW, right=NARROW), {name: GivenLens(NARROW, name) for name in ("left", "right")}
    found = rig_models(
        seen, BOARD, RigSettings(lenses="fixed", guess=("rig.yaml",), models=("opencv5",)), known, FLAT, {}
    )
    assert not found.beside
    assert list(found.candidates_of("left")) == []


def test_scores_of_cameras_together_are_those_of_all_their_views():
    one = CandidateModel("opencv5", np.array([3.0, 4.0]), 20, 0.3)
    other = CandidateModel("opencv5", np.array([1.0]), 20, 0.5)
    lost = CandidateModel("opencv8", reason="too few views")
    joint, failed = together([(one, lost), (other, CandidateModel("opencv8", np.array([9.0]), 20, 0.1))])
    assert joint.scores.tolist() == [3, 4, 1]
    assert joint.score == pytest.approx(8 / 40)
    assert joint.sigma_px == pytest.approx(np.sqrt((0.09 + 0.25) / 2))
    assert (failed.scores, failed.reason) == (None, "too few views")


def lens_file(path, **cameras):
    records = [{"file": "a.png", "camera": name, "sha256": f"hash of {name}"} for name in cameras]
    entries = {name: CameraEntry(camera) for name, camera in cameras.items()}
    native.write(path, CameraFile(entries, provenance={"images": records}))
    return path


def test_lenses_are_given_by_the_names_of_cameras_or_one_by_one(tmp_path):
    both = lens_file(tmp_path / "both.yaml", left=NARROW, right=FISHEYE)
    alone = lens_file(tmp_path / "alone.yaml", camera=FISHEYE)
    names = ("left", "right")
    found = given_lenses(RigSettings(guess=(str(both),)), names, SILENT)
    assert {name: lens.camera.model.name for name, lens in found.items()} == {
        "left": "opencv5",
        "right": "kannala_brandt4",
    }
    assert found["left"].images == {"hash of left"}
    found = given_lenses(RigSettings(guess=(str(both), f"left={alone}")), names, SILENT)
    assert found["left"].camera.model.name == "kannala_brandt4"
    assert found["left"].images == {"hash of camera"}
    found = given_lenses(RigSettings(guess=(f"left={both}#right",)), names, SILENT)
    assert list(found) == ["left"]


@pytest.mark.parametrize(
    ("lenses", "guess", "message"),
    [
        ("fixed", "left={0}/alone.yaml", "--lenses fixed: no lens of camera 'right': add --guess right=FILE"),
        ("prior", "{0}/both.yaml", r"has no covariance: use --lenses fixed, or joint \(camera left\)"),
        ("joint", "{0}/alone.yaml", "has the cameras camera, the rig left, right: use --guess NAME=FILE"),
        ("joint", "{0}/both.yaml#left", "one camera of a file is given as NAME=FILE#CAMERA"),
        ("joint", "top={0}/both.yaml", "no camera 'top' in the rig"),
    ],
)
def test_lenses_that_are_not_enough_are_refused(tmp_path, lenses, guess, message):
    lens_file(tmp_path / "both.yaml", left=NARROW, right=FISHEYE)
    lens_file(tmp_path / "alone.yaml", camera=FISHEYE)
    settings = RigSettings(lenses=lenses, guess=(guess.format(tmp_path),))
    with pytest.raises(InvalidInput, match=message):
        given_lenses(settings, ("left", "right"), SILENT)


def test_a_lens_for_images_of_another_size_is_named(tmp_path):
    half = replace(NARROW, image_size=(320, 240))
    path = lens_file(tmp_path / "both.yaml", left=NARROW, right=half)
    given = given_lenses(RigSettings(guess=(str(path),)), ("left", "right"), SILENT)
    with pytest.raises(InvalidInput, match="the lens is for 320x240 images, those of camera right are 640x480"):
        require_sizes(given, captures(left=NARROW, right=NARROW))


def test_a_held_lens_keeps_its_model(tmp_path):
    path = lens_file(tmp_path / "both.yaml", left=NARROW, right=FISHEYE)
    settings = RigSettings(lenses="fixed", guess=(str(path),), models=("right=opencv5",))
    given = given_lenses(settings, ("left", "right"), SILENT)
    with pytest.raises(InvalidInput, match="--model opencv5: --lenses fixed has kannala_brandt4"):
        rig_models(captures(left=NARROW, right=FISHEYE), BOARD, settings, given, FLAT, {})


def test_a_start_takes_over_what_two_models_have_in_common():
    found = starting(NARROW, model_named("opencv8"))
    assert found.model.name == "opencv8"
    assert [found.value(name) for name in ("fx", "cy", "k1", "p2", "k6")] == [600, 240, -0.1, -1e-4, 0]
    assert starting(NARROW, NARROW.model) is NARROW
