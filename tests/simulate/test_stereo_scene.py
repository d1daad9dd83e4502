"""Rendered stereo pairs: disparity and occlusion against geometry done in other ways, and images that agree with them.

That the scenes are as hard to match as photographs is not proved here.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from camcal.errors import InvalidInput
from camcal.simulate import stereo_scene
from camcal.simulate.render import draw
from camcal.simulate.stereo_scene import PairOptions, Scene, make_scene, render_pair
from camcal.simulate.stereo_surfaces import Ball, Facet, Paint

SMALL = PairOptions(size=(120, 90), focal=110.0, disparities=(2.0, 16.0), noise=0.0, objects=6)
FORWARD = np.array([[1.0, 0, 0], [0, 1, 0]])  # the axes of a facet that faces the cameras


def evenly(brightness):
    """A paint of one brightness."""
    return Paint(np.zeros((4, 4)), np.zeros((2, 3)), np.full(3, brightness), np.ones(3))


def wall(disparity, options=SMALL, brightness=0.5):
    """A plane that faces the cameras at a disparity."""
    depth = options.focal * options.baseline / (disparity + options.doffs)
    return Facet(np.array([0, 0, depth]), FORWARD, (np.inf, np.inf), evenly(brightness))


def screen(options, disparity, left, right, brightness=0.9):
    """A facet that faces the cameras and reaches from one column of the left image to another, over all rows."""
    depth = options.focal * options.baseline / (disparity + options.doffs)
    middle, half = (left + right) / 2 - (options.size[0] - 1) / 2, (right - left) / 2
    centre, reach = np.array([middle, 0, options.focal]) * depth / options.focal, half * depth / options.focal
    return Facet(centre, FORWARD, (reach, 100.0), evenly(brightness))


def rendered(surfaces, options=SMALL, seed=0):
    return render_pair(Scene(tuple(surfaces), options), np.random.default_rng(seed))


@cache
def drawn(seed):
    """A drawn scene and its pair."""
    scene = make_scene(SMALL, np.random.default_rng(seed))
    return scene, render_pair(scene, np.random.default_rng(seed))


def pixels(options):
    return np.meshgrid(np.arange(options.size[0]), np.arange(options.size[1]))


def test_a_plane_has_the_disparity_of_its_equation():
    normal, distance = np.array([0.5, -0.3, 1.0]), 1.2  # normal · X = distance
    axes = np.linalg.svd(normal[None])[2][1:]
    plane = Facet(np.array([0, 0, distance]), axes, (np.inf, np.inf), evenly(0.5))
    options = replace(SMALL, doffs=3.5)
    columns, rows = pixels(options)
    slope = normal[0] * (columns - 59.5) + normal[1] * (rows - 44.5) + normal[2] * options.focal
    truth = rendered([plane], options)
    # float32 holds disparities below 16 px to 1e-6.
    assert truth.disparity_left == pytest.approx(options.baseline / distance * slope - options.doffs, abs=2e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_disparities_are_those_of_rays_traced_one_by_one(seed):
    scene, truth = drawn(seed)
    rng = np.random.default_rng(seed)
    for column, row in rng.integers(0, SMALL.size, (60, 2)):
        for eye, shown in ((0.0, truth.disparity_left), (SMALL.baseline, truth.disparity_right)):
            ray = np.array([(column - 59.5) / SMALL.focal, (row - 44.5) / SMALL.focal, 1.0])
            depth = min(traced(surface, np.array([eye, 0, 0]), ray) for surface in scene.surfaces)
            # float32 holds disparities below 16 px to 1e-6.
            assert shown[row, column] == pytest.approx(SMALL.focal * SMALL.baseline / depth, abs=2e-6)


def traced(surface, eye, ray):
    """The depth at which a ray meets a surface: a linear system for facets, the roots of a quadratic for balls."""
    if isinstance(surface, Ball):
        off = eye - surface.centre
        roots = np.roots([ray @ ray, 2 * ray @ off, off @ off - surface.radius**2])
        return min((root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0), default=np.inf)
    depth, *along = np.linalg.solve(np.column_stack([ray, *-surface.axes]), surface.centre - eye)
    places = np.array(along) / surface.reach
    inside = np.hypot(*places) <= 1 if surface.elliptic else np.abs(places).max() <= 1
    return depth if inside and depth > 0 else np.inf


def test_a_screen_hides_the_wall_to_its_left_by_the_difference_of_their_disparities():
    # The wall's column u is seen at u - 3 in the right image, the screen's at u - 10.
    truth = rendered([wall(3), screen(SMALL, 10, 49.5, 79.5)])
    expected = np.ones(120, bool)
    expected[:3] = False  # left of the right image: u - 3 < -0.5
    expected[43:50] = False  # 43 … 49 fall on 40 … 46, where the screen, from 39.5 on, stands
    assert np.array_equal(truth.visible, np.tile(expected, (90, 1)))


def test_the_right_disparity_is_that_of_the_left_where_both_see_the_same_point():
    truth = rendered([wall(3), screen(SMALL, 10, 49.5, 79.5)])
    for row, column in np.argwhere(truth.visible)[::97]:
        there = column - round(float(truth.disparity_left[row, column]))
        assert truth.disparity_right[row, there] == truth.disparity_left[row, column]


@pytest.mark.parametrize("seed", [0, 1])
def test_the_right_image_moved_by_the_disparity_is_the_left_image(seed):
    options = PairOptions(size=(200, 150), focal=180.0, disparities=(2, 24), noise=0, depth=16, colour=False, objects=8)
    truth = render_pair(options, np.random.default_rng(seed))
    columns, rows = pixels(options)
    left, right = truth.left / 257, truth.right / 257
    moved = ndimage.map_coordinates(right, (rows, columns - truth.disparity_left), order=5, mode="nearest")
    bent = np.abs(ndimage.laplace(truth.disparity_left.astype(float))) > 1e-3  # edges of surfaces
    shared = truth.visible & ~ndimage.binary_dilation(bent | ~truth.visible, np.ones((7, 7)))
    difference = np.abs(moved - left)[shared]
    assert shared.mean() > 0.5
    # Gray levels. A slanted surface is a little larger in one image, and its finest grain looks different there.
    assert np.median(difference) < 0.1
    assert np.quantile(difference, 0.99) < 1.0
    assert difference.max() < 5


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.7])
def test_the_outline_of_a_screen_is_blurred_as_its_exact_integral(turn):
    options, depth = replace(SMALL, depth=16), SMALL.focal * SMALL.baseline / 10
    cosine, sine = np.cos(turn), np.sin(turn)
    axes = np.array([[cosine, sine, 0], [-sine, cosine, 0]])
    reach = 20.3 * depth / options.focal, 14.6 * depth / options.focal
    truth = rendered([wall(3, brightness=0.2), Facet(np.array([0, 0, depth]), axes, reach, evenly(0.9))], options)
    loop = np.array([(-20.3, -14.6), (20.3, -14.6), (20.3, 14.6), (-20.3, 14.6), (-20.3, -14.6)]) @ axes[:, :2]
    steps = np.linspace(0, 4, 1001)
    outline = np.column_stack([np.interp(steps, range(5), place) for place in loop.T])
    for image, shift in ((truth.left, 0), (truth.right, 10)):
        place = np.array([59.5 - shift, 44.5])
        share = draw(options.size, outline + place, np.ones(1000), options.blur)
        # Gray levels of 255. Places in 128 columns to a pixel know where an edge is to half of one, which is 0.7 of
        # the contrast of 178 levels; one count of 16 bits besides.
        assert image[:, :, 0] / 257 == pytest.approx(255 * (0.2 + 0.7 * share), abs=0.71)


def test_a_low_right_image_has_moved_down_by_the_shift_and_the_tilt():
    scene, straight = drawn(0)
    shifted, tilted = (
        render_pair(replace(scene, options=options), np.random.default_rng(0))
        for options in (replace(SMALL, row_shift=2.0), replace(SMALL, row_tilt=2.0))
    )
    assert np.array_equal(shifted.right[2:], straight.right[:-2])
    assert np.array_equal(shifted.disparity_right[2:], straight.disparity_right[:-2])
    assert np.array_equal(shifted.left, straight.left)
    rows = np.arange(2, 88)
    for column, lower in ((0, -1), (119, 1)):
        assert np.array_equal(tilted.disparity_right[rows, column], straight.disparity_right[rows - lower, column])


def test_the_right_exposure_is_a_power_a_gain_and_an_offset():
    options = replace(SMALL, depth=16, gamma=1.4, gain=0.8, offset=10)
    truth = rendered([wall(3, brightness=0.5)], options)
    assert truth.left[40, 60, 0] / 65535 == pytest.approx(0.5, abs=1e-5)  # one count of 16 bits
    assert truth.right[40, 60, 0] / 65535 == pytest.approx(0.8 * 0.5**1.4 + 10 / 255, abs=1e-5)


def test_noise_has_the_asked_deviation_and_is_another_in_each_image():
    truth = rendered([wall(3)], replace(SMALL, noise=5.0))
    left, right = (image.astype(float) for image in (truth.left, truth.right))
    # 32 400 values know their deviation to 0.4 %, five times that is allowed; rounding adds 1/12.
    assert left.std() == pytest.approx(np.sqrt(25 + 1 / 12), rel=0.02)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.03  # five times 1 / sqrt(32 400)


@given(
    seed=st.integers(0, 2**32),
    least=st.floats(0.5, 10),
    span=st.floats(4, 40),
    doffs=st.floats(0, 30),
)
@settings(max_examples=6, deadline=None)
def test_every_pixel_has_a_disparity_in_the_range_asked_for(seed, least, span, doffs):
    options = PairOptions(
        size=(64, 48), focal=60.0, doffs=doffs, disparities=(least - doffs, least + span - doffs), objects=4
    )
    truth = render_pair(options, np.random.default_rng(seed))
    assert np.isfinite(truth.disparity_left).all()
    assert truth.disparity_left.min() >= options.disparities[0] - 1e-4  # float32
    assert truth.disparity_left.max() <= options.disparities[1] + 1e-4
    assert np.isfinite(truth.disparity_right).all()


def test_a_seed_gives_the_same_pair_and_another_seed_another():
    (_, first), (_, other) = drawn(1), drawn(0)
    again = render_pair(make_scene(SMALL, np.random.default_rng(1)), np.random.default_rng(1))
    assert np.array_equal(first.left, again.left)
    assert np.array_equal(first.disparity_right, again.disparity_right)
    assert not np.array_equal(first.disparity_left, other.disparity_left)


def test_strips_of_a_large_image_join_without_a_seam(monkeypatch):
    scene, whole = drawn(0)
    monkeypatch.setattr(stereo_scene, "_STRIP", 20_000)  # rays: a strip of a few rows of pixels
    found = render_pair(scene, np.random.default_rng(0))
    assert np.array_equal(found.left, whole.left)
    assert np.array_equal(found.right, whole.right)
    assert np.array_equal(found.disparity_left, whole.disparity_left)
    assert np.array_equal(found.visible, whole.visible)


def test_where_nothing_is_seen_there_is_no_disparity():
    truth = rendered([screen(SMALL, 10, 19.5, 60.5)])
    assert np.array_equal(
        np.isfinite(truth.disparity_left).all(axis=0), (np.arange(120) >= 20) & (np.arange(120) <= 60)
    )
    assert not truth.visible[:, :20].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": (8, 90)}, "16 to 32000"),
        ({"focal": -1.0}, "positive"),
        ({"gamma": 0.0}, "positive"),
        ({"noise": float("nan")}, "finite"),
        ({"noise": -1.0}, "noise"),
        ({"blur": 0.1}, "blur"),
        ({"depth": 12}, "12 bits"),
        ({"disparities": (0.0, 16.0)}, "above 0"),
        ({"disparities": (16.0, 2.0)}, "above 0"),
        ({"disparities": (2.0, 130.0)}, "120 px wide"),
    ],
)
def test_what_cannot_be_rendered_is_refused(change, message):
    with pytest.raises(InvalidInput, match=message):
        replace(SMALL, **change)
