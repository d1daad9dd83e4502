"""Maps and what is drawn through them. Where a pixel comes from is checked against the lens model itself, what it
becomes against a textbook's loop and against ramps, whose value says the place.
"""

import cv2
import numpy as np
import pytest

from camcal import opencv
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.images import remap
from camcal.images.image import Scratch
from camcal.images.options import ViewOptions
from camcal.images.remap import INTERPOLATIONS, STEP, Maps, Trace, bands, build_maps, exact_bands
from camcal.images.views import make_view


def camera(model, size, *parameters):
    return Camera(model_named(model), size, np.array(parameters))


EUROC = camera(
    "opencv4", (752, 480), 458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05
)
FISHEYE = camera("kannala_brandt4", (500, 400), 130.0, 130, 250, 200, 0.01, -0.005, 0.001, -0.0002)
FOLDING = camera("opencv5", (500, 400), 260.0, 260, 250, 200, -0.4, 0.0, 0, 0, 0)
TILTED = camera("opencv14", (500, 400), 400.0, 400, 250, 200, *[0.01] * 12, 0.05, -0.08)
IDEAL = camera("pinhole", (60, 40), 50.0, 50, 30, 20)
PANORAMA = camera("equirectangular", (600, 300), 95.0, 95, 299.5, 149.5)
PAIRS = {
    "crop": (EUROC, make_view(EUROC, ViewOptions())),
    "all": (EUROC, make_view(EUROC, ViewOptions(alpha=1))),
    "far beyond": (EUROC, make_view(EUROC, ViewOptions(fov_deg=150))),
    "odd size": (EUROC, make_view(EUROC, ViewOptions(size=(333, 17)))),
    "fold": (FOLDING, make_view(FOLDING, ViewOptions(fov_deg=120))),
    "tilted": (TILTED, make_view(TILTED, ViewOptions(alpha=1))),
    "panorama": (FISHEYE, make_view(FISHEYE, ViewOptions(projection="equirectangular", fov_deg=360))),
    "cylinder": (FISHEYE, make_view(FISHEYE, ViewOptions(projection="cylinder"))),
    "across the seam": (PANORAMA, camera("stereographic", (300, 300), 30.0, 30, 149.5, 149.5)),
}
every_pair = pytest.mark.parametrize(("source", "view"), PAIRS.values(), ids=PAIRS)


def whole(parts):
    return np.concatenate([band for _, band in parts], axis=1)


@pytest.mark.parametrize("radius", [30.0, 120.0, 199.0, 300.0])
@pytest.mark.parametrize("name", ["panorama", "cylinder"])
def test_nothing_comes_from_outside_of_the_image_circle(name, radius):
    source, view = PAIRS[name]
    circle = ImageCircle(source.image_size, (243.0, 206.0), radius)
    exact = whole(exact_bands(Trace(source, view)))
    within = radius - np.hypot(exact[0] - 243.0, exact[1] - 206.0)  # px, NaN where there is no ray
    inside = ((exact >= 0) & (exact <= np.array(source.image_size)[:, None, None] - 1)).all(axis=0) & (within > 0)
    clear = ~(np.abs(within) < 1e-3)  # as good as positions are
    clear &= ~(np.abs(exact - np.rint(exact)) < 1e-2).any(axis=0)  # and on the border of the image
    np.testing.assert_array_equal(build_maps(source, view, circle=circle).valid()[clear], inside[clear])


@every_pair
def test_positions_are_those_of_the_model(source, view):
    trace = Trace(source, view)
    exact, fast = whole(exact_bands(trace)), whole(bands(trace))
    width, height = source.image_size
    seen = ((exact >= 0) & (exact <= np.array([width, height])[:, None, None] - 1)).all(axis=0)
    assert seen.any()
    # 2e-4 px at the middle of a cell, float32 rounding of 750 px, and a margin for cells that bend more elsewhere
    np.testing.assert_allclose(fast[:, seen], exact[:, seen], atol=1e-3)


@every_pair
def test_what_has_no_source_is_outside_and_everything_else_inside(source, view):
    maps = build_maps(source, view)
    exact = whole(exact_bands(Trace(source, view)))
    largest = np.array(source.image_size)[:, None, None] - 1
    with np.errstate(invalid="ignore"):
        off = np.maximum(-exact, exact - largest).max(axis=0)  # px beyond the border, NaN where there is no ray
    valid = maps.valid()
    assert valid[off < 0].all()
    assert not valid[~(off < 4e-3)].any()  # positions within 2e-3 px of the border, and the map's own error
    for positions, side in ((maps.x, source.image_size[0]), (maps.y, source.image_size[1])):
        assert (positions[valid] >= 0).all()
        assert (positions[valid] <= side - 1).all()


def test_a_twelve_megapixel_map_is_good_to_a_thousandth_of_a_pixel():
    source = camera("opencv5", (4000, 3000), 3000.0, 3004, 1990, 1505, -0.28, 0.08, 1e-4, 2e-4, -0.01)
    view = make_view(source, ViewOptions(keep_k=True))
    maps = build_maps(source, view)
    rng = np.random.default_rng(4)
    x, y = rng.integers(0, 4000, 20000), rng.integers(0, 3000, 20000)
    found = np.stack([maps.x[y, x], maps.y[y, x]])
    np.testing.assert_allclose(found, Trace(source, view).positions(x, y), atol=1e-3)


def test_rays_of_a_turned_view_are_turned():
    angle = np.radians(10)
    source_R_view = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    view = camera("pinhole", (101, 81), 100.0, 100, 50, 40)
    maps = build_maps(EUROC, view, source_R_view=source_R_view)
    expected = EUROC.project(np.array([[np.sin(angle), 0, np.cos(angle)]])).pixels[0]
    np.testing.assert_allclose([maps.x[40, 50], maps.y[40, 50]], expected, atol=1e-3)


def textbook(image, parameters):
    """Undistortion as Gao & Zhang print it (Introduction to Visual SLAM, ch. 5): the nearest pixel by truncation."""
    fx, fy, cx, cy, k1, k2, p1, p2 = parameters
    result = np.zeros_like(image)
    rows, columns = image.shape
    for v in range(rows):
        for u in range(columns):
            x, y = (u - cx) / fx, (v - cy) / fy
            square = x * x + y * y
            radial = 1 + k1 * square + k2 * square * square
            u_d = fx * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + cx
            v_d = fy * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + cy
            if 0 <= u_d < columns and 0 <= v_d < rows:
                result[v, u] = image[int(v_d), int(u_d)]
    return result


@pytest.mark.parametrize("k1", [-0.28340811, 0.2])
def test_nearest_truncate_is_the_loop_that_textbooks_print(k1):
    parameters = np.array([115.0, 114.0, 91.8, 62.1, k1, 0.07395907, 0.00019359, 1.76e-05])
    small = Camera(model_named("opencv4"), (188, 120), parameters)
    image = np.random.default_rng(5).integers(0, 255, (120, 188), dtype=np.uint8)
    maps = build_maps(small, make_view(small, ViewOptions(keep_k=True)), "nearest-truncate")
    np.testing.assert_array_equal(maps.apply(image), textbook(image, parameters))


def test_nearest_rounds_to_the_closest_pixel():
    image = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)
    view = Camera(IDEAL.model, (59, 39), np.array([50.0, 50, 29.6, 20.3]))
    maps = build_maps(IDEAL, view, "nearest")
    np.testing.assert_array_equal(maps.apply(image)[1:, :], image[1:39, :59])  # 0.4 right, 0.3 up


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_view_that_changes_nothing_changes_nothing_up_to_the_border(interpolation, dtype, channels):
    shape = (40, 60) if channels == 1 else (40, 60, channels)
    image = np.random.default_rng(6).integers(0, 255, shape).astype(dtype)
    result = build_maps(IDEAL, IDEAL, interpolation).apply(image)
    assert result.dtype == dtype
    np.testing.assert_array_equal(result, image)


@pytest.mark.parametrize(
    ("interpolation", "tolerance"),
    # rounded to 1/32 px in OpenCV 4; the cubic of OpenCV does not reproduce ramps
    [("linear", 1e-3 if cv2.__version__ >= "5" else 0.0226), ("cubic", 0.07), ("lanczos", 0.04)],
)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_ramp_is_drawn_where_it_belongs(interpolation, tolerance, channels):
    rng = np.random.default_rng(7)
    x, y = rng.uniform(4, 55, (50, 50)).astype(np.float32), rng.uniform(4, 35, (50, 50)).astype(np.float32)
    ramp = np.tile(np.arange(60, dtype=np.float32), (40, 1))
    image = ramp if channels == 1 else cv2.merge([ramp] * channels)
    drawn = Maps(x, y, (60, 40), interpolation).apply(image)
    np.testing.assert_allclose(drawn.reshape(50, 50, -1)[:, :, 0], x, atol=tolerance)


def test_eight_bit_colour_is_drawn_as_each_channel_alone():
    image = np.random.default_rng(8).integers(0, 255, (480, 752, 3), dtype=np.uint8)
    maps = build_maps(*PAIRS["all"])
    together = maps.apply(image, (10, 20, 30))
    for channel, border in enumerate((10, 20, 30)):
        alone = maps.apply(np.ascontiguousarray(image[:, :, channel]), (border,))
        np.testing.assert_array_equal(together[:, :, channel], alone)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize(
    ("dtype", "channels", "border"),
    [(np.uint8, 1, (7,)), (np.uint8, 3, (7,)), (np.uint8, 4, (1, 2, 3, 0)), (np.uint16, 3, (1000, 2, 3)),
     (np.float32, 1, (np.nan,)), (np.float32, 3, (-1.5, 0.0, 2.5))],
)  # fmt: skip
def test_pixels_without_a_source_have_the_border_value(interpolation, dtype, channels, border):
    image = np.full((400, 500) if channels == 1 else (400, 500, channels), 50, dtype)
    view = make_view(FISHEYE, ViewOptions(projection="stereographic", fov_deg=300))
    maps = build_maps(FISHEYE, view, interpolation)
    drawn, valid = maps.apply(image, border), maps.valid()
    assert 0.05 < valid.mean() < 0.9
    outside = drawn[~valid].reshape(-1, channels)
    np.testing.assert_array_equal(outside, np.broadcast_to(np.array(border, dtype), outside.shape))
    # Lanczos weights of OpenCV add up to 1 within 1e-6
    np.testing.assert_allclose(drawn[valid], 50, rtol=1e-5)


def test_a_border_of_nan_stays_out_of_the_image():
    image = np.ones((40, 60), np.float32)
    for interpolation in INTERPOLATIONS:
        assert np.isfinite(build_maps(IDEAL, IDEAL, interpolation).apply(image, (np.nan,))).all()


def test_scratch_memory_changes_nothing_and_is_used_again():
    image = np.random.default_rng(9).integers(0, 255, (480, 752, 3), dtype=np.uint8)
    maps, scratch = build_maps(*PAIRS["all"]), Scratch()
    first = maps.apply(image, scratch=scratch)
    np.testing.assert_array_equal(first, maps.apply(image))
    assert maps.apply(image, scratch=scratch) is first


def test_an_image_of_another_size_is_refused():
    with pytest.raises(InvalidInput, match="is 41x40, the maps are for 60x40"):
        build_maps(IDEAL, IDEAL).apply(np.zeros((40, 41), np.uint8))


@pytest.mark.parametrize(("border", "words"), [((256,), "256 does not fit uint8"), ((1, 2), "2 border values for 3")])
def test_a_border_that_does_not_fit_is_refused(border, words):
    with pytest.raises(InvalidInput, match=words):
        build_maps(IDEAL, IDEAL).apply(np.zeros((40, 60, 3), np.uint8), border)
    with pytest.raises(InvalidInput, match="nan does not fit"):
        build_maps(IDEAL, IDEAL).apply(np.zeros((40, 60, 3), np.uint8), (np.nan,))


def test_views_and_images_of_more_pixels_than_are_allowed_are_refused():
    large = camera("pinhole", (30_000, 20_000), 50.0, 50, 30, 5)
    for pair in ((large, IDEAL), (IDEAL, large)):
        with pytest.raises(InvalidInput, match="30000x20000 has 600 million pixels, more than --max-pixels 300"):
            build_maps(*pair)


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic", "lanczos"])
@pytest.mark.parametrize(("dtype", "channels"), [(np.uint8, 3), (np.uint16, 1), (np.float32, 1)])
def test_an_image_drawn_in_tiles_is_the_image_drawn_at_once(monkeypatch, interpolation, dtype, channels):
    pixels = np.random.default_rng(4).integers(8, 200, (480, 752, channels)).astype(dtype).squeeze()
    maps = build_maps(EUROC, make_view(EUROC, ViewOptions(alpha=1.0)), interpolation)
    whole = maps.apply(pixels, (7.0,))
    assert (whole == 7).mean() > 0.01
    for module in (opencv, remap):
        monkeypatch.setattr(module, "LONGEST_REMAPPED", 90)
    np.testing.assert_array_equal(maps.apply(pixels, (7.0,)), whole)


@pytest.mark.parametrize("longer", [(40, 33_000), (33_000, 40)])
def test_sides_that_opencv_cannot_count_are_drawn(longer):
    height, width = longer
    long = camera("pinhole", (width, height), 30_000.0, 30_000, (width - 1) / 2, (height - 1) / 2)
    pixels = np.random.default_rng(5).integers(0, 255, longer, np.uint8)
    drawn = build_maps(long, long).apply(pixels)
    # a position beyond 32 768 is a float32 in steps of 0.004 px
    np.testing.assert_allclose(drawn.astype(int), pixels, atol=1)


@pytest.mark.parametrize("border", [cv2.BORDER_CONSTANT, cv2.BORDER_REPLICATE])
def test_positions_far_outside_of_a_long_image_show_its_border(border):
    image = np.arange(2 * 40_000, dtype=np.float32).reshape(2, -1)
    x = np.array([[-50.0, 0, 39_999, 41_000]], np.float32)
    first, *inside, last = opencv.remap(image, x, np.zeros_like(x), border=border, value=(5.0,))[0]
    assert inside == [0, 39_999]
    assert (first, last) == ((5, 5) if border == cv2.BORDER_CONSTANT else (0, 39_999))


def test_an_unknown_interpolation_is_refused_with_those_there_are():
    with pytest.raises(InvalidInput, match="'bilinear' is unknown; use one of nearest-truncate, nearest, linear"):
        build_maps(IDEAL, IDEAL, "bilinear")


def test_an_image_smaller_than_a_cell_is_mapped():
    tiny = camera("opencv5", (STEP - 9, 3), 5.0, 5, 3, 1, -0.1, 0, 0, 0, 0)
    np.testing.assert_allclose(build_maps(tiny, make_view(tiny, ViewOptions(keep_k=True))).x[1, 3], 3, atol=1e-3)
