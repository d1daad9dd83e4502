"""The axes of frames in words."""

import numpy as np
import pytest

from camcal.geometry.pose import rotation_of
from camcal.stereo.depth import LEFT_CAMERA

AHEAD, RIGHT, DOWN = (0, 0, 1), (1, 0, 0), (0, 1, 0)


@pytest.mark.parametrize(
    ("frame", "ahead", "right", "down"),
    [
        (LEFT_CAMERA, (0, 0, 1), (1, 0, 0), (0, 1, 0)),
        ("body: x forward, y left, z up", (1, 0, 0), (0, -1, 0), (0, 0, -1)),
        ("x right, y up, z backward", (0, 0, -1), (1, 0, 0), (0, -1, 0)),
        ("world: x east, y north, z up, metres", (0, 1, 0), (1, 0, 0), (0, 0, -1)),
    ],
)
def test_words_turn_a_frame_to_that_of_a_camera(frame, ahead, right, down):
    np.testing.assert_array_equal(np.array([ahead, right, down]) @ rotation_of(frame).T, [AHEAD, RIGHT, DOWN])


@pytest.mark.parametrize(
    "frame", ["", "somewhere", "x right, y right, z up", "x right, y up, z forward", "x a, y b, z c"]
)
def test_a_frame_without_three_right_handed_axes_is_taken_for_that_of_a_camera(frame):
    np.testing.assert_array_equal(rotation_of(frame), np.eye(3))
