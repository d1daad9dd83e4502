"""Colours drawn through lenses of their own: they coincide in the view, and everything else is drawn as before."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.images.options import ViewOptions
from camcal.images.remap import INTERPOLATIONS, align_channels, build_maps
from camcal.images.views import make_view
from camcal.simulate.mosaics import lenses

SIZE = (160, 120)
LENS = Camera(model_named("opencv5"), SIZE, np.array([130.0, 131, 82, 58, -0.2, 0.05, 1e-3, -1e-3, 0]))
ABERRATION_PX = 3.0
COLOURS = {"red": lenses(LENS, ABERRATION_PX)["R"], "blue": lenses(LENS, ABERRATION_PX)["B"]}


def scene(camera):
    """What a lens makes of a pattern of long waves on the rays, 0 … 1: exact, no image is resampled."""
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    rays = camera.unproject(np.column_stack([x.ravel(), y.ravel()])).directions
    across, down = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    return (0.5 + 0.25 * np.sin(12 * across) + 0.2 * np.cos(9 * down)).reshape(y.shape).astype(np.float32)


def photograph():
    return np.stack([scene(COLOURS["blue"]), scene(LENS), scene(COLOURS["red"])], axis=-1)


@pytest.fixture(scope="module")
def view():
    return make_view(LENS, ViewOptions())


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "lanczos"])
def test_the_colours_of_a_photograph_coincide(view, interpolation):
    maps = build_maps(LENS, view, interpolation)
    apart = maps.apply(photograph())
    together = align_channels(maps, COLOURS, view).apply(photograph())
    inside = (slice(4, -4), slice(4, -4))  # beyond the rim, where red ends before green does
    for channel in (0, 2):
        assert np.abs(apart[..., channel] - apart[..., 1])[inside].max() > 0.05
        assert np.abs(together[..., channel] - together[..., 1])[inside].max() < 0.01  # interpolation
    # OpenCV 4.14 adds up one channel in another order than three
    np.testing.assert_allclose(together[..., 1], apart[..., 1], atol=1e-6)


@pytest.mark.parametrize("interpolation", list(INTERPOLATIONS))
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_lenses_that_do_not_differ_change_nothing(view, interpolation, dtype):
    maps = build_maps(LENS, view, interpolation)
    pixels = (photograph() * (1 if dtype == np.float32 else 250)).astype(dtype)
    same = align_channels(maps, {"red": LENS, "blue": LENS, "green": LENS}, view)
    np.testing.assert_allclose(same.apply(pixels), maps.apply(pixels), atol=1e-3 if dtype == np.float32 else 1)


def test_gray_and_alpha_are_drawn_through_the_camera_itself(view):
    maps = build_maps(LENS, view)
    aligned = align_channels(maps, COLOURS, view)
    gray = scene(LENS)
    np.testing.assert_array_equal(aligned.apply(gray), maps.apply(gray))
    with_alpha = np.dstack([photograph(), gray])
    drawn = aligned.apply(with_alpha)
    np.testing.assert_array_equal(drawn[..., 3], maps.apply(gray))
    np.testing.assert_array_equal(drawn[..., :3], aligned.apply(photograph()))


def test_a_pixel_has_all_colours_or_none():
    view = make_view(LENS, ViewOptions(alpha=1.0))
    maps = build_maps(LENS, view)
    aligned = align_channels(maps, COLOURS, view)
    pixels = np.full((*SIZE[::-1], 3), 200, np.uint8)
    drawn = aligned.apply(pixels, (1.0, 2.0, 3.0))
    valid = aligned.valid()
    np.testing.assert_array_equal(valid, maps.valid())
    assert 0.5 < valid.mean() < 1
    assert (drawn[valid] == 200).all()
    assert (drawn[~valid] == [1, 2, 3]).all()


def test_a_colour_that_images_do_not_have_is_refused(view):
    with pytest.raises(InvalidInput, match="channel 'infrared' is not an image channel; use one of blue, green, red"):
        align_channels(build_maps(LENS, view), {"infrared": LENS}, view)
