"""`camcal transform chain`, `eval`, `compose` and `invert`: what they give, say and refuse."""

import json
from pathlib import Path

import numpy as np
import pytest

from camcal.formats import frames as frames_format

FRAMES = """transforms:
  base_T_cam: {rotation_vector_deg: [0.0, 0.0, 90.0], t: [1.0, 0.0, 0.5]}
  cam_T_tag: {rotation_vector: [0.0, 0.0, 0.0], t: [0.0, 0.0, 2.0], std: [0.001, 0.001, 0.002, 0.01, 0.01, 0.01]}
  lidar_T_cam: {euler: {axes: ZYX, deg: [90.0, 0.0, -90.0]}, t: [0.0, 0.1, 0.0]}
"""
WEBCAM = str(Path(__file__).parents[2] / "sample_configs" / "cameras" / "webcam.yaml")  # one camera, no transforms
TRANSFORM_KEYS = [
    "name", "R", "t", "quaternion", "rotation_vector", "std", "covariance", "form", "numbers", "gimbal_lock"
]  # fmt: skip


@pytest.fixture
def frames(tmp_path):
    path = tmp_path / "frames.yaml"
    path.write_text(FRAMES)
    return path


def test_a_chain_is_said_with_its_uncertainty_and_what_it_is_made_of(run, frames):
    code, out, err = run("transform", "chain", frames, "--to", "base", "--from", "tag")
    assert code == 0
    assert "base_T_tag: takes points in tag to points in base" in out
    assert "1.0000 0.0000 2.5000  ± 0.0010 0.0010 0.0020" in out
    assert "base_T_cam * cam_T_tag" in out
    assert err == "camcal: warning: no covariance, assumed exact: base_T_cam\n"


@pytest.mark.parametrize(
    ("arguments", "products"),
    [
        (("chain", "--to", "base", "--from", "tag"), ["base_T_cam * cam_T_tag"]),
        (("eval", "base_T_cam * cam_T_tag"), ["base_T_cam * cam_T_tag"]),
    ],
)
def test_the_json_document(run, frames, arguments, products):
    where = ("-f", frames) if arguments[0] == "eval" else (frames,)
    code, out, _ = run("transform", *arguments, *where, "--json", "--as", "quat:wxyz")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "transforms", "products", "exact", "loops", "output", "warnings"]
    assert document["schema"] == f"camcal/transform-{arguments[0]}/1"
    (transform,) = document["transforms"]
    assert list(transform) == TRANSFORM_KEYS
    assert transform["name"] == "base_T_tag"
    assert transform["form"] == "quat:wxyz"
    np.testing.assert_allclose(transform["numbers"], [1, 0, 2.5, 0.5**0.5, 0, 0, 0.5**0.5], atol=1e-11)
    assert transform["std"] == pytest.approx([0.001, 0.001, 0.002, 0.01, 0.01, 0.01])
    assert document["products"] == products
    assert document["exact"] == ["base_T_cam"]


def test_bare_numbers_go_from_one_command_to_the_next(run, frames, tmp_path):
    code, out, _ = run("transform", "chain", frames, "--to", "base", "--from", "tag", "--as", "euler:ZYX:deg", "-q")
    assert (code, out) == (0, "")
    _, out, _ = run("transform", "chain", frames, "--to", "base", "--from", "tag", "--as", "euler:ZYX:deg")
    assert out.splitlines() == ["# base_T_tag, euler:ZYX:intrinsic:deg", "1 0 2.5 90 0 0"]
    (tmp_path / "piped.txt").write_text(out)
    _, out, _ = run("transform", "invert", tmp_path / "piped.txt", "--as", "kitti")
    assert out.splitlines()[0] == "# tag_T_base, kitti"
    np.testing.assert_allclose(np.array(out.splitlines()[1].split(), float), [0, 1, 0, 0, -1, 0, 0, 1, 0, 0, 1, -2.5],
                               atol=1e-12)  # fmt: skip


def test_a_loop_that_closes_is_said_and_one_that_does_not_is_refused(run, frames):
    _, out, _ = run("transform", "chain", frames, "tag_T_lidar=0.1 -2 0 0 0 0", "--form", "rvec",
                    "--to", "base", "--from", "tag", "--loop-mm", 9000, "--loop-deg", 180)  # fmt: skip
    assert "the loop cam_T_tag * tag_T_lidar * lidar_T_cam closes to" in out
    code, _, err = run("transform", "chain", frames, "tag_T_lidar=0.1 -2 0 0 0 0", "--form", "rvec",
                       "--to", "base", "--from", "tag")  # fmt: skip
    assert code == 2
    assert "from identity, more than 1 mm and 0.1°" in err
    code, out, _ = run("transform", "chain", frames, "cam_T_base=0 1 -0.5 0 0 -90", "--form", "rvec:deg",
                       "--to", "base", "--from", "tag")  # fmt: skip
    assert code == 0
    assert "the loop base_T_cam * cam_T_base closes to" in out


def test_bare_numbers_of_one_way_among_several_say_which_it_is_and_are_read_again(run, frames, tmp_path):
    code, out, _ = run("transform", "chain", frames, "base_T_tag=1 0 2.5004 0 0 90", "--form", "rvec:deg",
                       "--to", "base", "--from", "tag", "--as", "rvec:deg")  # fmt: skip
    assert code == 0
    made_of, loop, rule, *numbers = out.splitlines()
    assert made_of == "# made of base_T_tag"  # one transform, not two
    assert loop.startswith("# the loop base_T_cam * cam_T_tag * inv(base_T_tag) closes to 0.4 mm and")
    assert "the path with the fewest transforms is used; loops check the others" in rule
    assert numbers == ["# base_T_tag, rvec:deg", "1 0 2.5004 0 0 90"]
    (tmp_path / "piped.txt").write_text(out)
    _, again, _ = run("transform", "convert", tmp_path / "piped.txt", "--as", "rvec:deg")
    assert again.splitlines() == numbers


def test_covariances_decide_whether_a_loop_closes(run, tmp_path):
    def loop(off):
        row = "rotation_vector: [0.0, 0.0, 0.0], std: [0.01, 0.01, 0.01, 0.01, 0.01, 0.01]"
        (tmp_path / "loop.yaml").write_text(
            f"transforms:\n  a_T_b: {{t: [0.0, 0.0, 0.0], {row}}}\n  b_T_a: {{t: [{off}, 0.0, 0.0], {row}}}\n"
        )
        return run("transform", "chain", tmp_path / "loop.yaml", "--to", "a", "--from", "b")

    code, out, _ = loop(0.03)  # 0.03² / (2 · 0.01²)
    assert code == 0
    assert "χ² = 4.5 with 6 degrees of freedom" in out
    code, _, err = loop(0.3)
    assert code == 2
    assert "χ² = 450" in err


def test_a_product_whose_frames_do_not_meet_is_refused(run, frames):
    code, _, err = run("transform", "eval", "base_T_cam * lidar_T_cam", "-f", frames)
    assert code == 2
    assert "did you mean base_T_cam * inv(lidar_T_cam)?" in err
    code, _, err = run("transform", "compose", f"{frames}#base_T_cam", f"{frames}#lidar_T_cam")
    assert code == 2
    assert "'cam' does not meet 'lidar'" in err


def test_poses_without_names_are_composed_as_they_are(run):
    code, out, _ = run("transform", "compose", "-1 0 0 0 0 90", "0 1 0 0 0 0", "--form", "rvec:deg", "--as", "rvec:deg")
    assert code == 0
    assert out.splitlines() == ["# pose, rvec:deg", "-2 0 0 0 0 90"]


def test_turns_about_axes_are_multiplied(run):
    code, out, _ = run("transform", "compose", "Rz(90deg)", "Ry(-90deg)", "Rx(0.5rad)", "--as", "euler:ZYX:deg")
    assert code == 0
    assert "# gimbal lock" in out
    code, out, _ = run("transform", "compose", "Rz(30deg)", "Ry(-20deg)", "Rx(10deg)", "--as", "euler:ZYX:deg")
    np.testing.assert_allclose(np.array(out.splitlines()[1].split(), float), [0, 0, 0, 30, -20, 10], atol=1e-9)


def test_numbers_below_zero_are_no_options_and_misspelt_options_no_numbers(run):
    code, out, _ = run("transform", "invert", -1, -2, "-.5", 0, 0, 0, "--form", "rvec", "--as", "rvec")
    assert (code, out.splitlines()[1]) == (0, "1 2 0.5 0 0 0")
    code, _, err = run("transform", "invert", -1, 2, 3, 0, 0, 0, "--fomr", "rvec")
    assert code == 2
    assert "--fomr" in err


def test_all_transforms_of_a_file_are_inverted_into_another(run, frames, tmp_path):
    output = tmp_path / "inverses.yaml"
    code, out, _ = run("transform", "invert", frames, "-o", output)
    assert code == 0
    assert f"wrote {output}" in out
    found = frames_format.read(output)
    assert [item.name for item in found] == ["cam_T_base", "tag_T_cam", "cam_T_lidar"]
    for item, original in zip(found, frames_format.read(frames), strict=True):
        np.testing.assert_allclose((item.pose @ original.pose).matrix(), np.eye(4), atol=1e-11)
    # 10 mrad seen from 2 m are 20 mm across, and 1 mm of its own
    assert np.sqrt(found[1].covariance[0, 0]) == pytest.approx(np.hypot(0.001, 0.02), rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("chain", "{frames}", "--to", "bose", "--from", "tag"), 2, "no frame 'bose'. Did you mean 'base'?"),
        (
            ("chain", "{frames}", "x_T_y=0 0 0 0 0 0", "--form", "rvec", "--to", "x", "--from", "tag"),
            2,
            "no transforms",
        ),
        (("chain", "0 0 0 0 0 0", "--form", "rvec", "--to", "a", "--from", "b"), 2, "write a_T_b='0 0 0 0 0 0'"),
        (
            ("chain", "{frames}", "--to", "base", "--from", "tag", "--loop-mm", "-1"),
            2,
            "'--loop-mm': -1 is less than 0",
        ),
        (("eval", "base_T_cam", "-f", "{frames}", "-f", "{frames}"), 2, "base_T_cam is also in"),
        (("compose", "0 0 0 0 0 0", "--form", "rvec"), 2, "two or more"),
        (("invert", "nowhere.txt"), 3, "nowhere.txt: no such file"),
        (("invert", "{frames}", "-o", "{frames}"), 2, "is an input"),
        (("invert", "{frames}", "-o", "out.txt"), 2, "3 transforms cannot be written as text"),
        (("invert", "{frames}", "-o", "out.png"), 2, "is not written; use .yaml"),
        (("invert", "{frames}", "--as", "quats"), 2, "form 'quats' is unknown"),
        (("invert", "1 0 0 0 0 1 0 0 0 0 -1 0"), 2, "det = -1, a reflection"),
        (("invert", ""), 2, "an empty text; is a variable of the shell not set?"),
        (("invert", "a_T_b="), 2, "'a_T_b=' is not a pose"),
        (("invert", "Rz(1e99deg)"), 2, "more than 1e+06 rad is not a valid rotation"),
        (("invert", "0 0 0 0 1e9 0", "--form", "rvec"), 2, "more than 1e+06 rad is not a valid rotation"),
        (("compose", "a_T_b=Rz(1deg)", WEBCAM), 4, "webcam.yaml: holds no transforms"),
    ],
)
def test_what_makes_no_sense_is_one_clear_line(run, frames, tmp_path, monkeypatch, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    found, out, err = run("transform", *(argument.format(frames=frames) for argument in arguments))
    assert found == code
    assert words in err
    assert out == ""
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames.yaml"]
