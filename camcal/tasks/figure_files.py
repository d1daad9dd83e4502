"""Figures as files, each with a caption on a page, and the figures of a document that a command wrote."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats.documents import Check, Document
from camcal.formats.schema import FINITE, flag, items, mapping, number, text, unchecked
from camcal.report.figures.calibration import matrix_plot
from camcal.report.figures.curves import (
    PHASES,
    PhotonTransfer,
    TransferCurve,
    parameter_errors,
    photon_transfer,
    signal_to_noise,
)
from camcal.report.figures.figure import Plot
from camcal.run.outputs import claim
from camcal.tasks.options import THEMES, FigureOptions

if TYPE_CHECKING:
    from camcal.report.figures.figure import Plot

CAPTIONS = "figures.md"


def write_figures(
    options: FigureOptions, plots: Iterable["Plot"], theme: str = THEMES[0], names: Sequence[str] | None = None
) -> tuple[Path, ...]:
    """Return the files of figures after writing them, and their captions, to the folder of the options.

    names: of the figures, where these are made one after another, as they are written.
    Raises InvalidInput or FileError, before any is written, if one of them must not or cannot be.
    """
    if options.folder is None:
        return ()
    from camcal.report.figures import figure

    if names is None:
        plots = list(plots)
        names = [plot.name for plot in plots]
    paths = [options.folder / f"{name}.{options.kind}" for name in _distinct(names)]
    captions = options.folder / CAPTIONS
    claim((*paths, captions))
    parts = ["# Figures\n"]
    for path, plot in zip(paths, plots, strict=True):
        files.write_bytes(path, figure.encoded(plot, path.suffix, figure.THEMES[theme]))
        parts.append(f"## {plot.title}\n\n![{plot.alt}]({path.name})\n\n{plot.caption}\n")
    files.write_text(captions, "\n".join(parts))
    return tuple(paths)


def _distinct(names: Sequence[str]) -> list[str]:
    """Return names with a number after those that stood before: objects may differ in letters that no file has."""
    return [
        name if name not in names[:index] else f"{name}_{1 + names[:index].count(name)}"
        for index, name in enumerate(names)
    ]


def figure_data(paths: Sequence[Path]) -> dict[str, Any]:
    """Return the files of figures for --json, nothing where none were asked for."""
    return {"figure_files": [path.as_posix() for path in paths]} if paths else {}


SENSOR, FIT = "camcal-sensor", "camcal-fit"

_VALUE = mapping({"value": number(positive=True)}, others=unchecked)
_CURVE = mapping({"signal_dn": items(FINITE), "variance_dn2": items(FINITE), "fitted": items(flag)}, others=unchecked)
_SENSOR = mapping(
    {
        "figures": mapping({"gain_dn_per_e": _VALUE, "read_noise_e": _VALUE, "full_well_e": _VALUE}, others=unchecked),
        "saturation": text,
        "curves": mapping({}, dict.fromkeys(PHASES, _CURVE)),
    },
    others=unchecked,
)
_ESTIMATE = mapping({"value": FINITE}, {"std": FINITE}, others=unchecked)
_FIT = mapping(
    {
        "model": text,
        "parameters": mapping({}, others=_ESTIMATE),
        "free": items(text),
        "correlation": items(items(number(-1.001, 1.001))),
    },
    others=unchecked,
)


def sensor_file_plots(content: Document) -> tuple[Plot, ...]:
    """Return the photon transfer and the signal-to-noise ratio of a sensor file; raises InvalidInput for its faults."""
    require(content, _SENSOR)
    figures = {name: float(item["value"]) for name, item in content["figures"].items() if "value" in item}
    curves = {}
    for name, own in content["curves"].items():
        if len({len(own[key]) for key in ("signal_dn", "variance_dn2", "fitted")}) != 1:
            raise InvalidInput(f"curves.{name}: its lists differ in length", where=content.where)
        curves[name] = TransferCurve(*(np.array(own[key]) for key in ("signal_dn", "variance_dn2", "fitted")))
    transfer = PhotonTransfer(
        figures["gain_dn_per_e"], figures["read_noise_e"], figures["full_well_e"], content["saturation"], curves
    )
    return photon_transfer(transfer), signal_to_noise(transfer)


def fit_file_plots(content: Document) -> tuple[Plot, ...]:
    """Return the standard errors and the correlations of the parameters in a file of a fit, as far as it has them.

    Raises InvalidInput for its faults, or where it has no standard errors.
    """
    require(content, _FIT)
    parameters = content["parameters"]
    known = [name for name in content["free"] if "std" in parameters.get(name, {})]
    if not known:
        raise InvalidInput("has no standard errors to draw", where=content.where)
    values, std = (np.array([float(parameters[name][key]) for name in known]) for key in ("value", "std"))
    errors = parameter_errors(known, values, std)
    matrix = np.array(content["correlation"], dtype=float)
    if len(known) < 2 or matrix.shape != (len(content["free"]), len(content["free"])):
        return (errors,)
    return errors, matrix_plot(content["free"], matrix, "parameter", f"Correlations of {content['model']}")


def require(content: Document, check: Check) -> None:
    """Raise InvalidInput if a document does not pass a check."""
    if faults := list(check(content.data, "")):
        raise content.error(faults)
