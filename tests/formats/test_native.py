"""camcal's own camera file: what it keeps, what it refuses and in which words, what it warns of."""

import copy
import math
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import FileError, InvalidInput
from camcal.formats import cameras, native
from camcal.formats.camera_file import (
    CalibrationNoise,
    CalibrationVerdict,
    CameraEntry,
    CameraFile,
    JointCovariance,
    ProjectionStd,
    Transform,
    ValidRegion,
)
from camcal.geometry.pose import Pose
from camcal.quality.projection_uncertainty import KnownRegion
from camcal.quality.range_uncertainty import CalibrationBoards
from camcal.targets.board import Surface, parse_board

GOOD = """%YAML 1.1
---
format: camcal-calibration
version: 1
cameras:
  left:
    image_size: [752, 480]
    model: opencv5
    intrinsics: {fx: 458.5, fy: 457.5, cx: 367.25, cy: 248.5}
    distortion: {k1: -0.28, k2: 0.074, p1: 0.0002, p2: 1.8e-05, k3: 0.0}
"""
RIGHT = GOOD.partition("cameras:\n")[2].replace("left", "right")
RIG = f"""{GOOD}{RIGHT}transforms:
  right_T_left:
    R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    t: [-0.11, 0.0, 0.0]
"""
CIRCLE = ImageCircle((640, 480), (322.25, 238.5), 310.125)
TWELVE_DIGITS = 5.1e-12  # half a unit of the twelfth digit, and the rounding of its decimal text


@pytest.fixture
def saved(tmp_path):
    def save(content: str) -> Path:
        path = tmp_path / "left.yaml"
        path.write_text(content, encoding="utf-8")
        return path

    return save


def faults(path: Path) -> list[str]:
    with pytest.raises(InvalidInput) as caught:
        native.read(path)
    return [line.replace(str(path), path.name) for line in str(caught.value).splitlines()]


def random_covariance(rng, stds) -> np.ndarray:
    factor = rng.normal(size=(len(stds), len(stds) + 3))
    product = factor @ factor.T
    scale = np.asarray(stds) / np.sqrt(np.diag(product))
    return product * np.outer(scale, scale)


def full_file(rng) -> CameraFile:
    """A file that uses every block there is."""
    model = MODELS["opencv8"]
    parameters = [612.3456789, 611.9876543, 319.125, 241.5, -0.31, 0.12, 1e-4, -2e-4, 0.01, 0.02, 0.03, 0.004]
    fixed = ("k6",)
    covariance = random_covariance(rng, np.abs(parameters) * 1e-3)
    covariance[-1] = covariance[:, -1] = 0
    lens = Camera(model, (640, 480), np.array(parameters), covariance, fixed)
    red = Camera(model, (640, 480), np.array(parameters) * 1.0001)
    shift = rng.normal(size=(3, 15)) * 1e-6
    shift[:, 11] = 0  # of k6, which is held
    left = CameraEntry(
        lens,
        valid=ValidRegion(0.65, 412.5, np.array([[0.5, 1.5], [600.0, 2.0], [300.0, 470.0]]), CIRCLE),
        projection=(
            ProjectionStd({"median_px": 0.02, "max_px": 0.3}, 1.5),
            ProjectionStd({"rms_px": 0.05, "max_px": 0.2, "inside_rms_px": 0.03, "inside_max_px": 0.1}),
        ),
        quality={"rms_px": 0.21, "images_used": 34, "points_used": 1836},
        noise=CalibrationNoise(0.11, 3400, 0.05),
        verdict=CalibrationVerdict(
            trustworthy=False,
            reasons=("no view in the lower left corner", "few tilts"),
            region=KnownRegion(1.0, 0.75, 0.9, np.array([[0.5, 1.25], [600.0, 2.0], [300.0, 470.0]])),
        ),
        sensor={"pixel_pitch_um": 3.45, "gain_e_per_dn": 0.4, "read_noise_e": 2.1, "full_well_e": 10500.0},
        channels={"red": red},
        held_by_prior=("k4", "k5"),
        boards=CalibrationBoards(0.31, 0.92, 0.4, shift),
        extra={"x_lab": {"shelf": 3, "notes": ["a", "b c"]}},
    )
    pose = Pose.from_vector(np.array([0.01, -0.02, 0.3]), np.array([-0.11, 0.002, 0.003]))
    names = ("left.fx", "right_T_left.tx", "right_T_left.rz")
    board = parse_board("charuco:9x7:30mm:22mm:DICT_5X5_100")
    terms = ("xy", "P2(x)", "P2(y)", "x/y scale", "shear", "keystone x", "keystone y")
    shape = Surface(
        board,
        ("bow", "stretch", "offsets"),
        terms,
        rng.normal(size=7) * 1e-4,
        random_covariance(rng, np.full(7, 1e-5)),
        rng.normal(size=(board.count, 3)) * 1e-5,
        3.1e-4,
        1.5e-5,
        {"bow": (3.9e-4, 1e-4), "stretch": (0.0, 2e-4), "corners in plane": (1e-4, 2e-5)},
    )
    return CameraFile(
        {"left": left, "right": CameraEntry(lens)},
        {"right_T_left": Transform(pose, random_covariance(rng, np.full(6, 1e-3)))},
        JointCovariance(names, random_covariance(rng, [0.1, 1e-4, 1e-5])),
        shape,
        provenance={"tool": "camcal", "images": [{"file": "a b.png", "used": True, "points": 48, "rms_px": 0.2}]},
        converted_from={"file": "chain.yaml", "format": "kalibr", "exact": True},
        extra={"x_rig": "north"},
    )


def assert_same_camera(found: Camera, expected: Camera) -> None:
    assert found.model is expected.model
    assert found.image_size == expected.image_size
    assert found.fixed == expected.fixed
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=TWELVE_DIGITS)
    assert (found.covariance is None) == (expected.covariance is None)
    if expected.covariance is not None:
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=TWELVE_DIGITS)


def test_everything_written_is_read_back_to_twelve_digits(tmp_path):
    file = full_file(np.random.default_rng(1))
    native.write(tmp_path / "rig.yaml", file)
    found = native.read(tmp_path / "rig.yaml")
    for name, entry in file.cameras.items():
        assert_same_camera(found.cameras[name].camera, entry.camera)
    left, expected = found.cameras["left"], file.cameras["left"]
    assert_same_camera(left.channels["red"], expected.channels["red"])
    assert left.held_by_prior == ("k4", "k5")
    assert (left.boards.nearest, left.boards.farthest, left.boards.noise_share) == (0.31, 0.92, 0.4)
    np.testing.assert_allclose(left.boards.shift, expected.boards.shift, rtol=TWELVE_DIGITS)
    assert (left.noise, left.projection) == (expected.noise, expected.projection)
    assert replace(left.verdict, region=None) == replace(expected.verdict, region=None)
    region, given = vars(left.verdict.region), vars(expected.verdict.region)
    np.testing.assert_array_equal(region.pop("polygon"), given["polygon"])
    assert region == {name: given[name] for name in ("limit_px", "share", "of_observed")}
    assert (left.quality, left.sensor, left.extra) == (expected.quality, expected.sensor, expected.extra)
    assert math.isclose(left.valid.max_theta, 0.65, rel_tol=1e-11)  # through degrees at 12 digits
    np.testing.assert_array_equal(left.valid.polygon, expected.valid.polygon)
    assert left.image_circle == CIRCLE
    step, wanted = found.transforms["right_T_left"], file.transforms["right_T_left"]
    np.testing.assert_allclose(step.pose.matrix(), wanted.pose.matrix(), rtol=TWELVE_DIGITS)
    np.testing.assert_allclose(step.covariance, wanted.covariance, rtol=TWELVE_DIGITS)
    assert found.joint_covariance.names == file.joint_covariance.names
    np.testing.assert_allclose(found.joint_covariance.matrix, file.joint_covariance.matrix, rtol=TWELVE_DIGITS)
    assert (found.provenance, found.converted_from, found.extra) == (file.provenance, file.converted_from, file.extra)


def test_the_shape_of_the_board_comes_back(tmp_path):
    file = full_file(np.random.default_rng(2))
    native.write(tmp_path / "rig.yaml", file)
    found, expected = native.read(tmp_path / "rig.yaml").board_shape, file.board_shape
    assert (found.board, found.tiers, found.terms) == (expected.board, expected.tiers, expected.terms)
    assert (found.deflection, found.deflection_std) == (expected.deflection, expected.deflection_std)
    assert found.classes == expected.classes
    for part in ("coefficients", "covariance", "offsets"):
        np.testing.assert_allclose(getattr(found, part), getattr(expected, part), rtol=TWELVE_DIGITS)


def test_a_shift_of_the_boards_has_a_number_for_each_parameter_and_axis(saved):
    block = "    uncertainty: {std: {fx: 0.5}, covariance_order: [fx], covariance: [[0.25]], boards: {nearest_m: 0.3, "
    rows = "[1.0e-06, 1.0e-06, 0.0, 0.0]", "[0.0, 1.0e-06]", "[0.0, 0.0, 0.0, 1.0e-06]"
    path = saved(f"{GOOD}{block}farthest_m: 1.0, shift: [{', '.join(rows)}]}}}}\n")
    assert faults(path)[-1].endswith("boards.shift[1]: 2 numbers; one for each of covariance_order and x, y, z are 4")
    path = saved(f"{GOOD}{block}shift: [[0.0]]}}}}\n")
    assert [line.partition("boards")[2] for line in faults(path)] == [
        ".shift: 1 items; 3 are needed",
        ": missing key 'farthest_m'",
    ]


@pytest.mark.parametrize(("name", "nothing"), [("tiers", ()), ("classes", {})])
def test_tiers_and_classes_of_a_shape_are_optional(tmp_path, name, nothing):
    file = full_file(np.random.default_rng(2))
    native.write(tmp_path / "rig.yaml", replace(file, board_shape=replace(file.board_shape, **{name: nothing})))
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text(encoding="utf-8"))
    assert {"tiers", "classes"} - data["board_shape"].keys() == {name}
    assert getattr(native.read(tmp_path / "rig.yaml").board_shape, name) == nothing


def test_a_shape_of_an_older_file_has_tiers_and_no_classes(saved):
    shape = native.read(saved(GOOD + SHAPE)).board_shape
    assert (shape.tiers, shape.classes, shape.terms) == (("bow",), {}, ("P2(x)",))


def test_the_keys_of_terms_and_classes_are_plain_words(saved):
    content = SHAPE.replace("tiers: [bow]", "classes: {corners_out_of_plane: {scale: 0.0001, std: 2.0e-05}}")
    content = content.replace("P2(x)", "keystone_y")
    shape = native.read(saved(GOOD + content)).board_shape
    assert shape.classes == {"corners out of plane": (1e-4, 2e-5)}
    assert shape.terms == ("keystone y",)


def test_keys_of_others_may_stand_in_a_shape(saved):
    content = SHAPE.replace("tiers: [bow]", "classes: {x_a: 1, bow: {scale: 0.001, std: 0.001, x_b: 2}}")
    content = content.replace("{P2(x): 0.0002}", "{P2(x): 0.0002, x_c: 3}")
    shape = native.read(saved(GOOD + content)).board_shape
    assert (list(shape.classes), shape.terms) == (["bow"], ("P2(x)",))


def test_what_was_read_is_written_with_the_same_bytes(tmp_path):
    first, second = tmp_path / "a" / "rig.yaml", tmp_path / "b" / "rig.yaml"
    native.write(first, full_file(np.random.default_rng(3)))
    native.write(second, native.read(first))
    assert first.read_bytes() == second.read_bytes()


def test_numpy_scalars_and_nothing_at_all_may_stand_in_what_is_written(tmp_path):
    lens = Camera(MODELS["pinhole"], (640, 480), np.array([500.0, 500.0, 320.0, 240.0]))
    entry = CameraEntry(lens, quality={"rms_px": np.float64(0.2), "images_used": np.int64(12)})
    native.write(tmp_path / "a.yaml", CameraFile({"cam": entry}, provenance={"tool": "camcal", "command": None}))
    found = native.read(tmp_path / "a.yaml")
    assert found.cameras["cam"].quality == {"rms_px": 0.2, "images_used": 12}
    assert found.provenance == {"tool": "camcal"}


@pytest.mark.parametrize("name", MODELS)
def test_every_model_is_written_and_read(tmp_path, name):
    model = MODELS[name]
    parameters = model.start((640, 480), 500.0)
    parameters[4:] = 0.001 * np.arange(1, len(parameters) - 3)  # no two alike
    camera = Camera(model, (640, 480), parameters)
    native.write(tmp_path / "a.yaml", CameraFile({"cam": CameraEntry(camera)}))
    assert_same_camera(cameras.read_camera(tmp_path / "a.yaml"), camera)


def test_a_spline_is_written_with_its_knots_and_read_with_them(tmp_path):
    model = MODELS["splined_stereographic"].configured({"knots": [7, 6], "fov_x_deg": 80.5, "degree": 2})
    parameters = np.concatenate([[500.0, 501.0, 320.0, 240.0], 0.001 * np.arange(84)])
    camera = Camera(model, (640, 480), parameters, np.diag(1e-6 * (1.0 + np.arange(88))) + 1e-7)
    native.write(tmp_path / "a.yaml", CameraFile({"cam": CameraEntry(camera)}))
    text = (tmp_path / "a.yaml").read_text(encoding="utf-8")
    assert "configuration: {knots: [7, 6], fov_x_deg: 80.5, degree: 2}" in text
    found = cameras.read_camera(tmp_path / "a.yaml")
    assert found.model == model
    np.testing.assert_allclose(found.parameters, parameters, rtol=TWELVE_DIGITS)
    np.testing.assert_allclose(found.covariance, camera.covariance, rtol=TWELVE_DIGITS)
    (tmp_path / "b.yaml").write_text(text.replace("[7, 6]", "[7, 3]"), encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"distortion\.dx_3_0: model 'splined_stereographic' has no 'dx_3_0' here"):
        native.read(tmp_path / "b.yaml")
    (tmp_path / "b.yaml").write_text(text.replace("[7, 6]", "[7, 0]"), encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"cam.configuration: knots \[7, 0\]: write \[columns, rows\] from 3 to 100"):
        native.read(tmp_path / "b.yaml")


def test_opencv_and_pyyaml_open_what_was_written(tmp_path):
    native.write(tmp_path / "rig.yaml", full_file(np.random.default_rng(4)))
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("cameras").getNode("left").getNode("intrinsics").getNode("fx").real() == 612.3456789
    assert storage.getNode("transforms").getNode("right_T_left").getNode("R").at(2).size() == 3
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text(encoding="utf-8"))
    assert data["cameras"]["left"]["fixed"] == ["k6"]


def test_nothing_is_written_that_would_be_refused(tmp_path):
    path = tmp_path / "a.yaml"
    lens = Camera(MODELS["pinhole"], (640, 480), np.array([-500.0, 500.0, 320.0, 240.0]))
    with pytest.raises(InvalidInput, match="must be > 0"):
        native.write(path, CameraFile({"cam": CameraEntry(lens)}))
    assert not path.exists()


def test_rows_of_fixed_parameters_are_zero_and_std_alone_means_no_correlation(saved):
    block = (
        "    fixed: [k3]\n    uncertainty:\n"
        "      std: {fx: 0.4, fy: 0.5, cx: 0.3, cy: 0.3, k1: 0.001, k2: 0.002, p1: 4.0e-05, p2: 3.9e-05}\n"
        "      covariance_order: [fy, fx]\n      covariance: [[0.25, 0.1], [0.1, 0.16]]\n"
    )
    camera = cameras.read_camera(saved(GOOD + block))
    assert camera.covariance[0, 1] == camera.covariance[1, 0] == 0.1
    assert (camera.std("fy"), camera.std("k3")) == (0.5, None)
    assert not camera.covariance[8].any()
    assert math.isclose(camera.std("cx"), 0.3)
    assert camera.covariance[2, 3] == 0


def test_a_partial_uncertainty_is_not_used_and_said(saved):
    file = native.read(saved(GOOD + "    uncertainty: {std: {fx: 0.4}}\n"))
    assert file.cameras["left"].camera.covariance is None
    assert "no uncertainty of fy, cx, cy, k1, k2, p1, p2, k3" in file.warnings[0].text


def test_one_of_several_cameras_must_be_named(saved):
    path = saved(RIG)
    assert cameras.read_camera(path, "right").value("fx") == 458.5
    with pytest.raises(InvalidInput, match=r"holds 2 cameras \(left, right\); choose one, such as .*left.yaml#left"):
        cameras.read_camera(path)
    with pytest.raises(InvalidInput, match=r"no camera 'rihgt'\. Did you mean 'right'"):
        cameras.read_camera(path, "rihgt")


def test_a_camera_is_addressed_in_the_library_as_on_the_command_line(saved):
    path = saved(RIG)
    assert cameras.read_camera(f"{path}#right").value("fx") == 458.5
    found = cameras.read(f"{path}#right")
    assert list(found.cameras) == ["right"]
    assert not found.transforms
    with pytest.raises(InvalidInput, match=r"left\.yaml: no camera 'rihgt'\. Did you mean 'right'"):
        cameras.read_camera(f"{path}#rihgt")
    odd = path.with_name("a#left.yaml")
    shutil.copy(path, odd)
    assert list(cameras.read(odd).cameras) == ["left", "right"]


@pytest.mark.parametrize("name", ["mono.camcal.yaml", "rig.camcal.yaml"])
def test_the_reference_examples_are_read_without_a_warning(real_data, name):
    path = real_data.parent / "reference" / "camcal_native" / name
    if not path.is_file():
        pytest.skip(f"no reference examples beside the real data: {path}")
    file = native.read(path)
    assert file.warnings == ()
    assert file.cameras


MODEL = "    model: opencv5\n"
FAULTS = {
    ("distortion:", "distorsion:"): "10: cameras.left.distorsion: unknown key. Did you mean 'distortion'?",
    ("k2: 0.074,", "k1: 0.074,"): "10: cameras.left.distortion: duplicate key 'k1' (first at line 10)",
    (", k3: 0.0}", "}"): (
        "10: cameras.left.distortion: model 'opencv5' needs k1,k2,p1,p2,k3; missing 'k3' (write k3: 0.0)"
    ),
    ("k3: 0.0}", "k3: 0.0, k4: 0.0}"): "10: cameras.left.distortion.k4: model 'opencv5' has no 'k4' here",
    ("p2: 1.8e-05", "p2: 1e-05"): (
        "10: cameras.left.distortion.p2: '1e-05' was read as text (YAML 1.1 needs 1.0e-05, without quotes)"
    ),
    ("cx: 367.25", "cx: .nan"): "9: cameras.left.intrinsics.cx: .nan is not finite",
    ("fx: 458.5", "fx: -458.5"): (
        "9: cameras.left.intrinsics.fx: -458.5 must be > 0 (mirrored image? flip the image instead)"
    ),
    ("fx: 458.5", "fx: 2.0e+10"): "9: cameras.left.intrinsics.fx: 20000000000.0 is outside [0.001, 1e+10]",
    ("fx: 458.5", "fx: 0.0005"): "9: cameras.left.intrinsics.fx: 0.0005 is outside [0.001, 1e+10]",
    ("[752, 480]", "[752]"): "7: cameras.left.image_size: 1 items; 2 are needed",
    ("[752, 480]", "[752, 0]"): "7: cameras.left.image_size[1]: 0 must be at least 1",
    ("[752, 480]", "[752, 480.0]"): "7: cameras.left.image_size[1]: 480.0 is not a whole number",
    ("model: opencv5", "model: opencv_5"): ("8: cameras.left.model: unknown model 'opencv_5'. Did you mean 'opencv5'?"),
    ("model: opencv5", "model: [opencv5]"): "8: cameras.left.model: unknown model a list",
    ("version: 1", "version: 2"): ("4: version: version 2 is newer than this camcal (reads 1); upgrade camcal"),
    ("camcal-calibration", "mrcal"): "3: format: 'mrcal'; a camera file has camcal-calibration",
    ("format: camcal-calibration\n", ""): ("3: not a camera file: 'format: camcal-calibration' is missing"),
    ("  left:", "  left_T_x:"): "6: cameras.left_T_x: 'left_T_x' is not a valid name",
    (MODEL, MODEL + "    configuration: {knots: [30, 18]}\n"): (
        "9: cameras.left.configuration: model 'opencv5' has no configuration; leave it out"
    ),
    (MODEL, MODEL + "    fixed: [k11]\n"): "9: cameras.left.fixed[0]: unknown parameter 'k11'. Did you mean 'k1'?",
    (MODEL, MODEL + "    held_by_prior: [k3, k4]\n"): (
        "9: cameras.left.held_by_prior[1]: unknown coefficient 'k4'; possible here: k1, k2, p1, p2, k3"
    ),
    (MODEL, MODEL + "    held_by_prior: [fx]\n"): "9: cameras.left.held_by_prior[0]: unknown coefficient 'fx'",
    (MODEL, MODEL + "    held_by_prior: k3\n"): "9: cameras.left.held_by_prior: 'k3' is not a list",
    (MODEL, MODEL + "    held_by_prior: [k3, k3]\n"): "9: cameras.left.held_by_prior[1]: 'k3' occurs twice",
    (MODEL, MODEL + "    fixed: [k3]\n    held_by_prior: [k3]\n"): (
        "10: cameras.left.held_by_prior[0]: 'k3' is fixed and cannot have a prior; leave it out"
    ),
}


@pytest.mark.parametrize(("old", "new"), FAULTS)
def test_a_broken_rule_is_told_with_line_key_and_what_to_do(saved, old, new):
    lines = faults(saved(GOOD.replace(old, new)))
    assert any(line.startswith(f"left.yaml:{FAULTS[old, new]}") for line in lines), lines


def test_all_broken_rules_are_told_at_once(saved):
    content = GOOD.replace("fx: 458.5", "fx: 0.0").replace("k3: 0.0", "k31: 0.0").replace("480]", "-1]")
    assert [line.partition(": ")[2].partition(":")[0] for line in faults(saved(content))] == [
        "cameras.left.image_size[1]",
        "cameras.left.intrinsics.fx",
        "cameras.left.distortion.k31",
    ]


def test_a_camera_without_its_distortion_is_told_what_the_model_needs(saved):
    content = "".join(line for line in GOOD.splitlines(keepends=True) if "distortion" not in line)
    assert "needs k1,k2,p1,p2,k3; missing 'k1', 'k2', 'p1', 'p2', 'k3' (write k1: 0.0)" in faults(saved(content))[0]


def uncertain(lines: str) -> str:
    return GOOD + "    uncertainty:\n" + "".join(f"      {line}\n" for line in lines.splitlines())


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        (
            "covariance_order: [fx, fy]\ncovariance: [[1.0]]",
            "cameras.left.uncertainty.covariance: covariance is 1x1 but covariance_order has 2 names",
        ),
        ("covariance_order: [fx, fy]\ncovariance: [[1.0, 0.5], [0.2, 1.0]]", "not symmetric (correlations differ by"),
        ("covariance_order: [fx, fy]\ncovariance: [[1.0, 2.0], [2.0, 1.0]]", "not positive semidefinite"),
        ("covariance_order: [fx, fy]\ncovariance: [[-1.0, 0.0], [0.0, 1.0]]", "the variance in row 1 is negative"),
        ("covariance_order: [fx, fx]\ncovariance: [[1.0, 1.0], [1.0, 1.0]]", "'fx' occurs twice"),
        (
            "covariance_order: [fx, k9]\ncovariance: [[1.0, 0.0], [0.0, 1.0]]",
            "no parameter 'k9'; possible here: fx, fy, cx",
        ),
        ("covariance_order: [fx]", "covariance_order goes with covariance, or with covariance_file"),
        ("covariance: [[1.0]]", "covariance_order goes with covariance, or with covariance_file"),
        ("std: {fx: 2.0}\ncovariance_order: [fx]\ncovariance: [[1.0]]", "std.fx is 2, 1 by the covariance"),
        ("std: {fx: -2.0}", "cameras.left.uncertainty.std.fx: -2.0 is outside [0, 1e+50]"),
        ("projection: [{range_m: 0.0, max_px: 0.1}]", "uncertainty.projection[0].range_m: 0.0 must be > 0"),
    ],
)
def test_a_covariance_that_is_none_is_refused(saved, block, expected):
    lines = faults(saved(uncertain(block)))
    assert any(expected in line for line in lines), lines


def test_a_fixed_parameter_has_no_uncertainty(saved):
    assert (
        "'k3' is fixed and cannot have an uncertainty"
        in faults(saved(uncertain("std: {k3: 0.1}") + "    fixed: [k3]\n"))[0]
    )


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("right_T_left:", "rigth_T_left:", "no camera or frame 'rigth'. Did you mean 'right'?"),
        ("right_T_left:", "right_to_left:", "'right_to_left' is not a transform name such as a_T_b"),
        ("right_T_left:", "left_T_left:", "there is already a path between 'left' and 'left'"),
        ("right_T_left:", "right_T_2left:", "'2left' is not a valid name"),
        ("[[1.0, 0.0, 0.0], [0.0", "[[1.0, 0.0003, 0.0], [0.0", "nearest rotation differs by 0.0086°; write R"),
        ("[[1.0, 0.0, 0.0], [0.0", "[[-1.0, 0.0, 0.0], [0.0", "det = -1, a reflection"),
        ("[[1.0, 0.0, 0.0], [0.0", "[[2.0, 0.0, 0.0], [0.0", "not a rotation: orthonormality error 3.0e+00"),
        ("[[1.0, 0.0, 0.0], [0.0", "[[1.0e+200, 0.0, 0.0], [0.0", "R[0][0]: 1e+200 is outside [-1e+12, 1e+12]"),
        ("[[1.0, 0.0, 0.0], [0.0", "[[1.0, 0.0], [0.0", "transforms.right_T_left.R[0]: 2 items; 3 are needed"),
        ("    t: [-0.11, 0.0, 0.0]\n", "", "transforms.right_T_left: missing key 't'"),
    ],
)  # fmt: skip
def test_a_transform_that_cannot_be_is_refused(saved, old, new, expected):
    lines = faults(saved(RIG.replace(old, new)))
    assert any(expected in line for line in lines), lines


def test_there_is_one_path_between_two_frames(saved):
    step = RIG.partition("transforms:\n")[2]
    further = step.replace("right_T_left", "imu_T_left") + step.replace("right_T_left", "right_T_imu")
    expected = "transforms.right_T_imu: there is already a path between 'right' and 'imu'; leave one transform out"
    assert faults(saved(RIG + further)) == [f"left.yaml:23: {expected}"]


def test_a_lens_that_folds_outside_of_its_image_circle_is_not_warned_of(saved):
    folding = GOOD.replace("k1: -0.28", "k1: -0.9")
    valid = "    valid: {image_circle: {centre_px: [367.0, 248.0], radius_px: 150.0}}\n    model:"
    assert [warning.code for warning in native.read(saved(folding)).warnings] == ["distortion_not_invertible"]
    assert native.read(saved(folding.replace("    model:", valid, 1))).warnings == ()
    wider = folding.replace("    model:", valid.replace("150.0", "300.0"), 1)
    assert "the image circle reaches to" in native.read(saved(wider)).warnings[0].text


def test_free_frames_may_have_names_of_their_own(saved):
    step = RIG.partition("transforms:\n")[2]
    names = ("lidar_T_left", "left2_T_right", "world_T_lidar")
    file = native.read(saved(RIG + "".join(step.replace("right_T_left", name) for name in names)))
    assert list(file.transforms) == ["right_T_left", *names]


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("    valid: {max_theta_deg: 200.0}\n", "valid.max_theta_deg: 200.0 is outside [0, 180]"),
        ("    valid: {image_circle: {radius_px: 300.0}}\n", "valid.image_circle: missing key 'centre_px'"),
        (
            "    valid: {image_circle: {centre_px: [1.0, 2.0], radius_px: 0.0}}\n",
            "image_circle.radius_px: 0.0 must be > 0",
        ),
        ("    quality: {rms: 0.2}\n", "quality.rms: unknown key. Did you mean 'rms_px'?"),
        ("    noise: {degrees_of_freedom: 10}\n", "noise: missing key 'sigma_px'"),
        ("    verdict: {trustworthy: maybe}\n", "verdict.trustworthy: 'maybe' is not true or false"),
        ("    sensor: {pixel_pitch_mm: 0.003}\n", "pixel_pitch_mm: unknown key. Did you mean 'pixel_pitch_um'?"),
        (
            "    channels: {red: {intrinsics: {fx: 1.0}}}\n",
            "channels.red.intrinsics: model 'opencv5' needs fx,fy,cx,cy",
        ),
        ("    channels: {red: 3}\n", "channels.red: 3 is not a mapping"),
        ("joint_covariance: {std: {left.fz: 0.1}}\n", "joint_covariance.std.left.fz: no parameter 'left.fz'"),
        ("provenance: {images: [{used: true}]}\n", "provenance.images[0]: missing key 'file'"),
        ("provenance: {created: 2026-11-21T02:12:00Z}\n", "provenance.created: '2026-11-21T02:12:00Z' is a date"),
        ("provenance: {board: {name: ~}}\n", "provenance.board.name: an empty value; leave the key out"),
        ("converted_from: {file: a.yaml}\n", "converted_from: missing key 'format'"),
        ("board_shape: {tiers: [bend]}\n", "board_shape.tiers[0]: unknown tier 'bend'"),
        ("colour: red\n", "colour: unknown key"),
    ],
)
def test_optional_blocks_are_checked(saved, block, expected):
    lines = faults(saved(GOOD + block))
    assert any(expected in line for line in lines), lines


SHAPE = """board_shape:
  board: {type: chessboard, inner_corners: [3, 2], square_mm: 25.0}
  tiers: [bow]
  coefficients: {P2(x): 0.0002}
  uncertainty: {std: {P2(x): 1.0e-05}}
  deflection_m: 0.0003
"""


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("deflection_m", "deflection_squares", "the board's lengths are in m; write deflection_m"),
        ("uncertainty: {std: {P2(x): 1.0e-05}}", "uncertainty: {}", "std is missing for P2(x)"),
        ("tiers", "offsets: [[0.0, 0.0, 0.0]]\n  tiers", "1 offsets; the board has 6 corners"),
        ("square_mm: 25.0", "square_mm: -1.0", "board_shape.board.square_mm: -1.0 must be > 0"),
        ("coefficients: {P2(x)", "coefficients: {P2(z)", "coefficients.P2(z): unknown key"),
        ("tiers: [bow]", "classes: {bwo: {scale: 0.1, std: 0.1}}", "classes.bwo: unknown key. Did you mean 'bow'?"),
        ("tiers: [bow]", "classes: {bow: {scale: 0.1}}", "classes.bow: missing key 'std'"),
        ("tiers: [bow]", "classes: {bow: {scale: -0.1, std: 0.1}}", "classes.bow.scale: -0.1 is outside"),
    ],
)
def test_a_board_shape_that_contradicts_itself_is_refused(saved, old, new, expected):
    assert native.read(saved(GOOD + SHAPE)).board_shape.deflection == 0.0003
    lines = faults(saved(GOOD + SHAPE.replace(old, new)))
    assert any(expected in line for line in lines), lines


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("cx: 367.25", "cx: 700.5", "cameras.left.intrinsics.cx: cx = 700.5 for image width 752: check that both"),
        ("fx: 458.5", "fx: 558.5", "fx/fy = 1.22: check the pixel aspect ratio"),
        ("458.5, fy: 457.5", "45800.5, fy: 45700.5", "horizontal field of view 0.941°"),
        ("k1: -0.28", "k1: -0.9", "distortion is not invertible beyond"),
        ("    model:", "    quality: {rms_px: 1.2}\n    model:", "quality.rms_px: reprojection RMS 1.2 px"),
        ("    model:", "    quality: {images_used: 4}\n    model:", "quality.images_used: 4 images: use 10 or more"),
        ("t: [-0.11", "t: [-120.5", "transforms.right_T_left.t: 120.5 m: check the unit"),
    ],
)
def test_what_looks_wrong_is_warned_of_with_its_line(saved, old, new, expected):
    assert native.read(saved(RIG)).warnings == ()
    warnings = native.read(saved(RIG.replace(old, new, 1))).warnings
    assert any(expected in str(warning) for warning in warnings), warnings
    assert all(str(saved(RIG)) + ":" in warning.where for warning in warnings)


def test_a_file_that_is_cut_off_is_no_camera(saved):
    with pytest.raises(FileError, match="truncated"):
        native.read(saved(GOOD[:-5]))


ODD = st.sampled_from([None, [], {}, "", "x", -1, 0, 2.5, True, [[]], [None], {"a": 1}, math.inf, math.nan, "1e-05"])


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    path = tmp_path_factory.mktemp("odd") / "rig.yaml"
    native.write(path, full_file(np.random.default_rng(5)))
    return yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)


@pytest.mark.slow
@given(st.data())
def test_a_file_with_any_one_value_exchanged_is_read_or_refused(tmp_path_factory, tree, data):
    changed = place = copy.deepcopy(tree)
    while True:
        key = data.draw(st.sampled_from(list(place) if isinstance(place, dict) else range(len(place))))
        if not isinstance(place[key], (dict, list)) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    place[key] = data.draw(ODD)
    path = tmp_path_factory.mktemp("odd") / "rig.yaml"
    path.write_text(yaml.dump(changed, Dumper=yaml.CSafeDumper), encoding="utf-8")
    try:
        found = native.read(path)
    except (InvalidInput, FileError) as error:
        assert str(error).startswith(str(path))  # noqa: PT017 either outcome is right, a traceback is not
    else:
        assert found.cameras
