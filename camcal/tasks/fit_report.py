"""The result of `camcal fit`, as a record and as plain data with its failures, and the figures of its file.

The figures of the file of `camcal sensor` are made here as well.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import records
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.estimate.curves.curve import CurveFit
from camcal.estimate.curves.fit import Comparison, End
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
from camcal.solve.descent import Iteration
from camcal.solve.differentiate import JacobianCheck

TRACE_COLUMNS = ("run", "iteration", "cost", "trial_cost", "damping", "gain", "step", "accepted")
_JACOBIAN_ERROR = {"complex": 1e-10, "central": 1e-6}  # of the largest: exact to rounding, and about the root of it

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


@dataclass(frozen=True, eq=False)
class FitReport:
    """A fit; turns: (run, turn) of every iteration; the other fit and how they compare; intervals by likelihood;
    figures: their files.
    """

    fit: CurveFit
    lines: Sequence[int | str]
    turns: tuple[tuple[int, Iteration], ...]
    other: CurveFit | None = None
    comparison: Comparison | None = None
    intervals: dict[str, tuple[End, End]] | None = None
    check: JacobianCheck | None = None
    figures: tuple[Path, ...] = ()


def document(report: FitReport) -> dict[str, Any]:
    """Return the report as plain data for --json and files; what is not known is None."""
    found = report.fit
    return {
        **plain(found),
        "profile": report.intervals,
        "comparison": _comparison(report),
        "jacobian_check": _check(report),
        "outliers": [report.lines[int(row)] for row in np.flatnonzero(found.outliers)],
        "largest_leverage": {
            "line": report.lines[int(np.argmax(found.leverage))],
            "leverage": float(found.leverage.max()),
        },
    }


def plain(found: CurveFit) -> dict[str, Any]:
    """Return a fit as plain data."""
    return {
        "model": found.curve.name,
        "formula": found.curve.text,
        "parameters": found.parameters,
        "derived": found.derived,
        "free": found.free,
        "correlation": found.correlations().tolist(),
        "strong_correlations": found.strong_correlations(),
        "unobservable": found.combinations,
        "at_bounds": found.at_bounds,
        **records.document(found.goodness),
        "condition": found.condition,
        "iterations": found.iterations,
        "runs": found.runs,
        "converged": found.converged,
        "reason": found.reason,
    }


def trace_rows(turns: Sequence[tuple[int, Iteration]]) -> list[tuple[object, ...]]:
    """Return the turns of every run as rows of `TRACE_COLUMNS`."""
    return [(run, *vars(turn).values()) for run, turn in turns]


def trace_csv(turns: Sequence[tuple[int, Iteration]]) -> str:
    """Return the turns of every run as the text of a CSV file."""
    lines = [",".join(map(_cell, row)) for row in trace_rows(turns)]
    return "\n".join([",".join(TRACE_COLUMNS), *lines]) + "\n"


def written(value: Any) -> Any:
    """Return plain data without what is not known, which a YAML file leaves out."""
    if records.is_record(value):
        value = records.document(value)
    if isinstance(value, Mapping):
        return {key: written(item) for key, item in value.items() if _is_known(item)}
    if isinstance(value, (list, tuple)):
        return [written(item) for item in value if _is_known(item)]
    return value


def _is_known(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and not np.isfinite(value))


def _comparison(report: FitReport) -> dict[str, Any] | None:
    if report.comparison is None or report.other is None:
        return None
    return {"with": plain(report.other), **records.document(report.comparison)}


def _check(report: FitReport) -> dict[str, Any] | None:
    if report.check is None:
        return None
    check = report.check
    return {
        "error": check.error,
        "method": check.method,
        "parameter": report.fit.curve.parameters[check.column],
        "line": report.lines[check.row[0]],
        "analytic": check.analytic,
        "numeric": check.numeric,
    }


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.12g}" if isinstance(value, float) else str(value).lower()


def require_settled(report: FitReport) -> None:
    """Raise what keeps a fit from being trusted: InsufficientData, NotConverged, or nothing at all."""
    found = report.fit
    check = report.check
    if check is not None and check.error > _JACOBIAN_ERROR[check.method]:
        name = found.curve.parameters[check.column]
        raise NotConverged(
            f"the derivative by {name} of row {report.lines[check.row[0]]} is {check.analytic:.9g}, numerically "
            f"{check.numeric:.9g}: {check.error:.1e} of the largest one"
        )
    if found.combinations:
        raise InsufficientData(
            f"parameters not separable by the data: {'; '.join(map(combination_text, found.combinations))}; "
            "--fix one of each, or add data"
        )
    if not found.converged:
        raise NotConverged(
            f"not converged after {found.iterations} iterations: {found.reason}; try another --start or --restarts 5"
        )
    if found.at_bounds:
        held = ", ".join(f"{name}={found.parameters[name].value:g}" for name in found.at_bounds)
        raise NotConverged(f"at a bound: {held}; widen --bounds, or --fix it")


def combination_text(parts: Mapping[str, float]) -> str:
    """Return a change that changes no residual in words, such as 'a + 2 b'; a single parameter by its name."""
    terms = [f"{'-' if part < 0 else '+'} {_times(abs(part))}{name}" for name, part in parts.items()]
    return " ".join(terms).removeprefix("+ ").replace("- ", "-", terms[0].startswith("-"))


def _times(factor: float) -> str:
    text = f"{factor:.3g}"
    return "" if text == "1" else f"{text} "


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
