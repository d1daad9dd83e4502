"""Sensor formats: names that people write, the rule of the inch, the pitch of the pixels."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.optics import FORMATS, literal_mm, pixel_pitch, sensor_format, smallest_format


@pytest.mark.parametrize("text", ["1/2.8", '1/2.8"', "1/2.8 inch", "1/2.8in", "1/2.80", "1/2.8-type"])
def test_a_format_is_known_by_all_its_spellings(text):
    assert sensor_format(text) is FORMATS['1/2.8"']


def test_the_diagonal_of_a_2_8th_of_an_inch_is_6_4_mm():
    assert sensor_format("1/2.8").diagonal_mm == pytest.approx(6.4, abs=0.05)  # the data sheets say 6.4 to 6.46


@pytest.mark.parametrize(
    ("text", "name"),
    [("APS-c", "APS-C"), ("full_frame", "full frame"), ("35mm", "full frame"), ("4/3", "4/3"), ("1", '1"')],
)
def test_a_name_is_found_whatever_the_case(text, name):
    assert sensor_format(text).name == name


def test_the_inch_of_a_name_is_longer_than_every_sensor_that_has_it():
    assert literal_mm(sensor_format("1/2.8")) == 9.07  # 25.4 / 2.8
    assert literal_mm(sensor_format("APS-C")) is None
    named = [known for known in FORMATS.values() if literal_mm(known) is not None]
    assert len(named) == 16
    assert all(literal_mm(known) > 1.35 * known.diagonal_mm for known in named)


def test_the_smallest_format_is_wide_enough_and_the_next_smaller_one_is_not():
    assert smallest_format(4.81e-3).name == '1/2.9"'
    assert smallest_format(4.8e-3 - 1e-9).name == '1/3"'
    assert smallest_format(0.05) is None


def test_other_inches_follow_the_rule():
    assert sensor_format("1/2.6").diagonal_mm == pytest.approx(18 / 2.6)
    assert sensor_format("1/1.5").diagonal_mm == pytest.approx(16 / 1.5)


def test_the_list_is_near_the_rule_where_formats_are_inches():
    for name, known in FORMATS.items():
        if name.endswith('"'):
            over, _, number = name[:-1].rpartition("/")
            size = (float(over) if over else 1.0) / float(number) if over else float(number)
            rule = size * (18 if size <= 0.5 else 16)
            assert known.diagonal_mm == pytest.approx(rule, rel=0.14), name  # what makers call an inch differs


def test_the_pitch_is_that_of_the_data_sheet():
    pitch = pixel_pitch(sensor_format("1/2.8"), (1920, 1080))
    assert pitch == pytest.approx(2.9e-6, rel=0.01)  # 1920 x 1080 at 2.9 um is sold as 1/2.8


@pytest.mark.parametrize(("text", "near"), [("fullframe", "full frame"), ("apsc", "APS-C")])
def test_a_misspelt_format_names_the_nearest(text, near):
    with pytest.raises(InvalidInput, match=f"Did you mean '{near}'"):
        sensor_format(text)


@given(st.text(alphabet='0123456789./" apsc', max_size=8))
def test_any_text_is_a_format_or_refused(text):
    try:
        known = sensor_format(text)
    except InvalidInput:
        return
    assert 0 < known.diagonal_mm < 60
