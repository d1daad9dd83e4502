"""What views show: every pixel has a source, every source pixel has a place, and what no pinhole can hold."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.images.options import ViewOptions
from camcal.images.remap import Trace, build_maps
from camcal.images.views import make_view, seen_across


def camera(model, size, *parameters):
    return Camera(model_named(model), size, np.array(parameters))


EUROC = camera(
    "opencv4", (752, 480), 458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05
)
LENSES = {
    "barrel": EUROC,
    "pincushion": camera("opencv5", (640, 360), 450.0, 455, 325, 170, 0.15, 0.05, 1e-3, -1e-3, 0),
    "rational": camera("opencv8", (800, 600), 380.0, 381, 398, 301, -0.2, 0.05, 1e-4, 2e-4, 0.01, 0.1, 0.02, 1e-3),
    "fisheye": camera("kannala_brandt4", (640, 360), 280.0, 280, 320, 180, -0.02, 0.002, 0, 0),
    "none": camera("pinhole", (640, 480), 500.0, 505, 310, 250),
}
ALL_AROUND = camera("kannala_brandt4", (500, 500), 110.0, 110, 250, 250, -0.05, -0.01, -0.001, 0)
every_lens = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)


def some(length):
    """Every seventh pixel of a side, its ends among them."""
    return np.unique([*range(0, length, 7), length - 1])


def sources(lens, view):
    width, height = view.image_size
    return Trace(lens, view).positions(some(width), some(height)[:, None])


def inside(positions, lens):
    return ((positions >= 0) & (positions <= np.array(lens.image_size)[:, None, None] - 1)).all(axis=0)


@every_lens
@pytest.mark.parametrize(
    ("size", "stretch"),
    [(None, False), (None, True), ((300, 400), False), ((801, 250), False), ((2000, 10), False), ((4, 300), False)],
)
def test_every_pixel_of_the_crop_has_a_source(lens, stretch, size):
    view = make_view(lens, ViewOptions(alpha=0, size=size, stretch=stretch))
    assert view.image_size == (size or lens.image_size)
    assert inside(sources(lens, view), lens).all()
    assert build_maps(lens, view).valid().all()


@every_lens
def test_the_crop_cannot_grow_about_its_middle(lens):
    view = make_view(lens, ViewOptions())
    width, height = view.image_size
    grown = view.model.rescale(view.parameters, (0.99, 0.99), (-0.005 * width, -0.005 * height))
    assert not inside(sources(lens, Camera(view.model, view.image_size, grown)), lens).all()


@every_lens
def test_pixels_keep_their_shape_unless_the_crop_may_be_stretched(lens):
    shape = lens.value("fx") / lens.value("fy")
    for alpha in (0.0, 0.3, 1.0):
        view = make_view(lens, ViewOptions(alpha=alpha))
        assert view.value("fx") / view.value("fy") == pytest.approx(shape)


def test_a_stretched_crop_shows_what_opencv_shows():
    import cv2

    fx, fy, cx, cy = EUROC.parameters[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    theirs, _ = cv2.getOptimalNewCameraMatrix(matrix, EUROC.parameters[4:], EUROC.image_size, 0)
    ours = make_view(EUROC, ViewOptions(alpha=0, stretch=True))
    # OpenCV looks at nine points of each edge
    np.testing.assert_allclose(ours.parameters, theirs[[0, 1, 0, 1], [0, 1, 2, 2]], rtol=2e-3)


@every_lens
@pytest.mark.parametrize("stretch", [False, True])
def test_every_pixel_of_the_source_has_a_place_with_alpha_one(lens, stretch):
    view = make_view(lens, ViewOptions(alpha=1, stretch=stretch))
    width, height = lens.image_size
    pixels = np.stack(np.meshgrid(some(width), some(height)), axis=-1).reshape(-1, 2)
    places = view.project(lens.unproject(pixels).directions).pixels
    # the outline is sampled: between two samples it bends by less than 0.01 px
    assert places.min() >= -0.01
    assert (places <= np.array(view.image_size) - 1 + 0.01).all()


@every_lens
def test_between_the_ends_the_view_opens_steadily(lens):
    focal = [make_view(lens, ViewOptions(alpha=alpha)).value("fx") for alpha in (0, 0.25, 0.5, 0.75, 1)]
    assert (np.diff(focal) <= 1e-9).all()


def test_a_lens_without_distortion_is_left_alone():
    lens = LENSES["none"]
    for options in (ViewOptions(alpha=0), ViewOptions(alpha=1), ViewOptions(keep_k=True)):
        # the search for the crop ends at 1e-7 of its size
        np.testing.assert_allclose(make_view(lens, options).parameters, lens.parameters, rtol=1e-6)


def test_kept_intrinsics_follow_another_size():
    np.testing.assert_array_equal(make_view(EUROC, ViewOptions(keep_k=True)).parameters, EUROC.parameters[:4])
    half = make_view(EUROC, ViewOptions(keep_k=True, size=(376, 240)))
    np.testing.assert_allclose(half.parameters, [229.327, 228.648, 183.3575, 123.9375])


@pytest.mark.parametrize("projection", ["pinhole", "cylinder", "equirectangular", "stereographic"])
@pytest.mark.parametrize("degrees", [60.0, 120.0, 170.0])
def test_the_field_of_view_reaches_from_edge_to_edge(projection, degrees):
    view = make_view(EUROC, ViewOptions(projection=projection, fov_deg=degrees, size=(401, 301)))
    edges = np.array([[-0.5, 150.0], [400.5, 150.0]])
    rays = view.unproject(edges).directions
    assert np.degrees(np.arctan2(rays[:, 0], rays[:, 2])) == pytest.approx([-degrees / 2, degrees / 2])


def test_a_panorama_shows_what_the_lens_sees_across():
    seen = np.degrees(seen_across(ALL_AROUND))
    assert 180 < seen < 210
    view = make_view(ALL_AROUND, ViewOptions(projection="equirectangular"))
    assert np.degrees(view.image_size[0] / view.value("fx")) == pytest.approx(seen)


@pytest.mark.parametrize(
    "options",
    [ViewOptions(), ViewOptions(alpha=1), ViewOptions(alpha=0.5, stretch=True)],
    ids=["crop", "all", "between"],
)
def test_a_pinhole_that_is_to_hold_half_the_world_is_refused_with_what_can(options):
    with pytest.raises(
        InvalidInput, match=r"\d+° exceeds the field of view of a pinhole.*cylinder, equirectangular or stereographic"
    ):
        make_view(ALL_AROUND, options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"fov_deg": 180.0}, "180° exceeds the field of view of a pinhole"),
        ({"fov_deg": 361.0, "projection": "cylinder"}, "a cylinder view holds up to 360°"),
        ({"fov_deg": 360.0, "projection": "stereographic"}, "up to 350°"),
        ({"fov_deg": -3.0}, "is positive"),
        ({"fov_deg": float("nan")}, "is positive"),
        ({"alpha": 1.5}, "'--alpha': 1.5 is more than 1"),
        ({"alpha": float("nan")}, "'--alpha': nan is not a number"),
        ({"alpha": 0.5, "keep_k": True}, "--alpha and --keep-k exclude each other"),
        ({"alpha": 0.5, "fov_deg": 90.0}, "exclude each other"),
        ({"projection": "cylinder", "alpha": 0.5}, "are for a pinhole"),
        ({"projection": "mercator"}, "use one of pinhole, cylinder"),
        ({"size": (1, 100)}, "at least 2 pixels a side"),
        ({"size": (1_048_577, 100)}, "1048577x100 has a side of more than 1048576 pixels"),
        ({"size": (40_000, 10_000)}, "40000x10000 has 400 million pixels, more than --max-pixels 300"),
    ],
)
def test_views_that_make_no_sense_are_refused(arguments, words):
    with pytest.raises(InvalidInput, match=words):
        ViewOptions(**arguments)


def test_a_part_of_a_fisheye_fits_a_pinhole():
    view = make_view(ALL_AROUND, ViewOptions(fov_deg=90))
    assert build_maps(ALL_AROUND, view).valid().all()


@pytest.mark.slow
def test_the_search_for_a_crop_ends_where_the_axis_is_at_the_corner_of_the_image():
    lens = Camera(model_named("kannala_brandt4"), (400, 300), np.array([150, 150, 2, 2, 0.01, -0.01, 0.002, -0.001]))
    with pytest.raises(InvalidInput, match="exceeds the field of view of a pinhole"):
        make_view(lens, ViewOptions())


@pytest.mark.parametrize(("size", "fy"), [((96, 72), 1e-320), ((1, 72), 100.0), ((96, 1), 100.0)])
def test_a_focal_length_next_to_zero_or_a_single_row_has_no_crop(size, fy):
    lens = camera("opencv5", size, 100.0, fy, size[0] / 2, size[1] / 2, -0.1, 0.02, 0, 0, 0)
    with pytest.raises(InvalidInput, match=r"no crop of \d+x\d+ without an empty pixel was found"):
        make_view(lens, ViewOptions())
