"""Figures of the files of `camcal sensor` and `camcal fit`."""

import numpy as np

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
