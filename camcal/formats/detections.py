"""Detections files: camcal's own CSV, or mrcal's corners.vnl, by the file's suffix."""

from pathlib import Path

from camcal import files
from camcal.formats import detections_csv, vnl
from camcal.targets.board import Board, Detections


def read(path: Path, board: Board | None = None, image_size: vnl.ImageSize | None = None) -> Detections:
    """Return the detections in a file, views in the order in which it first names them.

    board: what was looked for; it takes the place of the board a CSV names, and a .vnl names none. image_size: of the
    images of a .vnl, one (width, height) or a function of the image's name; a CSV has its own.
    Raises InvalidInput with file and line for the first row that breaks a rule, FileError if the file cannot be read.
    """
    if path.suffix.lower() == vnl.SUFFIX:
        return vnl.read(path, board, image_size)
    return detections_csv.read(path, board)


def write(path: Path, detections: Detections) -> None:
    """Write detections in the form the file's suffix says; raises InvalidInput for what the form cannot hold."""
    form = vnl if path.suffix.lower() == vnl.SUFFIX else detections_csv
    files.write_text(path, form.text(detections))
