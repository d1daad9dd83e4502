"""Views that do not fit the others say by how much, and by how much they might."""

import re
from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.noise import REJECTED, ViewNoise, corner_weights, median_limit
from camcal.calibrate.view_records import names_of, px_words
from camcal.cameras.catalogue import model_named

FLAT = ShapeOptions(smooth=False, offsets=False)
RAYLEIGH = np.sqrt(2 * np.log(2))  # of lengths of two coordinates with unit noise


@pytest.mark.parametrize(("share", "rejected"), [(0.97, False), (1.03, True)])
def test_all_corners_of_a_view_are_rejected_beyond_the_limit_of_its_median(share, rejected):
    """By the view's noise: corners of no residual at all count for little in a view whose typical corner is far off."""
    noise = ViewNoise(0.1, np.ones(1))
    view = share * median_limit(noise) / (RAYLEIGH * noise.sigma)  # standard deviations of a typical view
    weights = corner_weights(np.zeros((1, 5)), np.ones((1, 5), bool), ViewNoise(0.1, np.array([view**2])), np.zeros(1))
    assert (weights < REJECTED).all() == rejected


def test_the_limit_is_that_of_a_view_18_times_as_noisy_as_the_typical_one():
    assert median_limit(ViewNoise(0.05, np.ones(3))) == pytest.approx(0.05 * 17.96 * RAYLEIGH, rel=1e-3)


def test_a_view_that_does_not_fit_says_by_how_much():
    scene = make_scene(count=15)
    seen = list(scene.observe(2, noise_px=0.1))
    seen[4] = replace(seen[4], ids=np.random.default_rng(1).permutation(seen[4].ids))
    calibration = calibrate(seen, scene.board, Options(model_named("opencv5"), shape=FLAT))
    view = calibration.views[4]
    assert (view.used, view.rejected, view.kept) == (False, True, 0)
    words = r"rejected: median reprojection error ([\d.]+) px \(limit ([\d.]+) px\)"
    median, limit = map(float, re.fullmatch(words, view.reason).groups())
    assert median > 20  # corners of a board of hundreds of pixels in another order
    assert limit == pytest.approx(0.1 * 17.96 * RAYLEIGH, rel=0.1)
    assert not any(other.rejected for other in calibration.views if other is not view)


@pytest.mark.parametrize(
    ("distance", "words"),
    [(0.0312, "0.031 px"), (9.94, "9.9 px"), (12.34, "12 px"), (123.4, "123 px"), (np.inf, "inf px")],
)
def test_distances_have_no_exponents(distance, words):
    assert px_words(distance) == words


def test_errors_of_views_are_per_corner_and_add_up_to_that_of_all():
    scene = make_scene(count=12)
    seen = scene.observe(3, noise_px=0.1, outliers=0.02)
    calibration = calibrate(seen, scene.board, Options(model_named("opencv5"), shape=FLAT))
    squares = sum(view.kept * view.rms_px**2 for view in calibration.views)
    assert np.sqrt(squares / len(calibration.residuals)) == pytest.approx(calibration.rms_px, rel=1e-9)
    lengths = np.linalg.norm(calibration.residuals, axis=1)
    assert calibration.rms_px == pytest.approx(np.sqrt(np.mean(lengths**2)), rel=1e-9)
    parameters = 9 + 6 * len(seen)  # of lens and poses; weak priors hold less than one of them
    assert 2 * len(lengths) - parameters <= calibration.degrees_of_freedom <= 2 * len(lengths) - parameters + 1


def test_a_sentence_names_five_images():
    assert names_of("abcdefgh") == "a, b, c, d, e and 3 more"
    assert names_of("abcde") == "a, b, c, d, e"
