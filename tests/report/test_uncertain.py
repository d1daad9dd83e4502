"""Values and standard deviations as text."""

import pytest

from camcal.report.uncertain import value_and_std


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (458.6543, 0.4149, ("458.65", "0.41")),
        (458.6543, 41.49, ("459", "41")),
        (-0.28340811, 0.0009, ("-0.28341", "0.00090")),
        (1.93e-05, 4.1e-05, ("0.000019", "0.000041")),
        (458.6543, None, ("458.654", "")),
        (458.6543, 0.0, ("458.654", "0")),
        (458.6543, float("nan"), ("458.654", "nan")),
        (1e-09, 2e-09, ("1e-09", "2.0e-09")),
        (7.0, 3e6, ("7", "3.0e+06")),
    ],
)
def test_the_value_ends_where_its_uncertainty_does(value, std, expected):
    assert value_and_std(value, std) == expected
