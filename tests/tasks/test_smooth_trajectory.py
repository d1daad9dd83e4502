"""What is drawn of smoothed poses."""

import numpy as np

from camcal.geometry import rotation as so3
from camcal.report.figures.over_time import broken_at_half_turns


def test_no_line_is_drawn_from_one_half_turn_to_the_other():
    angles = np.linspace(0, 4, 41)  # past half a turn at 3.2 rad
    vectors = so3.log(so3.exp(np.outer(angles, [0.6, 0.0, 0.8])))
    drawn = broken_at_half_turns(vectors)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(drawn).any(axis=1)), [32])
    np.testing.assert_array_equal(np.delete(drawn, 32, axis=0), np.delete(vectors, 32, axis=0))
    np.testing.assert_array_equal(broken_at_half_turns(vectors[:1]), vectors[:1])
