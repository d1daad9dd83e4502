"""From a pair to its disparity: what is found, what is left out, how sure it is, and every pair there could be.

How good it is on photographs is told by the tests of real pairs.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from layered import layered_pair
from textured import darker, noisy, textured_pair, waves

from camcal.errors import InvalidInput
from camcal.run.process import over_threads
from camcal.simulate.stereo_scene import PairOptions, render_pair
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.match import UNMODELLED, match
from camcal.stereo.matching.preparation import prepare
from camcal.stereo.options import ALL, BACKGROUND, BALANCED, BEST, FAST, FILLS, NOTHING, QUALITIES, MatchOptions

LAYERS = layered_pair()
SHAPES = [(1, 1), (1, 8), (8, 1), (3, 5), (1, 300), (300, 2), (17, 23)]


@pytest.fixture(params=QUALITIES)
def quality(request):
    return request.param


@pytest.fixture(scope="module")
def scenes():
    """Two drawn worlds with everything in them that makes matching hard."""
    options = PairOptions(size=(200, 150), focal=180, disparities=(4, 22), objects=8)
    return [render_pair(options, np.random.default_rng(seed)) for seed in (2, 4)]


def wrong(disparity, truth, limit=1.0):
    """Return the share of pixels off by more than a limit, pixels without a disparity among them."""
    return np.mean(~(np.abs(disparity - truth) <= limit))


def assert_whole(found, shape):
    """Check what is true of every result: its shapes, and that sigma and confidence are known where the value is."""
    known = np.isfinite(found.values)
    assert found.values.shape == found.sigma.shape == found.confidence.shape == shape
    np.testing.assert_array_equal(np.isfinite(found.sigma), known)
    np.testing.assert_array_equal(found.confidence > Confidence.NONE, known)
    assert (found.sigma[known] > 0).all()


def same(first, second):
    return all(
        getattr(first, name).tobytes() == getattr(second, name).tobytes() for name in ("values", "sigma", "confidence")
    )


def test_layers_are_found_with_all_that_both_images_show(quality):
    left, right, truth, visible = LAYERS
    found = match(left, right, MatchOptions(quality, fill=ALL))
    assert_whole(found, truth.shape)
    limit = {FAST: 0.06, BALANCED: 0.03, BEST: 0.03}[quality]  # corners and what windows of 5 pixels make of edges
    assert wrong(found.values[visible], truth[visible]) < limit
    low, high = found.searched
    assert low <= 4
    assert high >= 16


def test_what_is_not_filled_is_what_is_surer(quality):
    left, right, truth, _ = LAYERS
    maps = {fill: match(left, right, MatchOptions(quality, fill=fill)) for fill in FILLS}
    known = {fill: np.isfinite(found.values) for fill, found in maps.items()}
    assert known[ALL].all()
    assert not (known[NOTHING] & ~known[BACKGROUND]).any()
    assert not (maps[NOTHING].confidence == Confidence.FILLED).any()
    assert (maps[ALL].confidence[~known[NOTHING]] == Confidence.FILLED).all()
    np.testing.assert_array_equal(maps[ALL].values[known[NOTHING]], maps[NOTHING].values[known[NOTHING]])
    sparse = maps[NOTHING].values
    assert wrong(sparse[known[NOTHING]], truth[known[NOTHING]]) < wrong(maps[ALL].values, truth) / 2


def test_a_row_where_nothing_is_matched_is_filled_only_if_all_are():
    left, right, _, _ = LAYERS
    left, right = left.copy(), right.copy()
    left[60:80], right[60:80] = 255 * (np.random.default_rng(1).random((2, 20, 160)) > 0.5)
    maps = {fill: match(left, right, MatchOptions(FAST, (300, 331), fill)) for fill in FILLS}
    assert np.isnan(maps[NOTHING].values).all()  # all of it would be outside the right image
    assert np.isnan(maps[ALL].values).all()
    sparse = match(left, right, MatchOptions(BALANCED, (0, 20), BACKGROUND)).values
    dense = match(left, right, MatchOptions(BALANCED, (0, 20), ALL)).values
    assert np.isfinite(dense).all()
    rows = np.isnan(sparse).any(axis=1)
    np.testing.assert_array_equal(np.isnan(sparse).all(axis=1), rows)
    assert rows[62:78].any()
    assert not rows[:55].any()


def test_fractions_of_a_pixel_are_found(quality):
    left, right = textured_pair(np.full((60, 160), 9.3))
    values = match(left, right, MatchOptions(quality)).values[:, 12:]
    assert np.nanmedian(values) == pytest.approx(9.3, abs=0.06)  # the fast one knows a twentieth of a pixel
    assert np.mean(np.abs(values - 9.3) < 0.4) > 0.95


def test_cameras_that_squint_have_disparities_of_both_signs(quality):
    left, right, truth, visible = layered_pair(disparities=(-11, -3, 8))
    for search in (None, (-14, 10)):
        values = match(left, right, MatchOptions(quality, search, ALL)).values
        assert wrong(values[visible], truth[visible]) < 0.06


def test_disparities_beyond_256_px_are_found(quality):
    left, right, truth, visible = layered_pair((480, 40), (262, 300))
    values = match(left, right, MatchOptions(quality, (150, 310), ALL)).values
    assert wrong(values[visible], truth[visible]) < 0.08


def test_a_disparity_at_an_end_of_the_range_is_found(quality):
    left, right = textured_pair(np.full((60, 160), 9.0))
    for search in ((9, 25), (0, 9), (9, 9)):
        found = match(left, right, MatchOptions(quality, search))
        assert np.mean(np.abs(found.values[:, 14:] - 9) < 0.6) > 0.9
        assert found.searched[0] == search[0]
        assert found.searched[1] >= search[1]


def test_an_image_narrower_than_the_range_is_matched(quality):
    left, right = textured_pair(np.full((30, 40), 5.0))
    found = match(left, right, MatchOptions(quality, (-60, 90), ALL))
    assert_whole(found, (30, 40))
    assert wrong(found.values[:, 8:], 5, 0.6) < 0.05


def test_what_a_range_leaves_out_is_not_believed():
    left, right, truth, visible = LAYERS
    found = match(left, right, MatchOptions(BALANCED, (0, 10)))
    assert np.isfinite(found.values[visible & (truth == 16)]).mean() < 0.5  # of one side of it, a match by chance
    assert np.nanmax(found.values) <= 10.5


def as_colour(image):
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)


def with_alpha(image):
    return np.dstack([as_colour(image), np.full(image.shape, 255, image.dtype)])


def with_gaps(image):
    values = image.astype(np.float32) / 255
    values[50:54, 90:94] = np.nan
    return values


TYPES = {
    "colour": as_colour,
    "alpha": with_alpha,
    "uint16": lambda image: image.astype(np.uint16) * 257,
    "twelve bits of sixteen": lambda image: image.astype(np.uint16) * 16,
    "float32": lambda image: image.astype(np.float32) / 255,
    "float32 with NaN": with_gaps,
    "colour of 16 bits": lambda image: as_colour(image.astype(np.uint16) * 257),
    "columns in another order": np.asfortranarray,
}


@pytest.mark.parametrize("kind", TYPES)
def test_a_pair_of_any_type_is_matched(quality, kind):
    left, right, truth, visible = LAYERS
    found = match(TYPES[kind](left), TYPES[kind](right), MatchOptions(quality, fill=ALL))
    assert_whole(found, truth.shape)
    assert wrong(found.values[visible], truth[visible]) < 0.07


def test_a_pair_is_not_changed(quality):
    left, right, _, _ = LAYERS
    before = left.tobytes(), right.tobytes()
    match(left, right, MatchOptions(quality))
    assert (left.tobytes(), right.tobytes()) == before


def test_images_of_different_sizes_are_refused(quality):
    left, right, _, _ = LAYERS
    with pytest.raises(InvalidInput, match="the left image has 160 × 110 pixels, the right one 159 × 110"):
        match(left, right[:, 1:], MatchOptions(quality))


@pytest.mark.parametrize(
    ("search", "line"),
    [
        ((9, 3), "the range 9 to 3 is empty"),
        ((0, 99999), "exceeds any image"),
        ((-99999, 0), "exceeds any image"),
    ],
)
def test_ranges_that_cannot_be_are_refused(search, line):
    with pytest.raises(InvalidInput, match=line):
        match(*LAYERS[:2], MatchOptions(FAST, search))


def test_unknown_names_are_refused_with_those_that_are_known():
    with pytest.raises(InvalidInput, match="'good' is not one of fast, balanced, best"):
        MatchOptions("good")
    with pytest.raises(InvalidInput, match="'some' is not one of none, background, all"):
        MatchOptions(fill="some")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("search", [None, (0, 0), (-30, 40), (500, 530)])
def test_images_of_any_size_are_matched(quality, shape, search):
    image = np.random.default_rng(1).integers(0, 255, shape).astype(np.uint8)
    assert_whole(match(image, image, MatchOptions(quality, search, ALL)), shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_no_matcher_of_opencv_gets_fewer_columns_than_its_window(quality, shape, monkeypatch):
    # With so few it reads beyond its buffers and divides by zero.
    left_over = []
    create = cv2.StereoSGBM.create

    class Recorded:
        """The matcher itself, with a note of how many columns it is left with."""

        def __init__(self, **settings):
            self.settings, self.matcher = settings, create(**settings)

        def compute(self, left, right):
            low, count = self.settings["minDisparity"], self.settings["numDisparities"]
            columns = left.shape[1] + min(low, 0) - max(low + count, 0)
            left_over.append(columns - self.settings["blockSize"] // 2)
            return self.matcher.compute(left, right)

    monkeypatch.setattr(cv2.StereoSGBM, "create", staticmethod(Recorded))
    image = np.random.default_rng(1).integers(0, 255, shape).astype(np.uint8)
    match(image, image, MatchOptions(quality))
    assert min(left_over, default=1) > 0


@pytest.mark.parametrize("size", [(201, 141), (199, 53), (333, 1)])
def test_odd_sizes_and_single_rows_are_matched(quality, size):
    left, right = textured_pair(np.full(size[::-1], 6.0))
    found = match(left, right, MatchOptions(quality, (0, 15), ALL))
    assert_whole(found, size[::-1])
    assert wrong(found.values[:, 8:], 6) < (0.05 if size[1] > 1 else 0.25)  # one row has a fifth of the evidence


def test_an_image_with_itself_has_disparity_0(quality):
    left, _, _, _ = LAYERS
    found = match(left, left, MatchOptions(quality, fill=ALL))
    assert np.mean(np.abs(found.values) < 0.05) > 0.99  # all but some at the borders, where windows are half empty
    assert np.abs(found.values).max() < 0.5
    assert prepare(left, left).failures[0].code == "identical_images"


def test_swapped_images_are_matched_and_remarked_on(quality):
    left, right, _, _ = LAYERS
    found = match(right, left, MatchOptions(quality))
    assert found.searched[0] <= -16
    assert set(np.rint(np.quantile(found.values[np.isfinite(found.values)], (0.02, 0.98)))) == {-16, -4}
    assert "swapped_images" in [failure.code for failure in prepare(right, left).failures]


@pytest.mark.parametrize("value", [0, 90, 255])
def test_in_images_of_one_gray_level_nothing_is_matched(quality, value):
    flat = np.full((40, 61), value, np.uint8)
    for fill in FILLS:
        found = match(flat, flat, MatchOptions(quality, fill=fill))
        assert np.isnan(found.values).all()
        assert_whole(found, flat.shape)
    (warning,) = prepare(flat, flat).warnings
    assert (warning.code, dict(warning.values)) == ("unknown_range", {"first": 0, "last": 10})


def test_images_of_different_things_are_mostly_not_believed():
    left, right = (noisy(np.full((80, 120), 120, np.uint8), 40, seed) for seed in (1, 2))
    found = match(left, right, MatchOptions(BEST))
    assert np.isfinite(found.values).mean() < 0.2
    assert prepare(left, right).warnings[0].code == "unknown_range"


def test_a_range_outside_the_images_leaves_nothing(quality):
    left, right, truth, _ = LAYERS
    for fill in FILLS:
        found = match(left, right, MatchOptions(quality, (300, 331), fill))
        assert np.isnan(found.values).all()
        assert_whole(found, truth.shape)


@pytest.mark.parametrize("rows", [1.0, 2.0, (0.004, 0.0, 0.6)])
def test_rows_that_are_off_are_put_right(rows, quality):
    truth = np.tile(np.linspace(5, 14, 200), (140, 1))
    left, right = textured_pair(truth, rows)
    options = MatchOptions(quality, (0, 20), ALL)
    values = match(left, right, options).values[:, 16:]
    spoilt = match(left, right, replace(options, align_rows=False)).values[:, 16:]
    clean = match(*textured_pair(truth), options).values[:, 16:]
    assert prepare(left, right).rows > 0.5
    deviations = [np.sqrt(np.mean((found - truth[:, 16:]) ** 2)) for found in (clean, values, spoilt)]
    assert deviations[1] < 1.5 * deviations[0] + 0.02  # linear interpolation blurs
    assert deviations[1] < deviations[2]


def test_another_exposure_does_not_matter():
    left, right, truth, visible = LAYERS
    bad = [
        wrong(match(left, image, MatchOptions(BEST, fill=ALL)).values[visible], truth[visible])
        for image in (right, darker(right))
    ]
    assert bad[1] <= 1.2 * bad[0] + 0.002  # a few tens of pixels by chance


def test_noise_costs_little():
    left, right, truth, visible = LAYERS
    found = match(noisy(left), noisy(right, seed=3), MatchOptions(BEST, fill=ALL))
    assert wrong(found.values[visible], truth[visible], 2) < 0.06


def test_a_pair_upside_down_has_its_disparity_upside_down():
    left, right, _, _ = LAYERS
    upright, turned = (match(*pair, MatchOptions(BALANCED, (0, 20), ALL, align_rows=False)) for pair in (
        (left, right), (np.ascontiguousarray(left[::-1]), np.ascontiguousarray(right[::-1]))))  # fmt: skip
    np.testing.assert_allclose(turned.values[::-1], upright.values, atol=1e-4)  # sums of the filter in another order
    np.testing.assert_array_equal(turned.confidence[::-1], upright.confidence)


def test_results_do_not_depend_on_threads(quality):
    left, right, _, _ = LAYERS
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        single_matcher = match(left, right, MatchOptions(quality))
        cv2.setNumThreads(2)
        assert same(match(left, right, MatchOptions(quality)), single_matcher)
    finally:
        cv2.setNumThreads(threads)
    with over_threads(2) as each:
        assert same(match(left, right, MatchOptions(quality), each), single_matcher)


@pytest.mark.parametrize("quality", [BALANCED, BEST])
def test_sigma_holds_two_thirds_of_the_errors_of_drawn_scenes(scenes, quality):
    for scene in scenes:
        found = match(scene.left, scene.right, MatchOptions(quality, fill=ALL))
        drawn = np.sqrt(found.sigma**2 - UNMODELLED**2)  # nothing is added to drawings
        share = np.mean(np.abs(found.values - scene.disparity_left) <= drawn)
        assert 0.6 < share < 0.78  # 68 % over many scenes, and no two of them are alike


@pytest.mark.parametrize("quality", [BALANCED, BEST])
def test_sigma_holds_two_thirds_of_the_errors_of_pairs_matched_from_coarse_to_fine(scenes, monkeypatch, quality):
    monkeypatch.setattr("camcal.stereo.matching.match.LARGEST", 13_000)
    maps = [match(scene.left, scene.right, MatchOptions(quality, fill=ALL)) for scene in scenes]
    shares = [
        np.mean(np.abs(found.values - scene.disparity_left) <= found.sigma)
        for found, scene in zip(maps, scenes, strict=True)
    ]
    assert 0.63 < np.mean(shares) < 0.73


def test_the_surer_a_pixel_is_the_smaller_is_its_error(scenes):
    maps = [match(scene.left, scene.right, MatchOptions(BEST, fill=ALL)) for scene in scenes]
    errors = np.array([np.abs(found.values - scene.disparity_left) for found, scene in zip(maps, scenes, strict=True)])
    classes = np.array([found.confidence for found in maps])
    spread = {each: np.quantile(errors[classes == each], 0.68) for each in Confidence if each}
    middle = [spread[Confidence.SINGLE], spread[Confidence.APART]]  # about as good as each other
    assert spread[Confidence.FILLED] > max(middle)
    assert min(middle) > spread[Confidence.NEAR] > spread[Confidence.AGREED]
    sigma = np.array([found.sigma for found in maps])
    surest, least_sure = sigma < np.quantile(sigma, 0.25), sigma > np.quantile(sigma, 0.75)
    assert np.median(errors[least_sure]) > 4 * np.median(errors[surest])


@pytest.mark.parametrize(("search", "low", "high"), [((12, 20), 1, 0), ((4, 12), 0, 1), ((4, 20), 0, 0)])
def test_the_share_of_matches_at_either_end_of_the_range_is_told(search, low, high):
    left, right = textured_pair(np.full((50, 120), 12.0))
    assert match(left, right, MatchOptions(BALANCED, search)).at_ends == pytest.approx((low, high), abs=0.1)


def test_what_only_one_camera_shows_is_no_match_at_the_end_of_the_range(quality):
    left, right = textured_pair(waves(110, 130, (320, 160)))  # more than a third of the left image
    assert max(match(left, right, MatchOptions(quality)).at_ends) < 0.005


def test_no_sigma_is_below_what_photographs_have_beyond_drawings():
    left, right = textured_pair(np.full((50, 120), 12.0))
    sigma = match(left, right, MatchOptions(BALANCED, (4, 20))).sigma
    assert 0.09 <= np.nanmin(sigma) < 0.105
