"""What residuals of different views share is the lens's; what one view has to itself is not."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.intrinsics import Calibration, Options, RejectedCorner, View
from camcal.cameras.catalogue import SPLINE_MODEL, model_named
from camcal.cameras.directions import in_hull
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.quality.lens_choice import radial_pattern, shared_pattern
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board, Surface
from camcal.tasks.calibration.model_selection import select, solve_given

SIZE = (1000, 800)
MIDDLE = np.array([499.5, 399.5])
BOARD = Board("chessboard", 9, 6, 0.030)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([900.0, 900.0, *MIDDLE]))
SIGMA = 0.1
HERE, THERE = np.array([249.5, 249.5]), np.array([749.5, 549.5])  # in the middle of two cells


def calibration_of(pixels, residuals, rows):
    names = [f"{row:02d}.png" for row in range(max(rows) + 1)]
    seen = tuple(View(name, 54, int(np.sum(np.equal(rows, row)))) for row, name in enumerate(names))
    arrays = np.array(residuals, float), np.array(pixels, float), np.array(rows)
    return Calibration(CAMERA, BOARD, Surface(BOARD), seen, (), SIGMA, 300, 0.2, *arrays, 5)


def agreeing(count, size=1.0, place=HERE):
    """One corner of every view at one place, with the same residual."""
    return [place] * count, [[0.6 * size, 0.8 * size]] * count, list(range(count))


def together(*parts):
    return calibration_of(*([each for own in values for each in own] for values in zip(*parts, strict=True)))


def test_what_eleven_views_share_is_no_chance_and_what_ten_share_may_be():
    assert shared_pattern(calibration_of(*agreeing(10)), MIDDLE[None], 0.1) is None
    found = shared_pattern(calibration_of(*agreeing(11)), np.stack([HERE, THERE]), 0.1)
    assert found.largest_px == pytest.approx(1.0)
    assert found.words.endswith("by 1.00 px near (250, 250)")
    np.testing.assert_allclose(found.bias, [[0.6, 0.8], [0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(("stated_px", "named"), [(2.7, True), (3.3, False)])
def test_what_the_map_states_is_no_pattern(stated_px, named):
    assert (shared_pattern(calibration_of(*agreeing(20)), HERE[None], stated_px) is not None) == named


@pytest.mark.parametrize(("few", "largest"), [(2, 1.0), (3, 2.0)])
def test_a_place_that_three_views_saw_counts(few, largest):
    found = shared_pattern(together(agreeing(20), agreeing(few, 2.0, THERE)), HERE[None], 0.1)
    assert found.largest_px == pytest.approx(largest)


def test_a_rejected_corner_counts_with_ten_standard_deviations_at_most():
    kept = calibration_of(*agreeing(20, 0.5))
    lost = [RejectedCorner(view.image, 7, THERE, np.array([9.0, -12.0])) for view in kept.views]
    found = shared_pattern(replace(kept, rejected=tuple(lost)), THERE[None], 0.1)
    assert found.largest_px == pytest.approx(10 * SIGMA)
    np.testing.assert_allclose(found.bias, [[6 * SIGMA, -8 * SIGMA]])
    # neither does that of a view that is not used, nor one that the lens cannot take
    elsewhere = [replace(own, image="other.png") for own in lost[1:]]
    unknown = replace(lost[0], residual=np.full(2, np.nan))
    alone = shared_pattern(replace(kept, rejected=(unknown, *elsewhere)), THERE[None], 0.1)
    assert alone.largest_px == pytest.approx(0.5)


def test_residuals_that_point_outwards_are_a_bias_along_the_radius_as_large_beyond_them():
    rng = np.random.default_rng(1)
    pixels = MIDDLE + rng.uniform(-200, 200, (400, 2))
    outwards = pixels - MIDDLE
    radius = np.linalg.norm(outwards, axis=1, keepdims=True)
    rows = np.repeat(np.arange(20), 20)
    found = radial_pattern(calibration_of(pixels, 1e-3 * outwards, rows), np.add(MIDDLE, [[150.0, 0.0], [0.0, 390.0]]))
    assert found.largest_px == pytest.approx(1e-3 * np.quantile(radius, 15 / 16), rel=0.05)
    assert found.bias[0, 0] == pytest.approx(0.15, rel=0.05)
    assert found.bias[1, 1] == pytest.approx(found.largest_px)
    np.testing.assert_allclose(found.bias[[0, 1], [1, 0]], 0, atol=1e-9)


LENS = Camera(
    model_named("kannala_brandt4"), (1280, 960), np.array([520, 520, 642.3, 477.1, -0.012, 4e-3, -2e-3, 3e-4])
)
DENT, WIDTH = np.array([900.0, 380.0]), 90.0


def dented(pixels, depth_px):
    """Pixels of the lens with a dent of a depth, px."""
    depth = depth_px * np.exp(-0.5 * np.sum((pixels - DENT) ** 2, axis=1) / WIDTH**2)
    return pixels + depth[:, None] * [0.8, 0.6]


def waved(pixels, height_px):
    """Pixels of a lens whose focal length rises and falls on the way outwards."""
    centre = LENS.parameters[2:4]
    radius = np.linalg.norm(pixels - centre, axis=1, keepdims=True)
    return pixels + height_px * np.sin(2 * np.pi * radius / 300) * (pixels - centre) / np.maximum(radius, 1e-9)


def views_by(change):
    """A board, and what is seen of it by the lens with its pixels changed."""
    rng = np.random.default_rng(1)
    board = Board("chessboard", 10, 7, 0.030)
    seen, _ = observe(LENS, board, views(LENS, board, 30, rng=rng), rng=rng, noise_px=0.1)
    return board, [replace(own, pixels=change(own.pixels)) for own in seen.views]


@pytest.fixture(scope="module")
def dented_views():
    return views_by(lambda pixels: dented(pixels, 4.0))


@pytest.fixture(scope="module")
def waved_views():
    return views_by(lambda pixels: waved(pixels, 3.0))


OPTIONS = Options(LENS.model)


def test_a_lens_with_a_dent_is_calibrated_as_a_spline(dented_views):
    board, seen = dented_views
    found = select(seen, board, OPTIONS)
    assert found.calibration.camera.model.name == SPLINE_MODEL
    assert found.assessment.trustworthy
    assert found.calibration.rms_px < 0.16  # √2 × noise


def test_a_lens_that_no_parametric_model_fits_is_not_two_cameras_and_calibrated_as_a_spline(waved_views):
    board, seen = waved_views
    found = select(seen, board, OPTIONS)
    assert found.calibration.camera.model.name == SPLINE_MODEL
    assert found.assessment.trustworthy
    assert found.calibration.rms_px < 0.16
    u, v = (np.ravel(each) for each in np.meshgrid(np.arange(40.0, 1280, 40), np.arange(40.0, 960, 40)))
    grid = np.column_stack([u, v])[in_hull(np.column_stack([u, v]), np.concatenate([own.pixels for own in seen]))]
    rays = LENS.unproject(grid).directions
    off = found.calibration.camera.project(rays).pixels - waved(grid, 3.0)
    assert np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)) < 0.1


def test_a_parametric_lens_that_does_not_fit_is_refused_with_the_spline_as_the_remedy(waved_views):
    board, seen = waved_views
    with pytest.raises(InsufficientData) as caught:
        solve_given(seen, board, OPTIONS)
    assert caught.value.failures[0].code == "lens_model_does_not_fit"
    assert f"use --model {SPLINE_MODEL}, which passes" in caught.value.message


def test_a_parametric_lens_for_one_with_a_dent_is_refused_where_it_is_and_the_spline_named(dented_views):
    board, seen = dented_views
    [refusal] = solve_given(seen, board, OPTIONS).assessment.failures
    assert refusal.code == "lens_model"
    u, v = map(float, refusal.text.split("near (")[1].split(")")[0].split(", "))
    assert np.hypot(*(np.array([u, v]) - DENT)) < 1.5 * WIDTH
    assert f"use --model {SPLINE_MODEL}, which passes" in refusal.text
