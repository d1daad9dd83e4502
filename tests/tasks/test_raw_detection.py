"""Corners in raw frames: measured in samples of one colour, where no demosaicing has moved them.

The frames are rendered with photon noise unless a test says otherwise; the truth is the projection of the board.
"""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.options import given_words
from camcal.raw import MONO, PATTERNS
from camcal.raw.demosaic import demosaic
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Mosaic, sites
from camcal.raw.options import GivenLayout, ImageReadOptions
from camcal.raw.pixel_formats import pack, pixel_format_named
from camcal.raw.reading import agreeing_gains, detection_image_of, read_detection_image
from camcal.simulate.mosaics import filter_mosaic, lenses
from camcal.simulate.render import Exposure, evenly_lit
from camcal.targets.board import Board, parse_board
from camcal.tasks.calibration.detect import DEMOSAICED, detect_images
from camcal.tasks.calibration.options import DetectOptions

SIZE = (480, 360)
BOARD = Board("chessboard", 8, 5, 0.03)
CHARUCO = parse_board("charuco:7x5:40mm:28mm:DICT_4X4_50")
LENS = Camera(model_named("opencv5"), SIZE, np.array([420.0, 421, 238, 181, -0.1, 0.02, 5e-4, -3e-4, 0]))
POSE = Pose(so3.exp(np.array([0.25, -0.2, 0.1])), np.array([-0.11, -0.06, 0.33]))
BLACK, WHITE, WELL_E = 64.0, 4095.0, 12000.0


def frame(pattern="RGGB", light=(1.0, 1.0, 1.0), aberration_px=0.0, noisy=True, board=BOARD, **how):
    """Return a raw frame of the board; light: what red, green and blue samples get of the same white."""
    cameras = lenses(LENS, aberration_px)
    seen = {camera: evenly_lit(camera, board, POSE, Exposure(**how)) for camera in set(cameras.values())}
    shares = dict(zip("RGB", light, strict=True))
    planes = {colour: shares[colour] * seen[camera] for colour, camera in cameras.items()}
    electrons = WELL_E * (planes["G"] if pattern == MONO else filter_mosaic(pattern, planes))
    if noisy:
        rng = np.random.default_rng(1)
        electrons = rng.poisson(electrons) + 4 * rng.standard_normal(electrons.shape)
    counts = np.rint(BLACK + electrons * (WHITE - BLACK) / WELL_E)
    values = np.clip(counts, 0, WHITE).astype(np.uint16)
    return Mosaic(values, pattern, np.full((2, 2), BLACK), WHITE)


def write(path, mosaic):
    """Write a bare mosaic as a camera without a file format of its own gives it: 12 bits in 16, black level and all."""
    save(path, mosaic.values)
    return path


def found(path, board=BOARD, **how):
    report = detect_images(DetectOptions((path,), board, jobs=1, reading=ImageReadOptions(**how)))
    assert report.failed == ()
    return report


def error_px(view, board=BOARD, lens=LENS):
    """Return the RMS distance of the corners of a view from the truth."""
    truth = lens.project(POSE.apply(board.points()[view.ids])).pixels
    return float(np.sqrt(np.mean(np.sum((view.pixels - truth) ** 2, axis=1))))


def test_green_corners_are_as_good_as_those_of_a_monochrome_sensor_whatever_the_aberration(tmp_path):
    shown = {"noisy": False}
    mono = found(write(tmp_path / "mono.png", frame(MONO, **shown)))
    mosaic = write(tmp_path / "mosaic.png", frame(aberration_px=1.0, **shown))
    green = found(mosaic, pattern="RGGB").detections.views[0]
    gray = found(mosaic, pattern="RGGB", algorithm="gray").detections.views[0]
    assert len(green.ids) == BOARD.count
    assert error_px(green) < 1.2 * error_px(mono.detections.views[0])
    assert error_px(green) < 0.01  # px, the detector's own error
    assert error_px(gray) > 2 * error_px(green)  # what red and blue do to a gray mosaic


def test_gray_corners_are_as_good_as_those_of_a_monochrome_sensor_without_aberration(tmp_path):
    for noisy, limit in ((False, 1.2), (True, 1.5)):  # the noise of one frame decides by a quarter
        mono = found(write(tmp_path / "mono.png", frame(MONO, noisy=noisy)))
        gray = found(write(tmp_path / "gray.png", frame(noisy=noisy)), pattern="RGGB", algorithm="gray")
        # without noise what is left is how well the model fits, a thousandth of a pixel
        assert error_px(gray.detections.views[0]) < max(limit * error_px(mono.detections.views[0]), 0.001)


def test_a_sharp_lens_does_not_bias_green_corners(tmp_path):
    """Filling the gaps of green blurs edges unevenly; the samples themselves do not know of it."""
    mosaic = frame(noisy=False, blur_px=0.4)
    image = detection_image_of(mosaic)
    path = write(tmp_path / "sharp.png", mosaic)
    exact = found(path, pattern="RGGB").detections.views[0]
    filled = found(save_as(tmp_path / "filled.png", image.gray)).detections.views[0]
    assert error_px(exact) < 0.006
    assert error_px(filled) > 1.5 * error_px(exact)


def save_as(path, pixels):
    save(path, pixels)
    return path


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_phase_puts_the_corners_of_every_colour_in_its_place(tmp_path, pattern):
    path = write(tmp_path / "mosaic.png", frame(pattern, (0.5, 1.0, 0.6), aberration_px=1.0))
    report = found(path, pattern=pattern, colours=True)
    assert error_px(report.detections.views[0]) < 0.02  # px, photon noise
    for colour in ("red", "blue"):
        view, lens = report.detections.views[0].colours[colour], lenses(LENS, 1.0)[colour[0].upper()]
        assert len(view.ids) > 0.9 * BOARD.count
        assert error_px(view, lens=lens) < 0.04  # a quarter of the samples, half of the light
        assert error_px(view) > 0.1  # it is not green that was found again


def test_a_camera_raw_file_brings_its_pattern(tmp_path):
    mosaic = replace(frame("GBRG", (0.5, 1.0, 0.6)), orientation=6)
    write_dng(tmp_path / "photo.dng", mosaic)
    view = found(tmp_path / "photo.dng").detections.views[0]
    assert error_px(view) < 0.02
    assert (view.size, view.orientation) == (SIZE, 6)  # noted, never applied


def test_markers_are_read_and_their_corners_measured_in_raw_frames(tmp_path):
    path = write(tmp_path / "charuco.png", frame(aberration_px=0.5, board=CHARUCO))
    report = found(path, CHARUCO, pattern="RGGB", colours=True)
    view = report.detections.views[0]
    assert len(view.ids) > 0.8 * CHARUCO.count
    assert error_px(view, CHARUCO) < 0.03
    assert error_px(report.detections.views[0].colours["red"], CHARUCO, lenses(LENS, 0.5)["R"]) < 0.05


def test_channels_of_demosaiced_images_come_with_a_warning(tmp_path):
    mosaic = frame(aberration_px=1.0, noisy=False)
    path = save_as(tmp_path / "colour.png", demosaic(mosaic.values, "RGGB", "bilinear"))
    report = found(path, colours=True)
    assert DEMOSAICED in report.warnings
    assert set(report.detections.views[0].colours) == {"red", "blue"}
    assert error_px(report.detections.views[0].colours["red"], lens=lenses(LENS, 1.0)["R"]) < 0.2  # moved, not lost


def test_gains_go_by_the_board_and_not_by_what_stands_around_it():
    mosaic = frame(light=(0.5, 1.0, 0.6))
    light = (mosaic.values.astype(np.float32) - BLACK) / (WHITE - BLACK)
    for site in sites("RGGB", "R"):
        light[site][:, :40] *= 3  # a red wall beside the board
    red, green, blue = agreeing_gains(light, "RGGB")
    assert (red, green, blue) == pytest.approx((2, 1, 1 / 0.6), rel=0.02)


def test_a_frame_without_light_has_gains_of_one():
    assert agreeing_gains(np.zeros((8, 8), np.float32), "RGGB") == (1, 1, 1)


def test_a_wrong_phase_is_refused_with_the_likely_ones(tmp_path):
    path = write(tmp_path / "mosaic.png", frame("RGGB", (0.5, 1.0, 0.6)))
    with pytest.raises(InvalidInput, match="pattern RGGB or BGGR, not GRBG") as caught:
        read_detection_image(path, ImageReadOptions(pattern="GRBG"))
    assert caught.value.where == str(path)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"pattern": "RGBG"}, "'--pattern': 'RGBG' is not one of RGGB, GRBG"),
        ({"algorithm": "ri"}, "'--algorithm': 'ri' is not one of green, gray"),
        ({"algorithm": "gray", "colours": True}, "against green"),
    ],
)
def test_a_reading_that_cannot_be_is_refused(how, words):
    with pytest.raises(InvalidInput, match=words):
        ImageReadOptions(**how)


@pytest.mark.parametrize(
    ("pattern", "words"), [(MONO, "without colours"), ("GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG", "X-Trans")]
)
def test_sensors_without_bayer_cells_have_no_channels(pattern, words):
    side = 2 if pattern == MONO else 6
    mosaic = Mosaic(np.zeros((48, 48), np.uint16), pattern, np.zeros((side, side)), 4095.0)
    with pytest.raises(InvalidInput, match=words):
        detection_image_of(mosaic, ImageReadOptions(colours=True))


def test_what_is_no_mosaic_costs_only_itself(tmp_path):
    write(tmp_path / "1.png", frame())
    save(tmp_path / "2.png", np.zeros((*SIZE[::-1], 3), np.uint8))
    (tmp_path / "3.npy").write_bytes(b"no array")
    report = detect_images(DetectOptions((tmp_path,), BOARD, jobs=1, reading=ImageReadOptions(pattern="RGGB")))
    assert [view.image for view in report.detections.views] == [(tmp_path / "1.png").as_posix()]
    assert "in colour already" in report.failed[0]
    assert len(report.failed) == 2


def test_gray_images_without_a_pattern_have_no_channels(tmp_path):
    path = write(tmp_path / "gray.png", frame())
    with pytest.raises(InvalidInput, match="give its --pattern"):
        detect_images(DetectOptions((path,), BOARD, jobs=1, reading=ImageReadOptions(colours=True)))


def test_a_raw_frame_without_a_board_is_a_listed_result(tmp_path):
    path = write(tmp_path / "wall.png", replace(frame(), values=np.full(SIZE[::-1], 900, np.uint16)))
    with pytest.raises(InsufficientData):
        found(path, pattern="RGGB", colours=True)


def test_header_less_files_of_a_folder_are_read_where_their_layout_is_given(tmp_path):
    packed = pixel_format_named("BayerRG12p")
    (tmp_path / "frame.raw").write_bytes(pack(frame().values, packed))
    dumped = found(tmp_path, layout=GivenLayout("BayerRG12p", SIZE)).detections.views[0]
    bare = found(write(tmp_path / "bare.png", frame()), pattern="RGGB").detections.views[0]
    assert len(dumped.ids) == BOARD.columns * BOARD.rows
    # the full scale of a file of 16 bits is not that of 12, and a corner does not depend on it
    np.testing.assert_allclose(dumped.pixels[np.argsort(dumped.ids)], bare.pixels[np.argsort(bare.ids)], atol=2e-3)


def test_layouts_are_offered_for_a_header_less_file_without_one(tmp_path):
    path = tmp_path / "frame.raw"
    path.write_bytes(bytes(640 * 480 * 2))
    with pytest.raises(InvalidInput, match=r"frame\.raw: .*640x480.*give --format and --size"):
        read_detection_image(path, ImageReadOptions("RGGB"))


def test_a_layout_is_repeated_as_options():
    options = given_words(ImageReadOptions(layout=GivenLayout("pRAA", (640, 480), stride=832)))
    assert options == ["--format", "pRAA", "--size", "640x480", "--stride", "832"]
