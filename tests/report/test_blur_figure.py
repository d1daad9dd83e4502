"""The figure of blur over distance: a file of its kind, the same bytes every time. How it looks is for eyes."""

from dataclasses import replace
from math import inf

import cv2
import numpy as np
import pytest

from camcal.report.figures.sensor import BlurCurve, blur_over_distance

CURVE = BlurCurve(8e-3, 2.8, 0.5, 3.45e-6, 0.465436, 0.540109, 3.45e-6, 3.8e-6)


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_a_figure_is_a_file_of_its_kind(suffix, start):
    assert blur_over_distance(CURVE, suffix).startswith(start)


def test_the_same_figure_is_the_same_file_and_names_lens_and_focus():
    figure = blur_over_distance(CURVE, ".svg")
    assert blur_over_distance(CURVE, ".svg") == figure
    for words in ("8 mm, f/2.8, focused at 0.5 m", "in focus, 0.4654 m to 0.5401 m", "pixels", "Airy disc"):
        assert words in figure.decode()


def test_infinity_is_drawn_as_far_as_paper_goes_and_without_a_pitch_in_micrometres():
    far = replace(CURVE, focus=inf, near=6.6, far=inf, pitch=None, airy_diameter=None)
    figure = blur_over_distance(far, ".svg").decode()
    for words in ("focused at infinity", "from 6.6 m on", "diameter on the sensor, um"):
        assert words in figure
    assert "Airy" not in figure


def test_the_depth_of_field_is_a_band_of_green():
    image = cv2.imdecode(np.frombuffer(blur_over_distance(CURVE, ".png"), np.uint8), cv2.IMREAD_COLOR).astype(int)
    row = image[image.shape[0] // 2]  # between the legend and the axis
    green = np.flatnonzero((row[:, 1] > row[:, 0] + 8) & (row[:, 1] > row[:, 2] + 8))
    width = np.ptp(green) / image.shape[1]
    assert 0.1 < width < 0.4  # 0.075 m of the 0.3 m that are drawn
