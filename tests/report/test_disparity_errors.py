"""The table of a disparity map's errors: what is infinite stays so, what there is none of is left empty."""

import numpy as np

from camcal.report.stereo_words import figure_rows
from camcal.stereo.truth import evaluate


def test_errors_of_a_map_without_a_match_are_infinite_and_those_of_no_pixel_are_none():
    truth = np.full((4, 5), 7.0)
    found = {name: values for name, *values in figure_rows(evaluate(np.full_like(truth, np.nan), truth))}
    assert found["pixels"] == [20, 0]
    assert found["bad2, %"] == [100, None]
    assert found["a90, px"] == [np.inf, None]
    assert found["avg, px"] == [None, None]
