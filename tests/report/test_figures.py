"""The figure of a sensor: a file of its kind, the same bytes every time. How it looks is for eyes."""

from functools import cache

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw.level import measure_level
from camcal.raw.mosaic import Mosaic
from camcal.raw.sensor import characterise
from camcal.report.figures.sensor import photon_transfer, require_suffix
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


@cache
def drawn(suffix, known_exposures=True):
    return photon_transfer(measured(known_exposures), suffix)


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_a_figure_is_a_file_of_its_kind(suffix, start):
    assert drawn(suffix).startswith(start)


def test_the_same_figure_is_the_same_file():
    assert photon_transfer(measured(), ".svg") == drawn(".svg")


@pytest.mark.slow
def test_without_exposures_another_figure_stands_in_for_linearity():
    with_line, without = (drawn(".svg", known).decode() for known in (True, False))
    assert ("linearity" in with_line, "signal-to-noise" in with_line) == (True, False)
    assert ("linearity" in without, "signal-to-noise" in without) == (False, True)


def test_a_figure_has_the_size_of_a_page_and_something_on_it():
    image = cv2.imdecode(np.frombuffer(drawn(".png"), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[:2] == (528, 1200)
    reds = (image[..., 2] > 200) & (image[..., 1] < 60) & (image[..., 0] < 60)
    assert reds.sum() > 50  # the red phase's marks


def test_other_types_of_file_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="figures are"):
        require_suffix(tmp_path / "plot.jpg")
