"""Values and standard deviations as text."""

import pytest

from camcal.report.table import projection_words, value_and_std


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
        (1e-09, 2e-09, ("1.0e-09", "2.0e-09")),
        (1.23456789e-3, 1.5e-9, ("1.2345679e-03", "1.5e-09")),
        (7.9e-73, 2.2e-38, ("0", "2.2e-38")),
        (7.0, 3e6, ("0", "3.0e+06")),
        (1234567.0, 2.3e5, ("1.23e+06", "2.3e+05")),
        (-1e-9, 1e-5, ("0.000000", "0.000010")),
        (float("inf"), 1.0, ("inf", "1")),
    ],
)
def test_the_value_ends_where_its_uncertainty_does(value, std, expected):
    assert value_and_std(value, std) == expected


@pytest.mark.parametrize(
    ("figures", "range_m", "words"),
    [
        ({"max_px": 0.2136, "rms_px": 0.0412}, None, "at infinity): RMS 0.041 px, worst 0.21 px"),
        ({"rms_px": 12.34, "inside_max_px": 123.4}, None, "RMS 12 px; where corners were seen: worst 123 px"),
        ({"inside_rms_px": 0.0}, 0.5, "at 0.5 m): where corners were seen: RMS 0 px"),
        (
            {"median_px": 0.1, "p95_px": 0.3, "centre_px": 0.05},
            2,
            "centre 0.05 px, median 0.1 px, 95th percentile 0.3 px",
        ),
    ],
)
def test_a_projection_uncertainty_is_one_line_of_two_digits(figures, range_m, words):
    assert projection_words(figures, range_m).startswith("Projection uncertainty (1 sigma, at ")
    assert projection_words(figures, range_m).endswith(words)
