"""A second look: corners nobody found are recovered, corners that are none are not."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.targets.board import Board
from camcal.targets.corner_measurement import Expected, remeasure, seen_cells, signs
from camcal.targets.detect import detect, locate
from camcal.targets.detection import BoardDetection, MaskedImage

BOARD = Board("chessboard", 8, 6, 0.03)
CAMERA = Camera(model_named("opencv5"), (480, 400), np.array([450.0, 450, 241, 198, -0.3, 0.1, 0, 0, 0]))
ROTATION = so3.exp(np.array([0.4, -0.3, 0.1]))
POSE = Pose(ROTATION, np.array([0.0, 0.0, 0.36]) - ROTATION @ np.array([*BOARD.extent, 0.0]) / 2)


def expected():
    ids = np.arange(BOARD.count)
    pixels, cells = seen_cells(
        BOARD, ids, BOARD.points(), lambda points: CAMERA.project(POSE.apply(points)).pixels, blur_px=1.0
    )
    return Expected(pixels, cells, np.ones(BOARD.count, bool), signs(BOARD))


def photograph():
    return render(CAMERA, BOARD, POSE, rng=np.random.default_rng(0), exposure=Exposure(noise_dn=2))


def test_corners_that_were_missed_are_found_where_they_must_be():
    known, ids = expected(), np.arange(0, BOARD.count, 2)
    again = remeasure(MaskedImage(photograph()), BoardDetection(ids=ids, pixels=known.pixels[ids] + 0.1), known)
    assert len(again.ids) == BOARD.count
    off = again.pixels - known.pixels[again.ids]
    honest = np.einsum("ni,nij,nj->n", off, np.linalg.inv(again.covariance), off).mean() / 2
    assert 0.6 < honest < 1.5  # 48 corners: ± 0.15


def test_hidden_corners_are_not_made_up():
    known, ids = expected(), np.arange(0, BOARD.count, 2)
    image = photograph().copy()
    x, y = np.rint(known.pixels[9]).astype(int)
    image[y - 25 : y + 26, x - 25 : x + 26] = 90
    again = remeasure(MaskedImage(image), BoardDetection(ids=ids, pixels=known.pixels[ids]), known)
    assert 9 not in again.ids


def test_a_board_printed_the_other_way_round_is_as_good():
    known, ids = expected(), np.arange(0, BOARD.count, 2)
    again = remeasure(MaskedImage(255 - photograph()), BoardDetection(ids=ids, pixels=known.pixels[ids]), known)
    assert len(again.ids) == BOARD.count


def test_a_corner_of_the_wrong_colour_is_none():
    known, ids = expected(), np.arange(BOARD.count)
    wrong = known.signs.copy()
    wrong[20] *= -1
    again = remeasure(
        MaskedImage(photograph()), BoardDetection(ids=ids, pixels=known.pixels), replace(known, signs=wrong)
    )
    assert set(ids) - set(again.ids) == {20}


def test_points_outside_the_image_are_not_looked_for():
    known, ids = expected(), np.arange(0, BOARD.count, 2)
    inside = known.pixels[:, 0] < 240
    cut = replace(known, inside=inside)
    ids = ids[inside[ids]]
    again = remeasure(MaskedImage(photograph()[:, :260]), BoardDetection(ids=ids, pixels=known.pixels[ids]), cut)
    assert inside[again.ids].all()
    assert set(again.ids) - set(ids)


@pytest.mark.parametrize(("off", "kept"), [(0.3, True), (1.5, False)])
def test_a_corner_that_is_drawn_far_from_where_it_was_found_is_left_out(off, kept):
    known, ids = expected(), np.arange(BOARD.count)
    start = known.pixels.copy()
    start[20] += [off, 0.0]
    assert (20 in remeasure(MaskedImage(photograph()), BoardDetection(ids=ids, pixels=start), known).ids) == kept


def test_located_corners_are_measured_as_well_as_measured_ones():
    known, image = expected(), photograph()
    located = locate(image, BOARD)
    assert located.located
    assert located.covariance is None
    off = np.linalg.norm(located.pixels - known.pixels, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.2  # px, what "located" promises
    once = remeasure(MaskedImage(image), located, known)
    again = remeasure(MaskedImage(image), detect(image, BOARD), known)
    assert not once.located
    np.testing.assert_array_equal(once.ids, again.ids)
    np.testing.assert_allclose(once.pixels, again.pixels, atol=2e-3)  # where steps of the fit end
    np.testing.assert_allclose(once.covariance, again.covariance, rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(("off", "kept"), [(0.7, True), (9.0, False)])
def test_a_located_corner_may_be_further_off_than_one_that_was_measured(off, kept):
    known, ids = expected(), np.arange(BOARD.count)
    start = known.pixels.copy()
    start[20] += [off, 0.0]
    view = BoardDetection(ids=ids, pixels=start, located=True)
    found = remeasure(MaskedImage(photograph()), view, known)
    assert (20 in found.ids) == kept
    assert [20.0] * (not kept) == [float(np.flatnonzero((start == point).all(axis=1))[0]) for point in found.refused]


def test_a_located_view_of_which_too_little_is_seen_stays_located():
    view = BoardDetection(ids=np.arange(3), pixels=expected().pixels[:3], located=True)
    assert remeasure(MaskedImage(np.full((400, 480), 90, np.uint8)), view, expected()) is view


@pytest.mark.parametrize(("contrast", "recovered"), [(0.2, False), (0.5, True)])
def test_faint_corners_are_not_recovered(contrast, recovered):
    known, ids = expected(), np.arange(0, BOARD.count, 2)
    image = photograph().astype(float)
    x, y = np.rint(known.pixels[19]).astype(int)
    around = slice(y - 25, y + 26), slice(x - 25, x + 26)
    image[around] = image[around].mean() + contrast * (image[around] - image[around].mean())
    assert (
        19
        in remeasure(
            MaskedImage(np.rint(image).astype(np.uint8)), BoardDetection(ids=ids, pixels=known.pixels[ids]), known
        ).ids
    ) == recovered
