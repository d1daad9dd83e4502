"""The catalogue: its names, and the hint a misspelt one gets."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from camcal import cameras
from camcal.cameras.catalogue import _FILES, MODELS, WIDE_MODEL, help_line, model_named
from camcal.errors import InvalidInput


def test_models_are_found_by_their_names_and_aliases():
    names = [name for model in MODELS.values() for name in (model.name, *model.aliases)]
    assert len(names) == len(set(names))
    for key, model in MODELS.items():
        assert all(model_named(name) is model for name in (key, model.name, *model.aliases))


def test_the_lines_of_the_files_name_the_models_that_they_hold():
    for file, names in _FILES.items():
        assert [model.name for model in import_module(f"camcal.cameras.{file}").MODELS] == names.split()
    held = {
        path.stem for path in Path(cameras.__file__).parent.glob("*.py") if "\nMODELS = (" in path.read_text("utf-8")
    }
    assert held == set(_FILES)


def test_names_of_other_tools_are_understood():
    assert model_named("fisheye") is model_named("equidistant") is MODELS[WIDE_MODEL]
    assert model_named("plumb_bob").parameter_names[4:] == ("k1", "k2", "p1", "p2", "k3")
    assert model_named("rational_polynomial").parameter_names[4:] == ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def test_the_help_names_every_lens_and_no_view():
    names, tilted = help_line().split("; ")
    assert tilted == "add _tilted for a tilted sensor"
    assert set(re.findall(r"\w+", names)) == {
        name for model in MODELS.values() if not model.is_view for name in (model.name, *model.aliases)
    }


@pytest.mark.parametrize(
    ("wrong", "near"), [("opencv9", "opencv"), ("kanala_brandt", "kannala_brandt4"), ("plumbob", "plumb_bob")]
)
def test_a_misspelt_name_is_refused_with_the_nearest(wrong, near):
    with pytest.raises(InvalidInput, match=f"{wrong!r} is unknown; did you mean '{near}"):
        model_named(wrong)


def test_a_name_like_no_other_is_refused_with_the_list():
    with pytest.raises(InvalidInput, match=r"use one of pinhole, opencv4, .*kannala_brandt4"):
        model_named("zzz")
