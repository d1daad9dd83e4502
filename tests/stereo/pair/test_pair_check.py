"""Pairs that are none: swapped, turned, one image twice; and what is said of good ones."""

import cv2
import numpy as np
import pytest
from textured import darker, noisy, textured_pair, waves

from camcal.errors import InvalidInput
from camcal.stereo.pair_check import IDENTICAL, SWAPPED, check_pair


@pytest.fixture(scope="module")
def pair():
    return textured_pair(waves(5, 30, (260, 260)), 0.3)


def test_a_good_pair_is_nothing_but_a_pair(pair):
    check = check_pair(*pair)
    assert check.failure is None
    assert check.residual.median.value == pytest.approx(0.3, abs=0.02)
    assert check.disparity == (pytest.approx(5, abs=1.5), pytest.approx(30, abs=1.5))  # pixels of a look 256 wide
    assert check.searched[0] <= 5 < 30 <= check.searched[1]


def test_swapped_images_are_found_by_their_negative_disparities(pair):
    assert check_pair(pair[1], pair[0]).failure == SWAPPED


def test_squinting_cameras_whose_far_disparities_are_negative_are_not_swapped_ones():
    assert check_pair(*textured_pair(waves(-20, 8))).failure is None


@pytest.mark.parametrize("change", [lambda image: image, noisy, darker], ids=["itself", "noise", "exposure"])
def test_one_image_twice_is_found(pair, change):
    assert check_pair(pair[0], change(pair[0])).failure == IDENTICAL


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (cv2.ROTATE_180, "180°"),
        (cv2.ROTATE_90_CLOCKWISE, "90° clockwise"),
        (cv2.ROTATE_90_COUNTERCLOCKWISE, "90° counter-clockwise"),
    ],
)
def test_a_turned_image_is_refused_in_words(pair, code, words):
    with pytest.raises(InvalidInput, match=f"the right image is rotated by {words}"):
        check_pair(pair[0], cv2.rotate(pair[1], code))


def test_an_image_turned_by_three_degrees_is_measured_as_a_tilt(pair):
    turned = cv2.warpAffine(pair[1], cv2.getRotationMatrix2D((130, 130), -3, 1), (260, 260))
    check = check_pair(pair[0], turned)
    expected = 259 * np.tan(np.radians(3))
    assert check.residual.trend.tilt.value == pytest.approx(expected, abs=0.5)  # edges are lost
