"""What `camcal doctor` sees, on this machine and on planted ones."""

import json
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import cv2
import pytest

from camcal.cli.main import app
from camcal.tasks import doctor


@pytest.fixture
def versions(monkeypatch):
    """Let packages have other versions than those installed; None takes one away."""
    installed = metadata.version

    def plant(**changed: str | None) -> None:
        names = {name.replace("_", "-"): version for name, version in changed.items()}

        def version(name: str) -> str:
            found = names.get(name, "")
            if found is None:
                raise metadata.PackageNotFoundError(name)
            return found or installed(name)

        monkeypatch.setattr(metadata, "version", version)

    return plant


def test_this_environment_is_complete():
    found = doctor.examine()
    assert found.failures == ()
    assert {"numpy", "opencv", "rawpy", "rich", "scipy", "typer", "matplotlib"} <= {p.name for p in found.packages}
    assert found.cores >= 1


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"numpy": "1.26.4"}, "numpy: version 1.26.4 is not >= 2.0; pip install 'numpy>=2.0'"),
        ({"typer": "0.30.1"}, "typer: version 0.30.1 is not < 0.30; pip install 'typer<0.30,>=0.29'"),
        ({"rawpy": None}, "rawpy: not installed; pip install 'rawpy>=0.27'"),
    ],
)
def test_a_package_that_does_not_fit_is_named_with_the_remedy(versions, changed, problem):
    versions(**changed)
    assert tuple(map(str, doctor.examine().failures)) == (problem,)


def test_optional_packages_are_listed_with_what_they_are_for_and_none_of_them_is_required(versions):
    versions(onnxruntime=None, rerun_sdk="0.29.0", rosbags="0.11.0", h5py="3.12.1")
    found = doctor.examine()
    single = [each for each in found.optional if each.extra not in ("clouds", "cluster")]
    assert {each.extra: (each.name, each.version) for each in single} == {
        "onnx": ("onnxruntime", None),
        "view": ("rerun-sdk", "0.29.0"),
        "bags": ("rosbags", "0.11.0"),
        "matlab": ("h5py", "3.12.1"),
    }
    assert all(each.purpose for each in found.optional)
    assert not {each.name for each in found.optional} & {each.name for each in found.packages}
    assert found.failures == ()


def test_every_extra_for_users_is_described():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"]) - {"dev", "docs"}
    assert set(doctor.PURPOSES) == extras
    page = (Path(__file__).parents[2] / "docs" / "installation.md").read_text(encoding="utf-8")
    assert {extra for extra in extras if f"| `{extra}` |" in page} == extras


def test_several_opencv_wheels_are_in_the_way(versions):
    versions(opencv_python="4.10.0.84")
    [problem] = map(str, doctor.examine().failures)
    assert problem.startswith("opencv: opencv-python 4.10.0.84, opencv-contrib-python-headless ")
    assert "overwrite each other" in problem


def test_an_opencv_that_is_too_old_is_in_the_way(monkeypatch):
    monkeypatch.setattr(cv2, "__version__", "4.11.0")
    [problem] = map(str, doctor.examine().failures)
    assert problem.startswith("opencv: version 4.11.0 is not >= 4.14")


def test_an_opencv_without_its_contributed_modules_is_in_the_way(monkeypatch):
    monkeypatch.delattr(cv2, "ximgproc")
    [problem] = map(str, doctor.examine().failures)
    assert problem.startswith("opencv: has no ximgproc;")


def test_an_opencv_that_cannot_be_imported_is_in_the_way(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    [problem] = map(str, doctor.examine().failures)
    assert problem.startswith("opencv: cannot be imported")


def test_the_command_exits_with_7_and_still_prints_its_document(versions, capsys):
    versions(numpy="1.26.4")
    with pytest.raises(SystemExit) as exit_:
        app(["doctor", "--json"])
    output = capsys.readouterr()
    assert exit_.value.code == 7
    (failure,) = json.loads(output.out)["failures"]
    assert (failure["code"], failure["where"]) == ("unusable_package", "numpy")
    assert failure["text"] == "version 1.26.4 is not >= 2.0; pip install 'numpy>=2.0'"
    assert output.err == "camcal: error: numpy: version 1.26.4 is not >= 2.0; pip install 'numpy>=2.0'\n"


def test_the_command_exits_with_0_when_nothing_is_in_the_way(capsys):
    with pytest.raises(SystemExit) as exit_:
        app(["doctor"])
    assert exit_.value.code == 0
    assert capsys.readouterr().out.startswith("All checks passed\n")
