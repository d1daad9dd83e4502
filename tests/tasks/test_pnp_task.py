"""The task behind `camcal pnp`: where views come from, what is said of those without a pose, what is written."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry.pose import Pose
from camcal.progress import Silent
from camcal.simulate.observe import observe
from camcal.targets.board import Detection, Detections, parse_board
from camcal.tasks.pnp import PnpOptions, pnp

BOARD = parse_board("chessboard:9x6:30mm")
CAMERA = Camera(model_named("opencv5"), (1280, 960), [900.0, 905.0, 640.0, 480.0, -0.2, 0.05, 1e-3, 0.0, 0.0])
TRUTHS = (
    Pose.from_vector(np.array([0.3, -0.2, 0.1]), np.array([-0.1, -0.08, 0.6])),
    Pose.from_vector(np.array([-0.4, 0.3, 0.0]), np.array([-0.12, -0.05, 0.8])),
)


class Listener(Silent):
    """Keeps the warnings."""

    def __init__(self):
        self.warnings = []

    def warn(self, message):
        self.warnings.append(message)


@pytest.fixture
def camera_file(tmp_path):
    path = tmp_path / "camera.yaml"
    native.write(path, CameraFile({"left": CameraEntry(CAMERA)}))
    return str(path)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(1)
    return observe(CAMERA, BOARD, TRUTHS, rng=rng, noise_px=0.1)[0]


def from_detections(camera_file, tmp_path, found, **options):
    path = tmp_path / "detections.csv"
    detections.write(path, found)
    return PnpOptions(camera_file, inputs=(str(path),), **options)


def from_points(camera_file, tmp_path, points, pixels, **options):
    path = tmp_path / "points.csv"
    np.savetxt(path, np.column_stack([points, pixels]), "%.17g", ",", header="X,Y,Z,u,v", comments="")
    return PnpOptions(camera_file, points=path, **options)


def assert_within_five_sigma(estimate, truth):
    off = np.concatenate(
        [estimate.transform.translation - truth.translation, (estimate.transform @ truth.inverse()).vector()]
    )
    assert off @ np.linalg.solve(estimate.covariance, off) < 45  # 5 σ in six dimensions: one in 10⁷ draws is beyond


def test_a_detections_file_gives_the_pose_of_every_view(camera_file, tmp_path, seen):
    report = pnp(from_detections(camera_file, tmp_path, seen))
    assert report.poses.frames == "camera_T_object"
    assert report.failed == ()
    for estimate, truth in zip(report.poses.estimates.values(), TRUTHS, strict=True):
        assert_within_five_sigma(estimate, truth)
        assert estimate.freedom == 2 * (108 - 6)  # shared by both views


def test_correspondences_give_the_same_pose_as_the_board(camera_file, tmp_path, seen):
    view = seen.views[0]
    board = pnp(from_detections(camera_file, tmp_path, replace(seen, views=(view,))))
    points = pnp(from_points(camera_file, tmp_path, BOARD.points()[view.ids], view.pixels))
    (first,), (second,) = board.poses.estimates.values(), points.poses.estimates.values()
    np.testing.assert_allclose(first.transform.matrix(), second.transform.matrix(), atol=1e-12)


def test_the_inverse_is_named_and_written_as_such(camera_file, tmp_path, seen):
    output = tmp_path / "poses.json"
    report = pnp(from_detections(camera_file, tmp_path, seen, output=output, inverse=True))
    written = json.loads(output.read_text("utf-8"))
    assert written["frames"] == "object_T_camera"
    for item, truth in zip(written["poses"], TRUTHS, strict=True):
        np.testing.assert_allclose(
            item["object_T_camera"]["translation"], truth.inverse().translation, atol=2e-3
        )  # 0.1 px at 900 px and 0.8 m: below 1 mm
    assert_within_five_sigma(next(iter(report.poses.estimates.values())), TRUTHS[0].inverse())


def test_a_given_noise_sets_the_covariance(camera_file, tmp_path, seen):
    small, large = (pnp(from_detections(camera_file, tmp_path, seen, noise_px=noise)) for noise in (0.1, 0.2))
    for image, estimate in small.poses.estimates.items():
        np.testing.assert_allclose(4 * estimate.covariance, large.poses.estimates[image].covariance, rtol=1e-9)
        assert estimate.freedom is None


def test_views_without_a_pose_are_listed_with_their_reason(camera_file, tmp_path, seen):
    good = seen.views[0]
    few = Detection("few.png", CAMERA.image_size, good.ids[:3], good.pixels[:3])
    small = Detection("small.png", (640, 480), good.ids, good.pixels / 2)
    empty = Detection.nothing("empty.png", CAMERA.image_size, "no board found")
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, (empty, few, small, good))))
    assert list(report.poses.estimates) == [good.image]
    assert report.poses.missing == {
        "empty.png": "no board found",
        "small.png": "the image has 640 x 480 pixels, the camera file is for 1280 x 960",
        "few.png": "a pose needs 4 different points or more, found 3",
    }
    assert report.failed == ("small.png", "few.png")  # an image without a board is a result


def test_without_any_pose_the_reason_is_raised_and_nothing_written(camera_file, tmp_path):
    empty = Detections(BOARD, (Detection.nothing("empty.png", CAMERA.image_size, "no board found"),))
    output = tmp_path / "poses.yaml"
    with pytest.raises(InsufficientData, match=r"empty\.png: no pose from 1 images; no board found"):
        pnp(from_detections(camera_file, tmp_path, empty, output=output))
    line = np.outer(np.arange(5), [0.1, 0, 0])
    pixels = CAMERA.project(line + np.array([0, 0, 2])).pixels
    with pytest.raises(InsufficientData, match="all 5 points lie on one line"):
        pnp(from_points(camera_file, tmp_path, line, pixels, output=output))
    assert not output.exists()


def test_a_board_without_a_size_gives_lengths_in_squares(camera_file, tmp_path, seen):
    unsized = Detections(replace(BOARD, square=None), seen.views)
    listener = Listener()
    report = pnp(from_detections(camera_file, tmp_path, unsized), listener)
    assert report.poses.unit == "squares"
    estimate = next(iter(report.poses.estimates.values()))
    np.testing.assert_allclose(estimate.transform.translation * 0.03, TRUTHS[0].translation, atol=2e-3)
    assert listener.warnings == []


def test_points_in_millimetres_draw_a_warning(camera_file, tmp_path, seen):
    view, listener = seen.views[0], Listener()
    pnp(from_points(camera_file, tmp_path, 1000 * BOARD.points()[view.ids], view.pixels), listener)
    assert len(listener.warnings) == 1
    assert "are the points in metres?" in listener.warnings[0]


def test_detections_of_several_cameras_need_the_name_of_one(camera_file, tmp_path, seen):
    left, right = (replace(seen.views[index], camera=name) for index, name in enumerate(("left", "right")))
    both = Detections(BOARD, (left, right))
    report = pnp(from_detections(camera_file, tmp_path, both, name="left"))
    assert list(report.poses.estimates) == [left.image]
    with pytest.raises(InvalidInput, match="of the cameras left, right; say which"):
        pnp(from_detections(camera_file, tmp_path, both))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "nothing to work on"),
        ({"points": "p.csv", "inputs": ("a.png",)}, "leave --board and the images out"),
        ({"inputs": ("a.csv", "b.png")}, "read alone"),
        ({"inputs": ("a.png",)}, "--board is needed"),
        ({"inputs": ("a.png",), "output": "poses.txt"}, "poses are written as"),
        ({"inputs": ("a.csv",), "output": "a.csv"}, "is an input and is not overwritten"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(camera_file, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    paths = {name: tmp_path / options[name] for name in ("points", "output") if name in options}
    with pytest.raises(InvalidInput, match=message):
        pnp(PnpOptions(camera_file, **{**options, **paths}))


def test_the_same_input_gives_the_same_bytes(camera_file, tmp_path, seen):
    contents = []
    for name in ("once.csv", "again.csv"):
        pnp(from_detections(camera_file, tmp_path, seen, output=tmp_path / name))
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]


def photographed(camera_T_board):
    """Return an image of the board, warped from its drawing; pinhole only."""
    scale, border = 2000, 2  # drawing's pixels per metre; squares of white around the pattern
    square = round(BOARD.square * scale)
    pattern = (np.indices((BOARD.rows + 1, BOARD.columns + 1)).sum(axis=0) % 2 * 255).astype(np.uint8)
    drawing = np.pad(np.kron(pattern, np.ones((square, square), np.uint8)), border * square, constant_values=255)
    first = (border + 1) * square - 0.5  # the first inner corner lies between pixels
    board_T_drawing = np.array([[1 / scale, 0, -first / scale], [0, 1 / scale, -first / scale], [0, 0, 1]])
    fx, fy, cx, cy = CAMERA.parameters[:4]
    columns = np.column_stack([camera_T_board.rotation[:, :2], camera_T_board.translation])
    homography = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) @ columns @ board_T_drawing
    return cv2.warpPerspective(drawing, homography, CAMERA.image_size, flags=cv2.INTER_AREA, borderValue=200)


def test_images_give_the_poses_of_the_board_in_them(tmp_path):
    pinhole = Camera(model_named("pinhole"), CAMERA.image_size, CAMERA.parameters[:4])
    native.write(tmp_path / "camera.yaml", CameraFile({"cam": CameraEntry(pinhole)}))
    for index, truth in enumerate(TRUTHS):
        cv2.imwrite(str(tmp_path / f"{index}.png"), photographed(truth))
    cv2.imwrite(str(tmp_path / "2.png"), np.full((960, 1280), 200, np.uint8))
    report = pnp(
        PnpOptions(str(tmp_path / "camera.yaml"), board="chessboard:9x6:30mm", inputs=(str(tmp_path),), jobs=1)
    )
    middle = BOARD.points().mean(axis=0)
    assert len(report.poses.estimates) == 2
    for estimate, truth in zip(report.poses.estimates.values(), TRUTHS, strict=True):
        assert estimate.rms_px < 0.2
        # the middle, since the drawing here does not say at which end the numbers begin; 0.2 px at 0.8 m
        np.testing.assert_allclose(estimate.transform.apply(middle), truth.apply(middle), atol=1e-3)
    assert len(report.poses.missing) == 1
    assert report.failed == ()
