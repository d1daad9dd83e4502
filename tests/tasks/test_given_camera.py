"""Cameras that are given as numbers, or by a file that does not say the size of its images."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import cameras, detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.images.options import ViewOptions
from camcal.options import command_line, declared
from camcal.simulate.scene import observe
from camcal.targets.board import parse_board
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort, undistort_points
from camcal.tasks.given_camera import camera_of
from camcal.tasks.options import GivenCamera, ImagePart
from camcal.tasks.poses.options import PnpOptions
from camcal.tasks.poses.pnp import pnp
from camcal.tasks.poses.smooth_options import TrackingOptions
from camcal.tasks.stereo.options import GeometryOptions
from camcal.tasks.stereo.rectified_pair import geometry_of

SIZE = (128, 96)
MATRIX, DISTORTION = (90.0, 90.5, 64.0, 47.0), (-0.1, 0.01, 1e-3, 0.0)
LENS = Camera(model_named("opencv4"), SIZE, [*MATRIX, *DISTORTION])
GIVEN = GivenCamera(MATRIX, DISTORTION)
BOARD = parse_board("chessboard:9x6:30mm")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in with an image, a camera file, and an OpenCV file that says no size."""
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "a.png", np.random.default_rng(0).integers(0, 255, (96, 128, 3), dtype=np.uint8))
    native.write(tmp_path / "camera.yaml", CameraFile({"camera": CameraEntry(LENS)}))
    matrix = f"K: {LENS.K.tolist()}\nD: {[*DISTORTION]}\n"
    (tmp_path / "bare.yml").write_text(matrix)
    return tmp_path


def test_undistort_gives_the_same_image_whichever_way_the_camera_is_given(folder):
    undistort(UndistortOptions("camera.yaml", folder / "file", ("a.png",)))
    undistort(UndistortOptions("bare.yml", folder / "bare", ("a.png",), GivenCamera(model="opencv4")))
    options = UndistortOptions("a.png", folder / "given", given=GIVEN)
    undistort(options)
    expected = (folder / "file" / "a.png").read_bytes()
    assert (folder / "bare" / "a.png").read_bytes() == expected
    assert (folder / "given" / "a.png").read_bytes() == expected
    provenance = cameras.read(folder / "given" / "camera.yaml").provenance
    assert provenance["command"].endswith("--camera-matrix 90,90.5,64,47 --distortion -0.1,0.01,0.001,0")
    assert provenance["camera"] == {"name": "camera", "given_by": "--camera-matrix"}


def test_points_need_a_size_where_no_image_has_one(folder):
    (folder / "points.csv").write_text("u,v\n10,20\n64,47\n")
    options = {"given": GIVEN, "points": folder / "points.csv"}
    with pytest.raises(InvalidInput, match="--camera-matrix: for which size of images"):
        undistort_points(UndistortOptions(None, folder / "out.csv", **options))
    report = undistort_points(UndistortOptions(None, folder / "out.csv", view=ViewOptions(size=SIZE), **options))
    assert report.count == 2


def test_pnp_gives_the_same_poses_whichever_way_the_camera_is_given(folder):
    truth = Pose.from_vector(np.array([0.3, -0.2, 0.1]), np.array([-0.1, -0.08, 0.6]))
    found, _ = observe(LENS, BOARD, (truth,), rng=np.random.default_rng(1), noise_px=0.1)
    detections.write(folder / "seen.csv", found)
    by_file = pnp(PnpOptions("camera.yaml", inputs=("seen.csv",), outliers="none"))
    given = GivenCamera(MATRIX, DISTORTION, SIZE)
    by_numbers = pnp(PnpOptions("seen.csv", given, outliers="none"))
    first, second = (next(iter(each.poses.estimates.values())).transform for each in (by_file, by_numbers))
    assert np.array_equal(first.matrix(), second.matrix())
    with pytest.raises(InvalidInput, match="for which size of images"):
        pnp(PnpOptions("seen.csv", GIVEN))


def test_a_camera_given_twice_or_not_at_all_is_refused(folder):
    twice = "camera.yaml and --camera-matrix are two cameras; leave one of them out"
    for record in (PnpOptions, UndistortOptions):
        with pytest.raises(InvalidInput, match=twice):
            record("camera.yaml", inputs=("a.png",), given=GIVEN)
        with pytest.raises(InvalidInput, match="no camera: give"):
            record(None)
    with pytest.raises(InvalidInput, match=twice):
        TrackingOptions(("camera.yaml", "a.png"), GIVEN)
    with pytest.raises(InvalidInput, match="--rig and --camera-matrix"):
        PnpOptions("a.png", GIVEN, rig=folder / "rig.yaml")
    with pytest.raises(InvalidInput, match="--distortion goes with --camera-matrix"):
        GivenCamera(distortion=DISTORTION)
    for run, options in ((pnp, PnpOptions("a.png")), (undistort, UndistortOptions("a.png", folder / "out"))):
        with pytest.raises(InvalidInput, match="is an image or video where a camera file is needed: put CAMERA first"):
            run(options)


def test_the_lens_model_of_the_coefficients():
    fisheye = camera_of(GivenCamera(MATRIX, DISTORTION, model="fisheye"), SIZE)
    assert (fisheye.model.name, fisheye.parameters.tolist()) == ("kannala_brandt4", [*MATRIX, *DISTORTION])
    assert camera_of(GivenCamera(MATRIX), SIZE).model.name == "pinhole"
    assert camera_of(GivenCamera(MATRIX, (0.1,) * 8), SIZE).model.name == "opencv8"
    for given, said in (
        (GivenCamera(MATRIX, (0.1,) * 3), "0, 4, 5, 8, 12, 14 distortion coefficients, found 3"),
        (GivenCamera(MATRIX, (0.1,) * 4, model="opencv5"), "opencv5 has k1,k2,p1,p2,k3, found 4 numbers"),
        (GivenCamera((-1.0, 1.0, 0.0, 0.0)), "positive focal lengths"),
    ):
        with pytest.raises(InvalidInput, match=said):
            camera_of(given, SIZE)


def test_a_rectified_pair_takes_a_camera_matrix_in_place_of_single_numbers():
    single = GeometryOptions(fx=90.0, fy=90.5, cx=64.0, cy=47.0, baseline=0.1)
    whole = GeometryOptions(given=GivenCamera(MATRIX, (0.0,) * 4, SIZE), baseline=0.1)
    assert geometry_of(whole, None, SIZE) == geometry_of(single, None, SIZE)
    with pytest.raises(InvalidInput, match="--camera-matrix and --fx are redundant"):
        GeometryOptions(given=GivenCamera(MATRIX), fx=90.0)
    with pytest.raises(InvalidInput, match="rectified images have none"):
        GeometryOptions(given=GIVEN)
    with pytest.raises(InvalidInput, match="128 × 96"):
        geometry_of(whole, None, (640, 480))


def test_the_command_line_says_all_of_it():
    whole = GivenCamera(MATRIX, DISTORTION, SIZE, "opencv4", ImagePart((64, 48, 3, 4), 2, (16, 12)))
    words = command_line("pnp", PnpOptions("a.png", whole))
    assert " ".join(words) == (
        "pnp a.png --camera-matrix 90,90.5,64,47 --distortion -0.1,0.01,0.001,0 --size 128x96 --model opencv4 "
        "--crop 64x48+3+4 --binning 2 --scale-to 16x12"
    )
    for each in declared(GivenCamera):
        value = each.of(whole)
        assert each.read(each.written(value)) == value
