"""The image circle from images to tables of detections, and from these and guesses to camera files.

How well the circle itself is found is tested in tests/images and tests/real.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from camcal.calibrate import intrinsics
from camcal.calibrate.intrinsics import CandidateModel, Options
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, folds_inside
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion
from camcal.quality.assess import judge
from camcal.quality.lens_choice import rank_models
from camcal.raw.options import AS_IMAGES
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.board_views import known_circle
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.detect import detect_images, document
from camcal.tasks.calibration.images_again import with_circle
from camcal.tasks.calibration.options import CalibrateOptions, DetectOptions
from camcal.tasks.calibration.video_frames import Video

SIZE = (400, 300)
CENTRE, RADIUS = (203.0, 148.0), 140.0
BOARD = Board("chessboard", 6, 5, 0.03)
CIRCLE = ImageCircle((640, 480), (320.0, 238.0), 301.5)
LENS = Camera(model_named("opencv5"), (640, 480), np.array([480.0, 480, 322, 238, -0.1, 0.02, 0, 0, 0]))


def photograph(path, seed, *, circle=True, size=SIZE):
    """Write the picture of a board before a bright wall, black outside of a circle if there is one."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[: BOARD.rows + 1, : BOARD.columns + 1]
    squares = np.kron(np.where((row + column) % 2, 220, 30), np.ones((20, 20))).astype(np.uint8)
    image = np.full((SIZE[1], SIZE[0]), 190.0) + rng.normal(0, 2, (SIZE[1], SIZE[0]))
    x, y = rng.integers(110, 150), rng.integers(80, 110)
    image[y : y + squares.shape[0], x : x + squares.shape[1]] = squares
    if circle:
        v, u = np.mgrid[: SIZE[1], : SIZE[0]]
        image *= np.clip(RADIUS + 0.5 - np.hypot(u - CENTRE[0], v - CENTRE[1]), 0, 1)
    cv2.imwrite(str(path), cv2.resize(np.clip(cv2.GaussianBlur(image, (0, 0), 0.7), 0, 255).astype(np.uint8), size))
    return path


@pytest.fixture
def folder(tmp_path):
    for seed in range(3):
        photograph(tmp_path / f"{seed}.png", seed)
    return tmp_path


def detected(folder, output=None):
    return detect_images(DetectOptions((folder,), BOARD, output, jobs=1))


def assert_is_the_circle(circle):
    assert circle.image_size == SIZE
    assert circle.radius == pytest.approx(RADIUS, rel=0.005)
    np.testing.assert_allclose(circle.centre, CENTRE, atol=0.005 * RADIUS)


def test_detect_writes_the_image_circle_and_says_so(folder, tmp_path):
    report = detected(folder, tmp_path / "corners.csv")
    circle = report.detections.circles[""]
    assert_is_the_circle(circle)
    assert detections.read(tmp_path / "corners.csv").circles == {"": circle}
    assert any(line.startswith("image circle of radius 140.") for line in report.lines)
    assert document(report, None)["image_circle"] == {"centre_px": list(circle.centre), "radius_px": circle.radius}


def test_a_vnl_holds_no_circle(folder, tmp_path):
    detected(folder, tmp_path / "corners.vnl")
    assert "image_circle" not in (tmp_path / "corners.vnl").read_text()
    assert detections.read(tmp_path / "corners.vnl", BOARD, SIZE).circles == {}


def test_without_a_table_the_images_are_not_read_again(folder):
    assert detected(folder).detections.circles == {}


def test_images_without_a_circle_have_none(tmp_path):
    for seed in range(3):
        photograph(tmp_path / f"{seed}.png", seed, circle=False)
    report = detected(tmp_path, tmp_path / "corners.csv")
    assert report.detections.circles == {}
    assert "# image_circle" not in (tmp_path / "corners.csv").read_text()
    assert document(report, None)["image_circle"] is None


def seen_in(folder, pixels, size=SIZE):
    names = sorted(folder.glob("*.png"))
    return Detections(BOARD, tuple(BoardDetection(name.as_posix(), size, np.array([0]), pixels) for name in names))


def test_a_corner_outside_of_the_circle_shows_that_it_is_none(folder):
    inside, outside = np.array([[CENTRE[0] + 0.97 * RADIUS, CENTRE[1]]]), np.array([[CENTRE[0] + 1.02 * RADIUS, 148.0]])
    assert_is_the_circle(with_circle(seen_in(folder, inside), (), AS_IMAGES).circles[""])
    assert with_circle(seen_in(folder, outside), (), AS_IMAGES).circles == {}


def test_images_that_are_gone_or_of_another_size_are_left_out(folder):
    photograph(folder / "0.png", 0, size=(200, 150))  # its view was made to fit
    (folder / "gone.png").touch()
    assert_is_the_circle(with_circle(seen_in(folder, np.array([CENTRE])), (), AS_IMAGES).circles[""])


def test_frames_of_videos_show_the_circle_too(folder):
    path = folder / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, SIZE)
    for image in sorted(folder.glob("*.png")):
        writer.write(cv2.imread(str(image)))
    writer.release()
    video = Video(path, 3, (0, 1, 2))
    seen = Detections(
        BOARD, tuple(BoardDetection(name, SIZE, np.array([0]), np.array([CENTRE])) for name in video.names)
    )
    assert_is_the_circle(with_circle(seen, (video,), AS_IMAGES).circles[""])


@pytest.fixture(scope="module")
def corners():
    rng = np.random.default_rng(3)
    board = Board("chessboard", 8, 6, 0.03)
    seen = observe(LENS, board, views(LENS, board, 12, rng=rng), rng=rng, noise_px=0.1)[0]
    lit = [np.hypot(*(view.pixels - [319.0, 239.0]).T) < 285 for view in seen.views]  # inside of both circles
    kept = [
        replace(view, ids=view.ids[near], pixels=view.pixels[near]) for view, near in zip(seen.views, lit, strict=True)
    ]
    return Detections(board, tuple(kept))


@pytest.fixture(scope="module")
def good():
    """A calibration that passes."""
    camera = Camera(model_named("opencv5"), (1600, 1200), np.array([1200.0, 1200, 799.5, 599.5, *[0.0] * 5]))
    board, rng = Board("chessboard", 9, 6, 0.040), np.random.default_rng(1)
    seen, _ = observe(camera, board, views(camera, board, 15, rng=rng), rng=rng, noise_px=0.1)
    return intrinsics.calibrate(seen.views, board, Options(camera.model))


def circle_in_file(corners, tmp_path, circles, guess=None):
    table = tmp_path / "table.csv"
    detections.write(table, Detections(corners.board, corners.views, circles))
    report = calibrate(CalibrateOptions((str(table),), tmp_path / "camera.yaml", model="opencv5", guess=guess))
    assert any("image circle" in line for line in report.lines) == bool(report.file.cameras["camera"].image_circle)
    return native.read(tmp_path / "camera.yaml").cameras["camera"].valid


@pytest.mark.slow
def test_calibrate_takes_the_circle_of_the_table_or_else_of_the_guess(corners, tmp_path):
    other = ImageCircle((640, 480), (318.0, 240.0), 290.25)
    entry = CameraEntry(LENS, valid=ValidRegion(image_circle=other))
    native.write(tmp_path / "guess.yaml", CameraFile({"camera": entry}))
    guess = str(tmp_path / "guess.yaml")
    found = circle_in_file(corners, tmp_path, {"": CIRCLE}, guess)
    assert found.image_circle == CIRCLE
    assert found.max_radius_px < 305
    assert circle_in_file(corners, tmp_path, {}, guess).image_circle == other
    without = circle_in_file(corners, tmp_path, {})
    assert without.image_circle is None
    assert without.max_radius_px > 390


@pytest.mark.parametrize(("share", "taken"), [(0.98, "opencv5"), (1.02, "kannala_brandt4")])
def test_a_fold_outside_of_the_circle_is_no_reason_for_another_lens_model(good, share, taken):
    size, centre = good.camera.image_size, (799.5, 599.5)
    values = {
        "opencv5": [1200.0, 1200, *centre, -0.5, 0, 0, 0, 0],
        "kannala_brandt4": [1200.0, 1200, *centre, *[0] * 4],
    }
    cameras = {
        name: Camera(model_named(name), size, np.array(own), np.diag([0.25] * 2 + [0.0] * (len(own) - 2)))
        for name, own in values.items()
    }
    scores = {"opencv5": 2.0, "kannala_brandt4": 1.99}
    candidates = [
        CandidateModel(name, np.full(5, 10 * score), 50, 0.1, calibration=replace(good, camera=cameras[name]))
        for name, score in scores.items()
    ]
    circle = ImageCircle(size, centre, share * folds_inside(cameras["opencv5"]).radius_px)
    assert rank_models(judge(candidates, circle), "opencv5")[0].name == taken


def test_calibrate_saves_the_circle_with_the_detections(corners, tmp_path):
    detections.write(tmp_path / "table.csv", Detections(corners.board, corners.views, {"": CIRCLE}))
    saved = tmp_path / "saved.csv"
    options = CalibrateOptions((f"{tmp_path}/table.csv",), tmp_path / "camera.yaml", model="opencv5")
    calibrate(replace(options, save_detections=saved))
    assert detections.read(saved).circles == {"": CIRCLE}


def test_the_circle_is_that_of_the_camera_and_of_images_of_this_size(corners):
    left = Detections(
        None,
        tuple(BoardDetection("a", SIZE, np.array([0]), np.array([[70.0, 148.0]]), camera="left") for _ in range(2)),
    )
    small = ImageCircle(SIZE, CENTRE, RADIUS)
    assert known_circle(Detections(None, left.views, {"left": small, "right": CIRCLE}), None) == small
    assert known_circle(Detections(None, left.views, {"right": small}), None) is None
    assert known_circle(Detections(None, left.views, {"left": CIRCLE}), None) is None
    assert known_circle(Detections(None, left.views, {"left": replace(small, radius=130.0)}), None) is None
    both = (*left.views, *corners.views)
    assert known_circle(Detections(None, both, {"left": small}), None) is None
