"""What stands beside a disparity map comes back, moves with its folder, and is refused where it is broken."""

import json

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import disparity_sidecar
from camcal.formats.disparity_sidecar import Sidecar, SourceFile
from camcal.stereo.depth_error import CalibrationError
from camcal.stereo.disparity import StereoGeometry

GEOMETRY = StereoGeometry(718.856, 718.9, 607.19, 185.2, 0.537, 1.5)


def everything(folder):
    return Sidecar(
        scale=256.0,
        invalid="0",
        geometry=GEOMETRY,
        image=folder / "images" / "left.png",
        sigma=folder / "map.sigma.tiff",
        confidence=folder / "map.confidence.png",
        searched=(-3, 80),
        matcher={"quality": "best", "p1": 8, "fill": None},
        inputs={"left": SourceFile(folder / "images" / "left.png", "ab" * 32)},
        camera_R_rectified=np.eye(3)[[1, 2, 0]],
        relative_sigma={"fx": 1e-5, "baseline": 2e-4},
    )


def test_everything_comes_back(tmp_path):
    map_file, given = tmp_path / "map.png", everything(tmp_path)
    disparity_sidecar.write(map_file, given)
    found = disparity_sidecar.read(map_file)
    for name in vars(given):
        if name != "camera_R_rectified":
            assert getattr(found, name) == getattr(given, name), name
    np.testing.assert_array_equal(found.camera_R_rectified, given.camera_R_rectified)


def test_a_view_about_the_baseline_and_the_error_of_its_calibration_come_back(tmp_path):
    geometry = StereoGeometry(300.0, 300.0, 400.0, 300.0, 0.1, 2.0, "latlon", "y")
    error = CalibrationError(np.array([0.0, 799.0]), np.array([0.0, 300.0, 599.0]), np.arange(18.0).reshape(3, 3, 2))
    disparity_sidecar.write(tmp_path / "map.tiff", Sidecar(geometry=geometry, calibration=error))
    found = disparity_sidecar.read(tmp_path / "map.tiff")
    assert found.geometry == geometry
    for name in ("columns", "rows", "variance"):
        np.testing.assert_array_equal(getattr(found.calibration, name), getattr(error, name))


def test_the_schema_stands_first_and_what_is_not_known_is_left_out(tmp_path):
    disparity_sidecar.write(tmp_path / "map.pfm", Sidecar(invalid="inf"))
    text = (tmp_path / "map.pfm.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"schema": "camcal/disparity/1", "scale": 1.0, "invalid": "inf"}
    assert text.startswith('{\n "schema"')


def test_paths_move_with_the_folder(tmp_path):
    before, after = tmp_path / "before", tmp_path / "after"
    before.mkdir()
    disparity_sidecar.write(before / "map.pfm", everything(before))
    assert str(tmp_path) not in (before / "map.pfm.json").read_text(encoding="utf-8")
    before.rename(after)
    assert disparity_sidecar.read(after / "map.pfm").image == after / "images" / "left.png"


def test_a_map_without_a_sidecar_has_none(tmp_path):
    assert disparity_sidecar.read(tmp_path / "map.pfm") is None


def test_the_rotation_cannot_be_changed(tmp_path):
    with pytest.raises(ValueError, match="read-only"):
        everything(tmp_path).camera_R_rectified[0, 0] = 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "camcal/disparity/2"}, "unknown schema 'camcal/disparity/2'"),
        ({"scale": 0}, "scale: 0 must be > 0"),
        ({"scale": None}, "scale: an empty value is not a number"),
        ({"invalid": "-1"}, "unknown code '-1'"),
        ({"geometri": {}}, "geometri: unknown key. Did you mean 'geometry'?"),
        ({"geometry": {"fx": 1, "fy": 1, "cx": 0, "baseline": 1}}, "geometry: missing key 'cy'"),
        ({"geometry": {"fx": "1", "fy": 1, "cx": 0, "cy": 0, "baseline": 1}}, "geometry.fx: '1'"),
        ({"image": 3}, "image: 3 is not text"),
        ({"searched": [0]}, "searched: 1 items; 2 are needed"),
        ({"inputs": {"left": {"path": "left.png"}}}, "inputs.left: missing key 'sha256'"),
        ({"camera_R_rectified": [[1, 0, 0]]}, "camera_R_rectified: 1 items"),
        ({"relative_sigma": {"fx": -1}}, "relative_sigma.fx: -1 is outside"),
        (
            {"geometry": {"fx": 1, "fy": 1, "cx": 0, "cy": 0, "baseline": 1, "axis": "z"}},
            "geometry.axis: unknown axis 'z'",
        ),
        ({"calibration": {"columns": [0], "rows": [0], "variance": [[[0]]]}}, "calibration.variance: 1 items; 3"),
        ({"calibration": {"columns": [0], "rows": [0], "variance": [[[0]], [[0]], [[0, 1]]]}}, "variance"),
    ],
)
def test_broken_content_is_named(tmp_path, change, message):
    data = {"schema": "camcal/disparity/1", "scale": 1.0, "invalid": "nan", **change}
    (tmp_path / "map.pfm.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"map\.pfm\.json") as caught:
        disparity_sidecar.read(tmp_path / "map.pfm")
    assert message in str(caught.value)


def test_every_fault_has_its_line(tmp_path):
    (tmp_path / "map.pfm.json").write_text('{"schema": "x", "scale": -1, "invalid": "nan"}', encoding="utf-8")
    with pytest.raises(InvalidInput) as caught:
        disparity_sidecar.read(tmp_path / "map.pfm")
    assert [line.startswith(str(tmp_path)) for line in str(caught.value).splitlines()] == [True, True]


@pytest.mark.parametrize("text", ['{"schema": "camcal/dis', "no json", ""])
def test_what_is_cut_off_is_a_file_error(tmp_path, text):
    (tmp_path / "map.pfm.json").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=r"map\.pfm\.json"):
        disparity_sidecar.read(tmp_path / "map.pfm")


def test_an_older_sidecar_is_replaced(tmp_path):
    disparity_sidecar.write(tmp_path / "map.pfm", Sidecar(scale=2.0))
    disparity_sidecar.write(tmp_path / "map.pfm", Sidecar(scale=4.0))
    assert disparity_sidecar.read(tmp_path / "map.pfm").scale == 4.0


@pytest.mark.parametrize("change", [{"scale": 0.0}, {"scale": np.inf}, {"invalid": "none"}])
def test_a_sidecar_that_cannot_be_is_refused(change):
    with pytest.raises(InvalidInput):
        Sidecar(**change)
