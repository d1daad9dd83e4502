"""`camcal fit`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.report.table import Column
from camcal.tasks.curves.options import TABLE, FitOptions

if TYPE_CHECKING:
    from camcal.estimate.curves.curve import CurveFit, Estimate
    from camcal.estimate.curves.fit import End
    from camcal.tasks.curves.fit_report import FitReport

ESTIMATE_COLUMNS = (
    Column(),
    Column("value"),
    Column("± std"),
    Column("95 % from", priority=1),
    Column("to", priority=1),
    Column("held"),
)


def fit(options: FitOptions, call: Call) -> None:
    """Fit a formula, a curve or a shape to data, with standard errors, intervals and a verdict.

    Problems are reported by name: unobservable parameters, active bounds, searches that did not converge.
    """
    from camcal.tasks.curves.fit import fit as run
    from camcal.tasks.curves.fit_report import document, require_settled
    from camcal.tasks.figure_files import figure_data

    report = run(options, call.progress)
    call.give(lambda: document(report) | figure_data(report.figures), lambda: _show(report, options, call.verbose))
    require_settled(report)


def _show(report: "FitReport", options: FitOptions, verbose: bool) -> None:
    found = report.fit
    every = {**found.parameters, **found.derived}
    rows = [[name, *_cells(value)] for name, value in every.items()]
    show.table(found.curve.text, ESTIMATE_COLUMNS, rows, verbose=verbose)
    for line in _lines(found):
        show.text(line)
    if report.intervals is not None:
        ends = [[name, *_ends(pair, every[name].std)] for name, pair in report.intervals.items()]
        show.table("by likelihood", ("", "95 % from", "to"), ends)
    if verbose and len(found.free) > 1:
        matrix = [
            [name, *map("{:.3f}".format, row)] for name, row in zip(found.free, found.correlations(), strict=True)
        ]
        show.table("correlations", ("", *found.free), matrix)
    if report.check is not None:
        show.text(f"derivatives agree with the {report.check.method} step to {report.check.error:.1e}")
    _show_comparison(report)
    if options.trace == TABLE:
        from camcal.tasks.curves.fit_report import TRACE_COLUMNS, trace_rows

        show.table("iterations", TRACE_COLUMNS, trace_rows(report.turns))
    show.wrote(*options.outputs(), show.several(report.figures, "figure"))


def _lines(found: "CurveFit") -> list[str]:
    good = found.goodness
    dof = f"{good.degrees_of_freedom} degrees of freedom"
    scatter = "" if good.sigma is None else f", standard deviation {good.sigma:.4g} ({dof})"
    lines = [f"residuals: RMS {good.rms:.4g}{scatter}"]
    if good.chi_square is not None and good.p_value is not None:
        lines.append(f"chi-square {good.chi_square:.4g}, p {good.p_value:.3g}")
    if good.r_squared is not None:
        lines.append(f"R2 {good.r_squared:.6f}")
    outliers = int(found.outliers.sum())
    if outliers:
        lines.append(f"{outliers} of {good.rows} rows with less than half weight")
    lines.append(
        f"{found.reason}; {found.iterations} iterations, best of {found.runs} runs, condition {found.condition:.3g}"
    )
    return lines


def _show_comparison(report: "FitReport") -> None:
    comparison, other = report.comparison, report.other
    if comparison is None or other is None:
        return
    fits = ((report.fit, comparison.first), (other, comparison.second))
    rows = [
        [fit.curve.text, fit.goodness.sum_of_squares, *(f"{value:.2f}" for value in (c.aic, c.aicc, c.bic))]
        for fit, c in fits
    ]
    show.table("comparison", (Column(wraps=True), "sum of squares", "AIC", "AICc", "BIC"), rows)
    words = {"first": report.fit.curve.text, "second": other.curve.text, "neither": "neither"}
    show.text(f"preferred: {words[comparison.preferred]}")
    if comparison.f is not None:
        show.text(f"F {comparison.f:.4g}, p {comparison.p_value:.3g}, if the models are nested")


def _cells(estimate: "Estimate") -> list[object]:
    from camcal.report.uncertain import value_and_std

    value, std = value_and_std(estimate.value, estimate.std)
    return [value, std or "-", *_ends(estimate.interval or (None, None), estimate.std), estimate.held or ""]


def _ends(ends: "tuple[End, End]", std: float | None) -> list[str | None]:
    """Return the ends of an interval to the place where the value is known."""
    from camcal.report.uncertain import value_and_std

    return [None if end is None else value_and_std(end, std)[0] for end in ends]
