"""A board that is printed and seen straight is found where it was drawn, whatever its type and the kind of file."""

from pathlib import Path

import numpy as np
import pytest
from printed import BOARDS, DPI, decoded, page_with, rasterised

from camcal.targets.board import parse_board
from camcal.targets.detect import detect
from camcal.targets.printing import encoded


@pytest.mark.parametrize("kind", [".pdf", ".png"])
@pytest.mark.parametrize("text", BOARDS)
def test_a_printed_board_is_found_with_the_spacing_it_was_asked_for(text, kind):
    board, page = parse_board(text), page_with(text)
    content = encoded(page, Path(f"board{kind}"), DPI)
    image = rasterised(content) if kind == ".pdf" else decoded(content)
    scale = DPI / 25.4
    assert image.shape[::-1] == pytest.approx([side * scale for side in page.size])
    seen = detect(image, board)
    assert (seen.reason, len(seen.ids)) == (None, board.count)
    expected = board.points()[seen.ids, :2] * [1, board.z_sign] * 1000 * scale
    shift = (seen.pixels - expected).mean(axis=0)
    # Edges are where they should be to 1/255 px, and the corners follow them; 0.1 px would be 0.02 mm.
    assert np.abs(seen.pixels - expected - shift).max() < 0.02


@pytest.mark.parametrize("kind", [".pdf", ".svg", ".png"])
def test_the_same_page_gives_the_same_bytes(kind):
    one, other = (encoded(page_with("charuco:5x7:30mm:22mm:DICT_4X4_50"), Path(f"a{kind}"), DPI) for _ in range(2))
    assert one == other
