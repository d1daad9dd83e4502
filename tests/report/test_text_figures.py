"""Figures of a calibration in letters: they say what the numbers say, fit the width, and can do without blocks."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.report.text_figures import (
    ASCII,
    BLOCKS,
    calibration_figures,
    coverage_map,
    coverage_words,
    letters,
    residual_histogram,
    residual_words,
)
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

SIZE = (1280, 960)
CAMERA = Camera(model_named("opencv5"), SIZE, np.array([900.0, 900, 640, 480, -0.1, 0.02, 0, 0, 0]))
BOARD = Board("chessboard", 9, 6, 0.025)


@pytest.fixture(scope="module")
def calibration():
    rng = np.random.default_rng(4)
    seen, _ = observe(CAMERA, BOARD, views(CAMERA, BOARD, 12, rng=rng), rng=rng, noise_px=0.2)
    return calibrate(seen.views, BOARD, Options(CAMERA.model))


def inside(lines):
    """What stands in the frame of a map."""
    return [line[1:-1] for line in lines[2:-1]]


def with_size(calibration, size):
    scale = np.array(size) / SIZE
    camera = replace(calibration.camera, image_size=size)
    return replace(calibration, camera=camera, pixels=calibration.pixels * scale)


@pytest.mark.parametrize("width", [40, 63, 64, 80, 120, 300])
@pytest.mark.parametrize("size", [SIZE, (1920, 1080), (720, 1280), (8000, 100), (100, 8000)])
def test_figures_fit_the_width(calibration, width, size):
    for encoding in ("utf-8", "ascii"):
        lines = calibration_figures(with_size(calibration, size), None, width, encoding)
        assert max(map(len, lines)) <= width
        assert len(lines) <= 40
        assert all(line == line.rstrip() and line for line in lines)


@pytest.mark.parametrize(("encoding", "found"), [("utf-8", BLOCKS), ("cp437", ASCII), ("ascii", ASCII), (None, ASCII)])
def test_blocks_are_drawn_where_the_encoding_has_them(calibration, encoding, found):
    assert letters(encoding) is found
    text = "\n".join(calibration_figures(calibration, None, 80, encoding))
    assert text.isascii() == (found is ASCII)
    assert "\x1b" not in text


def test_the_map_shows_where_corners_were_and_how_many(calibration):
    left = replace(calibration, pixels=np.array([[-0.5, -0.5]] * 9 + [[639.0, 959.4], [10.0, 959.4]]))
    lines = coverage_map(left, None, 42, BLOCKS)
    drawn = inside(lines)
    assert (len(drawn), len(drawn[0])) == (15, 40)
    assert drawn[0] == "█" + " " * 39
    assert drawn[-1] == "░" + " " * 18 + "░" + " " * 20
    assert set("".join(drawn[1:-1])) == {" "}
    assert lines[0] == "corners: ░ 1  ▒ 2  ▓ 4  █ 7 or more"


def test_what_lies_outside_the_image_circle_is_marked(calibration):
    circle = ImageCircle(SIZE, (639.5, 479.5), 300.0)
    middle = replace(calibration, pixels=np.array([[639.5, 479.5], [2.0, 2.0]]))
    drawn = inside(coverage_map(middle, circle, 42, ASCII))
    assert drawn[0] == "#" + 39 * "/"
    assert drawn[7].strip("/").replace("#", " ").isspace()
    assert {len(row) for row in drawn} == {40}


def test_bars_are_as_long_as_their_counts_and_noise_ends_at_the_marks(calibration):
    lines = residual_histogram(calibration, 60, 13, ASCII)[1:]
    assert len(lines) == 13
    bars, marks = [line.count("#") for line in lines], [line.index("|") for line in lines]
    assert bars[6] == max(bars)
    assert marks[:7] == sorted(marks[:7])
    assert marks[7:] == sorted(marks[7:], reverse=True)
    assert [marks[6 - k] == marks[6 + k] for k in range(7)] == [True] * 7
    ends = [len(line) - 1 for line in lines]
    assert np.max(np.abs(np.array(ends) - marks)) <= 6  # scatter of some 1300 coordinates in bars of up to 50 letters
    middles = [float(line.split()[0]) for line in lines]
    assert middles == pytest.approx(calibration.sigma_px * np.arange(-3.0, 3.1, 0.5), abs=1e-3)


def test_residuals_of_another_distribution_leave_the_marks(calibration):
    wide = replace(calibration, residuals=np.full_like(calibration.residuals, 1.5 * calibration.sigma_px))
    line = residual_histogram(wide, 60, 13, ASCII)[1 + 9]
    assert line.count("#") > 40
    assert "100.0 %" not in residual_words(wide)
    assert residual_words(replace(wide, residuals=2 * wide.residuals)).startswith(
        "100.0 % beyond 2 sigma (normal: 4.6 %)"
    )


def test_the_lines_say_how_much_is_covered_and_how_residuals_spread(calibration):
    middle = replace(calibration, pixels=np.array([[640.0, 480.0]]))
    assert coverage_words(middle, None).startswith("corners in 1 % of the image, out to 0 % of its diagonal")
    circle = ImageCircle(SIZE, (639.5, 479.5), 300.0)
    assert "of the image circle" in coverage_words(calibration, circle)
    assert residual_words(replace(calibration, residuals=np.array([[0.3, 0.4], [0, 0]]))).endswith("largest 0.5 px")
    share = float(residual_words(calibration).split(" %")[0])
    assert share == pytest.approx(4.6, abs=1.5)  # of some 1300 coordinates
