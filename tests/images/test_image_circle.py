"""The image circle of drawn photographs: its place to half a percent of the radius, and none where there is none.

What this does not prove: that a threshold on the photographs of a real lens is where its calibration ends. One large
bright disc before a black ground cannot be told from an image circle; no test asks for it.
"""

import itertools

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.images.image_circle import MOST_IMAGES, ImageCircleSearch, evenly_spaced

WITHIN = 0.005  # of the radius; the threshold lies a quarter of a reduced pixel outside of a sharp edge


def find_image_circle(images):
    """Return the image circle of images, None if they show none."""
    search = ImageCircleSearch()
    for image in images:
        search.add(image)
    return search.result()


def distances(size, centre):
    """Return how far (H, W) px the pixels of an image are from a centre."""
    y, x = np.mgrid[: size[1], : size[0]]
    return np.hypot(x - centre[0], y - centre[1])


def disc(size, centre, radius):
    """Return the share (H, W) of each pixel that a disc covers, to a few percent."""
    return np.clip(radius + 0.5 - distances(size, centre), 0, 1)


def scene(size, seed, low=10.0, high=255.0):
    """Return a textured image (H, W): blobs of many gray levels, sixteen along the longer side."""
    rng = np.random.default_rng(seed)
    small = cv2.GaussianBlur(rng.random((24, 32)).astype(np.float32), (0, 0), 0.8)
    small = (small - small.min()) / np.ptp(small)
    return low + (high - low) * cv2.resize(small, size, interpolation=cv2.INTER_CUBIC).clip(0, 1)


def photographs(size, centre, radius, count=12):
    """Yield images (H, W) uint8 of scenes inside an image circle: light, noise of the sensor, a black level of 8."""
    lit = disc(size, centre, radius)
    for seed in range(count):
        noise = np.random.default_rng([seed, 1]).normal(0, 2, size[::-1])
        yield np.clip(8 + lit * scene(size, seed) + noise, 0, 255).astype(np.uint8)


def visible_arc(size, centre, radius):
    turns = np.linspace(0, 2 * np.pi, 100001)[1:]
    x, y = centre[0] + radius * np.cos(turns), centre[1] + radius * np.sin(turns)
    return 2 * np.pi * np.mean((x > -0.5) & (x < size[0] - 0.5) & (y > -0.5) & (y < size[1] - 0.5))


def gray(values):
    return [np.clip(values, 0, 255).astype(np.uint8)]


def assert_found(circle, size, centre, radius, within=WITHIN):
    assert circle is not None
    assert circle.image_size == size
    assert circle.radius == pytest.approx(radius, rel=within)
    assert np.hypot(*np.subtract(circle.centre, centre)) < within * radius


@pytest.mark.parametrize(
    ("size", "centre", "radius"),
    [
        ((1280, 960), (639.5, 479.5), 430.0),
        ((1280, 960), (639.5, 479.5), 560.0),  # cut at the top and the bottom
        ((1280, 960), (500.0, 400.0), 520.0),  # cut at the left, the top
        ((960, 1280), (470.0, 655.0), 600.0),  # upright
        ((1277, 953), (655.3, 470.8), 441.7),  # no whole number of reduced pixels
        ((1280, 960), (640.0, 480.0), 670.0),  # only the image corners are dark
        ((320, 240), (158.2, 121.4), 100.0),  # not reduced
    ],
    ids=["full", "two sides", "off-centre", "upright", "odd", "corners", "small"],
)
def test_the_circle_is_found_where_it_was_drawn(size, centre, radius):
    circle = find_image_circle(photographs(size, centre, radius))
    assert_found(circle, size, centre, radius)
    # two reduced pixels along the border do not count, at up to eight ends of arcs
    assert visible_arc(size, centre, radius) - 0.35 < circle.visible_arc <= visible_arc(size, centre, radius) + 0.01
    assert circle.supported > 0.95
    assert circle.dark_outside > 0.99
    assert circle.dark_corners == 4
    assert circle.rms < 0.004 * radius


@pytest.mark.slow
def test_a_reduced_pixel_is_centred_on_the_pixels_that_it_was_made_of():
    size, centre, radius = (4000, 3000), (2003.0, 1490.0), 1300.0
    circle = find_image_circle(gray(240 * disc(size, centre, radius)))
    # a tenth of a reduced pixel; half a pixel taken for half a reduced one would be 4.5 px
    np.testing.assert_allclose(circle.centre, centre, atol=1.0)


def test_sixteen_bits_with_a_black_level_are_found_alike():
    size, centre, radius = (1280, 960), (650.0, 470.0), 440.0
    circle = find_image_circle(
        (256 + 15 * (image.astype(np.uint16) - image.min())).astype(np.uint16)
        for image in photographs(size, centre, radius)
    )
    assert_found(circle, size, centre, radius)


def test_light_that_falls_off_ends_at_a_quarter_of_the_range():
    size, centre, radius = (1280, 960), (630.0, 490.0), 440.0
    falling = np.clip((radius - distances(size, centre)) / (0.08 * radius), 0, 1)  # to nothing, over 8 % of the radius
    noise = np.random.default_rng(0).normal(0, 2, falling.shape)
    circle = find_image_circle(gray(10 + 220 * falling + noise))
    assert_found(circle, size, centre, radius * (1 - 0.25 * 0.08))


def test_things_in_the_way_and_reflections_outside_do_not_move_it():
    size, centre, radius = (1280, 960), (639.5, 479.5), 560.0
    lit = disc(size, centre, radius)
    lit[700:, 500:800] = 0  # a dark thing in every image, cut off by the border
    lit[300:420, 60:200] = 0
    lit += 0.8 * disc(size, (1180.0, 300.0), 40.0)  # a reflection that touches the rim
    images = (gray(8 + np.minimum(lit, 1) * scene(size, seed))[0] for seed in range(12))
    circle = find_image_circle(images)
    assert_found(circle, size, centre, radius)
    assert circle.supported < 0.95


def test_a_scene_that_is_dark_at_the_rim_is_found_by_the_lower_threshold():
    size, centre, radius = (1280, 960), (639.5, 479.5), 560.0
    values = np.full((960, 1280), 230.0)
    values[600:] = 50  # the floor, a fifth of the range
    circle = find_image_circle(gray(4 + values * disc(size, centre, radius)))
    assert_found(circle, size, centre, radius)


@pytest.mark.parametrize("count", [1, 12])
def test_textured_scenes_have_no_circle(count):
    for first in range(20):
        assert find_image_circle(gray(scene((640, 480), 100 * first + k, 0))[0] for k in range(count)) is None


SIZE = (1280, 960)
MIDDLE = (640.0, 480.0)


@pytest.mark.parametrize(
    "values",
    [
        scene(SIZE, 3, 20, 120) + 130 * disc(SIZE, MIDDLE, 350.0),  # a bright plate on a table
        scene(SIZE, 3, 70, 110) + 140 * disc(SIZE, (500.0, 470.0), 400.0),
        4 + 240 * disc(SIZE, MIDDLE, 150.0),  # a lamp in the dark
        4 + 240 * disc(SIZE, (300.0, 950.0), 430.0),  # a plate in the dark, cut in half by the border
        4 + 240 * disc(SIZE, MIDDLE, 765.0),  # too little of the circle is seen
        4 + 240 * (distances(SIZE, MIDDLE)[:, ::-1] < 450) * (np.abs(np.mgrid[:960, :1280][0] - 480) < 260),  # a barrel
        240 - 236 * disc(SIZE, MIDDLE, 400.0),  # a dark disc
        np.full(SIZE[::-1], 128.0) + 100 * (np.indices(SIZE[::-1]).sum(axis=0) > 1100),  # a straight edge
    ],
    ids=["plate", "faint plate", "lamp", "half a plate", "small arc", "barrel", "dark disc", "edge"],
)
def test_other_things_are_no_image_circle(values):
    assert find_image_circle(gray(values)) is None


def test_a_board_before_a_black_ground_is_no_image_circle():
    values = np.full(SIZE[::-1], 5.0)
    corners = np.array([[300, 150], [1000, 220], [950, 800], [260, 760]], np.int32)
    assert find_image_circle(gray(cv2.fillConvexPoly(values, corners, 230.0))) is None


def test_nearly_black_and_uniform_images_have_no_circle():
    noise = np.random.default_rng(0).integers(0, 4, (480, 640)).astype(np.uint8)
    assert find_image_circle([noise]) is None
    assert find_image_circle([np.zeros((480, 640), np.uint8)]) is None
    assert find_image_circle([np.full((480, 640), 255, np.uint8)]) is None
    assert find_image_circle([np.full((1, 5000), 255, np.uint8), np.zeros((1, 5000), np.uint8)]) is None
    assert find_image_circle([np.eye(3, dtype=np.uint8) * 255]) is None
    assert find_image_circle([]) is None


def test_the_result_can_be_asked_for_any_time_and_does_not_depend_on_the_order():
    images = list(photographs((640, 480), (321.0, 240.0), 215.0, 6))
    search = ImageCircleSearch()
    assert search.result() is None
    for image in images:
        search.add(image)
        before = image.copy()
        search.result()
        np.testing.assert_array_equal(image, before)
    assert search.result() == search.result() == find_image_circle(reversed(images))


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (
            np.zeros((480, 641), np.uint8),
            r"found uint8 of the shape \(480, 641\) after uint8 of the shape \(480, 640\)",
        ),
        (np.zeros((480, 640), np.uint16), "found uint16"),
        (np.zeros((480, 640), np.float32), "uint8 or uint16, found float32"),
        (np.zeros((480, 640, 3), np.uint8), r"\(H, W\)"),
        (np.zeros((0, 640), np.uint8), r"\(0, 640\)"),
    ],
)
def test_images_of_another_size_or_type_are_refused(image, message):
    search = ImageCircleSearch()
    search.add(np.zeros((480, 640), np.uint8))
    with pytest.raises(InvalidInput, match=message):
        search.add(image)


@pytest.mark.parametrize("count", [0, 1, 2, 23, 24, 25, 47, 1000])
def test_images_are_chosen_evenly_from_the_first_to_the_last(count):
    chosen = evenly_spaced(count)
    assert len(chosen) == min(count, MOST_IMAGES)
    assert chosen[:1] == ([0] if count else [])
    assert chosen[-1:] == ([count - 1] if count else [])
    steps = {after - before for before, after in itertools.pairwise(chosen)}
    assert not steps or max(steps) - min(steps) <= 1


def test_bright_images_rule_a_circle_out_and_lit_discs_do_not():
    search = ImageCircleSearch()
    assert not search.ruled_out
    for image in photographs((640, 480), (320.0, 240.0), 200.0):
        search.add(image)
        assert not search.ruled_out
    search.add(np.full((480, 640), 60, np.uint8))
    assert search.ruled_out
    assert search.result() is None


def test_dark_images_rule_nothing_out():
    search = ImageCircleSearch()
    search.add(np.full((480, 640), 50, np.uint8))  # beside 255 that others may bring it is dark
    assert not search.ruled_out
