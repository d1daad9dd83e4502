"""The list of planted faults, which benchmarks/planted_faults.py runs, is of the package as it is."""

import sys
import tomllib
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
sys.path.insert(0, str(PROJECT / "benchmarks"))

from planted_faults import THRESHOLDS, thresholds  # noqa: E402

LISTS = sorted((PROJECT / "tests" / "faults").glob("*.toml"))
PACKAGE = [path.read_text(encoding="utf-8") for path in (PROJECT / "camcal").rglob("*.py")]


@pytest.mark.parametrize("path", LISTS, ids=lambda path: path.stem)
def test_the_text_of_every_fault_stands_once_in_the_package_and_is_changed(path: Path) -> None:
    for name, fault in tomllib.loads(path.read_text(encoding="utf-8")).items():
        assert [text.count(fault["find"]) for text in PACKAGE if fault["find"] in text] == [1], name
        assert fault["put"] != fault["find"], name
        assert all((PROJECT / "tests" / each).exists() for each in fault["tests"]), name


def test_every_threshold_is_a_number_of_its_module_that_tests_are_named_for(tmp_path: Path) -> None:
    planted = thresholds()
    assert len({(each.module, each.find) for each in planted}) == len(planted) / 2
    for fault in planted:
        assert (PROJECT / "camcal" / fault.module).read_text(encoding="utf-8").count(fault.find) == 1, fault.name
        assert fault.tests, fault.module
        assert all((PROJECT / "tests" / each).exists() for each in fault.tests), fault.module
    (tmp_path / "one.toml").write_text(THRESHOLDS.read_text(encoding="utf-8").replace('"KNOWN_PX"', '"KNOWN"'))
    with pytest.raises(SystemExit, match="KNOWN is not defined once, by a number"):
        thresholds(tmp_path / "one.toml")


def test_every_critical_package_has_faults() -> None:
    assert [path.stem for path in LISTS] == [
        "calibrate",
        "cameras",
        "estimate_poses",
        "pipelines",
        "quality",
        "rectification",
        "reports",
        "resume",
        "rigs",
        "solve",
        "stereo_matching",
        "stereo_rectify",
        "targets_corners",
    ]
    assert all(len(tomllib.loads(path.read_text(encoding="utf-8"))) >= 12 for path in LISTS)
