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
    "opencv8": [700.0, 702.0, 805.0, 590.0, 1.2, 0.3, 0.0005, -0.0003, 0.01, 1.6, 0.65, 0.05],
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


@pytest.mark.parametrize(("outwards", "lens"), [(0.4, False), (0.79, False), (0.81, True), (1.0, True)])
@pytest.mark.parametrize("rough", [False, True])
def test_wrong_corners_far_from_the_centre_are_the_lens_models_and_wrong_ones_anywhere_those_of_images(
    outwards, lens, rough
):
    distances, sides, present = np.zeros((4, 50)), np.full(4, 100.0), np.ones((4, 50), bool)
    distances[:, :10] = 20.0
    found = Misfit(distances, sides, present, 0.35 if rough else 0.02, 1.2, outwards)
    with pytest.raises(InsufficientData) as caught:
        require_fit(found, IMAGES, 0.1, "opencv5")
    words = "the wrong ones are far from the image centre, so the lens model (opencv5) does not fit"
    assert (words in caught.value.message) == (lens and not rough)
    assert ("many views have wrong corners" in caught.value.message) == (not lens or rough)


@pytest.mark.parametrize(("share", "outside"), [(0.0, 1.0), (0.15, 0.5)])
def test_how_far_out_wrong_corners_are_is_the_probability_to_be_farther_than_right_ones(share, outside):
    camera = Camera(model_named("opencv8"), (1600, 1200), np.array(CAMERAS["opencv8"]))
    rng = np.random.default_rng(2)
    lens = camera if share == 0 else Camera(model_named("pinhole"), (1600, 1200), np.array(CAMERAS["pinhole"]))
    poses = views(lens, BOARD, 12, rng=rng)
    seen = observe(lens, BOARD, poses, rng=rng, noise_px=0.1, outliers=share, outlier_px=20.0)[0].views
    options = Options(model_named("opencv5"), shape=FLAT)
    with pytest.raises(InsufficientData) as caught:
        calibrate(seen, BOARD, options)
    assert ("far from the image centre" in caught.value.message) == (outside > 0.9)


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
