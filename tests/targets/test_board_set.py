"""Several boards as one: their numbers, their shape, and which of them cannot be told apart."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.targets.board import Board, Surface, basis, parse_board, terms_of
from camcal.targets.board_set import board_set, surfaces_of
from camcal.targets.detection import BoardDetection

ONE, OTHER = parse_board("chessboard:9x6:50mm"), parse_board("chessboard:8x5:40mm")
TAGS = parse_board("aprilgrid:3x2:40mm:0.3")
SET = board_set({"one": ONE, "other": OTHER, "tags": TAGS})


def test_points_are_numbered_one_board_after_another():
    assert SET.starts == (0, 54, 94, 118)
    assert SET.count == 118
    np.testing.assert_array_equal(SET.points()[54:94], OTHER.points())
    assert SET.place_of(np.array([0, 53, 54, 93, 94, 117])).tolist() == [0, 0, 1, 1, 2, 2]
    assert (SET.unit, SET.has_ids, SET.has_saddle_corners) == ("m", False, True)
    assert SET.extent == (max(ONE.extent[0], OTHER.extent[0]), max(ONE.extent[1], OTHER.extent[1]))


def test_a_view_of_one_board_has_the_numbers_of_all_and_gets_its_own_back():
    view = BoardDetection("a.png", (640, 480), np.array([0, 7, 39]), np.zeros((3, 2)))
    numbered = SET.numbered("other", view)
    assert (numbered.body, numbered.ids.tolist()) == ("other", [54, 61, 93])
    assert SET.alone(numbered).ids.tolist() == [0, 7, 39]


def test_every_board_has_terms_of_its_own():
    terms = terms_of(SET)
    assert len(terms) == 3 * len(terms_of(ONE))
    displaced = basis(SET, terms)
    for name, rows in (("one", slice(0, 54)), ("other", slice(54, 94)), ("tags", slice(94, 118))):
        own = [index for index, term in enumerate(terms) if term.startswith(f"{name}:")]
        bare = tuple(terms[index].removeprefix(f"{name}:") for index in own)
        np.testing.assert_array_equal(displaced[rows][:, :, own], basis(SET.members[name], bare))
        others = np.delete(displaced, own, axis=2)[rows]
        assert not others.any()


def test_the_shape_of_each_board_is_told_by_its_name():
    terms = terms_of(SET)
    coefficients = 1e-3 * np.arange(1, len(terms) + 1)
    surface = Surface(SET, (), terms, coefficients, np.diag(coefficients))
    found = surfaces_of(surface)
    assert list(found) == ["one", "other", "tags"]
    for name, own in found.items():
        places = [index for index, term in enumerate(terms) if term.startswith(f"{name}:")]
        assert own.board == SET.members[name]
        np.testing.assert_array_equal(own.coefficients, coefficients[places])
        np.testing.assert_array_equal(np.diag(own.covariance), coefficients[places])
    plain = Surface(ONE)
    assert surfaces_of(plain) == {"": plain}


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (ONE, parse_board("chessboard:9x6:30mm"), False),
        (ONE, parse_board("chessboard:6x9:50mm"), False),
        (TAGS, parse_board("aprilgrid:3x3:60mm:0.3"), False),
        (TAGS, replace(TAGS, first_marker=5), False),
        (TAGS, replace(TAGS, first_marker=6), True),
        (TAGS, replace(TAGS, dictionary="tag25h9"), True),
        (ONE, OTHER, True),
        (ONE, TAGS, True),
    ],
)
def test_boards_that_a_detector_takes_for_each_other_are_refused(first: Board, second: Board, told: bool):
    if told:
        assert board_set({"a": first, "b": second}).names == ("a", "b")
        return
    with pytest.raises(InvalidInput, match="boards a and b cannot be told apart"):
        board_set({"a": first, "b": second})


def test_a_board_that_looks_the_same_when_it_is_turned_is_refused():
    with pytest.raises(InvalidInput, match=r"board b: .* looks the same when it is turned"):
        board_set({"a": ONE, "b": parse_board("chessboard:8x6:25mm")})
