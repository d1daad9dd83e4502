"""Relative poses by common captures, and where cameras are by the best of them."""

import numpy as np
import pytest

from camcal.calibrate.rigs.links import CameraPoses, Link, link, motions, place
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

BOARD, SQUARE = Board("chessboard", 9, 6, 0.03), Board("chessboard", 6, 6, 0.03)
TURN, SHIFT = so3.exp(np.array([0.1, -0.4, 0.05])), np.array([-0.2, 0.01, 0.03])


def seen(captures, seed=0, noise=0.0, board=BOARD):
    """The poses of a board as two cameras see it in the same captures."""
    rng = np.random.default_rng(seed)
    rotations = so3.exp(rng.normal(size=(len(captures), 3)) * 0.4)
    translations = np.array([-0.1, -0.1, 1.0]) + 0.1 * rng.normal(size=(len(captures), 3))
    a = CameraPoses(np.array(captures), rotations, translations)
    moved = translations @ TURN.T + SHIFT + noise * rng.normal(size=translations.shape)
    return a, CameraPoses(np.array(captures), TURN @ rotations, moved)


def test_cameras_without_common_captures_have_no_link():
    a, b = seen([0, 1, 2])
    assert link(a, CameraPoses(b.captures + 3, b.rotations, b.translations), BOARD) is None


def test_a_link_is_what_most_captures_agree_on():
    a, b = seen(range(12), noise=1e-3)
    wrong = b.translations.copy()
    wrong[[1, 4, 5, 9]] += 0.3
    found = link(a, CameraPoses(b.captures, b.rotations, wrong), BOARD)
    assert np.linalg.norm(found.translation - SHIFT) < 2e-3
    assert np.linalg.norm(so3.log(found.rotation @ TURN.T)) < 1e-9
    assert np.flatnonzero(found.errors > 0.1).tolist() == [1, 4, 5, 9]
    assert found.spread < 3e-3
    back = found.inverse()
    np.testing.assert_allclose(back.rotation @ found.translation + back.translation, 0, atol=1e-12)


@pytest.mark.parametrize("board", [BOARD, SQUARE])
def test_views_of_symmetric_boards_are_turned_as_the_others_demand(board):
    a, b = seen(range(8), seed=2)
    turns, shifts = motions(board)
    chosen = np.random.default_rng(3).integers(len(turns), size=8)
    numbered = CameraPoses(
        b.captures,
        b.rotations @ turns[chosen],
        b.translations + np.einsum("nij,nj->ni", b.rotations, shifts[chosen]),
    )
    found = link(a, numbered, board)
    assert found.errors.max() < 1e-9
    assert np.linalg.norm(so3.log(found.rotation @ TURN.T)) < 1e-9


def made(spread, count=10):
    return Link(TURN, SHIFT, np.arange(count), np.full(count, spread), np.zeros(count, np.intp))


def test_cameras_are_placed_along_the_paths_known_best():
    # 0 to 2 directly is known badly; by way of 1 it is known well
    links = {(0, 1): made(1e-3), (1, 2): made(1e-3), (0, 2): made(1e-1)}
    found = place(links, 3)[0]
    np.testing.assert_allclose(found.rotations[2], TURN @ TURN)
    np.testing.assert_allclose(found.translations[2], TURN @ SHIFT + SHIFT)
    found = place(links | {(0, 2): made(1e-4)}, 3)[0]
    np.testing.assert_allclose(found.translations[2], SHIFT)


def test_a_path_counts_with_all_of_its_links_and_each_with_the_number_of_its_captures():
    few, many = made(1e-3, 5), made(1e-3, 100)
    np.testing.assert_allclose(place({(0, 1): many, (1, 2): many, (0, 2): few}, 3)[0].rotations[2], TURN @ TURN)
    links = {(0, 1): made(1.0e-3), (1, 2): made(0.9e-3), (0, 2): made(1.1e-3)}
    np.testing.assert_allclose(place(links, 3)[0].rotations[2], TURN)


def test_every_group_of_linked_cameras_is_placed_from_its_first():
    found = place({(0, 3): made(1e-3), (1, 2): made(1e-3), (2, 4): made(1e-3)}, 5)
    assert [sorted(own.rotations) for own in found] == [[0, 3], [1, 2, 4]]
    np.testing.assert_array_equal(found[1].rotations[1], np.eye(3))
    assert [sorted(own.rotations) for own in place({}, 3)] == [[0], [1], [2]]
