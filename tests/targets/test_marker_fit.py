"""The parts of the fit of a marker: its blurred drawing, its place in the image, and their derivatives."""

import numpy as np
import pytest
from tagged import facing, photograph, pinhole, true_corners

from camcal.targets import marker_fit
from camcal.targets.marker_fit import fit_marker
from camcal.targets.pattern import MarkerDrawing, family_named

CORNERS = np.array([[-21.0, -18.0], [19.0, -22.0], [24.0, 17.0], [-18.0, 20.0]])
DRAWING = family_named("tag25h9").drawing(3)
STEP = 1e-4  # of central differences in places from -1 to 1; float32 within the drawing allows no less


def random_places(count=60, reach=1.1, seed=1):
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 2))


def test_places_come_back_from_their_pixels():
    entries, places = marker_fit.homography(CORNERS), random_places()
    assert np.allclose(marker_fit.straight(entries, marker_fit.CORNERS).pixels, CORNERS)
    assert np.allclose(marker_fit.places_of(entries, marker_fit.straight(entries, places).pixels), places)


def test_derivatives_of_the_place_are_those_of_central_differences():
    entries, places = marker_fit.homography(CORNERS), random_places()
    placed = marker_fit.straight(entries, places)
    for axis, step in enumerate(np.eye(2) * 1e-6):
        ends = [marker_fit.straight(entries, places + sign * step).pixels for sign in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / 2e-6, placed.by_place[:, :, axis], atol=1e-6)  # float64 at h = 1e-6
    for entry, step in enumerate(np.eye(8) * 1e-6):
        ends = [marker_fit.straight(entries + sign * step, places).pixels for sign in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / 2e-6, placed.by_entries[:, :, entry], atol=1e-6)
    product = np.einsum("kij,kjl->kil", placed.gradients, placed.by_place)
    assert np.allclose(product, np.eye(2), atol=1e-12)


def test_bends_leave_the_corners_and_straight_lines_through_the_middle():
    entries = marker_fit.homography(CORNERS)
    at_corners = marker_fit.bends_of(entries, marker_fit.CORNERS, np.array([150.0, -90.0]), 400.0)
    assert at_corners.shape == (4, 2, marker_fit.BENDS)
    assert np.abs(at_corners).max() < 1e-12
    between = marker_fit.bends_of(entries, np.zeros((1, 2)), np.array([150.0, -90.0]), 400.0)
    assert (np.abs(between[0]).max(axis=0) > 1e-3).all()


@pytest.mark.parametrize("skew", [0.0, 0.4])
def test_slopes_of_the_drawing_are_those_of_central_differences(skew):
    places = random_places(200)
    gradients = np.tile(np.linalg.inv(20 * np.array([[1.0, skew], [skew, 1.0]])), (200, 1, 1))
    _, by_place, by_blur = DRAWING.blurred(places, gradients, 1.0)
    steepest = np.abs(by_place).max()
    for axis, step in enumerate(np.eye(2) * STEP):
        ends = [DRAWING.blurred(places + sign * step, gradients, 1.0)[0] for sign in (1, -1)]
        numeric = (ends[0].astype(float) - ends[1]) / (2 * STEP)
        # rounding of float32, 1e-7 / 1e-4, over a slope of 1
        assert np.abs(numeric - by_place[:, axis]).max() < 5e-3 * steepest
    ends = [DRAWING.blurred(places, gradients, np.exp(sign * 1e-3))[0] for sign in (1, -1)]
    numeric = (ends[0].astype(float) - ends[1]) / 2e-3
    limit = 5e-3 + skew**2  # the series' second term is left out of this one, which steers the search and no more
    assert np.abs(numeric - by_blur).max() < limit * np.abs(by_blur).max()


@pytest.mark.parametrize("skew", [0.0, 0.3, -0.3])
def test_a_blurred_drawing_is_the_mean_over_the_blur(skew):
    """Against a sum over many points of the sharp drawing, blurred by chance."""
    rng, places = np.random.default_rng(3), random_places(40, 1.0)
    by_place = 20 * np.array([[1.0, skew], [skew, 1.0]])
    gradients = np.linalg.inv(by_place)
    moved = places[:, None] + rng.normal(0, 1.2, (20_000, 2)) @ gradients.T
    cell = np.floor((moved + 1) / 2 * len(DRAWING.ink)).astype(int)
    inside = ((cell >= 0) & (cell < len(DRAWING.ink))).all(axis=-1)
    column, row = np.moveaxis(np.clip(cell, 0, len(DRAWING.ink) - 1), -1, 0)
    expected = np.where(inside, DRAWING.ink[row, column], 1.0).mean(axis=1)
    value = DRAWING.blurred(places, np.tile(gradients, (40, 1, 1)), 1.2)[0]
    assert np.abs(value - expected).max() < 0.025  # four deviations of a mean over 20 000, and the series' rest


def test_edges_are_where_black_meets_white():
    drawing = MarkerDrawing(np.array([[0.0, 0.0], [0.0, 1.0]]))
    starts, ends = drawing.edges
    assert len(starts) == 8  # six sides of the border, two within
    assert np.allclose(np.linalg.norm(ends - starts, axis=1), 1.0)


def test_a_fit_finds_its_way_from_a_start_that_is_off_by_a_pixel():
    camera, pose = pinhole((200, 160), 400.0), facing(0.01, 0.005, 0.4, (0.3, -0.2, 0.2))
    gray, truth = photograph(camera, [(3, pose)], family="DICT_5X5_100"), true_corners(camera, pose)
    start = truth + np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, 0.5]])
    fit = fit_marker(gray, start, family_named("DICT_5X5_100").drawing(3))
    assert fit.settled
    assert fit.agreement > 0.98
    assert np.abs(fit.corners - truth).max() < 0.06  # hundredths are usual


@pytest.mark.parametrize("side", [80, 96, 120])
def test_a_razor_sharp_marker_is_fitted_in_a_few_steps(side):
    known = family_named("tag36h11")
    bits = np.kron(known.drawing(side).ink, np.ones((side // 8, side // 8)))
    gray = np.full((side + 60, side + 70), 255, np.uint8)
    gray[25 : 25 + side, 31 : 31 + side] = 255 * bits
    low, high = np.array([30.5, 24.5]), np.array([30.5, 24.5]) + side
    truth = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    off = np.array([[0.4, 0.3], [-0.5, 0.2], [0.1, -0.4], [0.3, 0.3]])
    fit = fit_marker(gray, truth + off, known.drawing(side))
    assert fit.settled
    # pixels as sharp as these tell of a corner to a fraction of one only
    assert np.abs(fit.corners - truth).max() < 0.2
    assert fit.iterations <= 15  # 30 to 100 if the logarithm of a blur of nothing is looked for


def test_the_drawing_of_another_marker_does_not_agree():
    camera, pose = pinhole((200, 160), 400.0), facing(0.01, 0.005, 0.4, (0.3, -0.2, 0.2))
    gray, truth = photograph(camera, [(3, pose)], family="DICT_5X5_100"), true_corners(camera, pose)
    fit = fit_marker(gray, truth, family_named("DICT_5X5_100").drawing(4))
    assert fit.agreement < 0.7  # what detect_markers asks for


def test_nothing_is_fitted_outside_the_image_or_to_an_even_one():
    gray = np.full((60, 80), 128, np.uint8)
    assert fit_marker(gray, CORNERS + 500, DRAWING) is None
    even = fit_marker(gray, CORNERS + np.array([40, 30]), DRAWING)
    assert even is None or even.agreement < 0.1


def srgb(light):
    return np.where(light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("share", "halo_px", "gain"),
    [(0.0, 4.0, 1.0), (0.1, 4.0, 1.0), (0.1, 6.0, 1.0), (0.0, 4.0, 1.5)],
    ids=["gamma", "halo", "wide halo", "paper clipped"],
)
def test_light_does_not_change_the_side_of_a_tag(share, halo_px, gain):
    """Light is blurred, strays and is clipped before a camera encodes it as sRGB: the edges' 50 % places move."""

    def ratio(tag):
        corners = CORNERS + 60 + np.random.default_rng(tag).uniform(-0.5, 0.5, 2)
        drawing = family_named("tag36h11").drawing(tag)
        pixels = np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1).reshape(-1, 2)
        entries = marker_fit.homography(corners)
        places = marker_fit.places_of(entries, pixels)
        gradients = marker_fit.straight(entries, places).gradients
        direct, stray = (drawing.blurred(places, gradients, blur)[0] for blur in (1.2, halo_px))
        light = gain * (0.04 + 0.81 * ((1 - share) * direct + share * stray))
        gray = np.rint(255 * srgb(np.clip(light, 0, 1))).reshape(120, 120).astype(np.uint8)
        both = corners, fit_marker(gray, corners, drawing).corners
        sides = [np.linalg.norm(four - np.roll(four, 1, axis=0), axis=1).sum() for four in both]
        return sides[1] / sides[0] - 1

    assert abs(np.mean([ratio(tag) for tag in range(6)])) < 1e-3  # without halo and white 2 to 3e-3
