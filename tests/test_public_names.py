"""The names of `camcal` itself: all there, none in the way of a subpackage, none costing anything unused."""

import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

import camcal


def test_every_public_name_resolves_and_is_listed():
    assert {name for name in camcal.__all__ if getattr(camcal, name, None) is None} == set()
    assert set(camcal.__all__) <= set(dir(camcal))


def test_no_public_name_hides_a_subpackage_or_module():
    assert set(camcal.__all__) & {module.name for module in pkgutil.iter_modules(camcal.__path__)} == set()


def test_public_names_stand_in_alphabetical_order():
    assert camcal.__all__ == sorted(camcal.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'calibrat'"):
        _ = camcal.calibrat


def test_importing_camcal_imports_nothing_else():
    program = (
        "import sys, camcal; print(*(name for name in sys.modules if name.startswith(('camcal', 'numpy', 'cv2'))))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["camcal"]


def test_every_public_name_is_in_the_table_of_the_library_page():
    table = (Path(__file__).parents[1] / "docs" / "library.md").read_text().partition("## Public names")[2]
    listed = re.findall(r"`(\w+)`", table)
    assert sorted(listed) == sorted(set(listed))
    assert set(listed) == set(camcal.__all__)


@pytest.mark.parametrize("name", [name for name in camcal.__all__ if name.endswith("Options")])
def test_options_have_defaults(name):
    assert getattr(camcal, name)() is not None


@pytest.mark.parametrize("name", [name for name in camcal.__all__ if inspect.isfunction(getattr(camcal, name))])
def test_functions_take_no_options_for_the_default_ones(name):
    parameters = inspect.signature(getattr(camcal, name)).parameters
    assert parameters.get("options") is None or parameters["options"].default is not inspect.Parameter.empty


@pytest.mark.parametrize("name", [name for name in camcal.__all__ if name.startswith(("read_", "write_"))])
def test_paths_are_text_or_paths(name):
    assert get_type_hints(getattr(camcal, name))["path"] == str | Path


@pytest.mark.parametrize("name", [name for name in camcal.__all__ if name.startswith("read_")])
def test_a_path_as_text_is_read_like_a_path(name, tmp_path):
    for missing in (tmp_path / "none.png", str(tmp_path / "none.png")):
        with pytest.raises(camcal.CamcalError, match=r"none\.png"):
            getattr(camcal, name)(missing)
