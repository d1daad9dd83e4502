"""The scales of filters: there and back, and what square roots do to noise and colours."""

import numpy as np
import pytest
from bayer import random_mosaic
from hypothesis import given
from hypothesis import strategies as st

from camcal.raw import PATTERNS, residual
from camcal.raw.mosaic import sites
from camcal.raw.tiles import WHITE, Plane, Root, Scale, TiledMosaic, detail_balance

UNBALANCED = {"R": 2.5, "G": 1.0, "B": 0.4}


def there_and_back(scale, values, colour="G"):
    numbers = np.array(values, np.float32)
    scale.apply(numbers, colour)
    plane, scratch = Plane(1, len(values)), Plane(1, len(values))
    plane.fill(numbers[None])
    scale.undo(plane, scratch)
    return numbers, plane.image[0] * np.float32(scale.factor(colour))


@given(
    values=st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=30),
    white=st.sampled_from([1.0, 255.0, 4095.0, 65535.0]),
    colour=st.sampled_from("RGB"),
)
@pytest.mark.parametrize("kind", ["root", "proportional", "counts"])
def test_every_scale_leads_back_to_the_counts_below_zero_too(kind, values, white, colour):
    scale = {
        "root": Root(white, gains=UNBALANCED),
        "proportional": Scale(white, WHITE),
        "counts": Scale(white),
    }[kind]
    counts = np.float32(values) * np.float32(white)
    _, back = there_and_back(scale, counts, colour)
    # A dozen roundings of float32. Next to zero the root is all but linear, so that the error stays relative.
    np.testing.assert_allclose(back, counts, rtol=1e-6, atol=1e-37)


@pytest.mark.parametrize("scale", [Root(1000.0, gains={"G": 1.0}), Scale(1000.0, WHITE)])
def test_filters_see_0_to_255(scale):
    numbers, _ = there_and_back(scale, [0.0, 1000.0])
    np.testing.assert_allclose(numbers, [0, 255], rtol=1e-6)  # float32


def test_the_root_rises_everywhere_and_treats_both_sides_of_zero_alike():
    light = np.linspace(-1, 1, 2001)
    numbers, _ = there_and_back(Root(1.0, gains={"G": 1.0}), light)
    assert (np.diff(numbers) > 0).all()
    np.testing.assert_allclose(numbers, -numbers[::-1], atol=1e-6)  # the grid itself is symmetric to 1e-16


def test_photon_noise_is_equally_strong_in_shadow_and_light():
    rng = np.random.default_rng(4)
    deviations = []
    for electrons in (200, 1000, 8000):
        light = rng.poisson(electrons, 20000) / 10000
        deviations.append(there_and_back(Root(1.0, gains={"G": 1.0}), light)[0].std())
    # 0.5 % of sampling error, and the toe, which lowers the darkest by 5 %; counts would differ by a factor of 6
    np.testing.assert_allclose(deviations, np.mean(deviations), rtol=0.06)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_gains_make_the_detail_of_the_colours_equally_strong(pattern):
    mosaic = random_mosaic((400, 400), np.float32)
    for colour, strength in (("R", 0.5), ("B", 0.125)):
        for site in sites(pattern, colour):
            mosaic[site] *= np.float32(strength)
    gains = detail_balance(mosaic, pattern)
    assert gains["G"] == 1
    # the mean of 40 000 second differences
    assert gains["R"] == pytest.approx(2, rel=0.02)
    assert gains["B"] == pytest.approx(8, rel=0.02)


def test_gains_of_a_colour_that_is_almost_missing_end_at_sixteen():
    mosaic = random_mosaic((80, 80), np.float32)
    mosaic[::2, ::2] *= np.float32(0.01)
    assert detail_balance(mosaic, "RGGB")["R"] == 16


@pytest.mark.parametrize("shape", [(2, 2), (30, 40)])
def test_without_detail_colours_keep_their_proportions(shape):
    assert detail_balance(np.ones(shape, np.uint16), "RGGB") == {"R": 1, "G": 1, "B": 1}


def test_gamma_encoded_images_are_on_the_scale_that_filters_were_made_for(monkeypatch):
    scales = []
    monkeypatch.setattr(
        residual, "TiledMosaic", lambda *arguments: scales.append(arguments[3]) or TiledMosaic(*arguments)
    )
    residual.residual_interpolation(np.ones((4, 4), np.uint8), "RGGB", 255, linear=False)
    assert scales == [Scale(255, WHITE)]
