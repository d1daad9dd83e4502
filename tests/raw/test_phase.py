"""The diagonal of green told from synthetic mosaics; photographs are in tests/real."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.raw.frame_facts import check_phase, green_diagonal
from camcal.raw.mosaic import Mosaic

DARK = np.zeros((2, 2))
HEIGHT, WIDTH = 240, 360
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)

X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"


def sampled(scene, pattern="RGGB", gains=(1, 1, 1)):
    """Return the mosaic of a scene (H, W, 3) red, green, blue, or of a gray one (H, W)."""
    colours = np.broadcast_to(scene[..., None] if scene.ndim == 2 else scene, (*scene.shape[:2], 3))
    values = np.empty(scene.shape[:2], np.float32)
    for place, letter in enumerate(pattern):
        site = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        channel = "RGB".index(letter)
        values[site] = colours[site][..., channel] * gains[channel]
    return values


def coloured_patches(rng):
    return np.kron(rng.uniform(0.1, 0.9, (8, 12, 3)), np.ones((30, 30, 1)))


def chessboard(side=31.7, turned=0.0):
    across = np.cos(turned) * COLUMNS + np.sin(turned) * ROWS
    down = np.cos(turned) * ROWS - np.sin(turned) * COLUMNS
    return 0.5 + 0.4 * np.sign(np.sin(np.pi * across / side) * np.sin(np.pi * down / side))


def ramp(down, across):
    scene = down * ROWS + across * COLUMNS
    return (scene - scene.min()) / np.ptp(scene)


GRAY_SCENES = {
    "flat": np.full((HEIGHT, WIDTH), 0.4),
    "ramp across": ramp(0, 1),
    "ramp down": ramp(1, 0),
    "ramp along the diagonal": ramp(1, 1),
    "ramp along the other diagonal": ramp(1, -1),
    "chessboard": chessboard(),
    "turned chessboard": chessboard(9.3, 0.7),
    "stripes along the diagonal": 0.5 + 0.4 * np.sign(np.sin((ROWS + COLUMNS) * 1.3)),
    "single pixels": np.random.default_rng(3).random((HEIGHT, WIDTH)),
}
GAINS = {"balanced": (1, 1, 1), "unbalanced": (0.5, 1, 0.6), "red and blue alike": (0.5, 1, 0.5)}


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("gains", GAINS.values(), ids=GAINS)
def test_green_is_found_in_a_coloured_scene(pattern, gains):
    rng = np.random.default_rng(1)
    values = sampled(coloured_patches(rng), pattern, gains) + rng.normal(0, 0.02, (HEIGHT, WIDTH))
    found = green_diagonal(values, DARK)
    assert found.main == (pattern[0] == "G")
    assert found.ratio > 4  # noise of 2 % leaves neighbouring blocks unrelated; colours differ by tens of per cent
    assert not found.alike


@pytest.mark.parametrize("scene", GRAY_SCENES.values(), ids=GRAY_SCENES)
@pytest.mark.parametrize("gains", GAINS.values(), ids=GAINS)
def test_a_gray_scene_never_puts_green_on_the_wrong_diagonal(scene, gains):
    rng = np.random.default_rng(2)
    for noise in (0, 0.02, 0.2):
        values = sampled(scene, gains=gains) + rng.normal(0, noise, scene.shape)
        assert green_diagonal(values.astype(np.float32), DARK).main in (None, False)


@pytest.mark.parametrize("scene", GRAY_SCENES.values(), ids=GRAY_SCENES)
def test_a_gray_scene_in_balanced_light_tells_nothing(scene):
    found = green_diagonal(sampled(scene), DARK)
    assert found.main is None
    assert found.ratio < 2


@pytest.mark.parametrize("scene", ["flat", "ramp along the diagonal", "chessboard"])
def test_a_gray_scene_in_unbalanced_light_tells_the_diagonal(scene):
    assert green_diagonal(sampled(GRAY_SCENES[scene], gains=(0.5, 1, 0.6)), DARK).main is False


@pytest.mark.parametrize("level", [0.0, 0.02, 5.0, 100.0])
def test_noise_alone_never_tells_a_diagonal(level):
    rng = np.random.default_rng(4)
    for _ in range(40):
        noise = rng.normal(level, 10, (HEIGHT, WIDTH)).astype(np.float32)
        assert green_diagonal(noise, DARK).main is None


def test_greens_that_differ_by_five_per_cent_do_not_pass_for_red_and_blue():
    values = sampled(GRAY_SCENES["flat"], gains=(0.5, 1, 0.5))
    values[1::2, ::2] *= 1.05
    assert green_diagonal(values, DARK).main is None


def test_noise_of_rows_is_the_same_on_both_diagonals():
    rng = np.random.default_rng(5)
    values = sampled(GRAY_SCENES["flat"]) * (1 + rng.normal(0, 0.3, (HEIGHT, 1)))
    assert green_diagonal(values.astype(np.float32), DARK).main is None


def test_saturated_green_leaves_the_frame_undecided_or_right():
    rng = np.random.default_rng(6)
    scene = np.minimum(coloured_patches(rng) * (0.02, 5, 0.02), 1)
    scene[..., 1] = np.minimum(scene[..., 1] + rng.normal(0, 0.1, scene.shape[:2]), 1)
    assert green_diagonal(sampled(scene), DARK).main in (None, False)


def test_the_black_level_is_taken_off_before_samples_are_compared():
    black = np.array([[0.0, 60.0], [20.0, 5.0]])
    values = sampled(np.full((HEIGHT, WIDTH), 50.0)) + np.tile(black, (HEIGHT // 2, WIDTH // 2))
    assert green_diagonal(values.astype(np.float32), black).alike
    assert green_diagonal(values.astype(np.float32), DARK).main is not None


def test_samples_that_all_agree_are_named():
    rng = np.random.default_rng(7)
    scene = np.kron(rng.uniform(0.2, 0.8, (8, 12)), np.ones((30, 30)))
    assert green_diagonal(sampled(scene) + rng.normal(0, 0.02, scene.shape), DARK).alike
    assert not green_diagonal(sampled(scene, gains=(0.7, 1, 0.7)), DARK).alike


@pytest.mark.parametrize("shape", [(2, 2), (30, 40), (7, 5000)])
def test_a_frame_too_small_tells_nothing(shape):
    rng = np.random.default_rng(8)
    assert green_diagonal(rng.random(shape).astype(np.float32), DARK).main is None


def test_a_frame_without_light_tells_nothing():
    found = green_diagonal(np.zeros((HEIGHT, WIDTH), np.uint16), DARK)
    assert (found.main, found.ratio, found.alike) == (None, 1.0, False)


def test_a_frame_of_many_megapixels_is_judged_by_a_part_of_it():
    rng = np.random.default_rng(9)
    values = np.tile(sampled(coloured_patches(rng), "GBRG"), (9, 9))
    assert green_diagonal((values * 255).astype(np.uint8), DARK).main is True


def frame(pattern, scene, named=None):
    values = np.rint(sampled(scene, pattern) * 4000).astype(np.uint16)
    return Mosaic(values, named or pattern, np.zeros((2, 2)), 4095)


@pytest.mark.parametrize(
    ("pattern", "named", "message"),
    [
        ("GRBG", "RGGB", r"pattern GRBG or GBRG, not RGGB; --preview-patterns"),
        ("GBRG", "BGGR", r"pattern GRBG or GBRG, not BGGR"),
        ("BGGR", "GRBG", r"pattern RGGB or BGGR, not GRBG"),
    ],
)
def test_a_wrong_diagonal_is_refused_with_the_two_patterns_it_can_be(pattern, named, message):
    with pytest.raises(InvalidInput, match=message):
        check_phase(frame(pattern, coloured_patches(np.random.default_rng(10)), named))


@pytest.mark.parametrize(("pattern", "named"), [("RGGB", "RGGB"), ("RGGB", "BGGR"), ("GRBG", "GBRG")])
def test_the_right_diagonal_passes_whichever_end_is_red(pattern, named):
    found = check_phase(frame(pattern, coloured_patches(np.random.default_rng(11)), named))
    assert found.main == (named[0] == "G")


def test_a_gray_board_in_balanced_light_is_refused_under_no_name():
    for named in PATTERNS:
        found = check_phase(frame("RGGB", chessboard(), named))
        assert (found.main, found.alike) == (None, True)


def test_other_sensors_are_not_judged():
    scene = coloured_patches(np.random.default_rng(12))
    assert check_phase(frame("RGGB", scene, MONO)) is None
    x_trans = Mosaic(sampled(scene), X_TRANS, np.zeros((6, 6)), 1.0)
    assert check_phase(x_trans) is None
