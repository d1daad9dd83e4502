"""What of camcal's surroundings is installed, and what is in the way."""

import os
import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from types import ModuleType
from typing import Any

from camcal import __version__
from camcal.run.fanout import available_cores

_WHEELS = (
    "opencv-python",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-contrib-python-headless",
)
_WANTED_WHEEL = "opencv-contrib-python-headless"
_OPENCV_PARTS = ("aruco", "ximgproc")
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)\s*(?P<range>[^;]*)(?P<marker>;.*)?")


@dataclass(frozen=True)
class Package:
    """One required package; version is None if it is not installed, problem None if all is well."""

    name: str
    wanted: str
    version: str | None
    problem: str | None


@dataclass(frozen=True)
class Examination:
    """What was found; `problems` holds one line for everything that is in the way, with what to do about it."""

    python: str
    system: str
    camcal: str
    cores: int
    packages: tuple[Package, ...]
    opencv_wheels: tuple[str, ...]
    environment: dict[str, str]
    problems: tuple[str, ...]


def examine() -> Examination:
    """Return what of camcal's surroundings is installed, and what is in the way."""
    packages = tuple(_package(name, wanted) for name, wanted in _requirements() if name not in _WHEELS)
    wheels = tuple(f"{name} {version}" for name in _WHEELS if (version := _installed(name)))
    problems = [package.problem for package in packages if package.problem]
    return Examination(
        python=platform.python_version(),
        system=platform.platform(),
        camcal=__version__,
        cores=available_cores(),
        packages=(*packages, _opencv()),
        opencv_wheels=wheels,
        environment={name: value for name, value in sorted(os.environ.items()) if name.startswith("OPENCV_")},
        problems=(*problems,),
    )


def document(found: Examination) -> dict[str, Any]:
    """Return the examination as plain data."""
    return found.__dict__
