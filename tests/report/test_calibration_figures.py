"""Figures of a calibration: what is drawn is what was found, with units, numbers and room for all texts."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drawn_figures import require_readable
from matplotlib.collections import QuadMesh
from matplotlib.quiver import Quiver
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from camcal.calibrate import intrinsics
from camcal.calibrate.intrinsics import CandidateModel
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.report.figures import image_plane
from camcal.report.figures.board import poses
from camcal.report.figures.calibration import calibration_plots, correlation_matrix, residuals_by_view, short_name
from camcal.report.figures.figure import DARK, LIGHT, drawn, encoded, encoded_in
from camcal.simulate.scene import Shape, observe, views
from camcal.targets.board import Board

SIZE, NOISE = (1280, 960), 0.1
NAMES = (
    "projection_uncertainty",
    "uncertainty_over_distance",
    "residual_vectors",
    "residuals_over_radius",
    "residuals_by_view",
    "residual_histogram",
    "coverage",
    "board_shape",
    "board_height",
    "poses",
    "correlations",
    "lens_models",
)
CANDIDATES = (
    CandidateModel("pinhole", reason="not converged"),
    CandidateModel("opencv5", np.array([-10.0, -11.0]), 100, 0.09),
    CandidateModel("kannala_brandt4", np.array([-20.0, -21.0]), 100, 1.2),
)


@cache
def calibrated():
    """A bent board, and one view whose corners are displaced by some pixels, so that it is rejected."""
    board = Board("chessboard", 9, 6, 0.025)
    camera = Camera(model_named("opencv5"), SIZE, np.array([900.0, 902.0, 645.0, 470.0, -0.1, 0.05, 5e-4, -3e-4, 0.0]))
    rng = np.random.default_rng(5)
    poses = views(camera, board, 12, rng=rng)
    seen = list(observe(camera, board, poses, rng=rng, noise_px=NOISE, shape=Shape(bow_x=2e-3))[0].views)
    moved = seen[4].pixels + rng.normal(0, 15, seen[4].pixels.shape)
    seen[4] = replace(seen[4], pixels=np.clip(moved, 1, np.array(SIZE) - 2))
    return intrinsics.calibrate(seen, board, intrinsics.Options(model_named("opencv5")))


@cache
def plots():
    found = calibrated()
    uncertainty = projection_uncertainty(found.camera, observed=found.pixels)
    return {plot.name: plot for plot in calibration_plots(found, uncertainty, CANDIDATES)}


def number_before(unit, text):
    return float(re.search(rf"([0-9.e+-]+) {re.escape(unit)}", text)[1])


def test_the_catalogue_has_a_figure_for_every_question():
    assert tuple(plots()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_is_readable(name):
    require_readable(plots()[name])


@pytest.mark.parametrize("name", ["residuals_by_view", "poses"])
def test_what_is_readable_in_one_theme_is_in_the_other(name):
    require_readable(plots()[name], DARK)


@pytest.mark.parametrize(
    ("name", "suffix"), [("projection_uncertainty", ".pdf"), ("residuals_by_view", ".svg"), ("poses", ".png")]
)
def test_a_figure_is_the_same_bytes_every_time(name, suffix):
    first, second = (encoded(plots()[name], suffix) for _ in range(2))
    assert first == second
    assert encoded(plots()[name], suffix, DARK) != first


@pytest.mark.parametrize("titled", [False, True])
@pytest.mark.parametrize("name", ["projection_uncertainty", "board_shape", "correlations"])
def test_a_figure_in_both_themes_is_the_same_as_in_each(name, titled):
    both = encoded_in(plots()[name], ".png", (LIGHT, DARK), titled=titled)
    assert both == [encoded(plots()[name], ".png", theme, titled=titled) for theme in (LIGHT, DARK)]


def test_a_figure_carries_its_caption():
    plot = plots()["lens_models"]
    assert plot.caption.encode()[:40] in encoded(plot, ".svg")
    assert b"Title" in encoded(plot, ".png")


def test_the_title_can_be_left_to_the_page_around_it():
    titled, bare = (encoded(plots()["correlations"], ".svg", titled=titled) for titled in (True, False))
    heading = b"Correlations of the lens parameters</text>"
    assert (heading in titled, heading in bare) == (True, False)


def test_the_uncertainty_map_shows_the_uncertainty():
    found = calibrated()
    mesh = next(
        each for each in drawn(plots()["projection_uncertainty"]).axes[0].collections if isinstance(each, QuadMesh)
    )
    uncertainty = projection_uncertainty(found.camera, observed=found.pixels)
    assert np.asarray(mesh.get_array()).ravel() == pytest.approx(uncertainty.std_rms)
    said = number_before("px RMS over the image", plots()["projection_uncertainty"].caption)
    assert said == pytest.approx(uncertainty.figures()["rms_px"], rel=0.06)


def test_residual_vectors_are_as_long_as_their_magnification_says():
    found, plot = calibrated(), plots()["residual_vectors"]
    factor = float(re.search(r"magnified ([0-9]+) x", plot.caption)[1])
    axes = drawn(plot).axes[0]
    arrows = next(each for each in axes.collections if isinstance(each, Quiver))
    assert np.stack([arrows.U, arrows.V], axis=1) == pytest.approx(factor * found.residuals)
    assert axes.get_title(loc="right") == f"magnified {factor:g} x"


def test_rejected_corners_are_crossed_out():
    found = calibrated()
    axes = drawn(plots()["residual_vectors"]).axes[0]
    crosses = next(line for line in axes.lines if line.get_marker() == "x")
    assert len(crosses.get_xdata()) == len(found.rejected) > 40


def test_the_worst_view_comes_first_and_a_rejected_one_is_hatched():
    axes = drawn(plots()["residuals_by_view"]).axes[0]
    bars = [bar for bar in axes.patches if bar.get_width() > 0]
    assert bars[0].get_hatch() == "////"
    used = [bar.get_width() for bar in bars if bar.get_hatch() is None]
    assert used == sorted(used, reverse=True)
    assert len(used) == 11
    assert used[0] == pytest.approx(max(view.rms_px for view in calibrated().used))
    assert "1 rejected" in plots()["residuals_by_view"].caption


def test_of_many_views_the_worst_are_shown():
    rows = [(f"image{number:03d}.png", 0.1 + 0.001 * number, True) for number in range(100)]
    plot = residuals_by_view(rows, 103)
    assert "the 24 worst of 100 views" in plot.caption
    assert "3 without a usable board" in plot.caption
    labels = [label.get_text() for label in require_readable(plot).axes[0].get_yticklabels()]
    assert (labels[0], len(labels)) == ("image099.png", 24)


def test_the_median_over_radius_stays_at_what_noise_makes():
    axes = drawn(plots()["residuals_over_radius"]).axes[0]
    median = next(line for line in axes.lines if line.get_label() == "median").get_ydata()
    expected = next(line for line in axes.lines if line.get_label() == "expected median").get_ydata()[0]
    assert median == pytest.approx(np.full(len(median), expected), rel=0.35)  # 50 corners a bin


def test_the_histogram_encloses_the_fitted_distribution():
    found = calibrated()
    axes = drawn(plots()["residual_histogram"]).axes[0]
    area = sum(bar.get_width() * bar.get_height() for bar in axes.patches)
    curve = axes.lines[0].get_xydata()
    assert area == pytest.approx(1)
    assert np.trapezoid(curve[:, 1], curve[:, 0]) == pytest.approx(1, abs=1e-3)
    assert curve[:, 1].max() == pytest.approx(1 / (found.sigma_px * np.sqrt(2 * np.pi)), rel=1e-3)


def test_cells_count_the_corners_and_empty_ones_have_no_colour():
    found = calibrated()
    mesh = next(each for each in drawn(plots()["coverage"]).axes[0].collections if isinstance(each, QuadMesh))
    counts = mesh.get_array()
    assert counts.sum() == len(found.pixels)
    assert np.ma.count_masked(counts) > 0


def test_the_image_circle_is_drawn_where_there_is_one():
    circle = ImageCircle(SIZE, (640.0, 480.0), 450.0)
    pixels = calibrated().pixels
    patches = drawn(image_plane.coverage(pixels, SIZE, 11, circle=circle)).axes[0].patches
    assert [patch.get_radius() for patch in patches] == [450.0]
    assert not drawn(image_plane.coverage(pixels, SIZE, 11)).axes[0].patches


def test_the_board_is_exaggerated_by_what_the_figure_says():
    plot = plots()["board_shape"]
    factor = float(re.search(r"exaggerated ([0-9]+) x", plot.caption)[1])
    axes = drawn(plot).axes[0]
    assert axes.get_zlabel() == f"z x {factor:g}, mm"
    said = number_before("mm from the lowest", plot.caption)
    assert said == pytest.approx(2.0, abs=0.3)  # the bow is 2 mm
    surface = next(each for each in axes.collections if isinstance(each, Poly3DCollection))
    assert np.ptp(np.asarray(surface._faces)[..., 2]) == pytest.approx(factor * said, rel=0.05)


def test_a_board_that_is_taken_to_be_flat_has_no_shape_to_draw():
    found = calibrated()
    flat = replace(found, surface=type(found.surface).flat(found.board))
    names = {plot.name for plot in calibration_plots(flat, projection_uncertainty(found.camera))}
    assert names == set(NAMES) - {"uncertainty_over_distance", "board_shape", "board_height", "lens_models"}


def test_boards_are_drawn_where_they_stood_with_equal_lengths_along_all_axes():
    axes = drawn(plots()["poses"]).axes[0]
    faces = next(each for each in axes.collections if isinstance(each, Poly3DCollection))
    assert len(faces.get_array()) == 11
    size = np.array([np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())])
    ratio = np.asarray(axes._box_aspect) / size
    assert ratio == pytest.approx(np.full(3, ratio[0]))


def test_a_wide_range_of_colours_has_its_numbers_written_out():
    found = calibrated()
    wide = replace(found, views=tuple(replace(view, rms_px=0.02 * 2**k) for k, view in enumerate(found.used)))
    require_readable(poses(wide))
    labels = [label.get_text() for label in drawn(poses(wide)).axes[1].get_yticklabels()]
    assert {"0.1", "1", "10"} <= set(labels)


def test_correlations_are_those_of_the_covariance():
    matrix = correlation_matrix(np.array([[4.0, 3.0, 0.0], [3.0, 9.0, 0.0], [0.0, 0.0, 0.0]]))
    assert matrix == pytest.approx(np.array([[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1]]))
    image = drawn(plots()["correlations"]).axes[0].images[0]
    assert image.get_array().shape == (9, 9)
    assert image.get_clim() == (-1, 1)


def test_lens_models_are_marked_and_those_that_failed_are_named():
    plot = plots()["lens_models"]
    assert "Without a result: pinhole." in plot.caption
    axes = drawn(plot).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["opencv5 (used)", "kannala_brandt4"]
    assert axes.get_xscale() == "log"  # 0.09 and 1.2 px


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("folder/left01.png", "left01.png"),
        ("a\\b\\c.jpg", "c.jpg"),
        ("a_very_long_name_of_an_image_0001.png", "a_very_lon…e_0001.png"),
        ("cost_$5_$6.png", "cost_$5_$6.png"),
    ],
)
def test_names_of_images_are_short(name, shown):
    assert short_name(name) == shown


def test_names_are_text_not_mathematics():
    plot = residuals_by_view([("a$b$.png", 0.1, True), ("x_{2}.png", 0.2, True)], 2)
    labels = [label.get_text() for label in require_readable(plot).axes[0].get_yticklabels()]
    assert labels == ["x_{2}.png", "a$b$.png"]
    assert b"a$b$.png" in encoded(plot, ".svg")


@pytest.mark.parametrize(
    ("lengths", "factor"), [(np.full(10, 0.05), 1000.0), (np.full(10, 0.032), 2000.0), (np.zeros(0), 50.0)]
)
def test_magnifications_are_round(lengths, factor):
    assert image_plane.magnification(lengths, 1280) == factor


def test_the_themes_differ_in_paper_and_ink():
    assert LIGHT.paper != DARK.paper
    assert drawn(plots()["correlations"], DARK).get_facecolor() != drawn(plots()["correlations"]).get_facecolor()
