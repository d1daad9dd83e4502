"""The figures of simulated sensors against what they were made of.

benchmarks/sensor.py does this for many sensors; here are the corners of the method. Not proven: that a real sensor
behaves like these.
"""

import numpy as np
import pytest

from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.emva import FULL_WELL, NOT_REACHED, WHITE_LEVEL, characterise
from camcal.raw.level import measure_level
from camcal.raw.mosaic import Mosaic
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series
from camcal.simulate.options import Sensor

SENSOR = Sensor(0.3, 4.0, 12000.0, 100.0, 12, dark_current_e_s=40.0, prnu=0.01, dsnu_e=2.0)
SIZE = (240, 180)
SIGMAS = 4.0  # of the uncertainty that comes with a figure


class Bench:
    """A sensor in front of an even light."""

    def __init__(self, sensor=SENSOR, pattern="RGGB", light=(0.5, 1.0, 0.6), seed=0):
        self.raw = RawCamera(pattern, sensor, light)
        self.rng = np.random.default_rng(seed)
        self.fixed = FixedPattern.of(sensor, SIZE, self.rng)

    def level(self, shot, count=2, exposure_s="known", change=1.0):
        shots = [shot, *[shot._replace(share=change * shot.share)] * (count - 1)]
        frames = [even_frame(self.raw, one, 0.1, fixed=self.fixed, rng=self.rng) for one in shots]
        mosaics = (Mosaic(frame, self.raw.pattern, np.zeros((2, 2)), self.raw.sensor.white_dn) for frame in frames)
        return measure_level(mosaics, shot.exposure_s if exposure_s == "known" else exposure_s)

    def flats(self, levels=10):
        return [self.level(shot) for shot in exposure_series(self.raw, levels, 0.1)]

    def darks(self, *exposures, count=8):
        return [self.level(Shot(exposure, 0.0), count) for exposure in exposures or (0.001,)]


@pytest.fixture(scope="module")
def found():
    bench = Bench()
    return characterise(bench.flats(12), bench.darks(0.001, 0.5))


@pytest.mark.parametrize(
    ("name", "true", "within"),
    [
        ("gain_dn_per_e", 0.3, 0.01),
        ("read_noise_e", 4.0, 0.03),
        ("full_well_e", 12000.0, 0.02),
        ("dynamic_range_db", 20 * np.log10(3000), 0.004),
        ("snr_max_db", 10 * np.log10(12000), 0.002),
        ("threshold_e", np.sqrt(16 + 1 / 12 / 0.09 + 0.25) + 0.5, 0.03),
        ("black_dn", 100.0, 0.001),
        ("dsnu_e", 2.0, 0.05),
        ("prnu", 0.01, 0.05),
        ("dark_current_e_s", 40.0, 0.02),
    ],
)
def test_a_figure_is_the_truth_within_its_uncertainty(found, name, true, within):
    for figures in (found.figures, *found.phases.values()):
        figure = getattr(figures, name)
        # the dark current of 1 ms, 0.04 electrons, is in the black level and the noise of the shortest dark frames
        assert figure.value == pytest.approx(true, abs=SIGMAS * figure.std + 0.0005 * true)
    assert getattr(found.figures, name).std < within / 2 * true


def test_a_linear_sensor_is_found_linear(found):
    assert found.figures.linearity_error.value < 0.001


def test_a_sensor_that_bends_is_found_so():
    levels = []
    bench = Bench(light=(1.0, 1.0, 1.0))
    for shot in exposure_series(bench.raw, 10, 0.0):
        bent = shot._replace(share=shot.share * (1 - 0.1 * min(shot.share, 1.0)))
        levels.append(bench.level(bent))
    error = characterise(levels, bench.darks()).figures.linearity_error.value
    assert 0.005 < error < 0.03  # a bow of 10 % at full scale, less the line that fits it best


def test_full_pixels_and_the_white_level_are_told_apart(found):
    assert found.saturation == FULL_WELL
    bench = Bench(Sensor(1.0, 4.0, 12000.0, 100.0, 12))
    other = characterise(bench.flats(), bench.darks())
    assert other.saturation == WHITE_LEVEL
    assert other.figures.full_well_e.value == pytest.approx(3995, rel=0.005)


def test_two_flat_and_two_dark_frames_are_enough_for_an_answer():
    bench = Bench(light=(1.0, 1.0, 1.0))
    found = characterise([bench.level(Shot(0.05, 0.5))], bench.darks(count=2))
    assert found.figures.gain_dn_per_e.value == pytest.approx(0.3, rel=0.02)  # 43 200 differences: 0.7 %, three times
    assert found.figures.read_noise_e.value == pytest.approx(4.0, rel=0.02)
    assert found.figures.full_well_e.value == pytest.approx((4095 - 100) / 0.3, rel=0.02)
    assert (found.saturation, found.figures.linearity_error) == (NOT_REACHED, None)
    assert any(warning.code == "saturation_not_reached" for warning in found.warnings)


def test_unknown_exposures_leave_linearity_and_dark_current_open():
    bench = Bench()
    flats = [bench.level(shot, exposure_s=None) for shot in exposure_series(bench.raw, 6, 0.1)]
    found = characterise(flats, [bench.level(Shot(0.001, 0.0), 8, exposure_s=None)])
    assert (found.figures.linearity_error, found.figures.dark_current_e_s) == (None, None)
    assert found.figures.gain_dn_per_e.value == pytest.approx(0.3, rel=0.01)


def test_a_sensor_without_filters_has_one_phase():
    bench = Bench(pattern="MONO", light=(1.0, 1.0, 1.0))
    found = characterise(bench.flats(6), bench.darks())
    assert list(found.phases) == ["mono"]
    assert found.figures.gain_dn_per_e.value == pytest.approx(0.3, rel=0.01)


def test_noise_hidden_by_rounding_is_said_to_be():
    bench = Bench(Sensor(0.1, 4.0, 20000.0, 64.0, 12))  # 0.4 counts
    found = characterise(bench.flats(8), bench.darks())
    assert found.limited
    assert any(warning.code == "quantisation_limited" for warning in found.warnings)
    assert found.figures.read_noise_e.value == pytest.approx(4.0, rel=0.03)


def test_dark_frames_cut_off_at_zero_are_seen_through_and_warned_of():
    bench = Bench(Sensor(0.5, 5.0, 6000.0, 1.0, 12, dsnu_e=2.0))
    found = characterise(bench.flats(8), bench.darks())
    assert any(warning.code == "dark_clipped" for warning in found.warnings)
    assert found.figures.read_noise_e.value == pytest.approx(5.0, rel=0.03)
    assert found.figures.gain_dn_per_e.value == pytest.approx(0.5, rel=0.01)


def test_light_that_changes_is_warned_of_and_mixed_exposures_are_refused():
    bench = Bench(light=(1.0, 1.0, 1.0))
    darks = bench.darks()
    shot = Shot(0.05, 0.5)
    flicker = characterise([bench.level(shot, change=1.04)], darks)
    assert any("changed by 3.9 %" in warning.text for warning in flicker.warnings)
    assert flicker.figures.gain_dn_per_e.value == pytest.approx(0.3, rel=0.02)
    with pytest.raises(InsufficientData, match=r"50 ms.*mixed"):
        characterise([bench.level(shot, change=1.5)], darks)


def test_gains_that_differ_between_phases_are_warned_of():
    bench = Bench(light=(1.0, 1.0, 1.0))

    def scaled(level):
        factor = np.array([1.3, 1, 1, 1])
        means, variances = level.frame_means * factor, level.temporal * factor**2
        return type(level)(**{**vars(level), "mean_dn": level.mean_dn * factor, "frame_means": means,
                              "temporal": variances})  # fmt: skip

    found = characterise([scaled(level) for level in bench.flats(6)], [scaled(level) for level in bench.darks()])
    assert any("gains of R and Gr differ" in warning.text for warning in found.warnings)


def test_saturated_flats_are_refused():
    bench = Bench(light=(1.0, 1.0, 1.0))
    with pytest.raises(InsufficientData, match="does not increase"):  # full pixels: below white, without photon noise
        characterise([bench.level(Shot(1.0, 3.0))], bench.darks())
    white = Bench(Sensor(1.0, 4.0, 12000.0, 100.0, 12), light=(1.0, 1.0, 1.0))
    with pytest.raises(InsufficientData, match="no flat frame between darkness and saturation"):
        characterise([white.level(Shot(1.0, 3.0))], white.darks())


def test_flats_without_light_are_refused():
    bench = Bench()
    with pytest.raises(InsufficientData):
        characterise(bench.darks(0.002), bench.darks(0.001))


def test_missing_and_unlike_levels_are_refused():
    bench = Bench()
    darks = bench.darks()
    with pytest.raises(InsufficientData, match="no flat frames"):
        characterise([], darks)
    with pytest.raises(InsufficientData, match="no dark frames"):
        characterise([bench.level(Shot(0.05, 0.5))], [])
    other = Bench(pattern="BGGR")
    with pytest.raises(InvalidInput, match="must be alike"):
        characterise([other.level(Shot(0.05, 0.5))], darks)
