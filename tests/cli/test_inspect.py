"""`camcal inspect` as it is called from a shell."""

import json
from typing import NamedTuple

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.main import app
from camcal.formats.camera_file import CameraEntry
from camcal.tasks.calibration.inspect import camera_lines

UNTRUSTED = "19: cameras.left.verdict: untrustworthy calibration: the lower left corner was never seen"
CAMERA = """%YAML 1.1
---
format: camcal-calibration
version: 1
cameras:
  left:
    image_size: [640, 480]
    model: opencv4
    intrinsics: {fx: 512.0625, fy: 511.5, cx: 321.5, cy: 238.25}
    distortion: {k1: -0.2, k2: 0.05, p1: 0.0001, p2: -2.0e-05}
    fixed: [p2]
    held_by_prior: [k2]
    uncertainty:
      std: {fx: 0.41, fy: 0.4, cx: 0.33, cy: 0.29, k1: 0.0009, k2: 0.0011, p1: 4.1e-05}
      projection: [{range_m: 1.5, max_px: 0.21}, {rms_px: 0.04, max_px: 0.2, inside_rms_px: 0.03}]
    valid: {max_theta_deg: 36.5, max_radius_px: 401.0, polygon: [[0.0, 0.0], [639.0, 0.0], [320.0, 479.0]]}
    quality: {rms_px: 0.214, images_used: 34}
    noise: {sigma_px: 0.11, degrees_of_freedom: 3400}
    verdict: {trustworthy: false, reasons: ["the lower left corner was never seen"]}
    sensor: {pixel_pitch_um: 3.45}
    channels: {red: {intrinsics: {fx: 512.0, fy: 511.0, cx: 321.0, cy: 238.0},
                     distortion: {k1: -0.2, k2: 0.05, p1: 0.0, p2: 0.0}}}
  right:
    image_size: [640, 480]
    model: pinhole
    intrinsics: {fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5}
transforms:
  right_T_left:
    R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    t: [-0.12, 0.0, 0.0]
board_shape:
  board: {type: chessboard, inner_corners: [9, 6], square_mm: 25.0}
  tiers: [bow]
  classes: {bow: {scale: 0.00039, std: 0.0001}, stretch: {scale: 0.0012, std: 0.0003}}
  coefficients: {P2(x): 0.0002}
  uncertainty: {std: {P2(x): 1.0e-05}}
  deflection_m: 0.00031
  deflection_std_m: 1.5e-05
provenance:
  tool: camcal
  tool_version: "0.1.0"
  command: "camcal calibrate images"
  images:
    - {file: a.png, used: true, points: 54, rms_px: 0.18}
    - {file: b.png, used: false, points: 3, reason: "too few corners"}
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(CAMERA)
    return str(path)


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def camcal(capsys):
    def run(*arguments: str) -> Ended:
        with pytest.raises(SystemExit) as ended:
            app(["inspect", *arguments])
        return Ended(int(ended.value.code or 0), *capsys.readouterr())

    return run


def test_a_person_reads_everything_that_is_known(camcal, rig):
    result = camcal(rig, "--verbose")
    assert (result.code, result.err) == (0, f"camcal: warning: {rig}:{UNTRUSTED}\n")
    for words in (
        "left: opencv4, 640x480",
        "512.06",  # to the place of its standard deviation
        "fixed",
        "field of view horizontal 65.2°, vertical 51.3°",  # of the pinhole: 2 atan(320 / 500), 2 atan(240 / 500)
        "valid up to 36.5° from the axis, up to 401 px from the principal point, inside a polygon of 3 corners",
        "k2 is determined by its prior, not by the data",
        "fit rms 0.214 px, images used 34",
        "noise 0.11 px (3400 degrees of freedom)",
        "Projection uncertainty (1 sigma, at 1.5 m): worst 0.21 px",
        "Projection uncertainty (1 sigma, at infinity): RMS 0.04 px, worst 0.2 px; where corners were seen: RMS",
        "sensor pixel pitch 3.45 um",
        "separate lens models for red",
        "DO NOT TRUST: the lower left corner was never seen",
        "right: pinhole, 640x480",
        "right_T_left: 0.12 m apart, rotated by 0.000°",
        "board chessboard of 9x6 inner corners, bent by 0.310 ± 0.015 mm peak to peak",
        "board P2(x): 0.200 ± 0.010 mm",
        "board, scale of bow: 0.039 ± 0.010 % of the longer side",
        "board, scale of stretch: 0.120 ± 0.030 %\n",
        "made by camcal 0.1.0",
        "with camcal calibrate images",
        "from 1 of 2 images",
        "too few corners",
    ):
        assert words in result.out


def test_one_camera_of_several_is_shown_alone(camcal, rig):
    result = camcal(f"{rig}#right")
    assert "right: pinhole" in result.out
    assert "left: opencv4" not in result.out
    assert camcal(rig, "--camera", "right").out == result.out


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("cameras.left.intrinsics.fx", "512.0625"),
        ("cameras.left.model", "opencv4"),
        ("cameras.left.image_size", "[640, 480]"),
        ("cameras.left.image_size[1]", "480"),
        ("cameras.left.verdict.trustworthy", "false"),
        ("transforms.right_T_left.R[0][0]", "1.0"),
        ("board_shape.coefficients.P2(x)", "0.0002"),
        ("cameras.right.intrinsics", '{"fx": 500.0, "fy": 500.0, "cx": 319.5, "cy": 239.5}'),
    ],
)
def test_one_value_is_printed_and_nothing_else(camcal, rig, key, expected):
    result = camcal(rig, "--get", key)
    assert (result.code, result.out, result.err) == (0, f"{expected}\n", "")


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("cameras.left.intrinsic.fx", "no key 'intrinsic' under cameras.left. Did you mean 'intrinsics'?"),
        ("camera", "no key 'camera'. Did you mean 'cameras'?"),
        ("cameras.left.image_size[2]", "no key '[2]' under cameras.left.image_size"),
        ("cameras.left.model.name", "no key 'name' under cameras.left.model"),
    ],
)
def test_an_unknown_key_names_the_nearest(camcal, rig, key, words):
    result = camcal(rig, "--get", key)
    assert (result.code, result.out) == (2, "")
    assert words in result.err


def test_json_holds_the_file_and_what_follows_from_it(camcal, rig):
    payload = json.loads(camcal(rig, "--json").out)
    assert list(payload) == ["schema", "file", "content", "stated", "field_of_view_deg", "rig", "errors", "warnings"]
    assert payload["schema"] == "camcal/inspect/1"
    assert payload["content"]["cameras"]["left"]["intrinsics"]["fx"] == 512.0625
    assert [len(angles) for angles in payload["field_of_view_deg"].values()] == [3, 3]
    assert [f"{each['where']}: {each['text']}" for each in payload["warnings"]] == [f"{rig}:{UNTRUSTED}"]


def test_json_has_what_is_stated_and_the_gates_that_fail(camcal, rig):
    result = camcal(f"{rig}#left", "--json", "--require", "trustworthy", "--max-uncertainty", "0.02")
    payload = json.loads(result.out)
    assert result.code == payload["exit"] == 7
    assert payload["stated"] == {"left": {"trustworthy": False, "uncertainty_px": 0.03, "coverage": None}}
    assert [each["code"] for each in payload["failures"]] == ["untrustworthy", "projection_uncertainty"]
    assert payload["failures"][1]["values"] == {"uncertainty_px": 0.03, "limit_px": 0.02}


def test_a_gate_that_fails_is_a_line_for_each_camera_and_the_exit_code(camcal, rig, tmp_path):
    gates = ("--require", "trustworthy", "--max-uncertainty", "0.02", "--min-coverage", "70")
    result = camcal(rig, *gates, "--quiet")
    assert result.code == 7
    lines = [line.removeprefix("camcal: error: ") for line in result.err.splitlines() if "error" in line]
    nothing = "right: the file states no {}: calibrate with camcal"
    assert lines == [
        "left: not trustworthy: the lower left corner was never seen",
        "left: projection uncertainty 0.03 px (limit 0.02 px)",
        "left: the file states no region of its verdict: calibrate with camcal",
        *(nothing.format(each) for each in ("verdict", "projection uncertainty", "region of its verdict")),
    ]
    good = tmp_path / "good.yaml"
    region = "region: {limit_px: 1.0, share: 0.72, polygon: [[0.0, 0.0], [639.0, 0.0], [320.0, 479.0]]}"
    good.write_text(CAMERA.replace('trustworthy: false, reasons: ["the lower left corner was never seen"]', region))
    good.write_text(good.read_text().replace("verdict: {region", "verdict: {trustworthy: true, region"))
    passes = ("--require", "trustworthy", "--max-uncertainty", "0.03", "--min-coverage", "70")
    assert camcal(f"{good}#left", *passes).code == 0
    result = camcal(f"{good}#left", "--min-coverage", "80", "--get", "cameras.left.verdict.trustworthy")
    assert (result.code, result.out) == (7, "true\n")
    assert "left: the verdict holds in 72 % of the image (limit 80 %)" in result.err


def test_gates_are_not_for_raw_frames(camcal, tmp_path):
    (tmp_path / "frame.raw").write_bytes(bytes(64))
    result = camcal(str(tmp_path / "frame.raw"), "--require", "trustworthy")
    assert result.code == 2
    assert "are for camera files" in result.err


def test_json_of_one_value_is_a_document_too(camcal, rig):
    payload = json.loads(camcal(rig, "--json", "--get", "cameras.left.fixed").out)
    warnings = payload.pop("warnings")
    assert payload == {"schema": "camcal/inspect/1", "file": rig, "key": "cameras.left.fixed", "value": ["p2"]}
    assert warnings == []


def test_warnings_go_to_stderr_and_into_the_document(camcal, rig, tmp_path):
    odd = tmp_path / "odd.yaml"
    odd.write_text(CAMERA.replace("images_used: 34", "images_used: 3"))
    result = camcal(str(odd))
    assert result.code == 0
    few = f"camcal: warning: {odd}:17: cameras.left.quality.images_used: 3 images: use 10 or more"
    assert result.err.splitlines() == [few, f"camcal: warning: {odd}:{UNTRUSTED}"]
    assert json.loads(camcal(str(odd), "--json").out)["warnings"][0]["code"] == "few_images"


def test_every_broken_rule_has_its_line(camcal, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(CAMERA.replace("fx: 512.0625", "fx: 0.0").replace("model: pinhole", "model: pinhol"))
    result = camcal(str(path))
    assert (result.code, result.out) == (2, "")
    assert [line.partition("bad.yaml")[2].partition(": ")[0] for line in result.err.splitlines()] == [":9", ":25"]


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        (None, 3, "no such file"),
        (b"", 3, "is empty"),
        (b"\x89PNG\r\n\x1a\n", 3, "not a text file"),
        (b"a: [1,", 3, "truncated"),
        (b"type: chessboard\ninner_corners: [9, 6]\n", 2, "not a camera file"),
    ],
)
def test_what_is_no_camera_file_gets_one_clear_line(camcal, tmp_path, content, code, words):
    path = tmp_path / "a.yaml"
    if content is not None:
        path.write_bytes(content)
    result = camcal(str(path))
    assert (result.code, result.out) == (code, "")
    assert words in result.err
    assert len(result.err.splitlines()) == 1


def test_a_lens_without_rays_at_the_edges_of_the_image_has_no_field_of_view_there():
    entry = CameraEntry(Camera(model_named("pinhole"), (640, 480), np.array([500.0, 500.0, 320.0, 240.0])))
    assert list(camera_lines(entry, (1.0, np.nan, np.nan))) == ["field of view horizontal 1.0°"]
    (line,) = camera_lines(entry, (np.nan, np.nan, np.nan))
    assert line == "field of view unknown: the lens model is not valid at the edges of the image"


def test_the_image_circle_is_shown_and_ends_the_field_of_view(camcal, tmp_path):
    lens = """format: camcal-calibration
version: 1
cameras:
  fish:
    image_size: [640, 720]
    model: kannala_brandt4
    intrinsics: {fx: 200.0, fy: 200.0, cx: 319.5, cy: 319.5}
    distortion: {k1: -0.01, k2: 0.0, k3: 0.0, k4: 0.0}
"""
    (tmp_path / "fish.yaml").write_text(lens.replace("-0.01", "-0.1"))
    without = camcal(str(tmp_path / "fish.yaml"))
    (tmp_path / "fish.yaml").write_text(
        lens + "    valid: {image_circle: {centre_px: [319.5, 319.5], radius_px: 300.25}}\n"
    )
    result = camcal(str(tmp_path / "fish.yaml"))
    assert (result.code, result.err) == (0, "")
    assert "image circle of radius 300.2 px around (319.5, 319.5)" in result.out
    assert "field of view horizontal 176.2°" in result.out  # 2 · 1.538 rad: θ - 0.01 θ³ = 300.25 / 200
    assert "nan" not in without.out + without.err + result.out + result.err
    assert camcal(str(tmp_path / "fish.yaml"), "--get", "cameras.fish.valid.image_circle.radius_px").out == "300.25\n"


KNOWN = CAMERA.replace("fixed: [p2]", "fixed: [p2, p1]").replace(", p1: 4.1e-05}", "}").partition("  right:\n")[0]


def test_errors_at_a_distance_are_shown_and_in_json(camcal, tmp_path):
    (tmp_path / "left.yaml").write_text(KNOWN)
    result = camcal(str(tmp_path / "left.yaml"), "--at", "0.8m,2m", "--length", "100mm")
    assert result.code == 0
    assert "one pixel spans 1.56 mm at 0.8 m in the middle of the image" in result.out
    assert "left are placed from the camera itself: the file does not say how well the boards" in result.out
    found = json.loads(camcal(str(tmp_path / "left.yaml"), "--at", "0.8m,2m", "--length", "100mm", "--json").out)
    near, far = found["errors"]
    assert (near["distance_m"], near["length_m"], near["pairs"]) == (0.8, 0.1, [])
    left = near["cameras"]["left"]
    assert left["pixel_m"] == pytest.approx(0.8 / np.sqrt(512.0625 * 511.5))
    assert not left["placed_by_boards"]
    assert set(left["length"]) == {"std_m", "worst_m", "bound_95_m"}
    assert left["point"] == far["cameras"]["left"]["point"]  # of directions, from the camera itself


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--length", "1m"], "--length needs a distance: add --at, such as --at 0.8m"),
        (["--at", "near"], "'near' is not lengths such as 0.5m,800mm, separated by commas"),
        (["--at", "1m"], "camera 'right' states no covariance, so that no errors follow: calibrate with camcal"),
        (["--camera", "left", "--at", "0.1m", "--length", "1m"], "an object of 1 m has no two ends at 0.1 m"),
    ],
)
def test_errors_that_do_not_follow_are_refused(camcal, rig, arguments, words):
    result = camcal(rig, *arguments)
    assert result.code == 2
    assert words in result.err.splitlines()[-1]
