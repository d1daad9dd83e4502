"""Plots of sensor noise, lens blur and fitted curves, without a display; style and encoding."""

from dataclasses import dataclass
from io import BytesIO
from math import inf
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.curves.curve import CurveFit, predictions
from camcal.optics.lens import blur_disc
from camcal.raw.emva import line_deviation
from camcal.raw.sensor import Characterisation

SUFFIXES = (".png", ".svg", ".pdf")

_COLOURS = {"R": "tab:red", "Gr": "tab:green", "Gb": "tab:olive", "B": "tab:blue", "mono": "tab:gray"}
_MARKERS = {"R": "o", "Gr": "^", "Gb": "v", "B": "s", "mono": "o"}
_LINE = "0.25"
_DPI = 120
_DECADE = 10  # a longer range of distances is drawn with a logarithmic axis
STYLE: dict[Any, Any] = {"svg.hashsalt": "camcal", "svg.fonttype": "none", "font.size": 9}

# fitted curves
_POINTS, _CURVE, _OUTLIERS = "tab:blue", "tab:red", "0.6"
_FINE = 400
_MARGIN = 0.03  # of the range, beyond the data


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless figures are written as this type of file."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"figures are {', '.join(SUFFIXES)}, found {path.suffix or 'no suffix'}", where=str(path))


def photon_transfer(sensor: Characterisation, suffix: str) -> bytes:
    """Return a figure of a sensor's photon transfer curves and its linearity, as a file of the type of `suffix`.

    Left: noise over light with the line through the levels that count, and where pixels are full. Right: deviation of
    the light from a line over exposure, or the signal-to-noise ratio where exposures are unknown.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 4.4))
        figure.subplots_adjust(left=0.065, right=0.985, bottom=0.11, top=0.93, wspace=0.2)
        FigureCanvasAgg(figure)
        transfer, beside = figure.subplots(1, 2)
        _draw_transfer(transfer, sensor)
        if sensor.figures.linearity_error is None:
            _draw_ratio(beside, sensor)
        else:
            _draw_linearity(beside, sensor)
        return encoded(figure, suffix)


@dataclass(frozen=True)
class BlurCurve:
    """A lens whose blur over distance is drawn; lengths in metres, pitch and Airy disc None where unknown.

    near, far: the ends of the depth of field.
    """

    focal: float
    f_number: float
    focus: float
    circle: float
    near: float
    far: float
    pitch: float | None = None
    airy_diameter: float | None = None


def blur_over_distance(curve: BlurCurve, suffix: str) -> bytes:
    """Return a figure of the blur disc over distance with the depth of field, as a file of the type of `suffix`."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.4))
        figure.subplots_adjust(left=0.09, right=0.98, bottom=0.11, top=0.93)
        FigureCanvasAgg(figure)
        _draw_blur(figure.subplots(), curve)
        return encoded(figure, suffix)


def _draw_blur(axes: Axes, curve: BlurCurve) -> None:
    unit, scale = ("pixels", curve.pitch) if curve.pitch else ("um", 1e-6)
    distance = _distances(curve)
    disc = blur_disc(curve.focal, curve.f_number, curve.focus, distance) / scale
    ends = f"{curve.near:.4g} m to {curve.far:.4g} m" if curve.far < inf else f"from {curve.near:.4g} m on"
    axes.axvspan(curve.near, min(curve.far, distance[-1]), color="tab:green", alpha=0.15, label=f"in focus, {ends}")
    axes.plot(distance, disc, color="tab:blue", label="blur disc")
    axes.axhline(curve.circle / scale, color=_LINE, lw=0.8, ls="--", label="circle of confusion")
    if curve.airy_diameter is not None:
        axes.axhline(curve.airy_diameter / scale, color="tab:red", lw=0.8, ls=":", label="Airy disc")
    if distance[-1] > _DECADE * distance[0]:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.set_xlim(distance[0], distance[-1])
    largest = max(curve.circle, curve.airy_diameter or 0) / scale
    axes.set_ylim(0, 1.35 * min(max(float(disc.max()), largest), 6 * largest))  # room for the legend
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    focus = f"{curve.focus:g} m" if curve.focus < inf else "infinity"
    title = f"{1e3 * curve.focal:.4g} mm, f/{curve.f_number:g}, focused at {focus}"
    _label(axes, title, "distance from the front principal plane, m", f"diameter on the sensor, {unit}")
    axes.legend(loc="upper right", framealpha=0.9)


def _distances(curve: BlurCurve) -> Array:
    """Return distances (N,) in m, up to well beyond the depth of field to both sides, the focus among them."""
    far = curve.far if curve.far < inf else 10 * curve.near
    margin = min(max(far / curve.near, 1.05) ** 2, 4.0)
    low = max(curve.near / margin, 1.05 * curve.focal)
    return np.unique([*np.geomspace(low, far * margin, 400), min(curve.focus, far * margin)])


def encoded(figure: Figure, suffix: str) -> bytes:
    """Return the file; it has no date."""
    undated = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}[suffix.lower()]
    stream = BytesIO()
    figure.savefig(stream, format=suffix.lower()[1:], dpi=_DPI, metadata=undated)
    return stream.getvalue()


def _draw_transfer(axes: Axes, sensor: Characterisation) -> None:
    gain = sensor.figures.gain_dn_per_e.value
    full = sensor.figures.full_well_e.value * gain
    noise = sensor.figures.read_noise_e.value * gain
    for name, curve in sensor.curves.items():
        std = np.sqrt(np.maximum(curve.variance, 0))
        fitted = curve.fitted & (std > 0)
        axes.loglog(curve.signal[fitted], std[fitted], _MARKERS[name], color=_COLOURS[name], label=name, ms=5)
        other = ~curve.fitted & (curve.signal > 0) & (std > 0)
        axes.loglog(curve.signal[other], std[other], _MARKERS[name], color=_COLOURS[name], mfc="none", ms=5)
    light = np.geomspace(noise**2 / gain / 5, full, 200)  # from where the read noise rules
    axes.loglog(light, np.sqrt(gain * light + noise**2), color=_LINE, lw=1, label=f"gain {gain:.4g} DN/e")
    axes.axhline(noise, color=_LINE, lw=0.8, ls=":", label=f"read noise {sensor.figures.read_noise_e.value:.3g} e")
    ends = "white level" if sensor.saturation == "not reached" else sensor.saturation
    axes.axvline(full, color=_LINE, lw=0.8, ls="--", label=f"{ends} {sensor.figures.full_well_e.value:.0f} e")
    axes.set_ylim(bottom=noise / 2)
    _label(axes, "photon transfer (open: not fitted)", "signal above black, DN", "noise of a pixel in time, DN")
    axes.legend(loc="upper left", framealpha=0.9)


def _draw_linearity(axes: Axes, sensor: Characterisation) -> None:
    for name, curve in sensor.curves.items():
        deviation = 100 * line_deviation(curve, _limit(sensor, name))
        used = np.isfinite(deviation)
        axes.plot(
            curve.signal[used], deviation[used], _MARKERS[name] + "-", color=_COLOURS[name], label=name, ms=5, lw=1
        )
    axes.axhline(0, color=_LINE, lw=0.8)
    largest = max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-max(largest, 0.1), max(largest, 0.1))
    _label(
        axes, "linearity, 5 to 95 % of saturation", "signal above black, DN", "deviation from a line over exposure, %"
    )
    axes.legend()


def _draw_ratio(axes: Axes, sensor: Characterisation) -> None:
    gain = sensor.figures.gain_dn_per_e.value
    for name, curve in sensor.curves.items():
        seen = (curve.signal > 0) & curve.complete & (curve.variance > 0)
        ratio = curve.signal[seen] / np.sqrt(curve.variance[seen])
        axes.loglog(curve.signal[seen] / gain, ratio, _MARKERS[name], color=_COLOURS[name], label=name, ms=5)
    light = np.geomspace(1, sensor.figures.full_well_e.value, 200)
    noise = sensor.figures.read_noise_e.value
    axes.loglog(light, light / np.sqrt(light + noise**2), color=_LINE, lw=1, label="from gain and read noise")
    _label(axes, "signal-to-noise ratio", "signal, electrons", "ratio")
    axes.legend()


def _limit(sensor: Characterisation, name: str) -> float:
    """Return the counts above black at which a phase ends."""
    figures = sensor.phases[name]
    return figures.full_well_e.value * figures.gain_dn_per_e.value


def _label(axes: Axes, title: str, across: str, up: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(visible=True, which="major", lw=0.4, alpha=0.6)


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
        across, label = _draw_fitted(upper, fit)
        upper.set_title(fit.curve.name)
        _draw_residuals(lower, fit, across, label)
        if fit.data.target is not None:
            lower.set_xlim(upper.get_xlim())
        if fit.outliers.any():
            upper.legend()
        return encoded(figure, suffix)


def _draw_fitted(axes: Axes, fit: CurveFit) -> tuple[Array, str]:
    """Draw the data with their curve; return what the residuals are to be drawn over, and its name."""
    columns, target = fit.data.columns, fit.data.target
    if target is not None and len(columns) == 1:
        (name, x), *_ = columns.items()
        _draw_curve(axes, fit, name, x, target)
        return x, name
    if target is not None:
        predicted = target + fit.residuals[:, 0]
        _draw_points(axes, fit, predicted, target)
        axes.axline((float(target[0]), float(target[0])), slope=1, color=_CURVE, lw=1)
        axes.set_ylabel("measured")
        return predicted, "predicted"
    rows = np.arange(len(fit.data)) + 1.0
    if len(columns) == 2:
        _draw_shape(axes, fit)
    else:
        _draw_points(axes, fit, rows, np.linalg.norm(fit.residuals, axis=1))
        axes.set_ylabel("distance")
    return rows, "row"


def _draw_curve(axes: Axes, fit: CurveFit, name: str, x: Array, target: Array) -> None:
    sigma = fit.data.sigma
    _draw_points(axes, fit, x, target)
    if sigma is not None:
        axes.errorbar(x, target, sigma, fmt="none", ecolor=_POINTS, elinewidth=0.7)
    fine = _spanned(x)
    curve = predictions(fit.curve, {name: fine}, fit.values, len(fine))[:, 0]
    axes.plot(fine, np.where(np.isfinite(curve), curve, np.nan), color=_CURVE, lw=1.2)
    axes.set_ylabel("measured and fitted")


def _draw_shape(axes: Axes, fit: CurveFit) -> None:
    """Draw points in a plane, and the shape as the line on which the distance is zero."""
    (first, x), (second, y) = fit.data.columns.items()
    _draw_points(axes, fit, x, y)
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
        _draw_points(axes, fit, across, component)
    axes.axhline(0, color=_CURVE, lw=1)
    axes.set_xlabel(label)
    axes.set_ylabel("measured - fitted" if fit.data.target is not None else "distance")


def _draw_points(axes: Axes, fit: CurveFit, x: Array, y: Array) -> None:
    """Draw points; those that a robust loss leaves less than half of their weight are open."""
    ignored = fit.outliers
    axes.plot(x[~ignored], y[~ignored], "o", ms=3.5, color=_POINTS, label="measured")
    axes.plot(x[ignored], y[ignored], "o", ms=4, mfc="none", color=_OUTLIERS, label="less than half of its weight")


def _spanned(values: Array) -> Array:
    """Return a fine scale over the range of values and a little beyond."""
    margin = _MARGIN * (float(np.ptp(values)) or 1.0)
    return np.linspace(values.min() - margin, values.max() + margin, _FINE)
