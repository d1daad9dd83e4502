"""Sizes of images of one camera: how they are related, and where a pixel of one lies in the other."""

import cv2
import numpy as np
import pytest

from camcal.targets.detection import CLOCKWISE, COUNTER_CLOCKWISE, BoardDetection, pixel_map, size_relation, size_words

USUAL = (64, 48)
POINTS = np.array([(10.0, 12.0), (40.5, 20.25), (51.0, 37.0)])  # x, y
SIGMA_PX = 2.5


@pytest.mark.parametrize(
    ("size", "relation"),
    [
        ((64, 48), None),
        ((48, 64), "turned"),
        ((32, 24), "half"),
        ((128, 96), "double"),
        ((63, 48), "near"),
        ((66, 46), "near"),
        ((61, 48), None),
        ((32, 25), None),
        ((24, 32), None),
        ((16, 12), None),
        ((640, 480), None),
    ],
)
def test_sizes_are_related_by_a_turn_a_factor_of_two_or_a_pixel_or_two(size, relation):
    assert size_relation(size, USUAL) == relation


def test_nearly_square_images_that_are_turned_are_a_pixel_off():
    assert size_relation((48, 49), (49, 48)) == "near"


def test_words_say_how_a_size_differs():
    sizes = ((48, 64), (32, 24), (128, 96), (63, 50))
    assert [size_words(size, USUAL) for size in sizes] == [
        "turned by 90 degrees", "half as large", "twice as large", "1 x 2 px off",
    ]  # fmt: skip


def blobs(size):
    """Return an image (H, W) with a blob at each of POINTS."""
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    return sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 2 / SIGMA_PX**2) for u, v in POINTS).astype(np.float32)


def centres(image, near, reach):
    """Return the centroids (N, 2) of an image around some pixels."""
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    result = []
    for u, v in near:
        weight = image * (np.hypot(x - u, y - v) < reach)
        result.append(((weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum()))
    return np.array(result)


@pytest.mark.parametrize(
    ("change", "quarter"),
    [
        (lambda image: np.rot90(image, 1), CLOCKWISE),
        (lambda image: np.rot90(image, -1), COUNTER_CLOCKWISE),
        (lambda image: cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), 0),
        (lambda image: cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR), 0),
        (lambda image: image[:47, :62], 0),
    ],
    ids=["turned left", "turned right", "half", "double", "cropped"],
)
def test_what_another_image_shows_is_brought_to_where_it_was(change, quarter):
    """Each blob is found in the changed image near where the map says that it is, and goes back to within 0.02 px."""
    image = np.ascontiguousarray(change(blobs(USUAL)))
    size = image.shape[::-1]
    back = pixel_map(size, USUAL, quarter)
    there = np.linalg.solve(back.linear, (POINTS - back.offset).T).T
    scale = 1 / np.sqrt(abs(np.linalg.det(back.linear)))
    seen = centres(image, there, 3.4 * SIGMA_PX * scale)
    view = BoardDetection("a.png", size, np.arange(3), seen, np.tile(np.diag([1.0, 4.0]), (3, 1, 1)), orientation=6)
    moved = back.apply(view)
    assert (moved.size, moved.orientation, moved.image) == (USUAL, 6, "a.png")
    np.testing.assert_allclose(moved.pixels, POINTS, atol=0.02)  # windows around blobs cut pixels in whole
    swapped = np.diag([4.0, 1.0]) if quarter else np.diag([1.0, 4.0])
    np.testing.assert_allclose(moved.covariance, np.tile(swapped / scale**2, (3, 1, 1)), atol=1e-12)


def test_there_is_no_map_from_an_unrelated_size_or_an_unknown_turn():
    for size in ((61, 48), (48, 64)):
        with pytest.raises(ValueError, match="do not become"):
            pixel_map(size, USUAL)
