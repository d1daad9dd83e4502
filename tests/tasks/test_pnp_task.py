"""The task behind `camcal pnp`: where views come from, what is said of those without a pose, what is written."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import GateFailed, InsufficientData, InvalidInput
from camcal.estimate.poses.records import Correspondences
from camcal.formats import detections, native
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile
from camcal.formats.poses.record import PixelNoise, PoseKey
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.progress import Silent
from camcal.report import track_words
from camcal.simulate.scene import observe
from camcal.targets.board import Surface, parse_board
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.poses.pnp import Gates, PnpOptions, PriorOptions, pnp
from camcal.tasks.poses.pnp_observer import Observer
from camcal.tasks.poses.pnp_views import DetectionOptions, Observation

BOARD = parse_board("chessboard:9x6:30mm")
CAMERA = Camera(model_named("opencv5"), (1280, 960), [900.0, 905.0, 640.0, 480.0, -0.2, 0.05, 1e-3, 0.0, 0.0])
TRUTHS = (
    Pose.from_vector(np.array([0.3, -0.2, 0.1]), np.array([-0.1, -0.08, 0.6])),
    Pose.from_vector(np.array([-0.4, 0.3, 0.0]), np.array([-0.12, -0.05, 0.8])),
)


QUICK = {"outliers": "none"}  # most tests are about other things


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
    return PnpOptions(camera_file, inputs=(str(path),), **{**QUICK, **options})


def from_points(camera_file, tmp_path, points, pixels, **options):
    path = tmp_path / "points.csv"
    np.savetxt(path, np.column_stack([points, pixels]), "%.17g", ",", header="X,Y,Z,u,v", comments="")
    return PnpOptions(camera_file, points=path, **{**QUICK, **options})


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
    assert report.poses.noise.degrees_of_freedom == 2 * (108 - 6)  # shared by both views


def test_correspondences_give_the_same_pose_as_the_board(camera_file, tmp_path, seen):
    view = seen.views[0]
    board = pnp(from_detections(camera_file, tmp_path, replace(seen, views=(view,))))
    points = pnp(from_points(camera_file, tmp_path, BOARD.points()[view.ids], view.pixels))
    (first,), (second,) = board.poses.estimates.values(), points.poses.estimates.values()
    np.testing.assert_allclose(first.transform.matrix(), second.transform.matrix(), atol=1e-12)


def test_the_inverse_is_named_and_written_as_such(camera_file, tmp_path, seen):
    output = tmp_path / "poses.json"
    report = pnp(from_detections(camera_file, tmp_path, seen, output=output, pose="object_T_camera"))
    written = json.loads(output.read_text("utf-8"))
    assert written["frames"] == "object_T_camera"
    for item, truth in zip(written["poses"], TRUTHS, strict=True):
        np.testing.assert_allclose(
            item["object_T_camera"]["translation"], truth.inverse().translation, atol=2e-3
        )  # 0.1 px at 900 px and 0.8 m: below 1 mm
    assert_within_five_sigma(next(iter(report.poses.estimates.values())), TRUTHS[0].inverse())


def test_a_given_noise_sets_the_covariance(camera_file, tmp_path, seen):
    small, large = (pnp(from_detections(camera_file, tmp_path, seen, noise_px=noise)) for noise in (0.1, 0.2))
    for pose_key, estimate in small.poses.estimates.items():
        np.testing.assert_allclose(4 * estimate.covariance, large.poses.estimates[pose_key].covariance, rtol=1e-9)
    assert small.poses.noise.degrees_of_freedom is None


def test_views_without_a_pose_are_listed_with_their_reason(camera_file, tmp_path, seen):
    good = seen.views[0]
    few = BoardDetection("few.png", CAMERA.image_size, good.ids[:3], good.pixels[:3])
    small = BoardDetection("small.png", (640, 480), good.ids, good.pixels / 2)
    empty = BoardDetection("empty.png", CAMERA.image_size, reason="no board found")
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, (empty, few, small, good))))
    assert list(report.poses.estimates) == [(good.image, "")]
    assert {pose_key.image: reason for pose_key, reason in report.poses.missing.items()} == {
        "empty.png": "no board found",
        "small.png": "the image has 640 x 480 pixels, the camera file is for 1280 x 960; if the images were resized, "
        "not cropped, give --scale-intrinsics",
        "few.png": "a pose needs 4 different points or more, found 3",
    }
    assert report.failed == ("small.png", "few.png")  # an image without a board is a result


def test_without_any_pose_the_reason_is_raised_and_nothing_written(camera_file, tmp_path):
    empty = Detections(BOARD, (BoardDetection("empty.png", CAMERA.image_size, reason="no board found"),))
    output = tmp_path / "poses.yaml"
    with pytest.raises(InsufficientData, match=r"empty\.png: no pose from 1 image; no board found"):
        pnp(from_detections(camera_file, tmp_path, empty, output=output))
    line = np.outer(np.arange(5), [0.1, 0, 0])
    pixels = CAMERA.project(line + np.array([0, 0, 2])).pixels
    with pytest.raises(InsufficientData, match="all 5 points are collinear"):
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
    assert "check that the points are in metres" in listener.warnings[0].text


def test_detections_of_several_cameras_need_the_name_of_one(camera_file, tmp_path, seen):
    left, right = (replace(seen.views[index], camera=name) for index, name in enumerate(("left", "right")))
    both = Detections(BOARD, (left, right))
    report = pnp(from_detections(camera_file, tmp_path, both, name="left"))
    assert list(report.poses.estimates) == [(left.image, "")]
    with pytest.raises(InvalidInput, match="of the cameras left, right; choose one"):
        pnp(from_detections(camera_file, tmp_path, both))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "no input: give --points FILE"),
        ({"points": "p.csv", "inputs": ("a.png",)}, "--points excludes --board, --tags and images"),
        (
            {"points": "p.csv", "detection": DetectionOptions(scale=True)},
            "--scale-intrinsics needs images, not a file of points",
        ),
        (
            {"inputs": ("a.png",), "detection": DetectionOptions(board="b", tags="t")},
            "--board and --tags exclude each other",
        ),
        ({"inputs": ("a.csv",), "detection": DetectionOptions(tags="tag36h11:5cm")}, "tags are found in images"),
        ({"inputs": ("a.csv",), "outliers": "lots"}, "'--outliers': 'lots'"),
        ({"inputs": ("a.csv", "b.png")}, "a detections file cannot be combined with other inputs"),
        ({"inputs": ("a.png",)}, "no board or tags given: set --board"),
        ({"inputs": ("a.png",), "output": "poses.txt"}, "is not written; use .yaml"),
        ({"inputs": ("a.csv",), "output": "a.csv"}, "is an input and is not overwritten"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(camera_file, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("a.csv").touch()
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
    detection = DetectionOptions("chessboard:9x6:30mm", jobs=1)
    drawn = tmp_path / "drawn"
    report = pnp(
        PnpOptions(str(tmp_path / "camera.yaml"), inputs=(str(tmp_path),), detection=detection, draw=drawn, **QUICK)
    )
    middle = BOARD.points().mean(axis=0)
    assert len(report.poses.estimates) == 2
    for estimate, truth in zip(report.poses.estimates.values(), TRUTHS, strict=True):
        assert estimate.rms_px < 0.2
        # the middle, since the drawing here does not say at which end the numbers begin; 0.2 px at 0.8 m
        np.testing.assert_allclose(estimate.transform.apply(middle), truth.apply(middle), atol=1e-3)
    assert len(report.poses.missing) == 1
    assert report.failed == ()
    assert report.pictures == (drawn / "0_pose.png", drawn / "1_pose.png")
    picture = cv2.imread(str(report.pictures[0]))
    assert picture.shape[1] == 1280
    assert picture.shape[0] > 960  # words below
    assert np.ptp(picture, axis=2).max() > 100  # axes are in colour


def resized_views(seen, scale):
    size = tuple(int(side * scale) for side in CAMERA.image_size)
    views = tuple(replace(view, size=size, pixels=(view.pixels + 0.5) * scale - 0.5) for view in seen.views)
    return Detections(BOARD, views)


def test_resized_images_are_refused_with_the_way_out_and_taken_with_it(camera_file, tmp_path, seen):
    halved = resized_views(seen, 0.5)
    with pytest.raises(InvalidInput, match=r"view0000\.png: the image has 640 x 480 pixels.*give --scale-intrinsics"):
        pnp(from_detections(camera_file, tmp_path, halved))
    report = pnp(from_detections(camera_file, tmp_path, halved, detection=DetectionOptions(scale=True)))
    full = pnp(from_detections(camera_file, tmp_path, seen))
    for pose_key, estimate in report.poses.estimates.items():
        # the tangential coefficients and the scaling are exact, only the solver stops elsewhere
        np.testing.assert_allclose(
            estimate.transform.matrix(), full.poses.estimates[pose_key].transform.matrix(), atol=1e-6
        )


def test_cropped_images_need_another_camera(camera_file, tmp_path, seen):
    cropped = Detections(BOARD, tuple(replace(view, size=(1280, 720)) for view in seen.views))
    with pytest.raises(InvalidInput, match="are not resized images of 1280 x 960"):
        pnp(from_detections(camera_file, tmp_path, cropped, detection=DetectionOptions(scale=True)))


def bent_file(tmp_path, bow):
    surface = replace(Surface.flat(BOARD), tiers=("bow",), terms=("P2(x)",), coefficients=[bow], covariance=[[1e-12]])
    path = tmp_path / "bent.yaml"
    native.write(path, CameraFile({"left": CameraEntry(CAMERA)}, board_shape=replace(surface, deflection=abs(bow))))
    return str(path), surface


def test_a_board_is_taken_in_the_shape_that_the_camera_file_has(tmp_path):
    path, surface = bent_file(tmp_path, 0.004)
    pixels = CAMERA.project(TRUTHS[0].apply(surface.points())).pixels
    view = BoardDetection("a.png", CAMERA.image_size, np.arange(BOARD.count), pixels)
    found = Detections(BOARD, (view,))
    bent = pnp(from_detections(path, tmp_path, found))
    flat = pnp(from_detections(path, tmp_path, found, detection=DetectionOptions(board_shape=False)))
    assert bent.lines == ("board shape from the camera file, deflection 4 mm",)
    assert bent.poses.estimates["a.png", ""].rms_px < 1e-5  # the file's 12 digits
    assert flat.poses.estimates["a.png", ""].rms_px > 0.2  # 4 mm at 0.6 m
    other = replace(BOARD, square=0.025)
    away = pnp(from_detections(path, tmp_path, Detections(other, (view,))))
    assert "other_board_shape" in [warning.code for warning in away.warnings]


def test_undistorted_pixels_given_to_a_distorted_camera_are_noticed(camera_file, tmp_path):
    pinhole = Camera(model_named("pinhole"), CAMERA.image_size, CAMERA.parameters[:4])
    close = Pose.from_vector(np.array([0.2, 0.3, 0.0]), np.array([-0.12, -0.08, 0.25]))
    found, _ = observe(pinhole, BOARD, [close, close], rng=np.random.default_rng(3), noise_px=0.1)
    listener = Listener()
    pnp(from_detections(camera_file, tmp_path, found), listener)
    assert "already_undistorted" in [warning.code for warning in listener.warnings]


def test_distorted_pixels_draw_no_such_warning(camera_file, tmp_path, seen):
    listener = Listener()
    pnp(from_detections(camera_file, tmp_path, seen), listener)
    assert listener.warnings == []


def test_points_in_two_units_are_noticed(camera_file, tmp_path, seen):
    view, listener = seen.views[0], Listener()
    points = BOARD.points()[view.ids]
    points[:10] *= 1000
    pnp(from_points(camera_file, tmp_path, points, view.pixels), listener)
    assert "mixed_units" in [warning.code for warning in listener.warnings]


def test_images_in_two_units_are_noticed(camera_file, tmp_path, seen):
    listener, path = Listener(), tmp_path / "points.csv"
    rows = [
        f"{view.image},{','.join(map(str, [*(scale * point), *pixel]))}"
        for view, scale in zip(seen.views, (1.0, 1000.0), strict=True)
        for point, pixel in zip(BOARD.points()[view.ids], view.pixels, strict=True)
    ]
    path.write_text("image,X,Y,Z,u,v\n" + "\n".join(rows))
    pnp(PnpOptions(camera_file, points=path, **QUICK), listener)
    assert any(
        "view0001.png span 283 m, those of view0000.png 0.283 m" in warning.text for warning in listener.warnings
    )


def test_a_noise_from_few_residuals_is_said_to_be_one(camera_file, tmp_path, seen):
    view, listener = seen.views[0], Listener()
    few = [0, 8, 45, 53]
    pnp(from_points(camera_file, tmp_path, BOARD.points()[few], view.pixels[few]), listener)
    assert any("from 2 degrees of freedom only" in warning.text for warning in listener.warnings)


def test_residuals_that_exceed_the_given_noise_are_noticed(camera_file, tmp_path, seen):
    listener = Listener()
    pnp(from_detections(camera_file, tmp_path, seen, noise_px=0.02), listener)
    assert "residuals_exceed_noise" in [warning.code for warning in listener.warnings]


@pytest.mark.parametrize(("focal", "warned"), [(900.0, False), (990.0, True)])
def test_a_camera_file_of_another_camera_of_the_same_image_size_is_noticed(tmp_path, seen, focal, warned):
    own = replace(CAMERA, parameters=np.array([focal, focal + 5.0, 660.0 if warned else 640.0, *CAMERA.parameters[3:]]))
    path, listener = tmp_path / "camera.yaml", Listener()
    native.write(path, CameraFile({"left": CameraEntry(own, noise=CalibrationNoise(0.1, 400, model_error_px=0.0))}))
    known = np.tile(0.01 * np.eye(2), (len(BOARD.points()), 1, 1))
    views = tuple(replace(view, covariance=known[view.ids]) for view in seen.views)
    report = pnp(from_detections(str(path), tmp_path, replace(seen, views=views), outliers="few"), listener)
    codes = [warning.code for warning in listener.warnings]
    assert ("other_camera" in codes) == warned
    if warned:
        with pytest.raises(GateFailed, match="another camera"):
            report.require_good(Gates(require="consistent"))
    else:
        report.require_good(Gates(require="consistent"))


def test_a_given_sigma_is_taken_at_its_word(camera_file, tmp_path, seen):
    view, path = seen.views[0], tmp_path / "points.csv"
    table = np.column_stack([BOARD.points()[view.ids], view.pixels, np.full(len(view.ids), 0.3)])
    np.savetxt(path, table, "%.17g", ",", header="X,Y,Z,u,v,sigma", comments="")
    given, scaled = (pnp(PnpOptions(camera_file, points=path, **QUICK, noise_scale=scale)) for scale in (None, 2.0))
    plain = pnp(from_points(camera_file, tmp_path, *np.split(table[:, :5], [3], axis=1), noise_px=0.3))
    one, double, two = (next(iter(report.poses.estimates.values())) for report in (given, scaled, plain))
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-6)
    np.testing.assert_allclose(double.covariance, 4 * one.covariance, rtol=1e-6)
    assert given.poses.noise.scale == 1
    assert given.poses.noise.sigma_px == pytest.approx(0.3)
    path.write_text(path.read_text().replace("sigma", "weight"))
    weighted = pnp(PnpOptions(camera_file, points=path, **QUICK))
    assert weighted.poses.noise.degrees_of_freedom == 102
    with pytest.raises(InvalidInput, match="--noise-scale needs pixels with standard deviations; set --noise PX"):
        pnp(PnpOptions(camera_file, points=path, **QUICK, noise_scale="auto"))


def test_noise_is_pixels_also_where_corners_have_covariances(camera_file, tmp_path, seen):
    known = tuple(replace(view, covariance=np.tile(1e-4 * np.eye(2), (len(view.ids), 1, 1))) for view in seen.views)
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, known), outliers="few", noise_px=0.15))
    assert [record.n_inliers for record in report.poses.estimates.values()] == [54, 54]
    assert report.poses.noise == PixelNoise(0.15)
    with pytest.raises(InvalidInput, match="exclude each other"):
        pnp(from_detections(camera_file, tmp_path, seen, noise_px=0.1, noise_scale=2.0))


def test_a_pose_from_fewer_than_half_of_the_points_is_flagged(camera_file, tmp_path, seen):
    known = tuple(replace(view, covariance=np.tile(1e-4 * np.eye(2), (len(view.ids), 1, 1))) for view in seen.views)
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, known), outliers="few", noise_scale=0.5))
    for pose_key, record in report.poses.estimates.items():
        assert record.n_inliers < 27
        assert record.status == f"weak: {record.n_inliers} of 54 inliers, fewer than half"
        assert track_words.row(report.poses, pose_key, record)[-1] == record.status


def shaken(found, std_px, claimed_px, seed=5):
    """Return detections with noise added to their pixels, and covariances that claim some of it."""
    rng = np.random.default_rng(seed)
    views = (
        replace(
            view,
            pixels=view.pixels + std_px * rng.standard_normal(view.pixels.shape),
            covariance=np.tile(claimed_px**2 * np.eye(2), (len(view.ids), 1, 1)),
        )
        for view in found.views
    )
    return Detections(found.board, tuple(views))


def test_the_model_error_of_the_camera_file_counts_beside_what_corners_say(camera_file, tmp_path, seen):
    found = shaken(seen, 0.4, 0.05)  # on top of 0.1 px
    bare = pnp(from_detections(camera_file, tmp_path, found, outliers="few"))
    assert bare.poses.noise.scale == pytest.approx(0.41 / 0.05, rel=0.2)
    assert "x the corner standard deviations (a-posteriori scale" in track_words.noise(bare.poses)
    native.write(Path(camera_file), CameraFile({"left": CameraEntry(CAMERA, noise=CalibrationNoise(0.41, 3000, 0.4))}))
    known = pnp(from_detections(camera_file, tmp_path, found, outliers="few"))
    assert known.poses.noise.scale == pytest.approx(1.0, rel=0.2)
    assert known.poses.noise.sigma_px == pytest.approx(0.41, rel=0.2)
    assert "a-posteriori" not in track_words.noise(known.poses)
    given = pnp(from_detections(camera_file, tmp_path, found, outliers="few", noise_px=0.1))
    assert given.poses.noise == PixelNoise(0.1)


def test_the_model_error_follows_the_size_of_the_images(tmp_path):
    camera = replace(CAMERA, image_size=(640, 480))
    observer = Observer.of_camera(CAMERA, CalibrationNoise(0.3, 100, 0.2)).resized({None: camera}, None)
    view = Correspondences("a", BOARD.points(), np.zeros((54, 2)), np.tile(0.01 * np.eye(2), (54, 1, 1)))
    (found,) = observer.with_model_errors([Observation(PoseKey("a"), (view, view.alike()), (np.arange(54),))])
    np.testing.assert_allclose(found.views[0].covariance, np.tile(0.02 * np.eye(2), (54, 1, 1)))
    assert found.views[1].covariance is None


def test_outliers_are_named_by_their_ids(camera_file, tmp_path, seen):
    view = seen.views[0]
    pixels = view.pixels.copy()
    pixels[[4, 40]] += 25.0
    found = Detections(BOARD, (replace(view, pixels=pixels),))
    report = pnp(from_detections(camera_file, tmp_path, found, outliers="few", threshold_px=1.0))
    (estimate,) = report.poses.estimates.values()
    assert estimate.outliers == (4, 40)
    assert (estimate.n_points, estimate.n_inliers) == (54, 52)
    assert_within_five_sigma(estimate, TRUTHS[0])


def test_gates_name_the_image_and_the_figure(camera_file, tmp_path, seen):
    report = pnp(from_detections(camera_file, tmp_path, seen))
    report.require_good(Gates(max_rms=1.0, max_ambiguity=0.5, min_inliers=54))
    with pytest.raises(
        GateFailed, match=r"^--max-rms: view0000\.png: reprojection RMS 0\.1\d+ px \(limit 0\.01 px\)\nview0001\.png: "
    ):
        report.require_good(Gates(max_rms=0.01))
    with pytest.raises(GateFailed, match=r"--min-inliers: view0000\.png: 54 of 54 points are inliers \(limit 55\)"):
        report.require_good(Gates(min_inliers=55))


def test_a_prior_fills_in_what_three_points_leave_open(camera_file, tmp_path, seen):
    view, few = seen.views[0], [0, 8, 45]
    near = tmp_path / "near.txt"
    np.savetxt(near, TRUTHS[0].matrix(), "%.17g")
    prior = PriorOptions(near, (0.02, 0.1))
    options = from_points(camera_file, tmp_path, BOARD.points()[few], view.pixels[few], noise_px=0.1)
    with pytest.raises(InsufficientData, match="4 different points"):
        pnp(options)
    report = pnp(replace(options, prior=prior))
    (estimate,) = report.poses.estimates.values()
    assert_within_five_sigma(estimate, TRUTHS[0])
    turned = tmp_path / "turned.txt"
    np.savetxt(turned, TRUTHS[0].inverse().matrix(), "%.17g")
    inverse = replace(options, prior=PriorOptions(turned, (0.02, 0.1)), pose="object_T_camera")
    (other,) = pnp(inverse).poses.estimates.values()
    np.testing.assert_allclose(
        other.transform.inverse().translation, estimate.transform.translation, atol=2e-4
    )  # the same prior but for the frame in which it is isotropic


def test_a_pose_file_is_a_prior_with_its_own_covariance(camera_file, tmp_path, seen):
    view = seen.views[0]
    more = {"noise_px": 0.1, "output": tmp_path / "first.yaml"}
    first = from_detections(camera_file, tmp_path, Detections(BOARD, (view,)), **more)
    (known,) = pnp(first).poses.estimates.values()
    again = replace(first, output=None, prior=PriorOptions(tmp_path / "first.yaml"))
    (twice,) = pnp(again).poses.estimates.values()
    ratio = np.diag(twice.covariance) / np.diag(known.covariance)
    np.testing.assert_allclose(ratio, 0.5, rtol=1e-3)  # the same knowledge twice, to first order
    two = from_detections(camera_file, tmp_path, seen, output=tmp_path / "two.yaml")
    pnp(two)
    with pytest.raises(InvalidInput, match="holds 2 poses; a prior is one"):
        pnp(replace(again, prior=PriorOptions(tmp_path / "two.yaml")))


def test_pictures_of_images_with_one_name_are_told_apart_by_their_folders(camera_file, tmp_path, seen):
    views = tuple(replace(view, image=f"{name}/1.png") for view, name in zip(seen.views, "ab", strict=True))
    drawn = tmp_path / "drawn"
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, views), draw=drawn))
    assert report.pictures == (drawn / "a_1_pose.png", drawn / "b_1_pose.png")


def test_the_picture_of_one_image_may_go_to_a_file(camera_file, tmp_path, seen):
    one = tmp_path / "one.jpg"
    report = pnp(from_detections(camera_file, tmp_path, Detections(BOARD, seen.views[:1]), draw=one))
    assert report.pictures == (one,)
    assert one.is_file()
    with pytest.raises(InvalidInput, match="2 inputs cannot be written to one file; give a folder"):
        pnp(from_detections(camera_file, tmp_path, Detections(BOARD, seen.views[:2]), draw=one))


def test_a_picture_never_takes_the_place_of_an_image(camera_file, tmp_path, seen, monkeypatch):
    monkeypatch.chdir(tmp_path)
    views = tuple(replace(view, image=name) for view, name in zip(seen.views, ("1.png", "1_pose.png"), strict=True))
    save(tmp_path / "1_pose.png", np.zeros((4, 4), np.uint8))
    with pytest.raises(InvalidInput, match=r"1_pose\.png: is an input and is not overwritten"):
        pnp(from_detections(camera_file, tmp_path, Detections(BOARD, views), draw=tmp_path, overwrite=True))


def test_frames_of_a_video_have_poses_and_pictures(tmp_path):
    pinhole = Camera(model_named("pinhole"), CAMERA.image_size, CAMERA.parameters[:4])
    native.write(tmp_path / "camera.yaml", CameraFile({"cam": CameraEntry(pinhole)}))
    video = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 10, CAMERA.image_size)
    for truth in TRUTHS:
        writer.write(cv2.cvtColor(photographed(truth), cv2.COLOR_GRAY2BGR))
    writer.release()
    detection = DetectionOptions("chessboard:9x6:30mm", jobs=1)
    camera = str(tmp_path / "camera.yaml")
    report = pnp(PnpOptions(camera, inputs=(str(video),), detection=detection, draw=tmp_path / "drawn", **QUICK))
    names = [(tmp_path / f"clip_{number:06d}").as_posix() for number in (0, 1)]
    assert [pose_key.image for pose_key in report.poses.estimates] == names
    assert [path.name for path in report.pictures] == ["clip_000000_pose.png", "clip_000001_pose.png"]
    assert cv2.imread(str(report.pictures[0]))[:960].std() > 20  # the frame is behind the marks, not plain gray
