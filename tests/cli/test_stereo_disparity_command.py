"""`camcal stereo disparity`: the files it leaves, what they say to the next command, what it says, and its exits."""

import json

import cv2
import numpy as np
import pytest
from textured import textured_pair, waves

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import disparity as maps
from camcal.formats import disparity_sidecar, native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.images.files import load
from camcal.run.outputs import listed
from camcal.stereo.disparity import Confidence, StereoGeometry

SIZE = (120, 80)
TRUTH = waves(4, 20, SIZE)
QUICK = ("--quality", "fast", "--jobs", 1)
NUMBERS = ("--fx", 100, "--cx", 59.5, "--cy", 39.5, "--baseline", 0.2)
GEOMETRY = StereoGeometry(100, 100, 59.5, 39.5, 0.2)
BESIDE = ["x.pfm", "x.pfm.confidence.png", "x.pfm.json", "x.pfm.sigma.tiff"]


@pytest.fixture(scope="module")
def pictures():
    """The left and the right image of a good pair, and a left one that is -6 to 6 pixels from the same right one."""
    return *textured_pair(TRUTH), textured_pair(waves(-6, 6, SIZE))[0]


@pytest.fixture
def pair(tmp_path, pictures):
    """A folder with a good pair, the left image of a toed-in one, and the camera file."""
    folder = tmp_path / "pair"
    folder.mkdir()
    for name, image in zip(("left", "right", "toed_in"), pictures, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    camera = Camera(model_named("pinhole"), SIZE, np.array([100.0, 100, 59.5, 39.5]))
    right_T_left = Transform(Pose(np.eye(3), np.array([-0.2, 0, 0])))
    rig = CameraFile({"left": CameraEntry(camera), "right": CameraEntry(camera)}, {"right_T_left": right_T_left})
    native.write(folder / "rig.yaml", rig)
    return folder


@pytest.fixture
def match(run, pair):
    """A function that matches the good pair, or other images, and gives code, stdout and stderr."""

    def match(*arguments, left="left.png", right="right.png", quick=QUICK):
        return run("stereo", "disparity", pair / left, pair / right, *arguments, *quick)

    return match


@pytest.fixture
def sequence(tmp_path, pictures):
    """Folders of three left and right images; the second right one is no image."""
    for side, image in zip(("left", "right"), pictures[:2], strict=True):
        (tmp_path / side).mkdir()
        for index in range(3):
            cv2.imwrite(str(tmp_path / side / f"{side}_{index}.png"), image)
    (tmp_path / "right" / "right_1.png").write_bytes(b"no image")
    return tmp_path / "left", tmp_path / "right"


def names(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != ".camcal-output")


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def off(found):
    """Return the median difference of a map from the truth, pixels."""
    return np.nanmedian(np.abs(found.matched() - TRUTH))


@pytest.mark.parametrize("quality", ["fast", "balanced", "best"])
def test_map_uncertainty_classes_sidecar_and_picture_are_named_by_the_map(match, tmp_path, quality):
    output = tmp_path / "out" / "x.pfm"
    code, out, err = match("-o", output, "--vis", quick=("--quality", quality, "--jobs", 1))
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == f"wrote {output} and {output}.vis.png"
    assert names(output.parent) == [*BESIDE, "x.pfm.vis.png"]
    found = maps.read(output)
    assert off(found) < 0.2  # two steps of the finest matcher
    np.testing.assert_array_equal(np.isfinite(maps.read(found.sidecar.sigma).values), np.isfinite(found.matched()))
    classes = load(found.sidecar.confidence).pixels
    np.testing.assert_array_equal(classes > Confidence.NONE, np.isfinite(found.matched()))
    assert load(tmp_path / "out" / "x.pfm.vis.png").pixels.shape[1] >= SIZE[0]


def test_the_sidecar_says_how_the_map_was_made_and_of_what(match, tmp_path, pair):
    assert match(pair / "rig.yaml", "-o", tmp_path / "x.pfm", "--range", "0:31", "--fill", "background")[0] == 0
    sidecar = disparity_sidecar.read(tmp_path / "x.pfm")
    assert (sidecar.scale, sidecar.invalid, sidecar.searched) == (1, "inf", (0, 31))
    assert sidecar.geometry == GEOMETRY
    assert sidecar.image.resolve() == pair / "left.png"
    assert dict(sidecar.matcher) == {"engine": "own", "quality": "fast", "fill": "background", "rows_px": 0.0}
    assert set(sidecar.inputs) == {"left", "right"}


@pytest.mark.parametrize("given", ["camera file", "numbers"])
def test_with_the_geometry_clouds_and_views_need_no_options(run, match, tmp_path, pair, given):
    geometry = [pair / "rig.yaml"] if given == "camera file" else NUMBERS
    checked = ("--quality", "balanced", "--jobs", 1)  # fast gives what only one image shows a disparity, a wrong one
    assert match(*geometry, "-o", tmp_path / "x.pfm", quick=checked)[0] == 0
    code, out, err = run("stereo", "cloud", tmp_path / "x.pfm", "-o", tmp_path / "x.ply", "--sigma", "--json")
    assert (code, err) == (0, "")
    report = json.loads(out)
    truth = TRUTH[np.isfinite(maps.read(tmp_path / "x.pfm").matched())]
    # 0.3 px, which nine of ten errors do not exceed, of the 10 px that most have
    assert report["depth_m"]["median"] == pytest.approx(100 * 0.2 / np.median(truth), rel=0.03)
    assert report["appearance"] == "gray"
    assert "sigma" in report["fields"]
    assert run("view", tmp_path / "x.pfm", "-o", tmp_path / "x.html")[::2] == (0, "")


def test_without_a_geometry_the_map_says_so(match, tmp_path):
    code, out, _ = match("-o", tmp_path / "x.pfm", "--json")
    assert code == 0
    assert json.loads(out)["pairs"][0]["geometry"] is False
    assert disparity_sidecar.read(tmp_path / "x.pfm").geometry is None


@pytest.mark.parametrize(
    ("arguments", "words"), [(("--fx", 100), "--baseline"), (("nowhere.yaml",), "nowhere.yaml: no such file")]
)
def test_half_a_geometry_or_one_that_is_not_there_is_refused_before_anything_is_written(
    match, tmp_path, arguments, words
):
    code, _, err = match(*arguments, "-o", tmp_path / "out" / "x.pfm")
    assert code == (2 if "--fx" in arguments else 3)
    assert words in err
    assert not (tmp_path / "out").exists()


def test_every_format_holds_the_same_map(match, tmp_path):
    found = {}
    for suffix in maps.SUFFIXES:
        assert match("-o", tmp_path / f"x{suffix}", "--map-only")[0] == 0
        found[suffix] = maps.read(tmp_path / f"x{suffix}")
    expected = found[".npy"].matched()
    for suffix, each in found.items():
        rounding = 0.5 / 256 if suffix == ".png" else 0
        np.testing.assert_allclose(each.matched(), expected, rtol=0, atol=rounding, err_msg=suffix)
        assert each.scale == (256 if suffix == ".png" else 1)


def test_map_only_leaves_out_uncertainty_and_classes(match, tmp_path):
    assert match("-o", tmp_path / "out" / "x.pfm", "--map-only")[0] == 0
    assert names(tmp_path / "out") == ["x.pfm", "x.pfm.json"]
    sidecar = disparity_sidecar.read(tmp_path / "out" / "x.pfm")
    assert (sidecar.sigma, sidecar.confidence) == (None, None)


def test_what_an_earlier_run_left_beside_the_map_goes_with_it(match, tmp_path):
    output = tmp_path / "out" / "x.pfm"
    assert match("-o", output, "--vis")[0] == 0
    assert names(output.parent) == sorted([*BESIDE, "x.pfm.vis.png"])
    (output.parent / "y.pfm.vis.png").write_bytes(b"of another map")
    assert match("-o", output)[0] == 0
    assert names(output.parent) == [*BESIDE, "y.pfm.vis.png"]
    assert match("-o", output, "--map-only")[0] == 0
    assert names(output.parent) == ["x.pfm", "x.pfm.json", "y.pfm.vis.png"]


def test_a_run_that_cannot_finish_does_not_begin(match, tmp_path):
    output = tmp_path / "out" / "x.pfm"
    assert match("-o", output)[0] == 0
    (output.parent / "x.pfm.vis.png").mkdir()
    (output.parent / "x.pfm.vis.png" / "kept.txt").touch()
    before = contents(output.parent)
    code, _, err = match("-o", output)
    assert code == 3
    assert "x.pfm.vis.png: is a folder, not a file" in err
    assert contents(output.parent) == before


def test_the_files_of_one_pair_are_listed_in_their_folder(match, tmp_path):
    assert match("-o", tmp_path / "maps", "--type", "pfm")[0] == 0
    assert match("-o", tmp_path / "file" / "x.pfm")[0] == 0
    assert "left.pfm.sigma.tiff" in listed(tmp_path / "maps")
    assert names(tmp_path / "file") == BESIDE
    assert sorted(listed(tmp_path / "file")) == BESIDE


def test_disparities_of_zero_and_less_are_left_out_of_a_png_and_of_its_figures(match, tmp_path):
    shares = {}
    for suffix in ("png", "tiff"):
        arguments = ("-o", tmp_path / f"x.{suffix}", "--range", "-16:16", "--json")
        code, out, err = match(*arguments, left="toed_in.png")
        assert code == 0
        assert ("of 0 or less omitted: a PNG cannot store them" in err) == (suffix == "png")
        shares[suffix] = json.loads(out)["pairs"][0]["matched"]
        found = maps.read(tmp_path / f"x.{suffix}")
        values = found.values if suffix == "tiff" else found.matched()
        assert shares[suffix] == pytest.approx(np.isfinite(values).mean())
        assert np.isfinite(maps.read(found.sidecar.sigma).values).mean() == pytest.approx(shares[suffix])
    assert 0.2 < shares["png"] < 0.8 * shares["tiff"]  # waves from -6 to 6 are below zero for half of the image


def test_the_json_document_of_a_pair(match, tmp_path, pair):
    code, out, _ = match(pair / "rig.yaml", "-o", tmp_path / "x.pfm", "--vis", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "pairs", "reused", "failures", "failed", "warnings"]
    assert document["schema"] == "camcal/stereo-disparity/1"
    (found,) = document["pairs"]
    assert list(found) == [
        "left", "right", "output", "sidecar", "picture", "image_size", "searched", "at_ends", "matched", "filled",
        "classes", "median_px", "sigma_px", "rows_px", "scale", "geometry",
    ]  # fmt: skip
    assert list(found["classes"]) == ["none", "filled", "single", "apart", "near", "agreed"]
    assert sum(found["classes"].values()) == pytest.approx(1)
    assert found["image_size"] == list(SIZE)
    assert found["geometry"] is True
    assert found["picture"] == (tmp_path / "x.pfm.vis.png").as_posix()
    assert found["median_px"] == pytest.approx(np.nanmedian(maps.read(tmp_path / "x.pfm").matched()))


def test_folders_are_matched_together_and_a_broken_pair_costs_only_itself(run, sequence, tmp_path):
    code, out, err = run("stereo", "disparity", *sequence, "-o", tmp_path / "maps", "--type", "pfm", "--json", *QUICK)
    document = json.loads(out)
    assert code == 6
    assert "1 of 3 pairs failed, the rest is written" in err
    assert [entry["left"].rpartition("/")[2] for entry in document["pairs"]] == ["left_0.png", "left_2.png"]
    assert [entry["left"].rpartition("/")[2] for entry in document["failed"]] == ["left_1.png"]
    assert "right_1.png" in document["failed"][0]["message"]
    written = [name for name in names(tmp_path / "maps") if name.endswith(".pfm")]
    assert written == ["left_0.pfm", "left_2.pfm"]
    assert off(maps.read(tmp_path / "maps" / "left_0.pfm")) < 0.2  # two steps of the finest matcher


def test_a_line_is_printed_for_each_map_and_the_classes_if_asked_for(run, sequence, tmp_path):
    arguments = ("stereo", "disparity", *sequence, "-o", tmp_path / "maps", *QUICK)
    _, out, _ = run(*arguments)
    assert [line.split()[0] for line in out.splitlines()[-3:]] == ["left_0.tiff", "left_2.tiff", "wrote"]
    assert all(words in out for words in ("matched", "range", "median", "sigma"))
    assert out.splitlines()[-1] == f"wrote 2 maps to {tmp_path / 'maps'}/"
    assert "agreed" not in out
    assert "agreed" in run(*arguments, "--verbose")[1]
    assert run(*arguments, "--quiet")[:2] == (6, "")


@pytest.mark.slow
def test_the_number_of_cores_does_not_show_in_the_files(run, match, sequence, tmp_path):
    for jobs in (1, 2):
        assert match("-o", tmp_path / f"{jobs}" / "x.pfm", "--vis", quick=("--jobs", jobs))[0] == 0
        folders = ("stereo", "disparity", *sequence, "-o", tmp_path / f"maps{jobs}", "--quality", "fast", "--vis")
        assert run(*folders, "--jobs", jobs)[0] == 6
    assert contents(tmp_path / "1") == contents(tmp_path / "2")
    assert contents(tmp_path / "maps1") == contents(tmp_path / "maps2")


@pytest.mark.parametrize("output", ["left.png", "right.png"])
def test_a_map_never_takes_the_place_of_an_input(match, pair, output):
    before = contents(pair)
    code, _, err = match("-o", pair / output)
    assert code == 2
    assert "is an input and is not overwritten" in err
    assert contents(pair) == before


def test_nor_does_a_file_beside_the_map(match, pair):
    (pair / "right.png").rename(pair / "left.tiff.confidence.png")
    before = contents(pair)
    code, _, err = match("-o", pair / "left.tiff", right="left.tiff.confidence.png")
    assert code == 2
    assert "is an input and is not overwritten" in err
    assert contents(pair) == before


def test_maps_of_several_pairs_do_not_go_into_one_file(run, sequence, tmp_path):
    code, _, err = run("stereo", "disparity", *sequence, "-o", tmp_path / "x.pfm")
    assert code == 2
    assert "3 inputs cannot be written to one file" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--range", "16"), "is not auto, or whole numbers as 0:128"),
        (("--range", "0:1.5"), "is not auto, or whole numbers as 0:128"),
        (("--range", "a:b"), "is not auto, or whole numbers as 0:128"),
        (("--range", "1:2:3"), "is not auto, or whole numbers as 0:128"),
        (("--range", "20:10"), "the range 20 to 10 is empty"),
        (("--range", "0:99999"), "exceeds any image"),
        (("--quality", "good"), "is not one of fast, balanced, best"),
        (("--fill", "some"), "is not one of none, background, all"),
        (("--align-rows", "yes"), "--align-rows"),
        (("--exposure", "on"), "--exposure"),
        (("--type", "jpg"), "'jpg' is not one of"),
        (("--engine", "other"), "is not one of own, onnx"),
        (("--engine", "onnx"), "--engine onnx and --model FILE go together"),
        (("--model", "network.onnx"), "--engine onnx and --model FILE go together"),
        (("--engine", "onnx", "--model", "network.onnx", "--range", "0:64"), "a network takes no --quality, --range"),
        (("--engine", "onnx", "--model", "network.onnx", "--fill", "all"), "a network takes no --quality, --range"),
    ],
)
def test_options_that_make_no_sense_are_refused_with_one_line_and_no_file(match, tmp_path, arguments, words):
    code, out, err = match("-o", tmp_path / "out" / "x.pfm", *arguments, quick=())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_map_of_another_type_than_maps_have_is_refused(match, tmp_path):
    code, _, err = match("-o", tmp_path / "x.jpg")
    assert code == 2
    assert ".jpg is not written" in err


@pytest.mark.parametrize("quality", ["fast", "balanced", "best"])
@pytest.mark.parametrize(
    ("search", "end"), [("0:10", "upper"), ("12:40", "lower")], ids=["too short", "too far from zero"]
)
def test_disparities_that_crowd_at_the_end_of_the_range_are_warned_of(match, tmp_path, search, end, quality):
    quick = ("--quality", quality, "--jobs", 1, "--force")
    code, _, err = match("-o", tmp_path / "x.pfm", "--range", search, quick=quick)
    assert code == 0
    assert f"of the matches at the {end} end of the range {search}: widen --range" in err
    assert match("-o", tmp_path / "x.pfm", "--range", "0:31", quick=quick)[2] == ""


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_a_swapped_pair_ends_with_exit_7_unless_it_is_forced_or_the_range_says_so(run, pair, tmp_path, quality):
    arguments = ("-o", tmp_path / "x.pfm", "--quality", quality, "--jobs", 1)
    swapped = pair / "right.png", pair / "left.png"
    code, _, err = run("stereo", "disparity", *swapped, *arguments)
    assert code == 7
    assert "right.png: left and right swapped, or cameras toed in (negative disparities)" in err
    assert (tmp_path / "x.pfm").exists()
    code, _, err = run("stereo", "disparity", *swapped, *arguments, "--force")
    assert code == 0
    assert "left and right swapped" in err
    assert run("stereo", "disparity", *swapped, *arguments, "--range", "-24:0")[::2] == (0, "")


def test_negative_disparities_that_the_camera_file_explains_are_no_swap(run, pair, tmp_path):
    swapped = pair / "right.png", pair / "left.png"  # as of cameras that are toed in by 40 px
    arguments = ("-o", tmp_path / "x.pfm", *NUMBERS, "--quality", "balanced", "--jobs", 1)
    assert run("stereo", "disparity", *swapped, *arguments, "--doffs", 40)[::2] == (0, "")
    assert run("stereo", "disparity", *swapped, *arguments, "--doffs", 1)[0] == 7


def test_images_of_different_things_end_with_exit_7_and_say_how_little_is_matched(match, pair, tmp_path):
    cv2.imwrite(str(pair / "other.png"), np.random.default_rng(3).integers(0, 255, SIZE[::-1]).astype(np.uint8))
    code, out, err = match("-o", tmp_path / "x.pfm", "--json", right="other.png", quick=("--jobs", 1))
    assert code == 7
    assert "of the pixels matched (limit 15 %)" in err
    assert json.loads(out)["failures"][0]["code"] == "few_matches"


def test_images_of_other_sizes_are_refused_naming_both(match, pair, tmp_path):
    cv2.imwrite(str(pair / "small.png"), np.zeros((40, 60), np.uint8))
    code, _, err = match("-o", tmp_path / "out" / "x.pfm", right="small.png")
    assert code == 2
    assert "left.png" in err
    assert "small.png" in err
    assert not (tmp_path / "out").exists()


def test_a_pair_of_which_one_image_is_missing_or_the_same_is_no_pair(match, tmp_path):
    code, _, err = match("-o", tmp_path / "x.pfm", right="rihgt.png")
    assert code == 3
    assert "no such file. Did you mean" in err
    code, _, err = match("-o", tmp_path / "x.pfm", right="left.png")
    assert code == 2
    assert "is given as the left and as the right image" in err
