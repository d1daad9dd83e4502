"""Planes in areas without texture: a slanted board, a wall behind things, and where nothing tells the plane."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.filling import everywhere, from_the_background
from camcal.stereo.matching.match import match
from camcal.stereo.matching.matchers import Fused
from camcal.stereo.matching.planes import on_planes
from camcal.stereo.matching.preparation import GrayPair
from camcal.stereo.options import ALL, MatchOptions

HEIGHT, WIDTH = 150, 240


def paint(seed):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)), 0.9)
    return (120 + 14 * noise / noise.std()).astype(np.float32)


def right_of(left, disparity):
    """Return the right image (H, W) uint8 of surfaces, the nearer ones before the others."""
    right, nearest = left.copy(), np.full(left.shape, -np.inf)
    for y, x in np.ndindex(left.shape):
        there = round(x - disparity[y, x])
        if 0 <= there < left.shape[1] and disparity[y, x] > nearest[y, there]:
            right[y, there], nearest[y, there] = left[y, x], disparity[y, x]
    return right


def planes_of(left, disparity, gap, matched=None):
    """Return dense maps with and without planes; matched: (H, W) outside of the gap, the truth by default."""
    left = np.rint(left).astype(np.uint8)
    right = right_of(left, disparity)
    known = np.where(gap, np.nan, disparity if matched is None else matched).astype(np.float32)
    confidence = np.where(gap, Confidence.FILLED, Confidence.AGREED).astype(np.uint8)
    nothing = np.full(left.shape, np.nan, np.float32)
    found = Fused(known, confidence, nothing, np.zeros(left.shape, np.int8))
    dense = everywhere(from_the_background(known).disparity)
    return on_planes(found, dense, GrayPair(left, right, left, right, 0.5)), dense


def framed_board(end=WIDTH):
    """Return an image of a board that is painted only along its edge, its disparity, and what is not painted.

    end: the column at which it is painted again; at the border of the image it is not.
    """
    y, x = np.indices((HEIGHT, WIDTH))
    image, gap = paint(1), np.zeros((HEIGHT, WIDTH), bool)
    gap[30:120, 60:end] = True
    image[gap] = 150
    return image, 8 + 0.06 * x + 0.1 * y, gap


def wall_and_floor():
    """Return an image of a plain wall above a floor and behind a painted thing, its disparity, the wall's gap, matches.

    Matching makes the thing larger than it is.
    """
    y, x = np.indices((HEIGHT, WIDTH))
    image, disparity = paint(2), np.maximum(10.0, 10 + 0.2 * (y - 110))
    gap = y < 107
    image[y < 110] = 150
    thing = (abs(x - 120) < 20) & (y > 50) & (y < 80)
    image[thing], disparity[thing] = paint(3)[thing], 25
    larger = cv2.dilate(thing.astype(np.uint8), np.ones((9, 9))) > 0
    return image, disparity, gap & ~larger, np.where(larger, 25, disparity)


def test_gap_of_a_slanted_board_takes_its_plane():
    image, disparity, gap = framed_board()
    after, before = planes_of(image, disparity, gap)
    inside = np.zeros_like(gap)
    inside[40:110, 70:230] = True
    assert np.abs(after - disparity)[inside].max() < 0.2
    assert np.abs(before - disparity)[inside].max() > 1


def test_what_is_matched_stays_as_it_is():
    image, disparity, gap = framed_board()
    after, before = planes_of(image, disparity, gap)
    assert np.array_equal(after[~gap], before[~gap])


def test_wall_without_texture_goes_on_from_the_edge_of_the_floor_and_not_from_what_stands_before_it():
    image, disparity, gap, matched = wall_and_floor()
    after, before = planes_of(image, disparity, gap, matched)
    assert np.abs(before - disparity)[gap].mean() > 2
    assert np.abs(after - disparity)[gap].mean() < 1


def test_wall_stands_upright_rather_than_lean_on_what_hangs_before_it():
    image, disparity, gap, matched = wall_and_floor()
    thing = slice(5, 60), slice(150, 240)
    image[thing], disparity[thing] = paint(5)[thing], 34
    gap[thing], matched = False, np.where(disparity == 34, 34, matched)
    after, before = planes_of(image, disparity, gap, matched)
    assert np.abs(before - disparity)[gap].mean() > 5
    assert np.abs(after - disparity)[gap].mean() < 1


def test_how_steep_a_floor_without_texture_is_nobody_guesses():
    after, before = planes_of(*(values[::-1] for values in wall_and_floor()))
    assert np.array_equal(after, before, equal_nan=True)


def floor_with(standing):
    """Return an image of a plain floor below a painted wall, its disparity, and the gap; standing: a thing is on it."""
    y, x = np.indices((HEIGHT, WIDTH))
    image, disparity = paint(2), np.maximum(8.0, 8 + 0.25 * (y - 50))
    gap = y > 53
    image[y > 50] = 150
    thing = (x > 150) & (y > 40) & (y < 110)
    if standing:
        image[thing], disparity[thing], gap[thing] = paint(3)[thing], 8 + 0.25 * (109 - 50), False
    return image, disparity, gap


def test_floor_takes_its_steepness_from_what_stands_on_it():
    image, disparity, gap = floor_with(standing=True)
    after, before = planes_of(image, disparity, gap)
    assert np.abs(after - disparity)[gap].mean() < 1.5  # what stands on it counts where it is within a pixel of it
    assert np.abs(before - disparity)[gap].mean() > 5


def test_floor_that_nothing_stands_on_stays_as_it_is():
    after, before = planes_of(*floor_with(standing=False))
    assert np.array_equal(after, before)


def test_board_that_reaches_the_lower_edge_is_no_floor():
    image, _, gap = floor_with(standing=True)
    matched = np.where(image == 150, np.nan, np.where(np.indices(gap.shape)[0] > 50, 31.0, 20.0))
    after, before = planes_of(image, np.nan_to_num(matched, nan=20.0), gap, matched)
    assert np.array_equal(after, before)


def test_no_plane_goes_across_a_step():
    image, disparity, gap = paint(1), np.full((HEIGHT, WIDTH), 8.0), np.zeros((HEIGHT, WIDTH), bool)
    disparity[:, WIDTH // 2 :] += 12
    small = slice(50, 100), slice(WIDTH // 2 - 30, WIDTH // 2 + 30)
    image[small], gap[small] = 150, True
    after, before = planes_of(image, disparity, gap)
    assert np.array_equal(after, before)


def test_nothing_matched_stays_nothing():
    after, before = planes_of(paint(4), np.zeros((HEIGHT, WIDTH)), np.ones((HEIGHT, WIDTH), bool))
    assert after is before


def test_large_pair_is_looked_at_in_steps():
    image, disparity, gap = framed_board()
    size = 4 * WIDTH, 4 * HEIGHT
    image, disparity = (cv2.resize(values, size, interpolation=cv2.INTER_LINEAR) for values in (image, disparity))
    gap = cv2.resize(gap.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    left = np.rint(image).astype(np.uint8)
    known = np.where(gap, np.nan, 4 * disparity).astype(np.float32)
    found = Fused(known, np.where(gap, 1, 5).astype(np.uint8), known, np.zeros(gap.shape, np.int8))
    down, across = np.indices((4 * HEIGHT, 4 * WIDTH), np.float32)
    y, x = down / 4, across / 4
    seen = 4 * (8 + 0.08 * y + 0.06 * x) / (1 - 0.06)  # of a pixel of the right image
    right = cv2.remap(left, across + seen, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    after = on_planes(found, from_the_background(known).disparity, GrayPair(left, right, left, right, 0.5))
    assert np.abs(after - 4 * disparity)[160:440, 280:720].max() < 0.8


def test_rows_that_only_a_plane_reaches_are_full():
    image, disparity, gap, matched = wall_and_floor()
    image[:, 200:210], image[:, 210:] = 60, 90  # two plain strips beside the wall, of which nothing is matched
    gap[:, 196:] = True
    after, _ = planes_of(image, disparity, gap, matched)
    assert np.isfinite(after).all()


def test_matching_fills_a_board_without_texture():
    image, disparity, gap = framed_board(end=190)
    left = np.rint(image).astype(np.uint8)
    right = right_of(left, disparity)
    options = MatchOptions(search=(0, 48), fill=ALL)
    values, again = (match(left, right, options).values for _ in range(2))
    assert np.median(np.abs(values - disparity)[gap]) < 0.5
    assert np.array_equal(values, again)


@pytest.mark.parametrize(("truth", "planes"), [(14.0, True), (8.0, False)])
def test_a_plane_under_which_shading_fits_worse_than_as_it_is_filled_is_not_taken(truth, planes):
    """What is matched around the gap lies at 14 px, the filling at 8; a slope of gray levels says which is right."""
    image, _, gap = framed_board(190)
    image[gap] = (150 + 0.8 * (np.indices(gap.shape)[1] - 125))[gap]
    left = np.rint(image).astype(np.uint8)
    right = right_of(left, np.where(gap, truth, 14.0))
    known = np.where(gap, np.nan, 14.0).astype(np.float32)
    confidence = np.where(gap, Confidence.FILLED, Confidence.AGREED).astype(np.uint8)
    found = Fused(known, confidence, np.full(gap.shape, np.nan, np.float32), np.zeros(gap.shape, np.int8))
    filled = np.where(gap, 8.0, 14.0).astype(np.float32)
    after = on_planes(found, filled, GrayPair(left, right, left, right, 0.5))
    assert np.abs(after[40:110, 80:170] - (14 if planes else 8)).max() < 0.1
