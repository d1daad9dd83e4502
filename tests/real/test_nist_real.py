"""Curve fits against the certified values of NIST's reference problems, from both starts, with one setting for all."""

import nist_strd
import pytest

from camcal.estimate.curves.fit import fit_curve

# Lanczos1 has residuals of 1e-13: the rounding of its data alone moves their standard deviation by 5e-4
LEAST_DIGITS_OF_ERRORS = {"Lanczos1": 3.0}


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", nist_strd.NAMES)
def test_certified_values_and_standard_errors_are_found(real_data, name, start):
    path = real_data / "nist" / f"{name}.dat"
    if not path.is_file():
        pytest.skip(f"no {path}")
    problem = nist_strd.read(path)
    fit = fit_curve(problem.curve, problem.data, problem.start(start))
    assert fit.converged
    # 6 digits of what is certified to 11: where a search that ended too early would be seen
    assert nist_strd.digits(fit.values, problem.values) >= 6
    deviations = [estimate.std for estimate in fit.parameters.values()]
    assert nist_strd.digits(deviations, problem.deviations) >= LEAST_DIGITS_OF_ERRORS.get(name, 4.0)
    assert fit.goodness.sigma == pytest.approx(problem.residual_deviation, rel=1e-3 if name == "Lanczos1" else 1e-9)
