"""Numbers of a table over time, smoothed by `camcal smooth`."""

from dataclasses import replace

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.series import Series, SeriesOptions, SmoothedSeries, series_at, smooth_series
from camcal.formats import series as tables
from camcal.report.over_time import Panel, over_time
from camcal.tasks.poses.smooth_options import SmoothOptions
from camcal.tasks.poses.smoothing import Outlier, Smoothing, wanted_stamps


def smooth_table(options: SmoothOptions) -> Smoothing:
    """Return what came of smoothing the columns of a table, everything asked for written."""
    if options.reference is not None or options.kind is not None or options.frames is not None:
        raise InvalidInput("--evaluate, --format and --frames go with poses, not with a table of other numbers")
    if options.output is not None:
        tables.require_suffix(options.output)
    series = _read(options)
    grid = wanted_stamps(options, series.stamps)
    q = None if options.q is None else _single("--q", options.q)
    smoothed = smooth_series(series, SeriesOptions(options.motion, q, options.method, options.robust != "none"))
    shown = smoothed if grid is None else series_at(smoothed, grid)
    if options.output is not None:
        tables.write(options.output, shown)
    if options.plot is not None:
        files.write_bytes(options.plot, over_time(_panels(smoothed, shown), options.plot.suffix))
    return _smoothing(options, smoothed, shown)


def _read(options: SmoothOptions) -> Series:
    series = tables.read(options.source, options.columns)
    if options.sigma is not None:
        sigma = np.array(options.sigma)
        if len(sigma) not in (1, len(series.names)):
            raise InvalidInput(f"--sigma has {len(sigma)} numbers; one, or one for each of {', '.join(series.names)}")
        series = replace(series, sigma=np.broadcast_to(sigma, series.values.shape))
    if options.controls is not None:
        series = replace(series, controls=tables.read_controls(options.controls, series))
    return series


def _smoothing(options: SmoothOptions, smoothed: SmoothedSeries, shown: SmoothedSeries) -> Smoothing:
    series = smoothed.series
    off = series.values - smoothed.states[:, :, 0]
    outliers = [
        Outlier(int(row), float(series.stamps[row]), series.names[axis]) for row, axis in np.argwhere(smoothed.outliers)
    ]
    return Smoothing(
        options,
        "series",
        measured=int(np.isfinite(series.values).sum()),
        missing=int(np.isnan(series.values).sum()),
        stamps=shown.series.stamps,
        q={"all": smoothed.q},
        sigma=_sigma(options, smoothed),
        residual={name: _rms(off[:, axis]) for axis, name in enumerate(series.names)},
        log_likelihood=smoothed.log_likelihood,
        consistency=smoothed.consistency,
        nis=dict(zip(series.names, smoothed.nis.T, strict=True)),
        outliers=tuple(outliers),
        written=tuple(path for path in (options.output, options.plot) if path is not None),
    )


def _sigma(options: SmoothOptions, smoothed: SmoothedSeries) -> dict[str, float]:
    """Return the standard deviation of measurements by column, empty if the table has one for each."""
    if smoothed.sigma is not None:
        return {"all": smoothed.sigma}
    if options.sigma is None:
        return {}
    return dict(zip(smoothed.series.names, np.resize(options.sigma, len(smoothed.series.names)).tolist(), strict=True))


def _panels(measured: SmoothedSeries, shown: SmoothedSeries) -> list[Panel]:
    return [
        Panel(
            name,
            (shown.series.stamps, shown.states[:, axis, 0], np.sqrt(shown.covariances[:, axis, 0, 0])),
            (measured.series.stamps, measured.series.values[:, axis]),
            measured.outliers[:, axis],
        )
        for axis, name in enumerate(measured.series.names)
    ]


def _single(option: str, numbers: tuple[float, ...]) -> float:
    if len(numbers) != 1:
        raise InvalidInput(f"{option} has {len(numbers)} numbers; a table has one")
    return numbers[0]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
