"""The curve of gamma."""

import numpy as np
import pytest

from camcal.targets.corner_refinement import apply_tone

PICTURE = np.linspace(-1, 1, 41)[None]


def test_without_tone_a_picture_stays_as_it_is():
    np.testing.assert_allclose(apply_tone(PICTURE, np.zeros((1, 1)))[0], PICTURE)


def test_gamma_is_one_of_the_curves():
    black, white = 0.05, 0.8
    light = (white + black) / 2 + (white - black) / 2 * PICTURE
    seen = light ** (1 / 2.2)
    curve = apply_tone(PICTURE, np.full((1, 1), (white - black) / (white + black)))[0]
    fit = np.polyfit(curve[0], seen[0], 1)
    np.testing.assert_allclose(np.polyval(fit, curve[0]), seen[0], atol=1e-6)  # g is kept in single precision


@pytest.mark.parametrize("tone", [-0.9, -0.011, -0.009, 0.0, 0.009, 0.011, 0.5, 0.95])
def test_derivatives_are_those_of_the_curve(tone):
    inner, step = PICTURE[:, 1:-1], 1e-6

    def value(picture, beta):
        return apply_tone(picture, np.full((1, 1), beta))[0]

    _, *slopes = apply_tone(inner, np.full((1, 1), tone))
    by_picture = (value(inner + step, tone) - value(inner - step, tone)) / (2 * step)
    np.testing.assert_allclose(slopes[0], by_picture, rtol=1e-4)  # the series ends at β³
    by_tone = (value(inner, tone + step) - value(inner, tone - step)) / (2 * step)
    np.testing.assert_allclose(slopes[1], by_tone, atol=3e-4)


def test_series_and_closed_form_meet():
    below, above = (apply_tone(PICTURE, np.full((1, 1), beta))[0] for beta in (0.00999, 0.01001))
    np.testing.assert_allclose(below, above, atol=2e-5)
