"""Lines about a calibration: what is said of the board and of views, and from which size on."""

from types import SimpleNamespace

import numpy as np
import pytest

from camcal.calibrate.view_records import names_of, shown_name
from camcal.report.calibration import _board_lines, summary
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.040)
SIDE = max(BOARD.extent)
SHARE = "x/y scale"


def board_lines(bow=0.0, scale=0.0, offset=0.0):
    """The lines for a bow and a scale in standard deviations, and a largest offset as a share of the longer side."""
    surface = SimpleNamespace(
        deflection=bow * 1e-4,
        deflection_std=1e-4,
        terms=(SHARE,),
        coefficients=np.array([scale * 1e-3]),
        coefficients_std=lambda: np.array([1e-3]),
        offsets=np.array([[0.0, offset * SIDE, 0.0]]),
    )
    return _board_lines(SimpleNamespace(surface=surface, board=BOARD, correlations={(SHARE, "fx"): 0.5}))


@pytest.mark.parametrize(("stds", "said"), [(1.0, False), (1.99, False), (2.01, True), (4.0, True)])
def test_a_bow_and_a_scale_are_said_beyond_two_standard_deviations(stds, said):
    assert any("bent by" in line for line in board_lines(bow=stds)) == said
    for way in (stds, -stds):
        lines = board_lines(scale=way)
        assert any(line.endswith("% (correlation with fx +0.50)") for line in lines) == said


@pytest.mark.parametrize(("share", "said"), [(5e-6, False), (9.9e-6, False), (1.01e-5, True), (2e-5, True)])
def test_offsets_of_corners_are_said_beyond_a_hundred_thousandth_of_the_board(share, said):
    assert bool(board_lines(offset=share)) == said


def test_of_a_board_that_is_as_drawn_nothing_is_said():
    assert board_lines() == []


def test_an_absolute_path_is_shown_by_folder_and_file_and_other_names_as_they_are():
    assert shown_name("/home/someone/images/left/1.png") == "left/1.png"
    assert shown_name("left/1.png") == "left/1.png"
    assert shown_name("far/away/left/1.png") == "far/away/left/1.png"
    assert names_of(["/a/b/1.png", "2.png", "/a/c/3.png"], 2) == "b/1.png, 2.png and 1 more"


@pytest.mark.parametrize(
    ("unused", "rejected", "words"),
    [
        (0, 0, "of 2 views; noise 0.100 px"),
        (1, 0, "of 2 views (1 not used); noise"),
        (0, 3, "of 2 views (3 corners rejected); noise"),
        (2, 1, "of 2 views (2 not used, 1 corner rejected); noise"),
    ],
)
def test_what_was_not_used_is_said_where_there_is_any(unused, rejected, words):
    calibration = SimpleNamespace(
        views=[None] * (2 + unused),
        used=[None] * 2,
        rejected=[None] * rejected,
        rms_px=0.2,
        sigma_px=0.1,
        residuals=np.zeros((50, 2)),
        held_by_prior=(),
        model_error_px=None,
        within_views=SimpleNamespace(rolling_px=None, flex=None, share=0.0),
        between_views=SimpleNamespace(pupil=None),
        surface=SimpleNamespace(
            deflection=0.0,
            deflection_std=0.0,
            terms=(),
            coefficients=np.zeros(0),
            coefficients_std=lambda: np.zeros(0),
            offsets=None,
        ),
        board=BOARD,
    )
    (line,) = summary(calibration)
    assert line.startswith(f"RMS 0.200 px over 50 corners {words}")
