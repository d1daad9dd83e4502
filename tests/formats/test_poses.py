"""Pose files: the three forms hold the same numbers and read them back; what is wrong is told with its place."""

import csv
import json
from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.estimate.poses.records import Alternative
from camcal.formats import poses
from camcal.formats.poses.record import PixelNoise, PoseKey, PoseRecord, Poses
from camcal.geometry.pose import Pose

SUFFIXES = (".yaml", ".json", ".csv")
DIGITS = 1e-11  # relative; 12 significant digits are written


def covariance(rng):
    root = rng.normal(0, 1e-3, (6, 6))
    return root @ root.T


def record(rng, **more):
    pose = Pose.from_vector(rng.normal(0, 1, 3), rng.normal(0, 1, 3))
    figures = {"rms_px": 0.21, "max_px": 0.5, "n_points": 54, "n_inliers": 52, "outliers": (3, 17)}
    return PoseRecord(pose, covariance(rng), covariance(rng), "ok", **{**figures, **more})


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(1)
    other = Pose.from_vector(rng.normal(0, 1, 3), rng.normal(0, 1, 3))
    doubtful = record(
        rng,
        p_wrong=0.02,
        error_ratio=0.8,
        alternatives=(Alternative(other, 7.8, 0.02, covariance(rng), covariance(rng)),),
        planarity=0.0,
        least_depth=0.4,
        tilt_rad=0.3,
        image_share=0.05,
        condition=123.0,
    )
    estimates = {PoseKey("a, b.png"): record(rng, outliers=()), PoseKey("c.png", "tag_3"): doubtful}
    missing = {PoseKey("d.png"): "no board found", PoseKey("d.png", "tag_4"): "too few points, 3"}
    return Poses("camera_T_object", "m", PixelNoise(0.15, None, 102), estimates, missing)


def assert_same_pose(first, second):
    np.testing.assert_allclose(first.matrix(), second.matrix(), atol=1e-10)  # 12 digits of a quaternion


def assert_same(first, second):
    assert (first.frames, first.unit, list(first.estimates), dict(first.missing)) == (
        *(second.frames, second.unit, list(second.estimates), dict(second.missing)),
    )
    assert first.noise == second.noise
    for one, two in zip(first.estimates.values(), second.estimates.values(), strict=True):
        assert_same_pose(one.transform, two.transform)
        np.testing.assert_allclose(one.covariance, two.covariance, rtol=DIGITS)
        np.testing.assert_allclose(one.noise_covariance, two.noise_covariance, rtol=DIGITS)
        for field in fields(PoseRecord)[3:]:
            if field.name != "alternatives":
                value = getattr(two, field.name)
                expected = pytest.approx(value, rel=DIGITS) if isinstance(value, float) else value
                assert getattr(one, field.name) == expected, field.name
        assert len(one.alternatives) == len(two.alternatives)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_written_is_read_back(found, tmp_path, suffix):
    path = tmp_path / f"poses{suffix}"
    poses.write(path, found)
    back = poses.read(path)
    assert_same(back, found)
    (mine,), (theirs,) = (each.estimates["c.png", "tag_3"].alternatives for each in (back, found))
    assert_same_pose(mine.transform, theirs.transform)
    assert mine.chi_square_difference == pytest.approx(theirs.chi_square_difference)
    if suffix == ".csv":
        assert mine.noise_covariance is None
    else:
        np.testing.assert_allclose(mine.noise_covariance, theirs.noise_covariance, rtol=DIGITS)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_read_is_written_as_the_same_bytes(found, tmp_path, suffix):
    once, again = tmp_path / f"once{suffix}", tmp_path / f"again{suffix}"
    poses.write(once, found)
    poses.write(again, poses.read(once))
    numbers = [[float(f"{value:.9g}") for value in _numbers(path.read_text("utf-8"))] for path in (once, again)]
    assert numbers[0] == numbers[1]  # the last digits of rotation vectors may differ


def _numbers(text):
    for word in text.replace(",", " ").replace("[", " ").replace("]", " ").replace("}", " ").split():
        try:
            yield float(word)
        except ValueError:
            continue


@settings(max_examples=15)
@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=20),
)
def test_any_pose_and_any_name_come_back(tmp_path_factory, turn, place, name):
    rng = np.random.default_rng(2)
    one = replace(record(rng), transform=Pose.from_vector(np.array(turn), np.array(place)))
    found = Poses("object_T_camera", "squares", PixelNoise(1.0), {PoseKey(name, "o"): one})
    for suffix in SUFFIXES:
        path = tmp_path_factory.getbasetemp() / f"any{suffix}"
        poses.write(path, found)
        back = poses.read(path)
        assert list(back.estimates) == [PoseKey(name, "o")]
        np.testing.assert_allclose(back.estimates[name, "o"].transform.translation, place, rtol=DIGITS, atol=1e-300)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_scale_of_the_noise_is_read_back(found, tmp_path, suffix):
    path = tmp_path / f"poses{suffix}"
    for noise in (PixelNoise(0.15, 2.5, 102), PixelNoise(0.15, 1.0), PixelNoise(0.15)):
        poses.write(path, replace(found, noise=noise))
        assert poses.read(path).noise == noise


def test_yaml_and_json_hold_the_same_numbers(found, tmp_path):
    for name in ("poses.yaml", "poses.json"):
        poses.write(tmp_path / name, found)
    from_yaml = yaml.safe_load((tmp_path / "poses.yaml").read_text("utf-8"))
    assert from_yaml == json.loads((tmp_path / "poses.json").read_text("utf-8"))
    assert from_yaml["missing"][0] == {"image": "d.png", "reason": "no board found"}
    assert from_yaml["noise"]["degrees_of_freedom"] == 102
    item = from_yaml["poses"][1]
    camera = Pose.from_vector(
        np.array(item["camera_T_object"]["rotation_vector"]), item["camera_T_object"]["translation"]
    ).inverse()
    np.testing.assert_allclose(item["position"], camera.translation, rtol=1e-9)
    assert item["view_angle_deg"] == pytest.approx(np.degrees(0.3))


def test_a_csv_row_has_the_pose_and_the_upper_triangle_of_its_covariance(found, tmp_path):
    path = tmp_path / "poses.csv"
    poses.write(path, found)
    first, *lines = path.read_text("utf-8").splitlines()
    assert first == "# camcal-poses 1 frames=camera_T_object unit=m sigma_px=0.15 degrees_of_freedom=102"
    row, _ = csv.DictReader(line for line in lines if not line.startswith("#"))
    known = found.estimates["a, b.png", ""]
    assert row["image"] == "a, b.png"
    assert [float(row[name]) for name in ("tx", "ty", "tz")] == pytest.approx(known.transform.translation.tolist())
    assert float(row["cov_tz_rx"]) == pytest.approx(known.covariance[2, 3], rel=1e-11)
    assert row["alt_tx"] == ""
    assert lines[-2] == "# none d.png,,no board found"


def test_the_inverse_turns_names_transforms_and_covariances(found):
    back = found.inverse()
    assert back.frames == "object_T_camera"
    for pose_key, known in found.estimates.items():
        turned = back.estimates[pose_key]
        np.testing.assert_allclose((turned.transform @ known.transform).matrix(), np.eye(4), atol=1e-12)
        np.testing.assert_allclose(back.position(turned), found.position(known), atol=1e-12)
    assert_same(back.inverse(), found)


def test_other_kinds_of_file_are_refused(found, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.yaml, \.yml, \.json, \.csv"):
        poses.write(tmp_path / "poses.txt", found)


@pytest.mark.parametrize(
    ("suffix", "old", "new", "message"),
    [
        (".yaml", "    status: ok", "    statsu: ok", "poses[0].statsu: unknown key. Did you mean 'status'?"),
        (".json", '"status": "ok"', '"statsu": "ok"', "poses[0].statsu: unknown key. Did you mean 'status'?"),
        (".csv", "status", "statsu", ":2: unknown column 'statsu'. Did you mean 'status'?"),
        (".yaml", "unit: m\n", "unit: mm\n", "unit: unknown unit 'mm'"),
        (".yaml", "camera_T_object\nunit", "camera_to_object\nunit", "is not camera_T_object or object_T_camera"),
        (".csv", "frames=camera_T_object", "frames=extrinsics", "is not camera_T_object or object_T_camera"),
        (".yaml", "[tx, ty, tz, rx, ry, rz]", "[rx, ry, rz, tx, ty, tz]", "is not supported; use ['tx'"),
        (".json", '"image": "c.png",\n   "object": "tag_3"', '"image": "a, b.png"', "poses[1]: a, b.png occurs twice"),
        (".csv", "c.png,tag_3", '"a, b.png",', ":4: a, b.png occurs twice"),
        (".yaml", "version: 1", "version: 2", "is newer than this camcal"),
        (".csv", "camcal-poses 1", "camcal-poses 2", "is newer than this camcal"),
        (".yaml", "qw: ", "qw: 1", "outside"),
        (".yaml", "rms_px: 0.21", "rms_px: -0.21", "is outside [0, 1e+12]"),
    ],
)
def test_a_file_that_breaks_a_rule_is_refused_with_the_place(found, tmp_path, suffix, old, new, message):
    path = tmp_path / f"poses{suffix}"
    poses.write(path, found)
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    with pytest.raises(InvalidInput) as caught:
        poses.read(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_covariance_that_is_none_is_refused(found, tmp_path):
    path = tmp_path / "poses.json"
    poses.write(path, found)
    data = json.loads(path.read_text("utf-8"))
    data["poses"][0]["covariance"][2][2] *= -1
    path.write_text(json.dumps(data))
    with pytest.raises(InvalidInput, match=r"poses\[0\]\.covariance: not a covariance: the variance in row 3"):
        poses.read(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("poses.json", "{", "invalid or truncated JSON"),
        ("poses.json", "[1]", "not a JSON object"),
        ("poses.yaml", "a: [", "invalid or truncated YAML"),
        ("poses.csv", "image,tx\na,1\n", "not a pose file of camcal"),
        ("poses.csv", "", "is empty"),
    ],
)
def test_what_is_no_pose_file_at_all_cannot_be_read(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(FileError, match=message):
        poses.read(tmp_path / name)


def test_a_translation_beyond_all_measure_is_refused(tmp_path):
    path = tmp_path / "far.json"
    pose = '{"translation": [1e300, 0, 1], "quaternion": {"qw": 1, "qx": 0, "qy": 0, "qz": 0}}'
    path.write_text(
        '{"format": "camcal-poses", "version": 1, "frames": "camera_T_object", "poses": ['
        f'{{"image": "a.png", "camera_T_object": {pose}}}]}}'
    )
    with pytest.raises(InvalidInput, match=r"translation\[0\]: 1e\+300 is outside"):
        poses.read(path)


def test_a_translation_of_a_table_beyond_all_measure_is_refused(found, tmp_path):
    path = tmp_path / "far.csv"
    poses.write(path, found)
    lines = path.read_text("utf-8").splitlines()
    column = lines[1].split(",").index("ty")
    *before, last = next(csv.reader([lines[2]]))[: column + 1]
    lines[2] = lines[2].replace(f"{before[-1]},{last},", f"{before[-1]},3.4e38,", 1)
    path.write_text("\n".join(lines) + "\n", "utf-8")
    with pytest.raises(InvalidInput, match=r"far\.csv:3: a translation of 3\.4e\+38 is implausible"):
        poses.read(path)
