"""What a gross misfit is put down to where corners are in the order of the board: the lens model, or blurred images."""

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.refusals import Misfit, require_fit
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.040)
IMAGES = [f"{index}.png" for index in range(4)]
FLAT = ShapeOptions(smooth=False, offsets=False)
CAMERAS = {
    "pinhole": [1200.0, 1200, 799.5, 599.5],
    "kannala_brandt4": [520.0, 520, 799, 599, 0.02, -0.01, 0.004, 0.0],
}


@pytest.mark.parametrize(
    ("smoothness", "words"),
    [
        (1.75, "and residuals are random, as in blurred images: use sharper images, and check the corners"),
        (1.85, r"and residuals vary smoothly, so the lens model \(opencv5\) does not fit"),
    ],
)
def test_smooth_errors_are_the_lens_models_and_random_ones_those_of_images(smoothness, words):
    distances, sides, present = np.full((4, 50), 20.0), np.full(4, 100.0), np.ones((4, 50), bool)
    with pytest.raises(InsufficientData, match=f"corner ids are consistent {words}"):
        require_fit(Misfit(distances, sides, present, 0.02, smoothness), IMAGES, 0.1, "opencv5")


def seen_by(name, noise_px):
    camera = Camera(model_named(name), (1600, 1200), np.array(CAMERAS[name]))
    rng = np.random.default_rng(1)
    return observe(camera, BOARD, views(camera, BOARD, 12, rng=rng), rng=rng, noise_px=noise_px)[0].views


def test_blurred_images_are_refused_for_their_blur():
    with pytest.raises(
        InsufficientData,
        match="and residuals are random, as in blurred images: use sharper images, and check the corners",
    ):
        calibrate(seen_by("pinhole", 3.0), BOARD, Options(model_named("pinhole"), shape=FLAT))


@pytest.mark.slow
def test_a_fisheye_is_refused_for_its_model():
    with pytest.raises(InsufficientData, match=r"residuals vary smoothly, so the lens model \(opencv4\) does not fit"):
        calibrate(seen_by("kannala_brandt4", 0.1), BOARD, Options(model_named("opencv4"), shape=FLAT))
