"""The programs, libraries and the machine that the bytes of a report depend on."""

import platform
from importlib import metadata

import camcal
from camcal.formats import provenance
from camcal.run.process import processor_name

_DRAWN_BY = ("matplotlib", "jinja2")


def environment() -> dict[str, str]:
    """Return versions and machine by name, in the order in which they are listed."""
    found = {"camcal": camcal.__version__, "python": platform.python_version(), **provenance.libraries()}
    found |= {name: metadata.version(name) for name in _DRAWN_BY}
    return found | {"system": f"{platform.system()} {platform.machine()}", "processor": processor_name()}


def differences(recorded: dict[str, str], here: dict[str, str]) -> list[str]:
    """Return what differs between two environments, a line each."""
    names = dict.fromkeys([*recorded, *here])
    return [
        f"{name}: {recorded.get(name, 'none')} in the report, {here.get(name, 'none')} here"
        for name in names
        if recorded.get(name) != here.get(name)
    ]
