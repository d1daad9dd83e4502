"""The figure of a fitted curve: data, curve, residuals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from camcal.arrays import Array
from camcal.estimate.curves.curve import CurveFit, predictions
from camcal.messages import counted
from camcal.report.figures.figure import WIDTH, Plot, Theme, logarithmic_labels

_FINE = 400
_MARGIN = 0.03  # of the range, beyond the data


def fitted_curve(fit: CurveFit) -> Plot:
    """Return data, curve and residuals.

    A curve of one column is drawn over it, a shape in a plane as it lies there; of others the measured value is shown
    over the predicted one, or the distances alone.
    """
    rms = float(np.sqrt(np.mean(fit.residuals**2)))
    outliers = int(fit.outliers.sum())
    ignored = f" {outliers} rows (open marks) count less than half." if outliers else ""

    def draw(figure: FigureBase, theme: Theme) -> None:
        upper, lower = figure.subplots(2, 1, height_ratios=(3, 1))
        across, label = _draw_fitted(upper, fit, theme)
        _draw_residuals(lower, fit, across, label, theme)
        if fit.data.target is not None:
            lower.set_xlim(upper.get_xlim())
        if outliers:
            upper.legend()
        for axes in (upper, lower):
            axes.grid(visible=True)

    return Plot(
        "fitted_curve",
        f"Fit of {fit.curve.name}",
        f"Measured values (dots), the fitted curve, and below measured minus fitted in the units of the data: "
        f"{rms:.3g} RMS of {len(fit.data)} rows.{ignored}",
        f"Data with the fitted curve {fit.curve.name}, and its residuals, {rms:.3g} RMS.",
        draw,
        (WIDTH, 4.6),
    )


def _draw_fitted(axes: Axes, fit: CurveFit, theme: Theme) -> tuple[Array, str]:
    """Draw the data with their curve; return what the residuals are to be drawn over, and its name."""
    columns, target = fit.data.columns, fit.data.target
    if target is not None and len(columns) == 1:
        (name, x), *_ = columns.items()
        _draw_curve(axes, fit, name, x, target, theme)
        return x, name
    if target is not None:
        predicted = target + fit.residuals[:, 0]
        _draw_points(axes, fit, predicted, target, theme)
        axes.axline((float(target[0]), float(target[0])), slope=1, color=theme.series[1], lw=1)
        axes.set_ylabel("measured")
        return predicted, "predicted"
    rows = np.arange(len(fit.data)) + 1.0
    if len(columns) == 2:
        _draw_shape(axes, fit, theme)
    else:
        _draw_points(axes, fit, rows, np.linalg.norm(fit.residuals, axis=1), theme)
        axes.set_ylabel("distance")
    return rows, "row"


def _draw_curve(axes: Axes, fit: CurveFit, name: str, x: Array, target: Array, theme: Theme) -> None:
    sigma = fit.data.sigma
    _draw_points(axes, fit, x, target, theme)
    if sigma is not None:
        axes.errorbar(x, target, sigma, fmt="none", ecolor=theme.series[0], elinewidth=0.7)
    fine = _span(x)
    curve = predictions(fit.curve, {name: fine}, fit.values, len(fine))[:, 0]
    axes.plot(fine, np.where(np.isfinite(curve), curve, np.nan), color=theme.series[1], lw=1.2)
    axes.set_ylabel("measured and fitted")


def _draw_shape(axes: Axes, fit: CurveFit, theme: Theme) -> None:
    """Draw points in a plane, and the shape as the line on which the distance is zero."""
    (first, x), (second, y) = fit.data.columns.items()
    _draw_points(axes, fit, x, y, theme)
    grid = np.meshgrid(_span(x), _span(y))
    columns = {first: grid[0].ravel(), second: grid[1].ravel()}
    distance = predictions(fit.curve, columns, fit.values, grid[0].size)[:, 0].reshape(grid[0].shape)
    axes.contour(*grid, distance, levels=[0.0], colors=theme.series[1], linewidths=1.2)
    axes.set_xlabel(first)
    axes.set_ylabel(second)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_residuals(axes: Axes, fit: CurveFit, across: Array, label: str, theme: Theme) -> None:
    residuals = -fit.residuals if fit.data.target is not None else fit.residuals
    for component in residuals.T:
        _draw_points(axes, fit, across, component, theme)
    axes.axhline(0, color=theme.series[1], lw=1)
    axes.set_xlabel(label)
    axes.set_ylabel("measured - fitted" if fit.data.target is not None else "distance")


def _draw_points(axes: Axes, fit: CurveFit, x: Array, y: Array, theme: Theme) -> None:
    """Draw points; those that a robust loss leaves less than half of their weight are open."""
    ignored = fit.outliers
    axes.plot(x[~ignored], y[~ignored], "o", ms=3.5, color=theme.series[0], label="measured")
    axes.plot(x[ignored], y[ignored], "o", ms=4, mfc="none", color=theme.ink, label="less than half of its weight")


def _span(values: Array) -> Array:
    """Return a fine scale over the range of values and a little beyond."""
    margin = _MARGIN * (float(np.ptp(values)) or 1.0)
    return np.linspace(values.min() - margin, values.max() + margin, _FINE)


def parameter_errors(names: Sequence[str], values: Array, std: Array) -> Plot:
    """Return the standard errors (K,) of fitted parameters as shares of their values (K,)."""
    share = 100 * std / np.maximum(np.abs(values), 1e-300)
    words = ", ".join(
        f"{name} {value:.4g} ± {error:.2g}" for name, value, error in zip(names, values, std, strict=True)
    )

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot(share, range(len(names)), "o", color=theme.series[0], ms=7)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        if (share > 0).all():
            axes.set_xscale("log")
            axes.set_xlim(0.3 * float(share.min()), 3 * float(share.max()))
            logarithmic_labels(axes.xaxis)
        axes.set_xlabel("standard error, % of the value")
        axes.grid(visible=True)

    return Plot(
        "parameter_errors",
        "Standard errors of the parameters",
        f"Standard errors of the fitted parameters in percent of their values: {words}.",
        f"Standard errors of {counted(len(names), 'parameter')}: {words}.",
        draw,
        (WIDTH, 1.3 + 0.3 * max(len(names), 3)),
    )
