"""A lens for every colour, from corners with known noise: what is recovered, how well it is known, what is refused.

Corners are drawn, not photographed; how well they are found in a colour's samples is tested in tests/tasks.
"""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.channels import aberration, fit_colour
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.simulate.mosaics import lenses
from camcal.simulate.render import bow
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

SIZE = (1600, 1200)
GREEN = Camera(model_named("opencv5"), SIZE, np.array([1200.0, 1205, 805, 590, -0.12, 0.06, 5e-4, -3e-4, 0.01]))
BOARD = Board("chessboard", 9, 6, 0.04)
NOISE_PX = 0.05


@pytest.fixture(scope="module")
def poses():
    return views(GREEN, BOARD, 12, rng=np.random.default_rng(1))


def fit_red(green, views):
    """Return the lens of red that shows these views, one for each of the green calibration."""
    return fit_colour(green, [BoardDetection(view.image, view.size, colours={"red": view}) for view in views], "red")


def seen(camera, poses, seed, board=BOARD, **how):
    how = {"noise_px": NOISE_PX, "inside": False} | how
    return observe(camera, board, poses, rng=np.random.default_rng(seed), **how)[0].views


def calibrated(poses, seed=1, model="opencv5", **how):
    return calibrate(seen(GREEN, poses, seed, **how), BOARD, Options(model_named(model)))


def displacement(green, colour):
    """How far a colour lies from green, over a lattice of pixels of the whole image."""
    pixels = np.stack(np.meshgrid(np.linspace(0, SIZE[0] - 1, 9), np.linspace(0, SIZE[1] - 1, 7)), axis=-1)
    pixels = pixels.reshape(-1, 2)
    return colour.project(green.unproject(pixels).directions).pixels - pixels


def test_half_a_pixel_of_aberration_is_recovered_all_over_the_image(poses):
    green = calibrated(poses)
    for colour, sign, seed in (("R", 1, 2), ("B", -1, 3)):
        true = lenses(GREEN, 0.5)[colour]
        lens = fit_red(green, seen(true, poses, seed))
        errors = displacement(green.camera, lens.camera) - displacement(GREEN, true)
        assert np.linalg.norm(errors, axis=1).max() < 0.02  # px; 4σ of a scale and a shift from 1296 coordinates
        found = aberration(green.camera, lens)
        assert found.corner_px == pytest.approx(sign * 0.5, abs=4 * found.corner_std_px)
        assert 0 < found.corner_std_px < 0.01
        assert lens.terms == ("fx", "fy", "cx", "cy")
        assert lens.sigma_px == pytest.approx(NOISE_PX, rel=0.1)  # 4σ of 1287 degrees of freedom


def test_an_aberration_that_grows_with_the_cube_of_the_radius_takes_more_terms(poses):
    true = replace(GREEN, parameters=GREEN.parameters + 2e-3 * (np.arange(9) == 4))
    lens = fit_red(calibrated(poses, noise_px=0.01), seen(true, poses, 2, noise_px=0.01))
    assert lens.terms == ("fx", "fy", "cx", "cy", "k1", "p1", "p2")
    assert lens.camera.value("k1") - GREEN.value("k1") == pytest.approx(2e-3, abs=2e-4)


def test_no_aberration_is_found_where_there_is_none(poses):
    green = calibrated(poses)
    found = aberration(green.camera, fit_red(green, seen(GREEN, poses, 2)))
    assert abs(found.corner_px) < 4 * found.corner_std_px
    assert found.largest_px < 0.02


@pytest.mark.slow
def test_the_uncertainty_of_the_difference_is_the_true_one(poses):
    """The squared error of the four parameters over their covariance is 4 on average."""
    true = lenses(GREEN, 0.5)["R"]
    flat = Options(GREEN.model, guess=GREEN, shape=ShapeOptions(smooth=False, offsets=False))  # soon done
    squared = []
    for seed in range(30):
        green = calibrate(seen(GREEN, poses[:6], 2 * seed), BOARD, flat)
        lens = fit_red(green, seen(true, poses[:6], 2 * seed + 1, noise_px=2 * NOISE_PX))
        part = slice(0, 4)
        error = (lens.camera.parameters - green.camera.parameters - (true.parameters - GREEN.parameters))[part]
        squared.append(error @ np.linalg.solve(lens.difference_covariance[part, part], error))
    assert np.mean(squared) == pytest.approx(4, abs=4 * np.sqrt(8 / 30))  # 4σ of the mean of 30 χ² of 4 degrees


def test_a_noisy_colour_knows_its_lens_worse_than_green(poses):
    green = calibrated(poses)
    lens = fit_red(green, seen(lenses(GREEN, 0.5)["B"], poses, 2, noise_px=4 * NOISE_PX))
    assert lens.camera.std("fx") > green.camera.std("fx")
    assert np.linalg.eigvalsh(lens.difference_covariance).min() > -1e-12  # rounding


def test_wrong_corners_of_a_colour_are_rejected(poses):
    true = lenses(GREEN, 0.5)["R"]
    green = calibrated(poses)
    lens = fit_red(green, seen(true, poses, 2, outliers=0.05))
    assert 0.02 * 648 < lens.rejected < 0.09 * 648
    errors = displacement(green.camera, lens.camera) - displacement(GREEN, true)
    assert np.linalg.norm(errors, axis=1).max() < 0.02


@pytest.mark.parametrize(("deviations", "rejected"), [(3.5, 0), (6.0, 10)])
def test_corners_of_a_colour_are_rejected_beyond_four_and_a_half_standard_deviations(poses, deviations, rejected):
    colour = list(seen(GREEN, poses, 2))
    exact = seen(GREEN, poses, 2, noise_px=0.0)
    for index in range(10):
        pixels = colour[index].pixels.copy()
        pixels[20] = exact[index].pixels[20] + [deviations * NOISE_PX, 0.0]
        colour[index] = replace(colour[index], pixels=pixels)
    lens = fit_red(calibrated(poses), colour)
    assert lens.rejected == rejected
    assert lens.points == 648 - rejected


def test_the_difference_of_a_colour_has_the_noise_of_both(poses):
    """By the same corners and views: four times the noise of green gives 17 times the variance, no noise once."""
    green = calibrated(poses)
    quiet, noisy = (fit_red(green, seen(GREEN, poses, 2, noise_px=factor * NOISE_PX)) for factor in (0.01, 4.0))
    assert quiet.terms == noisy.terms
    ratio = noisy.difference_covariance[0, 0] / quiet.difference_covariance[0, 0]
    assert ratio == pytest.approx(17, rel=0.2)  # 4σ of the noise of 1292 degrees of freedom


def test_the_bend_of_the_board_and_missing_corners_do_not_matter(poses):
    shape = bow(1e-3, 5e-4)
    true = lenses(GREEN, 0.5)["R"]
    green = calibrated(poses, shape=shape)
    colour = [
        replace(view, ids=view.ids[:: 1 + index % 2], pixels=view.pixels[:: 1 + index % 2])
        for index, view in enumerate(seen(true, poses, 2, shape=shape))
    ]
    colour[3] = BoardDetection(colour[3].image, SIZE, reason="too dark in red")
    errors = displacement(green.camera, fit_red(green, colour).camera) - displacement(GREEN, true)
    assert np.linalg.norm(errors, axis=1).max() < 0.025  # px; fewer corners


def test_views_of_a_symmetric_board_are_numbered_as_green_numbered_them(poses):
    # the cubic bend has not the symmetry of the pattern, so that a view numbered from the other end does not fit
    board, shape = Board("chessboard", 9, 7, 0.035), replace(bow(2e-3, 1e-3), cubic=2e-3)
    turn = board.symmetries()[1]

    def numbered(views):
        return [replace(view, ids=turn[view.ids]) if index % 3 == 1 else view for index, view in enumerate(views)]

    poses = views(GREEN, board, 12, rng=np.random.default_rng(4))
    green = calibrate(numbered(seen(GREEN, poses, 1, board, shape=shape)), board, Options(model_named("opencv5")))
    true = lenses(GREEN, 0.5)["R"]
    lens = fit_red(green, numbered(seen(true, poses, 2, board, shape=shape)))
    assert any(view.symmetry for view in green.views)
    errors = displacement(green.camera, lens.camera) - displacement(GREEN, true)
    assert np.linalg.norm(errors, axis=1).max() < 0.02


def test_parameters_that_green_held_stay_held(poses):
    green = calibrate(seen(GREEN, poses, 1), BOARD, Options(model_named("opencv5"), fixed=("k3", "p1")))
    lens = fit_red(green, seen(lenses(GREEN, 2.0)["R"], poses, 2))
    assert lens.camera.fixed == green.camera.fixed
    assert (lens.camera.value("k3"), lens.camera.value("p1")) == (0, 0)


@pytest.mark.slow
def test_a_rational_lens_and_a_fisheye_have_channels_too(poses):
    true = lenses(GREEN, 0.5)["R"]
    for model in ("opencv8", "kannala_brandt4"):
        green = calibrated(poses, model=model, noise_px=0.02)
        lens = fit_red(green, seen(true, poses, 2, noise_px=0.02))
        assert aberration(green.camera, lens).corner_px == pytest.approx(0.5, abs=0.02)


def test_too_few_corners_of_a_colour_are_refused_with_how_many_it_takes(poses):
    green = calibrated(poses)
    nothing = [BoardDetection(view.image, SIZE, reason="dark") for view in green.views]
    with pytest.raises(InsufficientData, match="only 0 corners of a colour are clear; 45 at least"):
        fit_red(green, nothing)
