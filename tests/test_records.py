"""What records show of themselves in a notebook, what they say of names that do not exist, and their documents."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from report_scenes import SCENES, detections_of

import camcal
from camcal import records
from camcal.cli.show import plain
from camcal.progress import Outcome, failed_items
from camcal.records import ELSEWHERE, MERGED, OMITTED, Brief, entry

LONGEST = 500


@pytest.fixture(scope="module")
def results():
    """What the functions of the library return."""
    report = camcal.calibrate_camera(detections_of(SCENES["good"], 12))
    camera = report.camera
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (60, 108), np.uint8)
    disparity = camcal.match_pair(texture[:, :100], texture[:, 8:], camcal.MatchOptions(search=(0, 32)))
    points = rng.normal(0, 0.1, (20, 3))
    pose = camcal.Pose.from_vector([0.1, 0.2, 0.0], [0.0, 0.0, 1.0])
    pixels = camera.project(pose.apply(points)).pixels
    estimate = camcal.estimate_pose(camera, points, pixels)
    return report, disparity, estimate, pose, camera


def reachable(value, seen):
    """Yield the records of camcal that an object holds, itself included, each class once."""
    if is_dataclass(value) and not isinstance(value, type):
        if type(value) not in seen and type(value).__module__.startswith("camcal."):
            seen.add(type(value))
            yield value
            for own in fields(value):
                yield from reachable(getattr(value, own.name), seen)
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from reachable(each, seen)
    elif isinstance(value, (tuple, list)):
        for each in value[:3]:
            yield from reachable(each, seen)


def test_no_record_that_a_result_holds_fills_a_screen(results):
    every = list(reachable(results, set()))
    assert len(every) > 20
    assert {type(each).__name__: len(repr(each)) for each in every if len(repr(each)) > LONGEST} == {}
    assert {type(each).__name__ for each in every if "\n" in repr(each)} == set()


def test_every_public_record_has_a_short_repr():
    records = [found for name in camcal.__all__ if is_dataclass(found := getattr(camcal, name))]
    assert len(records) > 40
    assert [record.__name__ for record in records if not issubclass(record, Brief)] == []


def test_reprs_have_values_with_units_and_leave_out_what_is_usual(results):
    report, *_, pose, camera = results
    assert repr(report).startswith("<CalibrateReport: trustworthy; Lens model opencv5, fx 1001.")
    assert " px; Projection uncertainty (1 sigma, at infinity): RMS 0." in repr(report)
    assert repr(pose) == "Pose(translation=(0, 0, 1) m, rotation_vector=(0.1, 0.2, 0) rad)"
    assert repr(camera).startswith("Camera(opencv5, 1280x960 px, fx=1001.")
    assert repr(camcal.MatchOptions(search=(0, 32))) == "MatchOptions(search=(0, 32))"


@pytest.mark.parametrize("name", ["undistort_points", "plot", "uncertainty_at"])
def test_a_name_that_people_look_for_in_the_package_is_answered(name):
    with pytest.raises(AttributeError, match="module 'camcal' has no attribute") as caught:
        getattr(camcal, name)
    assert str(caught.value).endswith(f"; use {ELSEWHERE[name]}")


def test_imports_of_modules_do_not_wait_for_a_search_of_names_alike():
    code = "import camcal, sys; from camcal import records, urls; print('difflib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
    with pytest.raises(AttributeError, match=r"has no attribute 'stereo' before 'import camcal\.stereo'"):
        camcal.__getattr__("stereo")


def test_a_name_that_people_look_for_in_a_result_is_answered(results):
    report, camera = results[0], results[4]
    for owner, names in ((report, ("poses", "plot", "write_report", "rms")), (camera, ("save", "to_opencv"))):
        for name in names:
            with pytest.raises(AttributeError) as caught:
                getattr(owner, name)
            assert str(caught.value).endswith(f"; use {ELSEWHERE[name]}")
    with pytest.raises(AttributeError, match=r"'Camera' object has no attribute 'projct'\. Did you mean 'project'\?"):
        _ = camera.projct
    with pytest.raises(AttributeError, match=r"'camcal' has no attribute 'read_camra'\. Did you mean 'read_camera'\?"):
        _ = camcal.read_camra
    assert not hasattr(camera, "__array__")


def test_the_answers_hold(results, tmp_path):
    report, camera = results[0], results[4]
    camcal.write_camera_file(tmp_path / "camera.yaml", camera)
    np.testing.assert_allclose(camcal.read_camera(tmp_path / "camera.yaml").K, camera.K, rtol=1e-5)
    assert camera.dist.shape == (5,)
    assert isinstance(report.calibration.views[0].camera_T_board, camcal.Pose)
    assert report.calibration.rms_px > 0
    pixels = np.array([[700.0, 500.0], [30.0, 40.0]])
    np.testing.assert_allclose(camera.project(camera.unproject(pixels).directions).pixels, pixels, atol=1e-6)
    assert camera.project_with_jacobians(np.array([[0.1, 0.2, 1.0]])).d_point.shape == (1, 2, 3)


def test_a_single_point_is_refused_with_the_way_to_give_it(results):
    camera = results[4]
    with pytest.raises(camcal.InvalidInput, match=r"points has shape \(3,\), expected \(N, 3\); .* as points\[None\]"):
        camera.project([0.1, 0.2, 1.0])
    with pytest.raises(camcal.InvalidInput, match=r"shape \(4,\), expected \(N, 3\)$"):
        camera.project([0.1, 0.2, 1.0, 1.0])


def test_the_uncertainty_at_a_pixel_is_that_of_the_map(results):
    found = results[0].uncertainty
    camera, calibration = results[0].camera, results[0].calibration
    at = camcal.projection_covariances(camera, found.pixels[[0, 300]], calibration.pixels)
    np.testing.assert_allclose(at, found.covariances[[0, 300]], rtol=1e-6)
    everywhere = np.sqrt(np.trace(camcal.projection_covariances(camera, found.pixels), axis1=1, axis2=2) / 2)
    np.testing.assert_allclose(camera.projection_std(found.pixels), everywhere)
    assert camera.projection_std(found.pixels[7]) == pytest.approx(everywhere[7])
    with pytest.raises(camcal.InvalidInput, match="needs the covariance of the camera"):
        replace(camera, covariance=None).projection_std([1.0, 2.0])


def test_a_pose_comes_from_its_matrix(results):
    pose = results[3]
    again = camcal.Pose.from_matrix(pose.matrix())
    np.testing.assert_array_equal(again.rotation, pose.rotation)
    np.testing.assert_array_equal(camcal.Pose.from_matrix(pose.matrix()[:3]).translation, pose.translation)
    for wrong in (np.eye(3), np.diag([1.0, 1.0, 1.0, 2.0])):
        with pytest.raises(camcal.InvalidInput, match="not a homogeneous matrix"):
            camcal.Pose.from_matrix(wrong)


@dataclass(frozen=True)
class Size:
    width: float = field(metadata=entry("width_mm", 1e3))
    depth: tuple[float, float] | None = field(default=None, metadata=entry("depth_m", parts=("min", "max")))


@dataclass(frozen=True)
class Part:
    name: str
    size: Size
    turned: tuple[float, float] = field(metadata=entry("turned_deg", (1.0, 2.0), parts=("x", "y")))
    inner: Size = field(metadata=MERGED)
    path: Path = Path("a") / "b"
    note: str = field(default="", metadata=OMITTED)


PART = Part("lens", Size(0.5), (3.0, 4.0), Size(0.25, (1.0, 2.0)), note="not said")


def test_a_document_has_the_names_units_and_order_that_the_fields_of_its_record_say():
    said = {
        "name": "lens",
        "size": {"width_mm": 500.0, "depth_m": None},
        "turned_deg": {"x": 3.0, "y": 8.0},
        "width_mm": 250.0,
        "depth_m": {"min": 1.0, "max": 2.0},
        "path": "a/b",
    }
    assert plain(PART) == said
    assert list(records.document(PART)) == list(said)
    assert plain({"parts": (PART,), "kind": np.float64(1)}) == {"parts": [said], "kind": 1.0}


def test_figures_are_the_fields_that_say_how_they_are_written():
    assert records.figures(PART.inner) == {"width_mm": 250.0, "depth_m": {"min": 1.0, "max": 2.0}}
    assert list(records.entries(Size)) == ["width", "depth"]


def test_items_that_failed_are_named_with_their_errors():
    error = camcal.FileError("is empty")
    outcomes = [Outcome(Path("a"), 1), Outcome(Path("b"), error=error), Outcome((Path("c"), Path("d")), error=error)]
    assert failed_items(outcomes[:2], "source") == [{"source": Path("b"), "message": "is empty"}]
    assert failed_items(outcomes[2:], "left", "right") == [
        {"left": Path("c"), "right": Path("d"), "message": "is empty"}
    ]
