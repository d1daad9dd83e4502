"""The figure of a fitted curve: data and curve above, residuals below."""

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from camcal.arrays import Array
from camcal.estimate.curves.curve import CurveFit, predictions
from camcal.report.figures import STYLE, encoded

_POINTS, _CURVE, _OUTLIERS = "tab:blue", "tab:red", "0.6"
_FINE = 400
_MARGIN = 0.03  # of the range, beyond the data


def fitted_curve(fit: CurveFit, suffix: str) -> bytes:
    """Return a figure of data, curve and residuals, as a file of the type of `suffix`.

    A curve of one column is drawn over it, a shape in a plane as it lies there; of others the measured value is shown
    over the predicted one, or the distances alone.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 6.0))
        FigureCanvasAgg(figure)
        upper, lower = figure.subplots(2, 1, height_ratios=(3, 1))
        figure.subplots_adjust(left=0.12, right=0.97, top=0.94, bottom=0.09, hspace=0.32)
        across, label = _draw(upper, fit)
        upper.set_title(fit.curve.name)
        _draw_residuals(lower, fit, across, label)
        if fit.data.target is not None:
            lower.set_xlim(upper.get_xlim())
        if fit.outliers.any():
            upper.legend()
        return encoded(figure, suffix)


def _draw(axes: Axes, fit: CurveFit) -> tuple[Array, str]:
    """Draw the data with their curve; return what the residuals are to be drawn over, and its name."""
    columns, target = fit.data.columns, fit.data.target
    if target is not None and len(columns) == 1:
        (name, x), *_ = columns.items()
        _draw_over(axes, fit, name, x, target)
        return x, name
    if target is not None:
        predicted = target + fit.residuals[:, 0]
        _scatter(axes, fit, predicted, target)
        axes.axline((float(target[0]), float(target[0])), slope=1, color=_CURVE, lw=1)
        axes.set_ylabel("measured")
        return predicted, "predicted"
    rows = np.arange(len(fit.data)) + 1.0
    if len(columns) == 2:
        _draw_shape(axes, fit)
    else:
        _scatter(axes, fit, rows, np.linalg.norm(fit.residuals, axis=1))
        axes.set_ylabel("distance")
    return rows, "row"


def _draw_over(axes: Axes, fit: CurveFit, name: str, x: Array, target: Array) -> None:
    sigma = fit.data.sigma
    _scatter(axes, fit, x, target)
    if sigma is not None:
        axes.errorbar(x, target, sigma, fmt="none", ecolor=_POINTS, elinewidth=0.7)
    fine = _spanned(x)
    curve = predictions(fit.curve, {name: fine}, fit.values, len(fine))[:, 0]
    axes.plot(fine, np.where(np.isfinite(curve), curve, np.nan), color=_CURVE, lw=1.2)
    axes.set_ylabel("measured and fitted")


def _draw_shape(axes: Axes, fit: CurveFit) -> None:
    """Draw points in a plane, and the shape as the line on which the distance is zero."""
    (first, x), (second, y) = fit.data.columns.items()
    _scatter(axes, fit, x, y)
    grid = np.meshgrid(_spanned(x), _spanned(y))
    columns = {first: grid[0].ravel(), second: grid[1].ravel()}
    distance = predictions(fit.curve, columns, fit.values, grid[0].size)[:, 0].reshape(grid[0].shape)
    axes.contour(*grid, distance, levels=[0.0], colors=_CURVE, linewidths=1.2)
    axes.set_xlabel(first)
    axes.set_ylabel(second)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_residuals(axes: Axes, fit: CurveFit, across: Array, label: str) -> None:
    residuals = -fit.residuals if fit.data.target is not None else fit.residuals
    for component in residuals.T:
        _scatter(axes, fit, across, component)
    axes.axhline(0, color=_CURVE, lw=1)
    axes.set_xlabel(label)
    axes.set_ylabel("measured - fitted" if fit.data.target is not None else "distance")


def _scatter(axes: Axes, fit: CurveFit, x: Array, y: Array) -> None:
    """Draw points; those that a robust loss leaves less than half of their weight are open."""
    ignored = fit.outliers
    axes.plot(x[~ignored], y[~ignored], "o", ms=3.5, color=_POINTS, label="measured")
    axes.plot(x[ignored], y[ignored], "o", ms=4, mfc="none", color=_OUTLIERS, label="less than half of its weight")


def _spanned(values: Array) -> Array:
    """Return a fine scale over the range of values and a little beyond."""
    margin = _MARGIN * (float(np.ptp(values)) or 1.0)
    return np.linspace(values.min() - margin, values.max() + margin, _FINE)
