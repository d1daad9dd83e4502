"""Pictures of poses: marks stand where the lens puts them, and nothing else of the image is hidden."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.report.overlays import Posed, overlay

CAMERA = Camera(model_named("pinhole"), (1000, 800), [900.0, 900.0, 500.0, 400.0])
SQUARE = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0]])
POSE = Pose.from_vector(np.array([0.0, 0.3, 0.0]), np.array([-0.1, -0.1, 1.0]))


def posed(offset=0.0, inliers=(True,) * 4, camera=CAMERA, pose=POSE, words="words"):
    pixels = CAMERA.project(POSE.apply(SQUARE)).pixels + offset
    return Posed(camera, pose, SQUARE, pixels, np.array(inliers), words)


def gray(camera=CAMERA, level=100):
    width, height = camera.image_size
    return np.full((height, width), level, np.uint8)


def coloured(picture):
    """The pixels that are no gray, with their places (x, y)."""
    rows, columns = np.nonzero(np.ptp(picture.astype(int), axis=2) > 60)
    return np.column_stack([columns, rows])


def test_marks_are_near_the_object_and_the_rest_is_the_image():
    picture = overlay(gray(), [posed()])
    assert picture.shape[1] == 1000
    assert picture.shape[0] > 800
    places = coloured(picture)
    low, high = posed().pixels.min(axis=0) - 60, posed().pixels.max(axis=0) + 60
    assert len(places) > 200
    assert ((places > low) & (places < high)).all()
    assert np.ptp(picture[:100]) == 0


def test_axes_begin_at_the_origin_in_red_green_and_blue():
    seen = posed(pose=Pose.from_vector(np.array([0.4, 0.3, 0.0]), POSE.translation))
    picture = overlay(gray(), [seen])
    for index, channel in ((0, 2), (1, 1), (2, 0)):  # blue, green, red
        x, y = np.rint(seen.axis(index)[16]).astype(int)
        assert picture[y, x].argmax() == channel


def test_a_residual_is_drawn_enlarged_from_where_the_point_was_seen():
    picture = overlay(gray(), [posed(offset=np.array([1.0, 0.0]))])
    # 1 px is to be seen as at most 2 % of the width: 20 times; the arrow goes back to the left
    seen = posed(offset=np.array([1.0, 0.0])).pixels[2]
    x, y = np.rint(seen - np.array([15.0, 0.0])).astype(int)
    assert np.ptp(picture[y - 1 : y + 2, x].astype(int), axis=-1).max() > 60
    x, y = np.rint(seen - np.array([25.0, 0.0])).astype(int)
    assert np.ptp(picture[y - 1 : y + 2, x].astype(int), axis=-1).max() == 0


def test_an_outlier_is_a_red_cross_without_an_arrow():
    seen = posed(inliers=(True, True, False, True))
    x, y = np.rint(seen.pixels[2]).astype(int)
    patch = overlay(gray(), [seen])[y - 3 : y + 4, x - 3 : x + 4].reshape(-1, 3).astype(int)
    assert (patch[:, 2] - patch[:, 0] > 100).any()


def test_a_small_image_is_enlarged_by_a_whole_factor_and_marks_move_with_it():
    small = Camera(model_named("pinhole"), (250, 200), [225.0, 225.0, 124.625, 99.625])  # a quarter, edges kept
    tiny = Posed(small, POSE, SQUARE, small.project(POSE.apply(SQUARE)).pixels, np.ones(4, bool), "words")
    picture, large = overlay(gray(small), [tiny]), overlay(gray(), [posed()])
    assert picture.shape[1] == 1000
    middle = [coloured(each[:800]).mean(axis=0) for each in (picture, large)]
    np.testing.assert_allclose(*middle, atol=1.0)  # thick lines are rounded to pixels


@pytest.mark.parametrize("level", [0, 255])
def test_words_stand_below_whatever_letters_they_have(level):
    picture = overlay(gray(level=level), [posed(words="Brücke ± 3°")] * 12)
    strip = picture[800:]
    assert strip.min() < 100
    assert strip.max() > 240
    assert strip.shape[0] < 400  # of twelve objects the first ones are told


def test_what_the_lens_cannot_see_is_left_out():
    behind = Pose.from_vector(np.array([0.0, 0.3, 0.0]), np.array([-0.1, -0.1, -1.0]))
    picture = overlay(gray(), [posed(pose=behind)])
    assert len(coloured(picture[:800])) < 2000  # the points that were seen, no axes
