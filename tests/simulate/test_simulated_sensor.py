"""The simulated sensor: mean, variance and ends of its counts; colours seen through lenses of their own."""

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.raw.mosaic import sites
from camcal.simulate.mosaics import (
    FixedPattern,
    RawCamera,
    Shot,
    even_frame,
    expose,
    exposure_series,
    filter_mosaic,
    lenses,
    photograph,
)
from camcal.simulate.options import Sensor
from camcal.simulate.render import FLAT, Exposure, evenly_lit
from camcal.simulate.scene import make_camera
from camcal.targets.board import parse_board

SIZE = (320, 240)
EVEN = FixedPattern(np.ones((240, 320)), np.zeros((240, 320)))


def counts(sensor, light_e, exposure_s=0.01, fixed=EVEN):
    return expose(sensor, np.full((240, 320), float(light_e)), exposure_s, fixed, np.random.default_rng(1)).astype(
        float
    )


def test_counts_have_the_mean_and_variance_of_photons_and_reading():
    sensor = Sensor(0.5, 6.0, 20000.0, 100.0, 14, dark_current_e_s=500.0)
    values = counts(sensor, 2000, exposure_s=2.0)
    electrons = 2000 + 2.0 * 500
    variance = 0.5**2 * (electrons + 6.0**2) + 1 / 12
    assert values.mean() == pytest.approx(100 + 0.5 * electrons, abs=4 * np.sqrt(variance / values.size))
    assert values.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / values.size))


def test_a_full_pixel_and_the_white_level_end_the_counts():
    assert counts(Sensor(0.5, 0.0, 6000.0, 100.0, 14), 1e5).max() == 3100
    assert counts(Sensor(0.5, 0.0, 60000.0, 100.0, 12), 1e5).max() == 4095
    assert Sensor(0.5, 0.0, 6000.0, 100.0, 14).saturation_e == 6000
    assert Sensor(0.5, 0.0, 60000.0, 95.0, 12).saturation_e == 8000


def test_the_fixed_pattern_stays_from_frame_to_frame():
    sensor = Sensor(0.5, 1.0, 60000.0, 100.0, 16, prnu=0.05, dsnu_e=10.0)
    fixed = FixedPattern.of(sensor, SIZE, np.random.default_rng(2))
    rng = np.random.default_rng(3)
    one, other = (expose(sensor, np.full((240, 320), 1e4), 0.01, fixed, rng).astype(float) for _ in range(2))
    expected = 0.25 * ((0.05 * 1e4) ** 2 + 10**2)
    assert np.cov(one.ravel(), other.ravel())[0, 1] == pytest.approx(expected, rel=0.03)  # 76 800 pixels: 0.5 %


@pytest.mark.parametrize(
    "wrong",
    [
        {"gain_dn_per_e": 0.0},
        {"gain_dn_per_e": np.nan},
        {"read_noise_e": -1.0},
        {"full_well_e": np.inf},
        {"black_dn": 5000.0},
        {"bits": 17},
        {"prnu": -0.1},
    ],
)
def test_a_sensor_that_cannot_be_is_refused(wrong):
    with pytest.raises(InvalidInput):
        Sensor(**wrong)


@pytest.mark.parametrize("model", [own for own in MODELS.values() if own.is_central], ids=lambda own: own.name)
def test_aberration_moves_red_out_and_blue_in_by_its_pixels_at_the_furthest_corner(model):
    camera = make_camera(model, (1280, 960), np.radians(70))
    views = lenses(camera, 0.5)
    corner = [0.0, 959.0]  # the principal point is right of the middle and above it
    rays = camera.unproject(np.array([corner, [camera.value("cx"), camera.value("cy")]])).directions
    green, red, blue = (views[colour].project(rays).pixels for colour in "GRB")
    outward = (green[0] - green[1]) / np.linalg.norm(green[0] - green[1])
    assert (red - green)[0] == pytest.approx(0.5 * outward, abs=1e-6)  # of the unprojection
    assert (blue - green)[0] == pytest.approx(-0.5 * outward, abs=1e-6)
    assert (red - green)[1] == pytest.approx([0, 0], abs=1e-9)


def test_without_aberration_all_colours_have_one_lens():
    camera = make_camera(MODELS["opencv5"], SIZE, np.radians(70))
    assert set(lenses(camera, 0.0).values()) == {camera}


def test_a_mosaic_takes_every_sample_from_its_colour():
    images = {colour: np.full((4, 6), value) for value, colour in enumerate("RGB")}
    assert filter_mosaic("GBRG", images)[:2, :2].tolist() == [[1, 2], [0, 1]]
    assert filter_mosaic("BGGR", images)[2:, 4:].tolist() == [[2, 1], [1, 0]]


def test_every_colour_of_a_photograph_is_rendered_through_its_own_lens():
    clear = Sensor(5e-4, 0.0, 1e8, 100.0, 16)  # so many electrons that their noise is 5 counts of 50 000
    raw = RawCamera("GRBG", clear, (0.5, 1.0, 0.6), aberration_px=3.0)
    camera = make_camera(MODELS["opencv5"], SIZE, np.radians(70))
    board, pose = parse_board("chessboard:9x6:25mm"), Pose(np.eye(3), np.array([-0.1, -0.06, 0.3]))
    exposure = Exposure(gradient=0.0, vignetting=0.0)
    frame = photograph(
        raw, camera, board, pose, exposure=exposure, shape=FLAT, fixed=EVEN, rng=np.random.default_rng(0)
    )
    for colour, share in zip("RGB", raw.light, strict=True):
        seen = evenly_lit(lenses(camera, 3.0)[colour], board, pose, exposure)
        for site in sites("GRBG", colour):
            expected = 100 + share * 5e4 * seen[site]
            assert np.abs(frame[site] - expected).max() < 30  # six deviations
    other = evenly_lit(camera, board, pose, exposure)
    assert np.abs(frame[sites("GRBG", "R")[0]] - 100 - 2.5e4 * other[sites("GRBG", "R")[0]]).max() > 1000


def test_flat_frames_fall_off_towards_the_corners_and_dark_ones_do_not():
    raw = RawCamera("MONO", Sensor(0.25, 0.0, 15000.0, 64.0, 12))
    rng = np.random.default_rng(0)
    flat, dark = (even_frame(raw, Shot(0.05, share), 0.3, fixed=EVEN, rng=rng).astype(float) for share in (0.5, 0.0))
    assert (flat[:8, :8].mean() - 64) / (flat[116:124, 156:164].mean() - 64) == pytest.approx(0.72, abs=0.03)
    assert (dark == 64).all()


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_short_ladder_stays_below_saturation(levels):
    shots = exposure_series(RawCamera("RGGB"), levels, 0.1)
    assert len(shots) == levels
    assert all(0 < shot.share <= 0.6 for shot in shots)


def test_a_ladder_ends_where_the_weakest_colour_is_full_in_the_corners():
    shots = exposure_series(RawCamera("RGGB", light=(0.5, 1.0, 0.6)), 12, 0.2)
    assert shots[-1].share * 0.5 * 0.8 > 1.2
    assert [shot.share for shot in shots] == sorted(shot.share for shot in shots)
    assert all(shot.share == pytest.approx(shot.exposure_s / 0.1) for shot in shots)


def test_colours_of_a_sensor_without_filters_are_refused():
    with pytest.raises(InvalidInput, match="without colour filters"):
        RawCamera("MONO", aberration_px=1.0)
    with pytest.raises(InvalidInput, match="must be positive"):
        RawCamera("RGGB", light=(0.0, 1.0, 1.0))
