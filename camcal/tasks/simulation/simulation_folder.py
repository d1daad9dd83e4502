"""The folder of a simulation: known by its truth, so that another run may replace it and nothing else is touched."""

from pathlib import Path

from camcal.errors import CamcalError, InvalidInput
from camcal.formats import native

MARK = "x_simulation"  # the key under which the truth says how the images were made


def require_own(folder: Path, truth: str) -> None:
    """Raise InvalidInput unless a folder is empty, new, or holds an earlier simulation; truth: its camera file."""
    if folder.exists() and not folder.is_dir():
        raise InvalidInput("is a file; images go into a folder", where=str(folder))
    if folder.is_dir() and any(folder.iterdir()) and not _is_ours(folder / truth):
        raise InvalidInput("is not empty and not an earlier simulation; choose another folder", where=str(folder))


def _is_ours(truth: Path) -> bool:
    try:
        return MARK in native.read(truth).extra
    except CamcalError:
        return False
