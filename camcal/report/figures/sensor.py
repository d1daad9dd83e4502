"""Figures of a sensor: photon transfer, linearity, signal-to-noise ratio."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from camcal.arrays import Array
from camcal.raw.emva import Characterisation, line_deviation
from camcal.report.figures.figure import WIDTH, Plot, Theme, beside, logarithmic_labels

_SERIES = {"R": 1, "Gr": 2, "Gb": 3, "B": 0, "mono": 0}  # colours of a theme
_MARKERS = {"R": "o", "Gr": "^", "Gb": "v", "B": "s", "mono": "o"}
PHASES = tuple(_SERIES)
_SIZE = (WIDTH, 4.0)
_HEADROOM = 8.0  # times the largest value of a logarithmic axis: room for the legend


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
