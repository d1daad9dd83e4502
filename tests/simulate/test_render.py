"""Rendered boards against a renderer that goes the other way: many rays per pixel, back to the bent board.

That one shares the lens model and the drawing with render.py and nothing else.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from opencv_charuco import found_by_opencv
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import least_squares
from scipy.stats import norm

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.render import FLAT, Exposure, Shape, develop, evenly_lit, light, render
from camcal.simulate.scene import make_camera, views
from camcal.targets.board import parse_board
from camcal.targets.pattern import pattern_of

CHESSBOARD = parse_board("chessboard:5x4:30mm")
CHARUCO = parse_board("charuco:5x4:30mm:22mm:DICT_4X4_50")
DOTTED = parse_board("chessboard:5x4:30mm:dots")
APRILGRID = parse_board("aprilgrid:3x2:34mm:0.3")
CIRCLES = parse_board("circles:5x4:30mm:20mm")
SMALL = Camera(model_named("opencv5"), (32, 24), [27, 26.5, 15.3, 11.8, -0.2, 0.05, 0.001, -0.002, 0.0])
TILTED = Pose.from_vector(np.array([0.3, -0.4, 0.2]), [-0.06, -0.045, 0.14])
BENT = Shape(bow_x=2e-3, bow_y=1e-3, twist=1e-3, cubic=1e-3, stretch=0.003)
FINE = 24  # rays per pixel and axis


def rng(seed=0):
    return np.random.default_rng(seed)


def board_coordinates(camera, pose, shape, board, pixels):
    """Return the drawing's x, y (2, N) that is seen in pixels (N, 2), by intersecting rays with the bent board."""
    rays = camera.unproject(pixels).directions @ pose.rotation
    origin = -pose.rotation.T @ pose.translation
    half = np.array(board.extent) / 2
    height = np.zeros(len(rays))
    for _ in range(8):  # the error shrinks by slope times tangent of the incidence, some 1/20, each time
        x, y, _ = (origin + ((height - origin[2]) / rays[:, 2])[:, None] * rays).T
        a, b = (x - half[0]) / half[0] / (1 + shape.stretch), (y - half[1]) / half[1]
        a, b = np.clip(a, -3, 3), np.clip(b, -3, 3)  # far off the sheet, where nothing is seen anyway
        height = shape.bow_x * (1 - a * a) + shape.bow_y * (1 - b * b) + shape.twist * a * b + shape.cubic * (a**3 - a)
    return half[0] + half[0] * a, y


def supersampled(camera, board, pose, exposure, shape):
    """Return the brightness (height, width) as the weighted mean of FINE² rays per pixel."""
    blur = exposure.blur_px
    pad = int(np.ceil(0.5 + 4 * blur))
    axes = [(np.arange((length + 2 * pad) * FINE) + 0.5) / FINE - 0.5 - pad for length in camera.image_size]
    u, v = np.meshgrid(*axes)
    x, y = board_coordinates(camera, pose, shape, board, np.column_stack([u.ravel(), v.ravel()]))
    pattern = pattern_of(board)
    ink = exposure.black + (exposure.white - exposure.black) * pattern.ink
    ink = np.pad(ink, 1, constant_values=exposure.background)
    image = ink[np.searchsorted(pattern.y, y), np.searchsorted(pattern.x, x)]
    for left, top, radius, shade in pattern.discs:
        brightness = exposure.black + (exposure.white - exposure.black) * shade
        image = np.where(np.hypot(x - left, y - top) < radius, brightness, image)
    image = image.reshape(u.shape)
    for axis, places in enumerate((axes[1], axes[0])):
        image = np.moveaxis(np.tensordot(spread(places, camera.image_size[1 - axis], blur), image, (1, axis)), 0, axis)
    return image


def spread(places, count, blur):
    """Return the weights (count, N) of places along an axis in every pixel."""
    distance = places - np.arange(count)[:, None]
    if blur == 0:
        weights = (np.abs(distance) < 0.5).astype(float)
    else:
        weights = norm.cdf((distance + 0.5) / blur) - norm.cdf((distance - 0.5) / blur)
    return weights / weights.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("board", "shape", "blur"),
    [
        (CHESSBOARD, FLAT, 0.0),
        (CHESSBOARD, BENT, 0.7),
        (CHARUCO, BENT, 0.0),
        (DOTTED, BENT, 0.0),
        (APRILGRID, BENT, 0.0),
        (CIRCLES, BENT, 0.0),
    ],
)
def test_brightness_agrees_with_many_rays_per_pixel(board, shape, blur):
    exposure, pose = Exposure(blur_px=blur), TILTED
    if board is APRILGRID:  # its z points towards the camera, its y upwards
        pose = TILTED @ Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, board.extent[1], 0.0]))
    ours = evenly_lit(SMALL, board, pose, exposure, shape)
    error = (ours - supersampled(SMALL, board, pose, exposure, shape)) / (exposure.white - exposure.black)
    assert np.abs(error).max() < 2e-2  # 24 rays across an edge that runs along a row leave 1/48
    assert np.std(error) < 2e-3
    assert abs(np.mean(error)) < 1e-4


def test_the_bend_is_seen():
    flat, bent = (evenly_lit(SMALL, CHESSBOARD, TILTED, Exposure(), shape) for shape in (FLAT, BENT))
    assert np.abs(flat - bent).max() > 0.05


def fitted_corner(spline, start):
    """Return the point about which an image (of spline coefficients) is the same turned by 180°, as a checker's is."""
    offsets = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(-1, 2) + 0.25

    def difference(centre):
        one, other = (
            map_coordinates(spline, (centre + side * offsets).T[::-1], order=5, prefilter=False) for side in (1, -1)
        )
        return one - other

    return least_squares(difference, start, xtol=1e-12).x


def test_corners_are_where_the_camera_sees_them():
    camera = Camera(model_named("pinhole"), (200, 160), [300, 300, 99.2, 80.7])
    pose = Pose.from_vector(np.array([0.0, 0.0, 0.3]), [-0.05, -0.06, 0.4])
    image = evenly_lit(camera, CHESSBOARD, pose, Exposure(blur_px=0.8))
    corners = camera.project(pose.apply(CHESSBOARD.points())).pixels
    spline = spline_filter(image, order=5)
    found = np.array([fitted_corner(spline, np.round(corner)) for corner in corners])
    assert np.abs(found - corners).max() < 2e-4  # 6e-5 measured; interpolating the samples costs most of it


@pytest.mark.parametrize("model", [own for own in MODELS.values() if own.is_central], ids=lambda own: own.name)
def test_corners_of_every_lens_are_found_where_they_are(model):
    board = parse_board("chessboard:7x5:30mm")
    camera = make_camera(model, (640, 480), np.radians(70))
    pose = views(camera, board, 1, rng=rng(2))[0]
    image = render(camera, board, pose, rng=rng(), exposure=Exposure(noise_dn=1.0))
    found, corners = cv2.findChessboardCornersSB(image, (7, 5))
    assert found
    truth = camera.project(pose.apply(board.points())).pixels
    error = np.linalg.norm(corners.reshape(-1, 2) - truth, axis=1)
    turned = np.linalg.norm(corners.reshape(-1, 2)[::-1] - truth, axis=1)
    assert min(error.max(), turned.max()) < 0.3  # what the detector is good for


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_corners_are_found_where_they_are(legacy):
    board = replace(parse_board("charuco:7x6:30mm:22mm:DICT_5X5_100"), legacy=legacy)
    camera = make_camera(model_named("kannala_brandt4"), (640, 480), np.radians(120))
    pose = views(camera, board, 1, rng=rng(3))[0]
    image = render(camera, board, pose, rng=rng(), exposure=Exposure(noise_dn=1.0), shape=Shape(bow_x=1e-3))
    ids, pixels = found_by_opencv(image, board, markers=1)
    truth = camera.project(pose.apply(Shape(bow_x=1e-3).points(board))).pixels
    assert len(ids) > 0.9 * board.count
    assert np.median(np.linalg.norm(pixels - truth[ids], axis=1)) < 0.15  # what the detector is good for


def test_the_same_seed_gives_the_same_image():
    images = [render(SMALL, CHARUCO, TILTED, rng=rng(seed)) for seed in (1, 1, 2)]
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[2])


def test_the_board_is_brighter_than_the_background_and_the_background_than_its_ink():
    exposure = Exposure(blur_px=0.0)
    image = evenly_lit(SMALL, CHESSBOARD, Pose.from_vector(np.zeros(3), [-0.06, -0.045, 0.3]), exposure)
    assert image[0, 0] == pytest.approx(exposure.background)
    assert image.min() == pytest.approx(exposure.black, abs=1e-9)  # sums of some hundred steps
    assert image.max() == pytest.approx(exposure.white, abs=1e-9)


def test_a_board_cut_by_the_image_leaves_no_streaks():
    close = Pose.from_vector(np.array([0.1, 0.2, 0.1]), [-0.09, -0.03, 0.05])
    image = evenly_lit(SMALL, CHESSBOARD, close, Exposure())
    assert Exposure().black - 1e-9 <= image.min()
    assert image.max() <= Exposure().white + 1e-9


def test_noise_gamma_and_depth_are_as_asked():
    flat = np.full((200, 300), 0.25)
    noisy = develop(flat, Exposure(noise_dn=3.0), rng())
    assert noisy.dtype == np.uint8
    assert np.std(noisy.astype(float)) == pytest.approx(3.0, rel=0.03)  # 60 000 draws, and rounding to whole counts
    encoded = develop(flat, Exposure(noise_dn=0.0, gamma=2.0, depth=16), rng())
    assert encoded.dtype == np.uint16
    assert np.all(encoded == round(0.5 * 65535))


def test_light_falls_off_as_asked():
    even = light((101, 51), Exposure(gradient=0.0, vignetting=0.0), 0.0)
    assert np.all(even == 1)
    sloped = light((101, 51), Exposure(gradient=0.3, vignetting=0.0), 0.0)
    assert sloped[25, 50] == pytest.approx(1.0)
    assert sloped[25, 100] - sloped[25, 0] == pytest.approx(0.3)
    darker = light((101, 51), Exposure(gradient=0.0, vignetting=0.2), 0.0)
    assert darker[0, 0] == pytest.approx(0.8)


def test_a_board_beyond_the_field_of_the_lens_is_refused():
    behind = Pose.from_vector(np.zeros(3), [-0.06, -0.045, -0.14])
    with pytest.raises(
        InvalidInput, match="the board exceeds the field of view of the lens: move it or choose another lens"
    ):
        render(SMALL, CHESSBOARD, behind, rng=rng())


@pytest.mark.parametrize("bad", [{"blur_px": -1.0}, {"noise_dn": -1.0}, {"gamma": 0.0}, {"depth": 12}])
def test_an_exposure_out_of_range_is_refused(bad):
    with pytest.raises(InvalidInput):
        Exposure(**bad)


def test_writing_and_reading_back_keeps_every_pixel():
    image = render(SMALL, CHARUCO, TILTED, rng=rng(), exposure=Exposure(depth=16))
    back = cv2.imdecode(cv2.imencode(".png", image)[1], cv2.IMREAD_UNCHANGED)
    assert np.array_equal(back, image)
