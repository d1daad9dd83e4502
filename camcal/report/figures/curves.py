"""Figures of a fitted curve, and of a sensor: photon transfer, linearity, signal-to-noise ratio."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.curves.curve import CurveFit, predictions
from camcal.messages import counted
from camcal.raw.emva import Characterisation, line_deviation
from camcal.report.figures.figure import WIDTH, Plot, Theme, beside, logarithmic_labels

_FINE = 400
_MARGIN = 0.03  # of the range, beyond the data

_SERIES = {"R": 1, "Gr": 2, "Gb": 3, "B": 0, "mono": 0}  # colours of a theme
_MARKERS = {"R": "o", "Gr": "^", "Gb": "v", "B": "s", "mono": "o"}
PHASES = tuple(_SERIES)
_SIZE = (WIDTH, 4.0)
_HEADROOM = 8.0  # times the largest value of a logarithmic axis: room for the legend


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


@dataclass(frozen=True, eq=False)
class TransferCurve:
    """Signal (L,), counts, and variance (L,), counts², of a phase, and the mask (L,) of levels that were fitted."""

    signal: Array
    variance: Array
    fitted: Array


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """The curves of a sensor's phases, and the figures that they give. saturation: what ends the counts."""

    gain_dn_per_e: float
    read_noise_e: float
    full_well_e: float
    saturation: str
    curves: Mapping[str, TransferCurve]

    @classmethod
    def of(cls, sensor: Characterisation) -> "PhotonTransfer":
        """Return the photon transfer of a sensor."""
        found = sensor.figures
        return cls(
            found.gain_dn_per_e.value,
            found.read_noise_e.value,
            found.full_well_e.value,
            sensor.saturation,
            {name: TransferCurve(own.signal, own.variance, own.fitted) for name, own in sensor.curves.items()},
        )

    @property
    def ends(self) -> str:
        """What ends the counts, in words."""
        return "white level" if self.saturation == "not reached" else self.saturation


def sensor_plots(sensor: Characterisation) -> tuple[Plot, ...]:
    """Return photon transfer, signal-to-noise ratio and, where exposures are known, linearity of a sensor."""
    known, transfer = sensor.figures.linearity_error is not None, PhotonTransfer.of(sensor)
    return photon_transfer(transfer), signal_to_noise(transfer), *((linearity(sensor),) if known else ())


def characterisation(sensor: Characterisation) -> Plot:
    """Return the photon transfer of a sensor beside its linearity, or its signal-to-noise ratio without exposures."""
    transfer, ratio, *line = sensor_plots(sensor)
    return beside("sensor", "Sensor", (transfer, line[0] if line else ratio))


def photon_transfer(sensor: PhotonTransfer) -> Plot:
    """Return the noise over light with the line through the levels that count, and where pixels are full."""
    gain, read, full, ends = sensor.gain_dn_per_e, sensor.read_noise_e, sensor.full_well_e, sensor.ends
    noise = read * gain
    numbers = f"gain {gain:.4g} DN/e, read noise {read:.3g} e, {ends} {full:.0f} e"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        for name, curve in sensor.curves.items():
            std, colour = np.sqrt(np.maximum(curve.variance, 0)), theme.series[_SERIES[name]]
            fitted = curve.fitted & (std > 0)
            axes.loglog(curve.signal[fitted], std[fitted], _MARKERS[name], color=colour, label=name, ms=5)
            other = ~curve.fitted & (curve.signal > 0) & (std > 0)
            axes.loglog(curve.signal[other], std[other], _MARKERS[name], color=colour, mfc="none", ms=5)
        light = np.geomspace(noise**2 / gain / 5, full * gain, 200)  # from where the read noise rules
        axes.loglog(light, np.sqrt(gain * light + noise**2), color=theme.ink, lw=1, label="fit")
        axes.axhline(noise, color=theme.ink, lw=0.8, ls=":", label="read noise")
        axes.axvline(full * gain, color=theme.ink, lw=0.8, ls="--", label=ends)
        axes.set_ylim(noise / 2, _HEADROOM * axes.get_ylim()[1])
        _label(axes, "signal above black, DN", "temporal noise, DN")
        axes.legend(loc="upper left", ncols=3, columnspacing=0.8, handletextpad=0.4)

    return Plot(
        "photon_transfer",
        "Photon transfer",
        f"Temporal noise of a pixel over its signal, both in counts: {numbers}. Open marks are not fitted.",
        f"Noise over signal on logarithmic axes with the fitted curve: {numbers}.",
        draw,
        _SIZE,
    )


def linearity(sensor: Characterisation) -> Plot:
    """Return the deviation of the light from a line over exposure."""
    error = sensor.figures.linearity_error
    words = "" if error is None else f"; linearity error {100 * error.value:.2g} %"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        for name, curve in sensor.curves.items():
            deviation = 100 * line_deviation(curve, _limit(sensor, name))
            used = np.isfinite(deviation)
            mark, colour = f"{_MARKERS[name]}-", theme.series[_SERIES[name]]
            axes.plot(curve.signal[used], deviation[used], mark, color=colour, label=name, ms=5, lw=1)
        axes.axhline(0, color=theme.ink, lw=0.8)
        largest = max(*map(abs, axes.get_ylim()), 0.1)
        axes.set_ylim(-largest, 1.3 * largest)
        _label(axes, "signal above black, DN", "deviation from a line, %")
        axes.legend(loc="upper center", ncols=4)

    return Plot(
        "linearity",
        "Linearity",
        f"Deviation of the signal from a line over exposure, in percent, for 5 to 95 % of saturation{words}.",
        f"Deviation from linearity over the signal{words}.",
        draw,
        _SIZE,
    )


def signal_to_noise(sensor: PhotonTransfer) -> Plot:
    """Return the signal-to-noise ratio over the signal."""
    gain, read, full = sensor.gain_dn_per_e, sensor.read_noise_e, sensor.full_well_e
    best = full / float(np.sqrt(full + read**2))

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        for name, curve in sensor.curves.items():
            seen = (curve.signal > 0) & (curve.signal < full * gain) & (curve.variance > 0)
            ratio, colour = curve.signal[seen] / np.sqrt(curve.variance[seen]), theme.series[_SERIES[name]]
            axes.loglog(curve.signal[seen] / gain, ratio, _MARKERS[name], color=colour, label=name, ms=5)
        light = np.geomspace(1, full, 200)
        axes.loglog(light, light / np.sqrt(light + read**2), color=theme.ink, lw=1, label="from gain and read noise")
        axes.set_ylim(top=_HEADROOM * axes.get_ylim()[1])
        _label(axes, "signal, electrons", "signal-to-noise ratio, 1")
        axes.legend(loc="upper left", ncols=3, columnspacing=0.8, handletextpad=0.4)

    return Plot(
        "signal_to_noise",
        "Signal-to-noise ratio",
        f"Signal-to-noise ratio of a pixel over its signal in electrons; {best:.3g} (a ratio) at {full:.0f} e.",
        f"Signal-to-noise ratio on logarithmic axes, up to {best:.3g}.",
        draw,
        _SIZE,
    )


def _limit(sensor: Characterisation, name: str) -> float:
    """Return the counts above black at which a phase ends."""
    figures = sensor.phases[name]
    return figures.full_well_e.value * figures.gain_dn_per_e.value


def _label(axes: Axes, across: str, up: str) -> None:
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            logarithmic_labels(axis)
    axes.grid(visible=True, which="major")
