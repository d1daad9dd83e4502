"""The choice of a lens model at its limits: prediction errors beyond all bounds, and two views."""

import numpy as np
import pytest

from camcal.calibrate import jackknife
from camcal.calibrate.intrinsics import CandidateModel
from camcal.quality.lens_choice import chosen


def test_prediction_errors_have_a_scale_of_at_most_20_px():
    sigma, densities = jackknife._likeliest(np.full(50, 500.0))
    assert sigma == pytest.approx(20.0, rel=1e-3)
    assert np.isfinite(densities).all()


@pytest.mark.parametrize(("gains", "name"), [((5.0, 5.1), "other"), ((15.0, -1.0), "default")])
def test_two_views_beat_where_they_agree(gains, name):
    # ten corners each: 2 nat in all, and one and a half standard errors of the sum of both
    one = CandidateModel("default", np.zeros(2), 20)
    other = CandidateModel("other", np.array(gains), 20)
    assert sum(gains) > 2
    assert chosen([one, other], "default").name == name
