"""The figure of blur over distance: what it shows and says."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from drawn_figures import require_readable
from matplotlib.patches import Rectangle

from camcal.report.figures.figure import encoded
from camcal.report.figures.over_time import BlurCurve, blur_over_distance

CURVE = BlurCurve(8e-3, 2.8, 0.5, 3.45e-6, 0.465436, 0.540109, 3.45e-6, 3.8e-6)
FAR = replace(CURVE, focus=inf, near=6.6, far=inf, pitch=None, airy_diameter=None)


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_a_figure_is_a_file_of_its_kind(suffix, start):
    assert encoded(blur_over_distance(CURVE), suffix).startswith(start)


def test_the_caption_names_lens_and_focus_and_the_figure_its_units():
    plot = blur_over_distance(CURVE)
    assert "8 mm, f/2.8, focused at 0.5 m" in plot.caption
    figure = encoded(plot, ".svg").decode()
    for words in ("in focus, 0.4654 m to 0.5401 m", "pixels", "Airy disc"):
        assert words in figure


def test_infinity_is_drawn_as_far_as_paper_goes_and_without_a_pitch_in_micrometres():
    plot = blur_over_distance(FAR)
    assert "focused at infinity" in plot.caption
    figure = encoded(plot, ".svg").decode()
    for words in ("from 6.6 m on", "diameter on the sensor, um"):
        assert words in figure
    assert "Airy" not in figure


@pytest.mark.parametrize("curve", [CURVE, FAR])
def test_the_figure_is_readable(curve):
    require_readable(blur_over_distance(curve))


def test_the_depth_of_field_is_a_band():
    axes = require_readable(blur_over_distance(CURVE)).axes[0]
    band = next(patch for patch in axes.patches if isinstance(patch, Rectangle))
    assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx((CURVE.near, CURVE.far))
    low, high = axes.get_xlim()
    assert low < CURVE.near < CURVE.far < high
    assert np.isfinite(axes.lines[0].get_ydata()).all()
