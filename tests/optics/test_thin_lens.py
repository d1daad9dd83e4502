"""The thin lens against published examples worked by hand, and against its own definition of sharpness."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal import optics
from camcal.errors import InvalidInput

# focal length, f-number, circle of confusion, focus (mm, um); hyperfocal, near, far (mm) to all digits that are printed
REFERENCE = [
    ((8, 2.8, 3.45, 500), (6633.3, 465.436, 540.109)),
    ((16, 4, 3.45, 1000), (18566.7, 949.628, 1056.015)),
    ((50, 8, 30, 3000), (10466.7, 2337.905, 4185.268)),
    ((25, 1.4, 5, 300), (89310.7, 299.079, 300.927)),
]

focals = st.floats(1e-3, 0.2)
numbers = st.floats(0.9, 22)
circles = st.floats(1e-6, 30e-6)
ratios = st.floats(1.5, 1e4)  # of the focus to the focal length


@pytest.mark.parametrize(("given", "expected"), REFERENCE)
def test_depth_of_field_has_every_digit_of_the_reference(given, expected):
    focal, number, circle, focus = given[0] / 1e3, given[1], given[2] / 1e6, given[3] / 1e3
    near, far = optics.depth_of_field(focal, number, circle, focus)
    assert 1e3 * optics.hyperfocal(focal, number, circle) == pytest.approx(expected[0], abs=0.05)  # one digit printed
    assert 1e3 * near == pytest.approx(expected[1], abs=5e-4)  # three digits printed
    assert 1e3 * far == pytest.approx(expected[2], abs=5e-4)


def test_the_calibrated_distance_is_longer_than_the_focal_length_at_close_focus():
    assert 1e3 * optics.principal_distance(8e-3, 0.5) == pytest.approx(8.1301, abs=5e-5)
    assert optics.magnification(8e-3, 0.5) == pytest.approx(0.01626, abs=5e-6)
    assert optics.principal_distance(8e-3, math.inf) == 8e-3
    assert optics.magnification(8e-3, math.inf) == 0


def test_the_field_of_view_has_every_digit_of_the_reference():
    sides = (7.2e-3, 5.4e-3, math.hypot(7.2e-3, 5.4e-3))
    angles = [math.degrees(optics.field_angle(side, 8e-3)) for side in sides]
    assert angles == pytest.approx([48.455, 37.299, 58.716], abs=5e-4)


@given(focals, numbers, circles, ratios)
def test_the_blur_disc_at_both_ends_of_the_depth_of_field_is_the_circle_of_confusion(focal, number, circle, ratio):
    focus = ratio * focal
    near, far = optics.depth_of_field(focal, number, circle, focus)
    assert near < focus < far
    discs = optics.blur_disc(focal, number, focus, np.array([near, far]))
    assert discs[0] == pytest.approx(circle, rel=1e-6)
    if far < math.inf:
        assert discs[1] == pytest.approx(circle, rel=1e-6)
    else:
        assert discs[1] <= circle * (1 + 1e-6)


@given(focals, numbers, circles)
def test_focus_at_the_hyperfocal_distance_is_sharp_from_half_of_it_to_infinity(focal, number, circle):
    reach = optics.hyperfocal(focal, number, circle)
    assert optics.depth_of_field(focal, number, circle, reach) == (pytest.approx(reach / 2), math.inf)
    assert optics.depth_of_field(focal, number, circle, math.inf) == (pytest.approx(reach - focal), math.inf)


@given(focals, numbers, circles, ratios)
def test_a_smaller_aperture_and_a_larger_circle_deepen_the_field(focal, number, circle, ratio):
    near, far = optics.depth_of_field(focal, number, circle, ratio * focal)
    for other in (
        optics.depth_of_field(focal, 1.1 * number, circle, ratio * focal),
        optics.depth_of_field(focal, number, 1.1 * circle, ratio * focal),
    ):
        assert other[0] < near
        assert other[1] > far or far == math.inf


@given(focals, ratios, st.floats(1e-3, 0.05))
def test_focal_length_working_distance_and_sensor_are_solved_back(focal, ratio, sensor):
    focus = ratio * focal
    width = sensor / optics.magnification(focal, focus)
    assert optics.focal_for_width(sensor, focus, width) == pytest.approx(focal, rel=1e-9)
    assert optics.focus_for_width(focal, sensor, width) == pytest.approx(focus, rel=1e-9)
    assert optics.sensor_for_width(focal, focus, width) == pytest.approx(sensor, rel=1e-9)


@given(focals, ratios)
def test_the_focal_length_follows_from_the_principal_distance(focal, ratio):
    distance = optics.principal_distance(focal, ratio * focal)
    assert 1 / focal == pytest.approx(1 / (ratio * focal) + 1 / distance)
    assert optics.focal_length(distance, ratio * focal) == pytest.approx(focal)
    assert optics.focal_length(focal, math.inf) == focal


@pytest.mark.parametrize("focus", [0.004, 0.008, -1.0, math.nan])
def test_what_is_no_farther_than_the_focal_length_has_no_image(focus):
    with pytest.raises(InvalidInput, match="focus beyond its focal length"):
        optics.principal_distance(8e-3, focus)
    with pytest.raises(InvalidInput, match="8 mm"):
        optics.depth_of_field(8e-3, 4, 5e-6, focus)
