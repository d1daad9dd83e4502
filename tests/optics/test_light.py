"""Diffraction against integrals of the wave theory, exposure against tables of photographers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j1

from camcal import optics

GREEN = 550e-9


def test_the_airy_disc_ends_where_the_light_of_a_point_is_first_zero():
    radius = optics.airy_diameter(GREEN, 8) / 2
    assert radius == pytest.approx(1.22 * GREEN * 8, rel=1e-3)  # the usual 1.22 has three digits
    inside = np.linspace(1e-9, 0.999 * radius, 500)
    assert abs(j1(math.pi * radius / (GREEN * 8))) < 1e-9
    assert (j1(math.pi * inside / (GREEN * 8)) > 0).all()


def test_the_gaussian_of_the_airy_disc_has_the_scatter_of_its_core():
    radius = np.linspace(1e-4, 0.5 * optics.airy_diameter(1.0, 1.0), 2000)
    airy = (2 * j1(math.pi * radius) / (math.pi * radius)) ** 2
    gaussian = np.exp(-(radius**2) / (2 * optics.airy_sigma(1.0, 1.0) ** 2))
    assert np.abs(airy - gaussian).max() < 0.04  # the published approximation is off by up to 4 % of the peak


def test_the_contrast_is_that_of_two_discs_that_overlap():
    share = GREEN * 4 / (2 * 3.45e-6)
    across = np.linspace(-1, 1, 200_001)
    half = np.sqrt(np.maximum(1 - (np.abs(across) + share) ** 2, 0)) * (np.abs(across) + share < 1)
    overlap = 2 * np.sum(half) * (across[1] - across[0]) / math.pi
    assert optics.diffraction_contrast(GREEN, 4, 3.45e-6) == pytest.approx(overlap, abs=1e-5)  # of the sum


@given(st.floats(1, 30), st.floats(1e-6, 10e-6))
def test_contrast_falls_with_the_f_number_and_is_half_where_the_airy_disc_is_two_pixels(number, pitch):
    low, high = (optics.diffraction_contrast(GREEN, n, pitch) for n in (number, 1.1 * number))
    assert 0 <= high <= low <= 1
    limit = optics.widest_sharp_f_number(GREEN, pitch)
    assert optics.airy_diameter(GREEN, limit) == pytest.approx(2 * pitch)
    assert optics.diffraction_contrast(GREEN, limit, pitch) == pytest.approx(0.493, abs=5e-4)


def test_nothing_finer_than_the_cut_off_has_contrast():
    assert optics.diffraction_contrast(GREEN, 2 * 1e-6 / GREEN, 1e-6) == 0


@pytest.mark.parametrize(("number", "exposure", "value"), [(1, 1, 0), (16, 1 / 128, 15), (8, 1 / 64, 12), (2, 4, 0)])
def test_exposure_values_are_those_of_the_table(number, exposure, value):
    assert optics.exposure_value(number, exposure) == pytest.approx(value)


def test_life_size_costs_two_stops_and_doubles_the_f_number():
    assert optics.bellows_stops(1.0) == 2
    assert optics.effective_f_number(4, 1.0) == 8
    assert optics.bellows_stops(0.0) == 0
    assert optics.stops_between(0.008, 0.001) == 3
