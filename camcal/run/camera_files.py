"""The camera files that commands work from."""

from pathlib import Path

from camcal.formats import native
from camcal.formats.camera_file import CameraFile
from camcal.progress import Progress


def read_camera_file(path: Path, progress: Progress) -> CameraFile:
    """Return a camera file after warning of what looks wrong in it, and of cameras that are not to be trusted.

    Every command whose result depends on a calibration reads it here. Raises InvalidInput and FileError as
    `native.read` does.
    """
    file = native.read(path)
    for warning in file.warnings:
        progress.warn(warning)
    return file
