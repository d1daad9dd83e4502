"""Figures of the documents that commands print with --json."""

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats.documents import Document
from camcal.formats.poses import plain
from camcal.formats.schema import flag, integer, items, mapping, number, text, unchecked
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.figures.calibration import ranked_views, residuals_by_view
from camcal.report.figures.camera_files import pose_plots
from camcal.report.figures.figure import Plot
from camcal.report.figures.image_plane import projection_uncertainty
from camcal.tasks.curves.fit_report import written
from camcal.tasks.plot_documents import fit_file_plots, require

_SCHEMA = re.compile(r"camcal/(?P<command>[a-z-]+)/\d+")
_ROWS = items(items(unchecked))
_MAP = mapping({"u": items(number()), "v": items(number()), "rms_px": _ROWS, "worst_px": _ROWS, "inside": unchecked})
_VIEW = mapping({"file": text, "used": flag}, {"rms_px": number(0)}, others=unchecked)
_CALIBRATION = mapping(
    {
        "image_size": items(integer(1), 2),
        "uncertainty": mapping({"map": _MAP}, others=unchecked),
        "views": items(_VIEW),
    },
    others=unchecked,
)
_NOT_OF_A_POSE_FILE = ("schema", "failed", "pictures", "warnings")
_DETECTION = mapping(
    {"images": items(mapping({"image": text, "corners": integer(0)}, others=unchecked))}, others=unchecked
)


def command_of(content: Document) -> str | None:
    """Return the command that printed a document, None for another kind of file."""
    found = _SCHEMA.fullmatch(str(content.get("schema", "")))
    return None if found is None else found["command"]


def printed_plots(content: Document, command: str) -> tuple[Plot, ...]:
    """Return the figures of what a command printed.

    Raises FileError for the document of a failure, or of a command whose figures are those of its files; InvalidInput
    for its faults.
    """
    if "error" in content:
        raise FileError(f"holds the failure of camcal {command}, nothing to draw", where=content.where)
    if command not in _PLOTS:
        known = ", ".join(_PLOTS)
        raise FileError(
            f"is what camcal {command} prints with --json: draw the files that it wrote (of --json, {known} are drawn)",
            where=content.where,
        )
    return _PLOTS[command](content)


def _calibration(content: Document) -> tuple[Plot, ...]:
    require(content, _CALIBRATION)
    width, height = content["image_size"]
    rows = [(view["file"], float(view["rms_px"]), view["used"]) for view in content["views"] if "rms_px" in view]
    of_views = (residuals_by_view(rows, len(content["views"])),) if any(used for *_, used in rows) else ()
    return (projection_uncertainty(_uncertainty(content), (width, height)), *of_views)


def _uncertainty(content: Document) -> ProjectionUncertainty:
    found = content["uncertainty"]["map"]
    u, v = (np.array(found[name], float) for name in ("u", "v"))
    rms, worst = (_grid(content, found, name, float) for name in ("rms_px", "worst_px"))
    if not (np.isfinite(rms) & np.isfinite(worst)).any():
        raise InvalidInput("uncertainty.map: holds no numbers to draw", where=content.where)
    # ellipses with these axes, in whatever direction: neither is drawn
    covariances = np.zeros((len(rms), 2, 2))
    covariances[:, 0, 0], covariances[:, 1, 1] = worst**2, np.maximum(2 * rms**2 - worst**2, 0)
    inside = None if found["inside"] is None else _grid(content, found, "inside", bool)
    return ProjectionUncertainty(u, v, covariances, inside)


def _grid(content: Document, found: Mapping[str, Any], name: str, kind: type) -> Array:
    """Return the values (N,) of a map, row by row; NaN where it has none."""
    values: Array = np.zeros(0)
    with suppress(TypeError, ValueError):
        values = np.array(found[name], kind)
    if values.shape != (len(found["v"]), len(found["u"])):
        raise InvalidInput(f"uncertainty.map.{name}: not a number for each of v and u", where=content.where)
    return values.ravel()


def _detection(content: Document) -> tuple[Plot, ...]:
    require(content, _DETECTION)
    if not content["images"]:
        raise InsufficientData("holds no images to draw", where=content.where)
    return (ranked_views([(image["image"], image["corners"]) for image in content["images"]]),)


def _poses(content: Document) -> tuple[Plot, ...]:
    data = {key: value for key, value in content.data.items() if key not in _NOT_OF_A_POSE_FILE}
    file = replace(content, data=data)
    require(file, plain.check)
    return pose_plots(plain.from_document(file))


def _fit(content: Document) -> tuple[Plot, ...]:
    return fit_file_plots(replace(content, data=written(content.data)))


_PLOTS: dict[str, Callable[[Document], tuple[Plot, ...]]] = {
    "calibrate": _calibration,
    "detect": _detection,
    "pnp": _poses,
    "fit": _fit,
}
