"""What is built for users: a wheel with all that runs, a source archive with all that tests it."""

import email
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import camcal

PROJECT = Path(__file__).parents[1]
FOLDERS = (".ci", "benchmarks", "camcal", "docs", "sample_configs", "tests")
TOP = {"CHANGELOG.md", "LICENSE", "README.md", "mkdocs.yml", "pyproject.toml"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The names of the files in the wheel and in the source archive, and the metadata."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "-d", folder]
    subprocess.run(build, cwd=PROJECT, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": ""})
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        metadata = email.message_from_bytes(archive.read(f"camcal-{camcal.__version__}.dist-info/METADATA"))
    with tarfile.open(source) as archive:
        sources = {name.partition("/")[2] for name in archive.getnames()}
    return names, sources, metadata


def files_of(*folders):
    found = (path for folder in folders for path in (PROJECT / folder).rglob("*") if path.is_file())
    return {path.relative_to(PROJECT).as_posix() for path in found if "__pycache__" not in path.parts}


@pytest.mark.slow
def test_the_wheel_has_the_package_with_its_types_and_assets_and_the_manual(built):
    names, _, _ = built
    package = {name for name in names if name.startswith("camcal/")}
    assert package == files_of("camcal")
    assert {"camcal/py.typed", "camcal/__init__.pyi"} <= package
    installed = {name.partition("/share/")[2] for name in names if "/share/" in name}
    assert installed == {name.removeprefix("docs/") for name in files_of("docs/man")}
    assert {name.partition("/")[0] for name in names} == {
        "camcal",
        f"camcal-{camcal.__version__}.data",
        f"camcal-{camcal.__version__}.dist-info",
    }


@pytest.mark.slow
def test_the_source_archive_has_what_the_tests_need(built):
    _, sources, _ = built
    assert files_of(*FOLDERS) | TOP <= sources
    assert sources - files_of(*FOLDERS) - TOP <= {"PKG-INFO", ".gitignore"}


@pytest.mark.slow
def test_the_metadata_say_what_the_package_is(built):
    _, _, metadata = built
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata["Requires-Python"] == ">=3.11"
    assert not any(name.startswith("License ::") for name in metadata.get_all("Classifier"))
    assert "Typing :: Typed" in metadata.get_all("Classifier")
    assert set(metadata.get_all("Provides-Extra")) >= {"view", "bags", "clouds", "cluster", "onnx", "dev"}
