"""Views of images of other sizes: named, or made to fit; which way an image was turned is told by the others' lens.

The views are computed, with noise; tests/cli/test_detect_command.py looks at images.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections
from camcal.progress import SILENT
from camcal.raw.options import AS_IMAGES
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board, parse_board
from camcal.targets.detection import CLOCKWISE, COUNTER_CLOCKWISE, BoardDetection, Detections, pixel_map
from camcal.tasks.calibration.board_views import board_views
from camcal.tasks.calibration.images_again import _samples
from camcal.tasks.calibration.mixed_sizes import same_size, usual_size

SIZE = (640, 480)
BOARD = Board("chessboard", 9, 6, 0.03)
MIDDLE = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)


@cache
def seen(off=(9.0, -6.0), tangential=8e-4, noise_px=0.05):
    """Return what a camera sees whose principal point is `off` (px) the middle of the image."""
    parameters = [500, 500, MIDDLE[0] + off[0], MIDDLE[1] + off[1], -0.2, 0.05, tangential, 0, 0]
    camera = Camera(model_named("opencv5"), SIZE, parameters)
    poses = views(camera, BOARD, 10, rng=np.random.default_rng(4))
    return observe(camera, BOARD, poses, rng=np.random.default_rng(5), noise_px=noise_px)[0].views


def stored(view, size, quarter=0):
    """Return a view as the image of another size shows it that goes back to the usual one by some quarter turns."""
    back = pixel_map(size, SIZE, quarter)
    pixels = np.linalg.solve(back.linear, (view.pixels - back.offset).T).T
    return replace(view, size=size, pixels=pixels)


def mixture(first, *others):
    """Return the views of `first`, the last ones of which are those of `others`."""
    return [*first[: len(first) - len(others)], *others]


TURNED = SIZE[::-1]


def test_images_of_other_sizes_are_named_and_left_out():
    all_seen = seen()
    mixed = mixture(
        all_seen,
        stored(all_seen[6], TURNED, CLOCKWISE),
        stored(all_seen[7], (320, 240)),
        stored(all_seen[8], (641, 480)),
        replace(all_seen[9], size=(500, 400)),
    )
    assert usual_size(mixed) == SIZE
    result = same_size(mixed, SIZE, BOARD, mixed=False)
    assert [view.found for view in result.views] == [True] * 6 + [False] * 4
    assert [view.reason for view in result.views[6:]] == [
        "image 480x640 differs from the majority 640x480: turned by 90 degrees; --mixed-sizes uses it",
        "image 320x240 differs from the majority 640x480: half as large; --mixed-sizes uses it",
        "image 641x480 differs from the majority 640x480: 1 x 0 px off; --mixed-sizes uses it",
        "image 500x400 differs from the majority 640x480",
    ]
    assert result.warnings[0].text == (
        "not used: 1 image of 480x640, turned by 90 degrees (the majority: 640x480): view0006.png; "
        "--mixed-sizes uses such images"
    )
    assert len(result.warnings) == 3


@pytest.mark.parametrize("quarter", [CLOCKWISE, pytest.param(COUNTER_CLOCKWISE, marks=pytest.mark.slow)])
def test_images_are_used_as_the_camera_saw_them(quarter):
    all_seen = seen()
    mixed = mixture(
        all_seen,
        stored(all_seen[6], TURNED, quarter),
        stored(all_seen[7], (320, 240)),
        stored(all_seen[8], (641, 480)),
        stored(all_seen[9], (1280, 960)),
    )
    result = same_size(mixed, SIZE, BOARD, mixed=True)
    for view, truth in zip(result.views, all_seen, strict=True):
        assert view.size == SIZE
        np.testing.assert_allclose(view.pixels, truth.pixels, atol=1e-9)
    assert result.warnings[1].text == (
        "used with --mixed-sizes: 1 image of 320x240, half as large (the majority: 640x480): view0007.png"
    )
    assert [view.size for view in result.in_files(mixed)] == [view.size for view in mixed]
    # what is seen of a colour goes the same way
    mixed[7] = replace(mixed[7], colours={"red": replace(mixed[7], pixels=mixed[7].pixels + 1)})
    red = same_size(mixed, SIZE, BOARD, mixed=True).views[7].colours["red"]
    np.testing.assert_allclose(red.pixels, all_seen[7].pixels + 2)


@pytest.mark.slow
def test_every_way_that_is_told_is_the_true_one():
    """Ten views, each stored both ways; some may be unclear, none may be wrong."""
    all_seen, told = seen(), 0
    for index, quarter in np.ndindex(len(all_seen), 2):
        other = stored(all_seen[index], TURNED, (CLOCKWISE, COUNTER_CLOCKWISE)[quarter])
        mixed = [view if view is not all_seen[index] else other for view in all_seen]
        view = same_size(mixed, SIZE, BOARD, mixed=True).views[index]
        if view.found:
            np.testing.assert_allclose(view.pixels, all_seen[index].pixels, atol=1e-9)
            told += 1
    assert told >= 16


def test_the_way_is_unclear_where_a_lens_looks_the_same_upside_down():
    all_seen = seen((0.0, 0.0), 0.0)
    result = same_size(mixture(all_seen, stored(all_seen[9], TURNED, CLOCKWISE)), SIZE, BOARD, mixed=True)
    assert "ambiguous rotation: median 0.0" in result.views[9].reason
    (warning,) = result.warnings
    assert warning.text == "not used: 1 image of 480x640, turned by 90 degrees (the majority: 640x480): view0009.png"


def test_a_turned_image_that_does_not_fit_says_by_how_much():
    all_seen = seen()
    rng = np.random.default_rng(0)
    other = stored(all_seen[9], TURNED, CLOCKWISE)
    other = replace(other, pixels=other.pixels + rng.normal(0, 5, other.pixels.shape))
    reason = same_size(mixture(all_seen, other), SIZE, BOARD, mixed=True).views[9].reason
    words, _, figures = reason.partition("rejected in both rotations: median")
    assert words.startswith("image 480x640 differs from the majority 640x480: turned by 90 degrees; ")
    median, _, limit = figures.removesuffix(" px)").partition(" px (limit ")
    assert 3 < float(median) < 8  # of distances with 5 px a coordinate: 5.9
    assert 0.15 < float(limit) < 0.4  # five times the noise


def test_too_few_other_views_cannot_tell_the_way():
    all_seen = seen()
    mixed = [all_seen[0], all_seen[1], stored(all_seen[2], TURNED, CLOCKWISE)]
    reason = same_size(mixed, SIZE, BOARD, mixed=True).views[2].reason
    assert "unknown without a calibration of the other images: " in reason


def test_a_table_of_mixed_sizes_is_read_in_one_size_if_asked_for(tmp_path):
    all_seen = seen()
    table = tmp_path / "corners.csv"
    detections.write(table, Detections(BOARD, (*all_seen[:9], stored(all_seen[9], (320, 240)))))
    as_it_is = board_views((str(table),), None, False, 1, SILENT)
    assert as_it_is.detections.views[9].size == (320, 240)
    assert as_it_is.warnings[0].text.startswith("not used: 1 image of 320x240")
    fitting = board_views((str(table),), None, False, 1, SILENT, mixed_sizes=True).detections.views[9]
    assert fitting.size == SIZE
    np.testing.assert_allclose(fitting.pixels, all_seen[9].pixels, atol=1e-9)


def test_corners_are_not_measured_again_in_an_image_of_other_pixels(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full((240, 320), 120, np.uint8))
    for size, measured in (((320, 240), True), ((321, 240), True), ((640, 480), False), ((240, 320), False)):
        assert (_samples(path, size, AS_IMAGES) is not None) == measured


def test_views_without_points_have_no_usual_size():
    nothing = BoardDetection("a.png", SIZE, reason="nothing seen")
    assert usual_size([nothing]) == (0, 0)
    assert same_size([nothing], (0, 0), parse_board("chessboard:9x6"), mixed=True).views == (nothing,)
