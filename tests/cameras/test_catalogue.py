"""The catalogue: its names, and the hint a misspelt one gets."""

import pytest

from camcal.cameras.catalogue import MODELS, model_named
from camcal.errors import InvalidInput


def test_models_are_found_by_their_names():
    assert list(MODELS) == [
        "pinhole", "opencv4", "opencv5", "opencv8", "opencv12", "opencv14", "kannala_brandt4", "kannala_brandt5t",
        "cylinder", "equirectangular", "stereographic",
    ]  # fmt: skip
    assert all(model_named(name).name == name for name in MODELS)


@pytest.mark.parametrize(("wrong", "near"), [("opencv9", "opencv"), ("kanala_brandt", "kannala_brandt4")])
def test_a_misspelt_name_is_refused_with_the_nearest(wrong, near):
    with pytest.raises(InvalidInput, match=f"{wrong!r} is unknown; did you mean '{near}"):
        model_named(wrong)


def test_a_name_like_no_other_is_refused_with_the_list():
    with pytest.raises(InvalidInput, match=r"use one of pinhole, opencv4, .*kannala_brandt4"):
        model_named("zzz")
