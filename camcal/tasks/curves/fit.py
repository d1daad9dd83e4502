"""`camcal fit`: a curve through measurements, with what it is worth."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.estimate.curves.curve import CurveFit, predictions, predictions_with_jacobian
from camcal.estimate.curves.fit import compare, fit_curve, likelihood_intervals
from camcal.estimate.curves.search import SearchOptions
from camcal.formats import emit
from camcal.formats.schema import did_you_mean
from camcal.formats.tables import Table, read_measurements
from camcal.progress import SILENT, Progress
from camcal.run.paths import refuse_overwriting
from camcal.solve.descent import Iteration
from camcal.solve.differentiate import JacobianCheck, check_jacobian
from camcal.tasks.curves import fit_texts
from camcal.tasks.curves.fit_model import Measured, Model, model_of
from camcal.tasks.curves.fit_report import FitReport, document, trace_csv, written
from camcal.tasks.curves.options import TABLE, FitOptions


def fit(options: FitOptions, progress: Progress = SILENT) -> FitReport:
    """Return the fit of a model to a table, after writing what the options ask for.

    Raises InvalidInput, FileError, InsufficientData; a search that did not converge is written too, see
    `require_settled`.
    """
    if options.plot is not None:
        from camcal.report.figures import require_suffix  # plotting takes long to import

        require_suffix(options.plot)
    refuse_overwriting(options.outputs(), [options.data])
    table = read_measurements(options.data)
    measured = Measured(table, _names(options.x), options.y, options.sigma)
    fixed, values = fit_texts.fixed(options.fix)
    start = fit_texts.starts(options.start) | values
    model = model_of(options.model, measured, start)
    other = None if options.compare is None else model_of(options.compare, measured, start)
    _refuse_strangers(options, fixed, start, [model] if other is None else [model, other])
    turns: list[tuple[int, Iteration]] = []
    found = _fitted(model, options, fixed, turns)
    second = None if other is None else _fitted(other, options, fixed, [])
    report = FitReport(
        found,
        table.lines,
        turns=tuple(turns),
        other=second,
        comparison=None if second is None else compare(found, second),
        intervals=likelihood_intervals(found) if options.profile else None,
        check=_check_derivatives(model) if options.check_jacobian else None,
    )
    _warn(report, progress)
    _write(report, options, table)
    return report


def _fitted(model: Model, options: FitOptions, fixed: frozenset[str], turns: list[tuple[int, Iteration]]) -> CurveFit:
    search = SearchOptions(fit_texts.bounds(options.bounds), fixed, options.loss, options.restarts, options.method)
    return fit_curve(model.curve, model.data, model.start, search, lambda run, turn: turns.append((run, turn)))


def _check_derivatives(model: Model) -> JacobianCheck:
    """Return how far the curve's derivatives at its start are from numerical ones."""
    curve, data = model.curve, model.data
    at = np.array([model.start[name] for name in curve.parameters])
    _, slopes = predictions_with_jacobian(curve, data.columns, at, len(data), curve.parameters)
    analytic = all(formula.analytic for formula in curve.formulas)
    return check_jacobian(lambda p: predictions(curve, data.columns, p, len(data)), slopes, at, analytic=analytic)


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def _refuse_strangers(
    options: FitOptions, fixed: frozenset[str], start: dict[str, float], models: Sequence[Model]
) -> None:
    """Raise InvalidInput for a name in an option that is no parameter of any model."""
    known = list(dict.fromkeys(name for model in models for name in model.curve.parameters))
    given = {"--start": start, "--fix": fixed, "--bounds": fit_texts.bounds(options.bounds)}
    for option, names in given.items():
        for name in names:
            if name not in known:
                raise InvalidInput(f"{option} {name}: no such parameter{did_you_mean(name, known)}")


def _warn(report: FitReport, progress: Progress) -> None:
    for first, second, value in report.fit.strong_correlations():
        progress.warn(f"{first} and {second} are hardly told apart: correlation {value:+.4f}")


def _write(report: FitReport, options: FitOptions, table: Table) -> None:
    if options.trace not in (None, TABLE):
        files.write_text(Path(str(options.trace)), trace_csv(report.turns))
    if options.plot is not None:
        from camcal.report.curve import fitted_curve

        files.write_bytes(options.plot, fitted_curve(report.fit, options.plot.suffix))
    if options.output is None:
        return
    content = {"format": "camcal-fit", "version": 1, "data": Path(table.path).name, **document(report)}
    if options.output.suffix.lower() == ".json":
        text = json.dumps(emit.rounded(content), indent=1, ensure_ascii=False) + "\n"
    else:
        text = emit.document(written(content))
    files.write_text(options.output, text)
