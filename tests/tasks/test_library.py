"""The functions that programs call: arrays and files give the same numbers, and nothing is written unasked."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import camcal
from camcal.tasks.calibration.calibrate import calibrated, seen_of
from camcal.tasks.simulation.options import SimulateOptions
from camcal.tasks.simulation.simulate import simulate

BOARD = "chessboard:6x5:25mm"
OPTIONS = camcal.CalibrateOptions(model="opencv4", jobs=1)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return simulate(SimulateOptions(tmp_path_factory.mktemp("scene"), BOARD, views=8, size=(320, 240), jobs=1))


@pytest.fixture(scope="module")
def images(scene):
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in scene.images]


@pytest.fixture(scope="module")
def report(images):
    return camcal.calibrate_camera(images, BOARD, OPTIONS)


@pytest.mark.slow
def test_arrays_and_files_give_the_same_camera(scene, report):
    folder = str(scene.images[0].parent)
    from_files = camcal.calibrate_camera(folder, camcal.load_board(BOARD), OPTIONS)
    np.testing.assert_array_equal(from_files.camera.parameters, report.camera.parameters)
    np.testing.assert_array_equal(from_files.camera.covariance, report.camera.covariance)
    truth = scene.truth.camera
    off = np.abs(report.camera.K - truth.K)
    assert off.max() < 0.5


def test_arrays_have_the_names_of_their_places_and_leave_no_files(report, tmp_path, monkeypatch, images):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    found = camcal.detect_board(images[:2], BOARD, camcal.DetectOptions(jobs=1))
    assert [view.image for view in found.views] == ["images[0]", "images[1]"]
    assert [view.image for view in report.calibration.views] == [f"images[{index}]" for index in range(8)]
    assert list(tmp_path.iterdir()) == []


def test_detections_lead_to_the_calibration_without_refinement(images, report):
    found = camcal.detect_board(images, BOARD, camcal.DetectOptions(jobs=1))
    by_record = camcal.calibrate_camera(found, options=OPTIONS)
    by_views = camcal.calibrate_camera(found.views, BOARD, OPTIONS)
    np.testing.assert_array_equal(by_record.camera.parameters, by_views.camera.parameters)
    np.testing.assert_allclose(by_record.camera.K, report.camera.K, atol=0.5)


def test_locating_and_measuring_a_board_is_detecting_it(images):
    located = camcal.locate_board(images[0], BOARD)
    measured = camcal.measure_corners(images[0], BOARD, located)
    [detected] = camcal.detect_board(images[0], BOARD, camcal.DetectOptions(jobs=1)).views
    assert located.located
    assert located.covariance is None
    np.testing.assert_array_equal(measured.ids, detected.ids)
    np.testing.assert_array_equal(measured.pixels, detected.pixels)
    np.testing.assert_array_equal(measured.covariance, detected.covariance)
    assert measured.size == (320, 240)


def test_corners_of_another_program_are_measured_and_those_of_circles_are_not(images):
    [detected] = camcal.detect_board(images[0], BOARD, camcal.DetectOptions(jobs=1)).views
    rounded = camcal.BoardDetection(ids=detected.ids, pixels=np.rint(detected.pixels))
    measured = camcal.measure_corners(images[0], BOARD, rounded)
    off = np.linalg.norm(measured.pixels - detected.pixels[np.isin(detected.ids, measured.ids)], axis=1)
    assert len(off) > 0.9 * len(detected.ids)
    assert np.median(off) < 5e-3
    with pytest.raises(camcal.InvalidInput, match="checkerboard corners"):
        camcal.measure_corners(images[0], "circles:6x5:25mm", rounded)
    with pytest.raises(camcal.InvalidInput, match=r"ids 0 to 29: a .* has 0 to 11"):
        camcal.measure_corners(images[0], "chessboard:4x3:25mm", rounded)


def test_an_image_that_is_gone_when_corners_are_measured_costs_itself_only(scene, tmp_path):
    paths = [shutil.copy(path, tmp_path) for path in scene.images]
    board = camcal.load_board(BOARD)

    def look():
        seen = seen_of(replace(OPTIONS, inputs=tuple(paths)), board)
        (tmp_path / Path(paths[3]).name).unlink()
        return seen

    report = calibrated(look, OPTIONS)
    reasons = [view.reason for view in report.calibration.views]
    assert reasons[3] == "the image can no longer be read"
    assert reasons[:3] + reasons[4:] == [None] * 7


def test_views_without_a_board_are_refused(images):
    found = camcal.detect_board(images[:1], BOARD, camcal.DetectOptions(jobs=1))
    with pytest.raises(camcal.InvalidInput, match="the detections name no board"):
        camcal.calibrate_camera(found.views)


@pytest.mark.parametrize("given", [["a.png", np.zeros((9, 9), np.uint8)], [3, 4], ["a.png", None]])
def test_images_of_two_kinds_or_of_none_are_refused(given):
    with pytest.raises(camcal.InvalidInput, match="as files or as arrays"):
        camcal.detect_board(given, BOARD)


def test_a_board_that_is_none_is_refused(images):
    with pytest.raises(camcal.InvalidInput, match=r"\(6, 5\) is not a board: .* 'chessboard:9x6:25mm'"):
        camcal.detect_board(images, (6, 5))


def test_images_of_floating_point_are_refused(images):
    with pytest.raises(camcal.InvalidInput, match=r"images\[1\]: images are uint8 or uint16, found float64"):
        camcal.detect_board([images[0], images[1] / 255], BOARD)


def test_detections_are_a_sequence_of_views(images):
    found = camcal.detect_board(images[:2], BOARD, camcal.DetectOptions(jobs=1))
    assert len(found) == 2
    assert [view.image for view in found] == [found[0].image, found[1].image]


def test_a_camera_is_shown_by_its_parameters(report):
    assert repr(report.camera).startswith("Camera(opencv4, 320x240 px, fx=")


def test_a_camera_alone_is_written_and_read_back(report, tmp_path):
    camcal.write_camera_file(str(tmp_path / "camera.yaml"), report.camera)
    again = camcal.read_camera(tmp_path / "camera.yaml")
    np.testing.assert_allclose(again.parameters, report.camera.parameters, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("kind", ["opencv", "ros", "kalibr"])
def test_a_camera_is_written_for_other_programs(kind, report, tmp_path):
    camcal.write_camera_file(tmp_path / "camera.yaml", report.camera, kind)
    again = camcal.read_camera(str(tmp_path / "camera.yaml"))
    np.testing.assert_allclose(again.parameters[:8], report.camera.parameters, rtol=1e-12, atol=1e-15)


def test_an_unknown_kind_of_camera_file_is_refused(report, tmp_path):
    with pytest.raises(camcal.InvalidInput, match="Did you mean 'ros'"):
        camcal.write_camera_file(tmp_path / "camera.yaml", report.camera, "ross")


def test_an_undistorted_image_is_what_its_camera_sees(images, report):
    straight = camcal.undistort_image(images[0], report.camera)
    assert straight.pixels.shape == images[0].shape
    assert straight.camera.model.name == "pinhole"
    maps = camcal.build_maps(report.camera, straight.camera)
    np.testing.assert_array_equal(straight.pixels, maps.apply(images[0]))
    with pytest.raises(camcal.InvalidInput, match="the image is 10x10, the camera 320x240"):
        camcal.undistort_image(images[0][:10, :10], report.camera)


def test_one_pose_is_that_of_the_points(report):
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0], [0.05, 0.05, 0.1]])
    truth = camcal.Pose.from_vector([0.1, -0.2, 0.3], [0.02, -0.03, 0.8])
    pixels = report.camera.project(truth.apply(points)).pixels
    found = camcal.estimate_pose(report.camera, points.tolist(), pixels.tolist())
    np.testing.assert_allclose(found.transform.matrix(), truth.matrix(), atol=1e-6)
    with pytest.raises(camcal.InsufficientData):
        camcal.estimate_pose(report.camera, points[:2], pixels[:2])


def test_points_of_a_cloud_project_to_their_pixels():
    geometry = camcal.StereoGeometry(100.0, 110.0, 4.5, 3.5, baseline=0.1)
    disparity = np.full((8, 10), np.nan)
    disparity[2, 3], disparity[5, 7] = 5.0, 10.0
    image = np.arange(240, dtype=np.uint8).reshape(8, 10, 3)
    cloud = camcal.point_cloud(disparity, geometry, image)
    x, y, z = cloud.points.T
    np.testing.assert_allclose(z, [2.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(100 * x / z + 4.5, [3, 7], rtol=1e-5)
    np.testing.assert_allclose(110 * y / z + 3.5, [2, 5], rtol=1e-5)
    np.testing.assert_array_equal(cloud.colours, image[[2, 5], [3, 7], ::-1])
    assert camcal.point_cloud(disparity, geometry).colours is None


def test_a_cloud_of_a_match_holds_no_pixels_without_one():
    texture = np.random.default_rng(1).integers(0, 256, (60, 108), np.uint8)
    found = camcal.match_pair(texture[:, :100], texture[:, 8:], camcal.MatchOptions("fast", search=(0, 16)))
    cloud = camcal.point_cloud(found, camcal.StereoGeometry(100.0, 100.0, 50.0, 30.0, baseline=0.1))
    assert len(cloud.points) == np.count_nonzero(found.confidence >= camcal.Confidence.SINGLE)
    np.testing.assert_allclose(np.median(cloud.points[:, 2]), 100 * 0.1 / 8, rtol=1e-2)
