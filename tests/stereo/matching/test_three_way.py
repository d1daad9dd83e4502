"""OpenCV's matcher on the whole image, in pixels, wherever the range starts."""

import cv2
import numpy as np
import pytest
from textured import textured_pair

from camcal.stereo.matching.matchers import three_way, three_way_from_the_right

SHAPE = (60, 120)


def pair_at(disparity, shape=SHAPE):
    return textured_pair(np.full(shape, float(disparity)))


@pytest.mark.parametrize(("first", "count"), [(0, 32), (5, 30), (10, 16), (-40, 64), (-7, 20), (11, 5)])
def test_every_column_is_matched_that_the_right_image_shows(first, count):
    disparity = three_way(*pair_at(12), first, count)
    assert disparity.shape == SHAPE
    assert np.mean(np.abs(disparity[:, 14:] - 12) < 0.5) > 0.99  # of the last column the window is half outside


def test_the_disparity_of_the_right_image_is_that_of_its_own_pixels():
    left, right = pair_at(12)
    disparity = three_way_from_the_right(left, right, 0, 32)
    assert np.mean(np.abs(disparity[:, :-14] - 12) < 0.5) > 0.99


def test_disparities_to_the_other_side_are_negative():
    left, right = pair_at(9)
    disparity = three_way(right, left, -20, 32)
    assert np.mean(np.abs(disparity[:, :-11] + 9) < 0.5) > 0.99


@pytest.mark.parametrize("moved", [-2300, -35, 17, 300, 2300])
def test_a_moved_image_has_moved_disparities(moved):
    # Sixteenths in 16 bits end at 2047 px; the image is wide enough for its right partner to be inside.
    left, right = pair_at(6, (6, 2500))
    columns = np.clip(np.arange(2500) - moved, 0, 2499)
    near, far = three_way(left, right, 0, 16), three_way(left, np.ascontiguousarray(right[:, columns]), -moved, 16)
    inside = np.s_[:, max(0, -moved) + 20 : 2500 - max(0, moved) - 20]
    np.testing.assert_allclose(far[inside] + moved, near[inside], atol=1e-3)  # float32 at 2300


@pytest.mark.parametrize("quarter", [0.25, 0.5, 0.75])
def test_fractions_are_without_a_pull_towards_whole_pixels(quarter):
    disparity = three_way(*pair_at(8 + quarter), 0, 32)[:, 12:]
    assert np.nanmedian(disparity) == pytest.approx(8 + quarter, abs=0.08)  # OpenCV's own are off by 0.1 and more


def test_speckles_are_dropped_and_what_is_larger_stays():
    left, right = pair_at(9)
    left, right = left.copy(), right.copy()
    patch = np.random.default_rng(5).integers(0, 256, (8, 8), np.uint8)
    left[20:28, 60:68], right[20:28, 40:48] = patch, patch  # 64 pixels at another disparity
    kept, without = (three_way(left, right, 0, 32, smallest) for smallest in (0, 200))
    assert np.mean(np.abs(kept[22:26, 62:66] - 20) < 0.5) > 0.9
    assert np.isnan(without[22:26, 62:66]).all()
    assert np.mean(np.abs(without[:, 14:] - 9) < 0.5) > 0.97


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (1, 9), (9, 1), (3, 5)])
@pytest.mark.parametrize("first", [-50, 0, 50])
def test_tiny_images_are_matched_in_columns_enough_for_the_window(shape, first, monkeypatch):
    matched = []
    create = cv2.StereoSGBM.create

    class Recorded:
        """The matcher itself, with a note of how many columns it is left with."""

        def __init__(self, **settings):
            self.settings, self.matcher = settings, create(**settings)

        def compute(self, left, right):
            low, count = self.settings["minDisparity"], self.settings["numDisparities"]
            matched.append(left.shape[1] + min(low, 0) - max(low + count, 0))
            return self.matcher.compute(left, right)

    monkeypatch.setattr(cv2.StereoSGBM, "create", staticmethod(Recorded))
    image = np.random.default_rng(1).integers(0, 255, shape).astype(np.uint8)
    results = [three_way(image, image, first, 20) for _ in range(3)]
    assert min(matched) > 3 // 2  # OpenCV reads beyond its buffers, and divides by zero, with fewer
    assert results[0].shape == shape
    for again in results[1:]:
        np.testing.assert_array_equal(again, results[0])
