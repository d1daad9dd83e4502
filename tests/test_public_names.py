"""The names of `camcal` itself: all there, none in the way of a subpackage, none costing anything unused."""

import pkgutil
import subprocess
import sys

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
