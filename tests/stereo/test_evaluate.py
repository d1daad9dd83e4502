"""Figures of disparity errors on maps small enough to count by hand, and against their definitions on random ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from camcal.errors import InsufficientData, InvalidInput
from camcal.stereo.disparity import Confidence, StereoGeometry
from camcal.stereo.truth import AT_LEAST, FIGURES, evaluate, mean_of

GEOMETRY = StereoGeometry(1000, 1000, 5, 5, 0.2, 10)
TRUTH = np.full((2, 5), 40.0, np.float32)
ERRORS = np.array([[0.25, 0.75, 1.5, 2.5, 3.5], [0, -5, np.nan, np.nan, 100]], np.float32)
DISPARITY = TRUTH + ERRORS
VISIBLE = np.array([[True] * 5, [False] * 5])


def test_every_figure_of_a_map_counted_by_hand():
    figures = evaluate(DISPARITY, TRUTH).figures
    assert figures["all"] == {
        "density": 80, "bad0.5": 80, "bad1": 70, "bad2": 60, "bad3": 50, "bad4": 40, "d1": 50,
        "a50": 2.5, "a90": np.inf, "a99": np.inf,
    }  # fmt: skip
    valid = figures["all-valid"]
    errors = [0.25, 0.75, 1.5, 2.5, 3.5, 0, 5, 100]
    assert valid["bad1"] == 62.5
    assert valid["d1"] == 37.5
    assert valid["a50"] == 1.5
    assert valid["a90"] == 100
    assert valid["avg"] == pytest.approx(np.mean(errors))
    assert valid["rms"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))


def test_the_mask_chooses_what_the_first_columns_count():
    evaluation = evaluate(DISPARITY, TRUTH, VISIBLE)
    assert list(evaluation.figures) == ["nocc", "nocc-valid", "all", "all-valid"]
    assert evaluation.pixels == {"nocc": 5, "nocc-valid": 5, "all": 10, "all-valid": 8}
    assert evaluation.figures["nocc"]["bad2"] == 40
    assert evaluation.figures["all"]["bad2"] == 60


def test_an_error_of_just_the_threshold_is_not_bad():
    truth = np.full((1, 2), 200.0)
    figures = evaluate(truth + np.array([[2.0, 3.0]]), truth).figures["all"]
    assert figures["bad2"] == 50
    assert figures["bad3"] == 0


def test_d1_forgives_what_is_small_against_the_disparity():
    truth = np.array([[200.0, 40.0]])
    assert evaluate(truth + 5, truth).figures["all"]["d1"] == 50  # 5 of 200 is less than 5 %


def test_pixels_without_a_truth_do_not_count():
    truth = np.where([[True] * 5, [False] * 5], TRUTH, np.nan)
    assert evaluate(DISPARITY, truth).pixels["all"] == 5


def test_depth_errors_follow_from_the_geometry():
    valid = evaluate(np.array([[30.0, np.nan]]), np.array([[40.0, 40]]), geometry=GEOMETRY).figures["all-valid"]
    # z = 1000 * 0.2 / (d + 10): 5 m instead of 4 m
    assert valid["z_avg_m"] == pytest.approx(1)
    assert valid["z_a90_percent"] == pytest.approx(25)


def test_a_disparity_behind_the_cameras_has_no_depth_but_counts_as_bad():
    figures = evaluate(np.array([[-20.0, 40]]), np.array([[40.0, 40]]), geometry=GEOMETRY).figures
    assert figures["all"]["bad4"] == 50
    assert figures["all-valid"]["z_avg_m"] == 0


@given(arrays.arrays(np.float64, (6, 7), elements=st.floats(0, 60)), st.integers(0, 2**32 - 1))
def test_the_figures_are_those_of_their_definitions(error, seed):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(5, 90, error.shape)
    disparity = np.where(rng.random(error.shape) < 0.8, truth + error, np.nan)
    figures = evaluate(disparity, truth).figures
    wrong = np.abs(disparity - truth)
    for threshold in (0.5, 1, 2, 3, 4):
        counted = 100 * np.mean(~(wrong <= threshold))
        assert figures["all"][f"bad{threshold:g}"] == pytest.approx(counted)
    there = np.isfinite(wrong)
    if there.any():
        assert np.mean(wrong[there] <= figures["all-valid"]["a90"]) >= 0.9
        assert np.mean(wrong[there] < figures["all-valid"]["a90"]) < 0.9
    assert figures["all"]["density"] == pytest.approx(100 * there.mean())


def gaussian(shape=(200, 300), truthful=1.0):
    """A map whose errors are normal with a sigma that differs from pixel to pixel, and what it says of them."""
    rng = np.random.default_rng(4)
    sigma = rng.choice([0.2, 0.5, 1.5], shape)
    truth = np.full(shape, 50.0)
    return truth + sigma * rng.standard_normal(shape), truth, sigma * truthful


@pytest.mark.parametrize(("truthful", "one", "two"), [(1, 68.3, 95.4), (0.5, 38.3, 68.3), (2, 95.4, 99.99)])
def test_coverage_tells_whether_sigma_is_too_small_or_too_large(truthful, one, two):
    disparity, truth, sigma = gaussian(truthful=truthful)
    valid = evaluate(disparity, truth, sigma=sigma).figures["all-valid"]
    # 60 000 pixels: the share has a standard deviation of 0.2 points
    assert valid["within1"] == pytest.approx(one, abs=0.8)
    assert valid["within2"] == pytest.approx(two, abs=0.8)


def test_each_class_has_its_own_coverage():
    disparity, truth, sigma = gaussian()
    confidence = np.where(sigma == 0.2, Confidence.AGREED, Confidence.FILLED).astype(np.uint8)
    agreed, filled = evaluate(disparity, truth, sigma=sigma, confidence=confidence).classes
    assert (agreed.name, filled.name) == ("agreed", "filled")
    assert agreed.pixels + filled.pixels == disparity.size
    assert agreed.share == pytest.approx(100 / 3, abs=1)
    assert agreed.error68 == pytest.approx(0.2, rel=0.02)  # of a normal distribution 0.994 sigma
    assert agreed.sigma == 0.2
    for kind in (agreed, filled):
        assert kind.within1 == pytest.approx(68.3, abs=1)  # a third of the pixels: 0.3 points


def test_sparsification_is_perfect_when_sigma_is_the_error_and_worth_nothing_when_it_is_constant():
    disparity, truth, _ = gaussian()
    error = np.abs(disparity - truth)
    perfect = evaluate(disparity, truth, sigma=error).sparsification
    assert perfect.area == pytest.approx(0, abs=1e-9)  # sums of 60 000 numbers
    np.testing.assert_allclose(perfect.by_error[0], error.mean())
    assert np.all(np.diff(perfect.by_error) < 0)
    useless = evaluate(disparity, truth, sigma=np.ones_like(error)).sparsification
    np.testing.assert_allclose(useless.by_sigma, error.mean(), rtol=0.2)  # 600 pixels are left at the end


def test_a_better_sigma_has_a_smaller_area():
    disparity, truth, sigma = gaussian()
    told = evaluate(disparity, truth, sigma=sigma).figures["all-valid"]["ause"]
    mixed = np.random.default_rng(1).permuted(sigma)
    assert 0 < told < 0.6 * evaluate(disparity, truth, sigma=mixed).figures["all-valid"]["ause"]


def test_pixels_without_sigma_do_not_count_for_it():
    disparity, truth, sigma = gaussian()
    valid = evaluate(disparity, truth, sigma=np.full_like(sigma, np.nan)).figures["all-valid"]
    assert np.isnan(valid["within1"])
    assert np.isnan(valid["ause"])


def test_a_map_without_a_disparity_is_all_bad():
    figures = evaluate(np.full_like(TRUTH, np.nan), TRUTH, geometry=GEOMETRY).figures
    assert figures["all"]["bad2"] == 100
    assert figures["all"]["density"] == 0
    assert np.isnan(figures["all-valid"]["avg"])


def test_the_mean_counts_each_map_alike_and_leaves_out_what_one_does_not_know():
    large = evaluate(np.full((10, 10), 43.0), np.full((10, 10), 40.0), geometry=GEOMETRY)
    small = evaluate(TRUTH, TRUTH)
    mean = mean_of([large, small])
    assert mean.figures["all"]["bad2"] == 50
    assert mean.pixels["all"] == 110
    assert "z_avg_m" not in mean.figures["all-valid"]
    assert mean_of([large]) is large


def test_the_mean_of_classes_counts_each_pixel_alike():
    def of(error, size):
        image = np.full((size, 10), 40.0)
        return evaluate(image + error, image, sigma=image / 40, confidence=np.full(image.shape, 5, np.uint8))

    (kind,) = mean_of([of(0, 30), of(3, 10)]).classes
    assert (kind.pixels, kind.share, kind.bad2, kind.within1) == (400, 100, 25, 75)


def test_every_figure_is_in_the_list_of_names():
    disparity, truth, sigma = gaussian((20, 20))
    columns = evaluate(disparity, truth, geometry=GEOMETRY, sigma=sigma).figures.values()
    assert {name for figures in columns for name in figures} == set(FIGURES)
    assert set(AT_LEAST) <= set(FIGURES)


@pytest.mark.parametrize(
    ("shape", "message"),
    [((4, 10), "10 × 4, the disparity map 5 × 2.*0.5 times as large"), ((3, 3), r"3 × 3.*must be the same$")],
)
def test_a_truth_of_another_size_is_refused_with_advice_if_it_is_the_same_view(shape, message):
    with pytest.raises(InvalidInput, match=message):
        evaluate(DISPARITY, np.zeros(shape))


def test_a_mask_of_another_size_is_refused():
    with pytest.raises(InvalidInput, match="the mask is 3 × 2"):
        evaluate(DISPARITY, TRUTH, np.ones((2, 3), bool))


def test_nothing_to_count_is_said():
    with pytest.raises(InsufficientData, match="nocc"):
        evaluate(DISPARITY, TRUTH, np.zeros_like(VISIBLE))


def test_depth_errors_of_angular_views_depend_on_where_the_pixel_is():
    for axis in ("x", "y"):
        geometry = StereoGeometry(100.0, 100.0, 5.0, 3.0, 0.1, projection="latlon", axis=axis)
        truth = np.full((7, 11), 20.0, np.float32)
        found = evaluate(truth + 0.5, truth, None, geometry)
        row, column = np.mgrid[:7, :11]
        left = ((row - 3) if axis == "y" else (column - 5)) / 100
        distance, there = (0.1 / (np.tan(left) - np.tan(left - d / 100)) for d in (20.0, 20.5))
        assert found.figures["all-valid"]["z_avg_m"] == pytest.approx(np.mean(distance - there), rel=1e-4)
