"""camcal: calibrate, rectify and measure with cameras from the shell.

The names a program needs are here. They are listed in __init__.pyi, which type checkers read; each is imported when it
is first used, so that `import camcal` costs nothing.
"""

import re
from functools import cache
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"

_LISTED = re.compile(r"^from (camcal[\w.]+) import (\w+) as (\w+)$", re.MULTILINE)


@cache
def _homes() -> dict[str, tuple[str, str]]:
    """Return the module of every public name, and its name there."""
    listed = _LISTED.findall(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    return {name: (module, attribute) for module, attribute, name in sorted(listed, key=lambda line: line[2])}


@cache
def _modules() -> set[str]:
    """Return the names of what stands in the package."""
    return {path.stem for path in Path(__file__).parent.iterdir()}


def __getattr__(name: str) -> object:
    if name == "__all__":
        return list(_homes())
    if name in _modules():  # `from camcal import name` asks here first: no error that anybody sees
        raise AttributeError(f"module 'camcal' has no attribute {name!r} before 'import camcal.{name}'")
    if name.startswith("_") or name not in _homes():
        from camcal.records import missing

        raise missing("module 'camcal'", name, list(_homes()))
    module, attribute = _homes()[name]
    found = globals()[name] = getattr(import_module(module), attribute)
    return found


def __dir__() -> list[str]:
    return sorted(["__version__", *_homes()])
