"""Installed packages and settings, and failures that keep camcal from working."""

import os
import platform
import re
from importlib import metadata

from camcal import __version__
from camcal.dataclass import dataclass
from camcal.messages import Message
from camcal.run.process import available_cores

WHEEL = "opencv-contrib-python-headless"
_WHEELS = ("opencv-python", "opencv-python-headless", "opencv-contrib-python", WHEEL)  # all of them install `cv2`
_OPENCV_PARTS = ("aruco", "ximgproc")
_REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[^]]*])?\s*([^;]*?)(?:;\s*extra\s*==\s*['\"]([\w-]+)['\"])?$")
PURPOSES = {  # of the extras that users install
    "bags": "images of ROS bags and MCAP",
    "clouds": "LAS and LAZ point clouds",
    "cluster": "--scheduler, and URLs",
    "matlab": "MAT-files of version 7.3",
    "onnx": "camcal stereo disparity --engine onnx",
    "view": "camcal view --rerun, and .rrd files",
}
_CLAUSE = re.compile(r"(>=|<)\s*([\d.]+)")


@dataclass(frozen=True)
class Package:
    """A required package, the versions that serve, the one installed, and what is wrong with it, if anything."""

    name: str
    wanted: str
    version: str | None
    problem: str | None = None


@dataclass(frozen=True)
class OptionalPackage:
    """A package that an extra of camcal installs, the versions that serve, the one installed, and what needs it."""

    extra: str
    name: str
    wanted: str
    version: str | None
    purpose: str


@dataclass(frozen=True)
class Examination:
    """The surroundings; failures: what keeps camcal from working, with what to do about it."""

    camcal: str
    python: str
    system: str
    cores: int
    packages: tuple[Package, ...]
    optional: tuple[OptionalPackage, ...]
    opencv_wheels: tuple[str, ...]
    environment: dict[str, str]
    failures: tuple[Message, ...]


def examine() -> Examination:
    """Return the versions and settings camcal works with, and failures."""
    needed = [(name, wanted) for name, wanted, extra in _requirements() if not extra]
    packages = tuple(_opencv(wanted) if name == WHEEL else _package(name, wanted) for name, wanted in needed)
    optional = tuple(
        OptionalPackage(extra, name, wanted, _installed_version(name), PURPOSES[extra])
        for name, wanted, extra in _requirements()
        if extra in PURPOSES
    )
    wheels = tuple(f"{name} {version}" for name in _WHEELS if (version := _installed_version(name)))
    failures = [
        Message("unusable_package", package.problem, where=package.name) for package in packages if package.problem
    ]
    if not packages:
        failures.append(Message("not_installed", "not installed as a package: pip install it", where="camcal"))
    if len(wheels) > 1:
        text = f"{', '.join(wheels)} overwrite each other: pip uninstall all of them, then pip install {WHEEL}"
        failures.append(Message("opencv_conflict", text, where="opencv"))
    return Examination(
        camcal=__version__,
        python=platform.python_version(),
        system=platform.platform(),
        cores=available_cores(),
        packages=packages,
        optional=optional,
        opencv_wheels=wheels,
        environment={name: value for name, value in sorted(os.environ.items()) if name.startswith("OPENCV_")},
        failures=tuple(failures),
    )


def _requirements() -> list[tuple[str, str, str]]:
    """Return the names and version ranges of the packages that camcal requires, with the extra of an optional one."""
    try:
        lines = metadata.requires("camcal") or []
    except metadata.PackageNotFoundError:
        return []
    return sorted(match.groups("") for line in lines if (match := _REQUIREMENT.match(line)))  # type: ignore[misc]


def _installed_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _package(name: str, wanted: str) -> Package:
    version = _installed_version(name)
    if version is None:
        return Package(name, wanted, None, f"not installed; pip install '{name}{wanted}'")
    return Package(name, wanted, version, _misfit(name, version, wanted))


def _opencv(wanted: str) -> Package:
    """Return what `import cv2` yields, whichever wheel it comes from."""
    try:
        import cv2
    except ImportError as error:
        reason = str(error).partition("\n")[0]
        return Package("opencv", wanted, None, f"cannot be imported ({reason}); pip install {WHEEL}")
    missing = [part for part in _OPENCV_PARTS if not hasattr(cv2, part)]
    problem = _misfit(WHEEL, cv2.__version__, wanted)
    if missing and not problem:
        problem = f"has no {' and no '.join(missing)}; pip uninstall its wheel, then pip install {WHEEL}"
    return Package("opencv", wanted, cv2.__version__, problem)


def _misfit(name: str, version: str, wanted: str) -> str | None:
    """Return what is wrong with a version outside a range such as '<0.30,>=0.29'."""
    have = _numbers(version)
    for sign, bound in _CLAUSE.findall(wanted):
        if (have >= _numbers(bound)) != (sign == ">="):
            return f"version {version} is not {sign} {bound}; pip install '{name}{wanted}'"
    return None


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.match(r"\d+(?:\.\d+)*", version)[0].split("."))  # type: ignore[index]
