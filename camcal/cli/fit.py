"""`camcal fit`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.estimate.curves.result import CurveFit, Estimate
    from camcal.tasks.curves.fit_report import FitReport


def fit(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="CSV whose first row names the columns.")],
    model: Annotated[
        str,
        typer.Option(
            "--model",
            "-m",
            metavar="EXPR|FAMILY",
            help="A formula over columns and parameters, such as 'exp(a*x**2 + b*x + c)'; or one of poly:N, expquad, "
            "gauss, thin_lens, gamma, noise, edge, circle, line2d, plane, line3d.",
        ),
    ],
    start: Annotated[
        str | None,
        typer.Option(metavar="A=V,…", help="Where the search starts; families start by themselves if left out."),
    ] = None,
    y: Annotated[
        str | None,
        typer.Option(
            "--y", metavar="COLUMN", help="What is predicted: a column (by default y, or the last), or log(y)."
        ),
    ] = None,
    x: Annotated[
        str | None,
        typer.Option("--x", metavar="COLUMNS", help="Which column is x; for shapes x,y or x,y,z."),
    ] = None,
    sigma: Annotated[
        str | None,
        typer.Option(metavar="VALUE|COLUMN", help="Standard deviation of the data; by default from the residuals."),
    ] = None,
    bounds: Annotated[str | None, typer.Option(metavar="A=LOW:HIGH,…", help="Bounds; an end left out is open.")] = None,
    fix: Annotated[
        str | None, typer.Option(metavar="A,B=V,…", help="Parameters held at their start, or a value.")
    ] = None,
    loss: Annotated[
        str, typer.Option(metavar="none|huber|soft_l1|cauchy|tukey", help="Against outliers: how they count.")
    ] = "none",
    restarts: Annotated[
        int, typer.Option(metavar="N", min=0, max=1000, help="So many further starts, some powers of e off.")
    ] = 0,
    method: Annotated[
        str, typer.Option(metavar="levenberg-marquardt|gauss-newton", help="Plain Gauss-Newton is for comparison.")
    ] = "levenberg-marquardt",
    compare: Annotated[
        str | None, typer.Option(metavar="EXPR|FAMILY", help="A second model, compared by AIC, AICc, BIC and F test.")
    ] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Intervals by likelihood too, which may be lopsided.")
    ] = False,
    trace: Annotated[
        str | None,
        typer.Option(metavar="FILE|table", help="Every iteration: cost, damping, gain ratio, step; or a .csv."),
    ] = None,
    check_jacobian: Annotated[
        bool, typer.Option("--check-jacobian", help="Compare the derivatives with numerical ones.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="PATH", help="A figure of data, curve and residuals: .png, .svg or .pdf.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="PATH", help="Where to write the result: .yaml or .json.")
    ] = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Fit a formula, a curve or a shape to data, with standard errors, intervals and a verdict.

    What the data cannot tell is said by name: parameters that cannot be told apart, bounds that hold, searches that
    did not end in a minimum.
    """
    from camcal.tasks.curves.fit import FitOptions
    from camcal.tasks.curves.fit import fit as run
    from camcal.tasks.curves.fit_report import document
    from camcal.tasks.curves.fit_verdict import require_settled

    options = FitOptions(
        data,
        model,
        start,
        y,
        x,
        sigma,
        bounds,
        fix,
        loss,
        restarts,
        method,
        compare,
        profile,
        trace,
        check_jacobian,
        plot,
        output,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("fit", document(report))
    elif not quiet:
        _show(report, verbose)
        if trace == "table":
            _show_trace(report)
        for path in options.outputs():
            show.text(f"wrote {path}")
    require_settled(report)


def _show(report: "FitReport", verbose: bool) -> None:
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


def _lines(found: "CurveFit") -> list[str]:
    good = found.goodness
    scatter = "" if good.sigma is None else f", standard deviation {good.sigma:.6g} ({good.freedom} degrees of freedom)"
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
