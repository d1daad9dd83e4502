"""`camcal fit`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.curves.options import TABLE, FitOptions

if TYPE_CHECKING:
    from camcal.estimate.curves.curve import CurveFit, Estimate
    from camcal.tasks.curves.fit_report import FitReport


def fit(options: FitOptions, call: Call) -> None:
    """Fit a formula, a curve or a shape to data, with standard errors, intervals and a verdict.

    What the data cannot tell is said by name: parameters that cannot be told apart, bounds that hold, searches that
    did not end in a minimum.
    """
    from camcal.tasks.curves.fit import fit as run
    from camcal.tasks.curves.fit_report import document, require_settled

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report, options, call.verbose))
    require_settled(report)


def _show(report: "FitReport", options: FitOptions, verbose: bool) -> None:
    found = report.fit
    rows: list[list[object]] = [[name, *_cells(value)] for name, value in found.parameters.items()]
    rows += [[name, *_cells(value)] for name, value in found.derived.items()]
    show.table(found.curve.text, ("", "value", "std", "95 % from", "to", ""), rows)
    for line in _lines(found):
        show.text(line)
    if report.intervals is not None:
        show.table("by likelihood", ("", "95 % from", "to"), [[name, *ends] for name, ends in report.intervals.items()])
    if verbose and len(found.free) > 1:
        matrix = [[name, *row] for name, row in zip(found.free, found.correlations(), strict=True)]
        show.table("correlations", ("", *found.free), matrix)
    if report.check is not None:
        show.text(f"derivatives agree with the {report.check.method} step to {report.check.error:.1e}")
    _show_comparison(report)
    if options.trace == TABLE:
        _show_trace(report)
    for path in options.outputs():
        show.text(f"wrote {path}")


def _lines(found: "CurveFit") -> list[str]:
    good = found.goodness
    scatter = (
        ""
        if good.sigma is None
        else f", standard deviation {good.sigma:.6g} ({good.degrees_of_freedom} degrees of freedom)"
    )
    lines = [f"residuals: RMS {good.rms:.6g}{scatter}"]
    if good.chi_square is not None and good.p_value is not None:
        lines.append(f"chi-square {good.chi_square:.6g}, p {good.p_value:.3g}")
    if good.r_squared is not None:
        lines.append(f"R2 {good.r_squared:.6f}")
    outliers = int(found.outliers.sum())
    if outliers:
        lines.append(f"{outliers} of {good.rows} rows count less than half")
    lines.append(
        f"{found.reason}; {found.iterations} iterations, best of {found.runs} runs, condition {found.condition:.3g}"
    )
    return lines


def _show_comparison(report: "FitReport") -> None:
    comparison, other = report.comparison, report.other
    if comparison is None or other is None:
        return
    fits = ((report.fit, comparison.first), (other, comparison.second))
    rows = [[fit.curve.text, fit.goodness.sum_of_squares, c.aic, c.aicc, c.bic] for fit, c in fits]
    show.table("comparison", ("", "sum of squares", "AIC", "AICc", "BIC"), rows)
    words = {"first": report.fit.curve.text, "second": other.curve.text, "neither": "neither"}
    show.text(f"preferred: {words[comparison.preferred]}")
    if comparison.f is not None:
        show.text(f"F {comparison.f:.6g}, p {comparison.p_value:.3g}, if one is a special case of the other")


def _show_trace(report: "FitReport") -> None:
    from camcal.tasks.curves.fit_report import TRACE_COLUMNS, trace_rows

    show.table("iterations", TRACE_COLUMNS, trace_rows(report.turns))


def _cells(estimate: "Estimate") -> list[object]:
    low, high = estimate.interval or (None, None)
    return [estimate.value, estimate.std, low, high, estimate.held or ""]
