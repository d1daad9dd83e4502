"""What messages have in common: where an error is, and what a misspelt name may have meant."""

import pytest

from camcal.errors import FileError, InvalidInput, Located
from camcal.parsing import did_you_mean, nearest


@pytest.mark.parametrize("error", [InvalidInput, FileError])
def test_an_error_without_a_place_gets_that_of_its_block_and_keeps_its_own(error):
    with pytest.raises(error, match=r"^a\.yaml: wrong$"), Located("a.yaml"):
        raise error("wrong")
    with pytest.raises(error, match=r"^a\.yaml:3: wrong$"), Located("a.yaml"):
        raise error("wrong", where="a.yaml:3")


def test_the_inner_of_two_blocks_names_the_place():
    with pytest.raises(InvalidInput, match=r"^inner: wrong$"), Located("outer"), Located("inner"):
        raise InvalidInput("wrong")


def test_other_exceptions_pass_as_they_are():
    with pytest.raises(ZeroDivisionError), Located("a.yaml"):
        1 / 0  # noqa: B018


def test_a_misspelt_name_is_answered_with_the_nearest_one():
    assert nearest("distorsion", ["distortion", "intrinsics"]) == "distortion"
    assert did_you_mean("distorsion", ["distortion", "intrinsics"]) == ". Did you mean 'distortion'?"


@pytest.mark.parametrize(
    ("known", "otherwise", "said"),
    [
        (["left", "right"], None, "; possible here: left, right"),
        (["left", "right"], "; give --camera", "; give --camera"),
        ([f"camera{number}" for number in range(40)], None, ""),
        ([], None, ""),
    ],
)
def test_names_are_listed_where_none_is_near_and_there_are_few(known, otherwise, said):
    assert did_you_mean("x", known, otherwise) == said
