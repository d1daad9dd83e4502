"""Figures of a sensor: what they show; a file of its kind, the same bytes every time."""

from functools import cache

import numpy as np
import pytest
from drawn_figures import require_readable

from camcal.errors import InvalidInput
from camcal.raw.emva import characterise
from camcal.raw.level import measure_level
from camcal.raw.mosaic import Mosaic
from camcal.report.figures.curves import characterisation, sensor_plots
from camcal.report.figures.figure import encoded, require_suffix
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series
from camcal.simulate.options import Sensor


@cache
def measured(known_exposures=True):
    raw, rng = RawCamera("RGGB", Sensor()), np.random.default_rng(0)
    fixed = FixedPattern.of(raw.sensor, (80, 60), rng)

    def level(shot):
        frames = [even_frame(raw, shot, 0.1, fixed=fixed, rng=rng) for _ in range(2)]
        mosaics = (Mosaic(frame, "RGGB", np.zeros((2, 2)), 4095.0) for frame in frames)
        return measure_level(mosaics, shot.exposure_s if known_exposures else None)

    return characterise([level(shot) for shot in exposure_series(raw, 8, 0.1)], [level(Shot(0.01, 0.0))])


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_a_figure_is_a_file_of_its_kind(suffix, start):
    assert encoded(characterisation(measured()), suffix).startswith(start)


def test_the_same_figure_is_the_same_file():
    first, second = (encoded(characterisation(measured()), ".svg") for _ in range(2))
    assert first == second


@pytest.mark.slow
def test_without_exposures_another_figure_stands_in_for_linearity():
    with_line, without = (encoded(characterisation(measured(known)), ".svg").decode() for known in (True, False))
    assert ("Linearity" in with_line, "Signal-to-noise" in with_line) == (True, False)
    assert ("Linearity" in without, "Signal-to-noise" in without) == (False, True)


def test_the_figures_of_a_sensor_are_readable_and_show_every_phase():
    plots = sensor_plots(measured())
    assert [plot.name for plot in plots] == ["photon_transfer", "signal_to_noise", "linearity"]
    for plot in plots:
        figure = require_readable(plot)
        labels = figure.axes[0].get_legend_handles_labels()[1]
        assert {"R", "Gr", "Gb", "B"} <= set(labels)


def test_the_transfer_curve_goes_through_the_levels_that_are_fitted():
    sensor = measured()
    curve = sensor.curves["R"]
    figure = require_readable(sensor_plots(sensor)[0])
    points = next(line for line in figure.axes[0].lines if line.get_label() == "R").get_xydata()
    assert points == pytest.approx(np.column_stack([curve.signal[curve.fitted], np.sqrt(curve.variance[curve.fitted])]))


def test_other_types_of_file_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="figures are"):
        require_suffix(tmp_path / "plot.jpg")
