"""`camcal stereo check`: what it says, its picture, and its exits."""

import json

import cv2
import numpy as np
import pytest
from room_scene import BESIDE, RoomRig
from textured import darker, noisy, textured_pair, waves

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.run.outputs import listed

SIZE = (180, 130)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """A folder with left and right images: good ones, and right ones whose rows are off."""
    folder = tmp_path_factory.mktemp("pairs")
    left, right = textured_pair(waves(4, 20, SIZE))
    _, lower = textured_pair(waves(4, 20, SIZE), 0.8)
    for name, image in {"left": left, "right": right, "lower": lower, "dark": darker(right)}.items():
        cv2.imwrite(str(folder / f"{name}.png"), image)
    return folder


def sequence(tmp_path, *rows):
    """Write folders of left and right images whose row differences so much; None for images that share nothing."""
    for index, off in enumerate(rows):
        left, right = textured_pair(waves(4, 20, SIZE), off or 0.0)
        if off is None:
            right = noisy(np.full_like(left, 100), 40)
        for side, image in (("left", left), ("right", right)):
            (tmp_path / side).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / side / f"{side}_{index}.png"), image)
    return tmp_path / "left", tmp_path / "right"


def test_a_good_pair_is_said_to_be_one(run, images):
    code, out, err = run("stereo", "check", images / "left.png", images / "right.png", "--max-rms", 0.5)
    assert code == 0
    assert err == ""
    for words in ("rows differ by", "±", "trend:", "disparity 4 … 20 px", "exposures agree", "Rows agree"):
        assert words in out


def test_rows_and_exposure_that_differ_are_said_in_numbers(run, images):
    _, out, _ = run("stereo", "check", images / "left.png", images / "lower.png")
    assert "worth a new calibration and rectification" in out
    assert "rows differ by +0.80" in out or "rows differ by +0.79" in out  # to a standard error of 0.01
    _, out, _ = run("stereo", "check", images / "left.png", images / "dark.png")
    assert "% darker (gain 0." in out


def test_rows_far_off_are_said_to_be_of_no_rectified_pair_without_figures_of_a_trend(run, tmp_path):
    left, right = textured_pair(waves(4, 20, SIZE), (0.06, 0.0, 3.0))
    for name, image in (("left", left), ("right", right)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    code, out, _ = run("stereo", "check", tmp_path / "left.png", tmp_path / "right.png")
    assert code == 0
    assert "These images are not rectified: rows differ by more than the 5 px that are corrected" in out
    assert "rows differ by up to 1" in out  # 3 at the left edge, 14 at the right one
    assert "95 % within" not in out
    assert "trend" not in out


def test_the_gate_lets_rows_through_only_below_its_limit(run, images):
    assert run("stereo", "check", images / "left.png", images / "lower.png", "--max-rms", 1.5)[0] == 0
    code, out, err = run("stereo", "check", images / "left.png", images / "lower.png", "--max-rms", 0.5)
    assert code == 7
    assert "rows differ by" in out  # the findings are shown before the gate closes
    assert "left.png: row differences 0.8" in err
    assert "(limit 0.5 px)" in err


@pytest.mark.parametrize(("right", "words"), [("left.png", "the same view"), (None, "swapped")])
def test_a_pair_that_is_none_is_said_in_words_and_fails_a_gate_only(run, images, tmp_path, right, words):
    first, second = (
        (images / "right.png", images / "left.png") if right is None else (images / "left.png", tmp_path / "copy.png")
    )
    if right is not None:
        second.write_bytes(first.read_bytes())
    code, out, err = run("stereo", "check", first, second)
    assert code == 0
    assert words in out
    assert words in err
    assert run("stereo", "check", first, second, "--max-rms", 0.5, "--quiet")[0] == 7


def test_the_picture_shows_the_left_image_and_the_colours_of_its_rows(run, images, tmp_path):
    code, out, _ = run("stereo", "check", images / "left.png", images / "lower.png", "-o", tmp_path / "check.png")
    assert code == 0
    assert f"wrote {tmp_path / 'check.png'}" in out
    picture = cv2.imread(str(tmp_path / "check.png")).astype(int)
    assert picture.shape[1] == 1320
    blue, _, red = np.moveaxis(picture[:, : picture.shape[1] // 2], 2, 0)
    assert np.mean(red > blue + 10) > 0.2  # rows lie lower in the right image: red cells nearly everywhere
    assert np.mean(blue > red + 10) < 0.02


def test_no_picture_is_written_unless_it_is_named(run, images, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("stereo", "check", images / "left.png", images / "right.png")[0] == 0
    assert list(tmp_path.iterdir()) == []


def test_the_json_document_of_a_pair(run, images):
    code, out, _ = run("stereo", "check", images / "left.png", images / "lower.png", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "pairs", "overall", "failed", "warnings"]
    assert document["schema"] == "camcal/stereo-check/1"
    pair = document["pairs"][0]
    assert list(pair) == [
        "left", "right", "size", "axis", "features", "rows_px", "trend_px", "rows_per_disparity", "disparity_px",
        "exposure", "failure", "verdict", "picture",
    ]  # fmt: skip
    assert pair["rows_px"]["median"]["value"] == pytest.approx(0.8, abs=0.03)  # two standard errors
    assert list(pair["rows_px"]) == ["median", "rms", "p95", "scatter"]
    assert list(pair["trend_px"]) == ["centre", "tilt", "scale", "rms", "largest"]
    assert list(pair["disparity_px"]) == ["low", "high", "search"]
    assert list(pair["exposure"]) == ["brightness", "gain", "offset", "gamma", "scatter", "differs"]
    assert pair["failure"] is None
    assert document["overall"]["rms"] == pair["rows_px"]["rms"]


@pytest.mark.slow
def test_folders_are_paired_and_checked_together(run, tmp_path):
    left, right = sequence(tmp_path, 0.0, 0.8)
    code, out, _ = run("stereo", "check", left, right, "-o", tmp_path / "pictures", "-j", 1)
    assert code == 0
    assert out.count("left_") == 3  # a line each, and the worst
    assert "all 2 pairs: median" in out
    assert f"the worst is {left / 'left_1.png'}" in out
    pictures = sorted(path.name for path in (tmp_path / "pictures").glob("*.png"))
    assert pictures == ["left_0_check.png", "left_1_check.png"]


@pytest.mark.slow
def test_pictures_are_listed_as_written_by_camcal(run, images, tmp_path):
    for output in (tmp_path / "folder", tmp_path / "check.png"):
        assert run("stereo", "check", images / "left.png", images / "right.png", "-o", output)[0] == 0
    assert listed(tmp_path / "folder") == {"left_check.png"}
    assert listed(tmp_path) == {"check.png"}


@pytest.mark.slow
def test_worker_processes_find_the_same(run, tmp_path):
    left, right = sequence(tmp_path, 0.0, 0.8)
    found = [run("stereo", "check", left, right, "--json", "-j", jobs) for jobs in (1, 2)]
    assert found[0] == found[1]


def test_a_pair_that_cannot_be_checked_costs_only_itself_and_a_gate_names_each_bad_one(run, tmp_path):
    left, right = sequence(tmp_path, 0.8, None)
    code, out, _ = run("stereo", "check", left, right, "--json", "-j", 1)
    document = json.loads(out)
    assert code == 6
    assert len(document["pairs"]) == 1
    assert document["failed"][0]["left"].endswith("left_1.png")
    assert "check that both images show the same scene" in document["failed"][0]["message"]
    code, _, err = run("stereo", "check", left, right, "--max-rms", 0.5, "-q", "-j", 1)
    assert code == 7
    assert err.count("camcal: error") == 1
    assert "left_0.png" in err


def test_sixteen_bits_are_compared_by_one_scale(run, images, tmp_path):
    for name, factor in (("left", 200), ("right", 150)):
        image = cv2.imread(str(images / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(tmp_path / f"{name}.png"), image.astype(np.uint16) * factor)
    _, out, _ = run("stereo", "check", tmp_path / "left.png", tmp_path / "right.png", "--json")
    exposure = json.loads(out)["pairs"][0]["exposure"]
    assert exposure["differs"]
    assert exposure["gain"] == pytest.approx(0.75, abs=0.1)  # the scale takes the darkest count for 0, and so shifts it


def test_images_of_other_sizes_are_refused_naming_both(run, images, tmp_path):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((90, 120), np.uint8))
    code, _, err = run("stereo", "check", images / "left.png", tmp_path / "small.png")
    assert code == 2
    assert "left.png" in err
    assert "small.png: the images differ in size: 180x130 and 120x90" in err


def test_images_without_features_are_too_little_data(run, tmp_path):
    for name in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((180, 240), 90, np.uint8))
    code, _, err = run("stereo", "check", tmp_path / "left.png", tmp_path / "right.png")
    assert code == 4
    assert "0 matched features" in err
    assert "image without texture: standard deviation of the gray levels" in err


def test_of_one_image_twice_nothing_is_said_that_is_nothing(run, images, tmp_path):
    (tmp_path / "copy.png").write_bytes((images / "left.png").read_bytes())
    _, out, _ = run("stereo", "check", images / "left.png", tmp_path / "copy.png")
    assert [line.strip() for line in out.splitlines()][3:5] == [
        "disparity 0 px; search range -3:3",
        "exposures agree",
    ]
    assert "rows do not differ" in out
    assert "trend" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--max-rms", 0), "--max-rms must be more than 0 px"),
        (("--max-rms", "nan"), "--max-rms must be more than 0 px"),
        (("-o", "check.svg"), ".svg is not written"),
    ],
)
def test_options_that_make_no_sense_are_refused(run, images, arguments, words):
    code, _, err = run("stereo", "check", images / "left.png", images / "right.png", *arguments)
    assert code == 2
    assert words in err


def test_an_input_is_not_overwritten_by_the_picture(run, images):
    code, _, err = run("stereo", "check", images / "left.png", images / "right.png", "-o", images / "right.png")
    assert code == 2
    assert "is an input" in err


def test_columns_of_cameras_above_each_other_are_checked(run, tmp_path):
    left, right = textured_pair(waves(4, 20, SIZE), 0.8)
    size = SIZE[::-1]
    view = Camera(model_named("pinhole"), size, np.array([100.0, 100.0, 64.0, 89.0]))
    cameras = {"upper": CameraEntry(view), "lower": CameraEntry(view)}
    below = Transform(Pose(np.eye(3), np.array([0.0, -0.1, 0.0])))
    native.write(tmp_path / "rectified.yaml", CameraFile(cameras, {"lower_T_upper": below}))
    for name, image in (("upper", left.T), ("lower", right.T)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    arguments = "stereo", "check", tmp_path / "upper.png", tmp_path / "lower.png", tmp_path / "rectified.yaml"
    code, out, err = run(*arguments, "-o", tmp_path / "check.png")
    assert (code, err) == (0, "")
    assert "columns differ by +0.80" in out or "columns differ by +0.79" in out
    assert "Column differences 0." in out
    found = json.loads(run(*arguments, "--json")[1])["pairs"][0]
    assert (found["axis"], found["size"]) == ("y", list(size))
    assert run(*arguments, "--max-rms", 0.5)[0] == 7


def test_images_of_a_rig_are_rectified_before_their_rows_are_checked(run, tmp_path):
    rig = RoomRig(tmp_path, "pinhole", BESIDE)
    code, out, err = run("stereo", "check", rig.left, rig.right, rig.file, "--json")
    assert code == 0, err
    assert json.loads(out)["pairs"][0]["rows_px"]["rms"] < 0.3
    as_they_are = json.loads(run("stereo", "check", rig.left, rig.right, "--json")[1])["pairs"]
    assert as_they_are[0]["rows_px"]["rms"] > 1
