"""The programs, libraries and the machine that the bytes of a report depend on."""

import platform
from importlib import metadata
from pathlib import Path

import camcal
from camcal.formats import provenance

_DRAWN_BY = ("matplotlib", "jinja2")
_PROCESSORS = Path("/proc/cpuinfo")
_MODEL = "model name"


def environment() -> dict[str, str]:
    """Return versions and machine by name, in the order in which they are listed."""
    found = {"camcal": camcal.__version__, "python": platform.python_version(), **provenance.libraries()}
    found |= {name: metadata.version(name) for name in _DRAWN_BY}
    return found | {"system": f"{platform.system()} {platform.machine()}", "processor": _processor()}


def _processor() -> str:
    """Return the name of the processor, "unknown" where the system does not say it."""
    try:
        lines = _PROCESSORS.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return platform.processor() or "unknown"
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(_MODEL)), "unknown")


def differences(recorded: dict[str, str], here: dict[str, str]) -> list[str]:
    """Return what differs between two environments, a line each."""
    names = dict.fromkeys([*recorded, *here])
    return [
        f"{name}: {recorded.get(name, 'none')} in the report, {here.get(name, 'none')} here"
        for name in names
        if recorded.get(name) != here.get(name)
    ]
