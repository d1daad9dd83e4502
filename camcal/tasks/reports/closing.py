"""What all reports end with: where the result comes from, and how to repeat it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import camcal
from camcal import files
from camcal.formats import native
from camcal.formats.camera_file import CameraFile
from camcal.report.page.origin import origin_section, repeat_section
from camcal.report.page.record import Section


def made() -> str:
    """Return the program that makes a page, with its version."""
    return f"camcal {camcal.__version__}"


def result_text(file: CameraFile, name: str) -> str:
    """Return the text of a camera file that is called so."""
    with files.unwatched(), TemporaryDirectory() as folder:
        path = Path(folder) / name
        native.write(path, file)
        return files.read_text(path)


def images_of(file: CameraFile) -> list[dict[str, Any]]:
    """Return the images that a calibration lists in its provenance."""
    images = file.provenance.get("images")
    return images if isinstance(images, list) else []


def closing_sections(
    provenance: Mapping[str, Any], environment: Mapping[str, str], lines: Sequence[str]
) -> tuple[Section, ...]:
    """Return the sections on provenance and repetition; lines: what else the calibration reported."""
    command = str(provenance.get("command", "camcal"))
    return origin_section(provenance, environment, lines), repeat_section(command)
