"""The settings that repeat a development bit for bit, written beside every image."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import camcal
from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.options import declared
from camcal.raw.mosaic import Mosaic
from camcal.tasks.raw.options import DemosaicOptions

SUFFIX = ".yaml"
_COMMENT = "What camcal demosaic did; given to --config, this file repeats it."


def path_beside(image: Path) -> Path:
    """Return where the settings of an image stand."""
    return image.with_name(image.name + SUFFIX)


def require_own(path: Path) -> None:
    """Raise InvalidInput if something else stands where settings go."""
    if path.exists() and _COMMENT.encode() not in files.read_bytes(path):
        raise InvalidInput("was not written by 'camcal demosaic' and is kept; choose another output", where=str(path))


def text(options: DemosaicOptions, record: Mapping[str, Any]) -> str:
    """Return the settings file: options of the command by name, and under x_record what was found on the way.

    Of the development it has everything, so that another version with other defaults repeats it too.
    """
    recorded = [each for each in declared(DemosaicOptions) if each.option.recorded and not each.positional]
    settings = {
        each.key: each.setting(value)
        for each in recorded
        if (value := each.of(options)) is not None and (value != each.default or each.path[0] == "development")
    }
    return emit.document({**settings, "x_record": {"camcal": camcal.__version__, **record}}, _COMMENT)


def capture_facts(frame: Mosaic) -> dict[str, Any]:
    """Return what the file of a frame says of its capture, without what it does not say."""
    capture = frame.capture
    facts = {
        "make": capture.make,
        "model": capture.model,
        "exposure_s": capture.exposure_s,
        "iso": capture.iso,
        "f_number": capture.f_number,
        "focal_mm": capture.focal_mm,
    }
    return {name: value for name, value in facts.items() if value not in (None, "")}
