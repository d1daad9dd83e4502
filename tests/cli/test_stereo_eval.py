"""`camcal stereo eval`: maps against truths, figures and gates out."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.formats import disparity, disparity_sidecar
from camcal.formats.disparity_sidecar import Sidecar
from camcal.stereo.disparity import StereoGeometry

CONFIG = Path(__file__).parents[2] / "sample_configs" / "stereo_eval.yaml"
SIZE = (20, 40)
GEOMETRY = StereoGeometry(100, 100, 20, 10, 0.5)


@pytest.fixture
def truth(tmp_path):
    return write(tmp_path / "truth.pfm", np.full(SIZE, 8.0))


@pytest.fixture
def found(tmp_path):
    """A map that is wrong by 1.5 px in its upper half and has nothing in its last row."""
    values = np.full(SIZE, 8.0)
    values[:10] += 1.5
    values[-1] = np.nan
    return write(tmp_path / "found.tiff", values)


def write(path, values):
    path.parent.mkdir(exist_ok=True)
    disparity.write(path, np.asarray(values, np.float32))
    return path


def document(run, *arguments):
    code, out, err = run("stereo", "eval", *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def test_the_figures_are_printed_in_four_columns(run, found, truth):
    code, out, _ = run("stereo", "eval", found, truth)
    assert code == 0
    lines = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.split()}
    assert lines["nocc"] == ["nocc-valid", "all", "all-valid"]
    assert lines["bad1,"] == ["%", "55", "52.63", "55", "52.63"]  # of 20 rows 10 wrong and 1 empty
    assert lines["density,"] == ["%", "95", "-", "95", "-"]
    assert "occluded by: the truth warped to the right image" in out


def test_the_report_is_one_json_document(run, tmp_path, found, truth):
    report = document(run, found, truth, "-o", tmp_path / "error.png", "--gate", "bad2=10")
    assert list(report) == ["schema", "pairs", "mean", "gates", "failed", "warnings"]
    assert report["schema"] == "camcal/stereo-eval/1"
    (pair,) = report["pairs"]
    assert list(pair) == [
        "disparity", "truth", "scale", "truth_scale", "occlusion", "geometry", "picture", "pixels", "figures",
        "classes", "sparsification",
    ]  # fmt: skip
    assert pair["pixels"] == {"nocc": 640, "nocc-valid": 608, "all": 800, "all-valid": 760}
    assert report["mean"]["figures"] == pair["figures"]
    assert report["gates"] == [{"gate": "bad2=10", "value": 5.0, "passed": True}]
    assert report["failed"] == []


@pytest.mark.parametrize(
    ("gate", "code"),
    [
        ("bad1=60", 0), ("bad1=50", 7), ("bad1:all-valid=53", 0), ("bad1:all=53", 7), ("density=95", 0),
        ("density=96", 7), ("avg=0.8", 0), ("a99:all=5", 7),
    ],
)  # fmt: skip
def test_a_gate_fails_with_its_name_and_what_was_found(run, found, truth, gate, code):
    ended, out, err = run("stereo", "eval", found, truth, "--gate", gate)
    assert ended == code
    assert out.startswith(f"Gate {gate} {'FAILED' if code else 'passed'}: ")
    assert (f"--gate: {gate} failed: " in err) == (code == 7)


@pytest.mark.parametrize(
    ("gate", "message"),
    [
        ("bd2=3", "unknown figure 'bd2'. Did you mean 'bad2'?"),
        ("bad2", "a gate is written FIGURE=LIMIT"),
        ("bad2=nan", "a gate is written FIGURE=LIMIT"),
        ("bad2:nooc=3", "no bad2 in nooc; available in nocc, nocc-valid, all, all-valid"),
        ("avg:all=3", "no avg in all; available in nocc-valid, all-valid"),
        ("z_avg_m=1", "unknown here (no geometry, no sigma)"),
    ],
)
def test_a_gate_that_names_no_figure_is_refused(run, found, truth, gate, message):
    code, _, err = run("stereo", "eval", found, truth, "--gate", gate)
    assert code == 2
    assert message in err


def test_the_error_picture_shows_where_the_map_is_wrong(run, tmp_path, found, truth):
    assert run("stereo", "eval", found, truth, "-o", tmp_path / "error.png", "-q")[0] == 0
    blue, _, red = (cv2.imread(str(tmp_path / "error.png"))[:20, 10:40].astype(int)).transpose(2, 0, 1)
    assert (red[:9] > red[10:19]).all()
    assert (blue[19] == red[19]).all()  # gray: no disparity


def test_an_input_is_never_overwritten(run, tmp_path, truth):
    png = write(tmp_path / "found.png", np.full(SIZE, 8.0))
    content = png.read_bytes()
    code, _, err = run("stereo", "eval", png, truth, "-o", png)
    assert code == 2
    assert "not overwritten" in err
    assert png.read_bytes() == content


@pytest.mark.parametrize("numbers", [["--fx", 100, "--baseline", 0.5], "sidecar of the map", "sidecar of the truth"])
def test_depth_errors_follow_wherever_the_geometry_is_from(run, found, truth, numbers):
    if isinstance(numbers, str):
        disparity_sidecar.write(found if numbers.endswith("map") else truth, Sidecar(geometry=GEOMETRY))
        numbers = []
    report = document(run, found, truth, *numbers)
    # 50 / 8 and 50 / 9.5 m
    assert report["mean"]["figures"]["all-valid"]["z_a90_m"] == pytest.approx(50 / 8 - 50 / 9.5, rel=1e-6)
    assert report["pairs"][0]["geometry"]["baseline"] == 0.5


def test_numbers_come_before_the_sidecar(run, found, truth):
    disparity_sidecar.write(found, Sidecar(geometry=GEOMETRY))
    assert document(run, found, truth, "--baseline", 1.0)["pairs"][0]["geometry"]["baseline"] == 1.0


def test_a_calibration_of_the_pair_gives_the_geometry(run, tmp_path, found, truth):
    matrix = "[100 0 20; 0 100 10; 0 0 1]"
    text = f"cam0={matrix}\ncam1={matrix}\ndoffs=0\nbaseline=500\nwidth=40\nheight=20\n"
    (tmp_path / "calib.txt").write_text(text, encoding="utf-8")
    assert document(run, found, truth, tmp_path / "calib.txt")["pairs"][0]["geometry"]["baseline"] == 0.5


def test_half_a_geometry_is_refused(run, found, truth):
    code, _, err = run("stereo", "eval", found, truth, "--fx", 100)
    assert code == 2
    assert "--baseline" in err


def test_a_mask_tells_what_both_cameras_see(run, tmp_path, found, truth):
    mask = np.full(SIZE, 128, np.uint8)
    mask[10:] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    report = document(run, found, truth, "--mask", tmp_path / "mask.png")
    assert report["mean"]["figures"]["nocc"]["bad1"] == 10
    assert report["pairs"][0]["occlusion"] == "mask mask.png"


def test_kitti_truth_without_occluded_pixels_is_a_mask(run, tmp_path, found, truth):
    mask = write(tmp_path / "disp_noc.png", np.where(np.arange(20)[:, None] < 10, 8.0, np.nan) * np.ones(SIZE))
    assert document(run, found, truth, "--mask", mask)["mean"]["figures"]["nocc"]["bad1"] == 100


def test_the_truth_of_the_right_image_tells_what_is_occluded(run, tmp_path, found, truth):
    right = np.full(SIZE, 8.0)
    right[:10] = 3.0
    report = document(run, found, truth, "--right-truth", write(tmp_path / "right.pfm", right))
    assert report["mean"]["figures"]["nocc"]["bad1"] == 10
    assert report["pairs"][0]["occlusion"] == "left-right check of the truths"


def test_sigma_and_confidence_are_found_through_the_sidecar(run, tmp_path, found, truth):
    write(tmp_path / "sigma.tiff", np.where(np.arange(20)[:, None] < 10, 2.0, 0.1) * np.ones(SIZE))
    cv2.imwrite(str(tmp_path / "confidence.png"), np.repeat(np.uint8([[1], [5]]), 10, axis=0) * np.ones(SIZE, np.uint8))
    sidecar = Sidecar(sigma=tmp_path / "sigma.tiff", confidence=tmp_path / "confidence.png")
    disparity_sidecar.write(found, sidecar)
    report = document(run, found, truth, "--gate", "within1=60")
    assert report["mean"]["figures"]["all-valid"]["within1"] == 100
    agreed, filled = report["mean"]["classes"]
    assert (agreed["name"], agreed["pixels"], agreed["bad1"]) == ("agreed", 360, 0)
    assert (filled["name"], filled["pixels"], filled["bad1"]) == ("filled", 400, 100)
    assert len(report["pairs"][0]["sparsification"]["by_sigma"]) == 100
    code, out, _ = run("stereo", "eval", found, truth)
    assert code == 0
    assert "68 % of  sigma," in out  # the head of a column on two lines


def test_a_map_copied_with_its_sidecar_alone_is_evaluated_without_what_that_names(run, tmp_path, found, truth):
    disparity_sidecar.write(found, Sidecar(sigma=tmp_path / "gone.tiff", confidence=tmp_path / "gone.png"))
    code, out, err = run("stereo", "eval", found, truth, "--json")
    assert code == 0
    assert "within1" not in json.loads(out)["mean"]["figures"]["all-valid"]
    for name in ("gone.tiff", "gone.png"):
        assert f"found.tiff.json: {name} not found; not used" in err
    code, _, err = run("stereo", "eval", found, truth, "--sigma", tmp_path / "gone.tiff")
    assert code == 3
    assert "gone.tiff: no such file" in err


def test_disparities_of_zero_do_not_count_for_the_likely_scale(run, tmp_path):
    values = np.full(SIZE, 8.0)
    values[:4] = 0
    found = write(tmp_path / "found.tiff", values)
    disparity_sidecar.write(found, Sidecar(searched=(0, 64)))
    code, _, err = run("stereo", "eval", found, write(tmp_path / "truth.tiff", values * 4))
    assert code == 0
    assert "try --truth-scale 4" in err


def test_counts_taken_for_pixels_are_noticed(run, tmp_path):
    found = write(tmp_path / "found.tiff", np.full(SIZE, 8.1))
    cv2.imwrite(str(tmp_path / "disp2.png"), np.full(SIZE, 32, np.uint8))
    code, _, err = run("stereo", "eval", found, tmp_path / "disp2.png")
    assert code == 0
    assert "try --truth-scale 4" in err
    _, _, err = run("stereo", "eval", found, tmp_path / "disp2.png", "--truth-scale", 4)
    assert err == ""


def test_folders_are_paired_in_natural_order_and_averaged(run, tmp_path):
    for number, error in ((2, 0.0), (10, 5.0)):
        write(tmp_path / "found" / f"frame{number}.pfm", np.full(SIZE, 8.0 + error))
        write(tmp_path / "truth" / f"{number:02d}.png", np.full(SIZE, 8.0))
    report = document(run, tmp_path / "found", tmp_path / "truth", "-o", tmp_path / "errors", "--gate", "bad2=50")
    assert [Path(pair["truth"]).name for pair in report["pairs"]] == ["02.png", "10.png"]
    assert report["mean"]["figures"]["nocc"]["bad2"] == 50
    assert sorted(path.name for path in (tmp_path / "errors").glob("[!.]*")) == ["frame10.png", "frame2.png"]


def test_maps_of_folders_go_with_the_truths_of_their_names(run, tmp_path):
    for name, truth_name, level in (("x1a", "xa", 8.0), ("x0b", "xb", 30.0)):  # in another order than the truths
        write(tmp_path / "found" / f"{name}.pfm", np.full(SIZE, level))
        write(tmp_path / "truth" / f"{truth_name}.png", np.full(SIZE, level))
    report = document(run, tmp_path / "found", tmp_path / "truth")
    assert [Path(pair["truth"]).name for pair in report["pairs"]] == ["xb.png", "xa.png"]
    assert report["mean"]["figures"]["all"]["bad1"] == 0


def test_folders_whose_names_agree_in_part_are_refused(run, tmp_path):
    for found, truth in (("a", "b"), ("b", "c")):
        write(tmp_path / "found" / f"{found}.pfm", np.full(SIZE, 8.0))
        write(tmp_path / "truth" / f"{truth}.pfm", np.full(SIZE, 8.0))
    code, _, err = run("stereo", "eval", tmp_path / "found", tmp_path / "truth")
    assert code == 2
    assert "have only some names in common" in err
    assert "a.pfm is unpaired" in err


def test_a_map_without_a_disparity_is_named_and_not_averaged_into_what_it_has_not(run, tmp_path):
    for name, level in (("empty", np.nan), ("full", 9.5)):
        write(tmp_path / "found" / f"{name}.pfm", np.full(SIZE, level))
        write(tmp_path / "truth" / f"{name}.pfm", np.full(SIZE, 8.0))
    code, out, err = run("stereo", "eval", tmp_path / "found", tmp_path / "truth", "--json")
    assert code == 0
    figures = json.loads(out)["mean"]["figures"]
    assert figures["all-valid"]["avg"] == 1.5
    assert figures["all"]["bad2"] == 50  # the empty map is bad everywhere
    assert err.count("\n") == 1
    assert "empty.pfm: no avg, rms, " in err
    assert "in nocc-valid, all-valid; excluded from their mean" in err


def test_one_pair_that_fails_costs_only_itself(run, tmp_path):
    for number in range(3):
        write(tmp_path / "found" / f"{number}.pfm", np.full(SIZE, 8.0))
        write(tmp_path / "truth" / f"{number}.pfm", np.full(SIZE, 8.0 if number else np.nan))
    code, out, err = run("stereo", "eval", tmp_path / "found", tmp_path / "truth")
    assert code == 6
    assert "1 of 3 maps failed" in err
    assert "mean over 2 maps" in out


def test_maps_of_a_folder_are_those_with_a_sidecar_if_any_has_one(run, tmp_path, truth):
    found = write(tmp_path / "found" / "map.tiff", np.full(SIZE, 8.0))
    sigma = write(tmp_path / "found" / "map.sigma.tiff", np.full(SIZE, 1.0))
    disparity_sidecar.write(found, Sidecar(sigma=sigma))
    write(tmp_path / "truths" / "map.pfm", np.full(SIZE, 8.0))
    report = document(run, tmp_path / "found", tmp_path / "truths")
    assert [Path(pair["disparity"]).name for pair in report["pairs"]] == ["map.tiff"]


def test_folders_of_different_counts_are_refused_with_both(run, tmp_path):
    write(tmp_path / "found" / "1.pfm", np.full(SIZE, 8.0))
    for number in range(2):
        write(tmp_path / "truth" / f"{number}.pfm", np.full(SIZE, 8.0))
    code, _, err = run("stereo", "eval", tmp_path / "found", tmp_path / "truth")
    assert code == 2
    assert f"1 maps in {tmp_path / 'found'} and 2 files in {tmp_path / 'truth'} differ" in err
    assert f"{tmp_path / 'truth' / '0.pfm'} is unpaired" in err


def test_a_truth_of_twice_the_size_is_refused_with_the_way_out(run, tmp_path, found):
    code, _, err = run("stereo", "eval", found, write(tmp_path / "large.pfm", np.full((40, 80), 16.0)))
    assert code == 2
    assert "the truth is 80 × 40, the disparity map 40 × 20" in err
    assert "make the truth 0.5 times as large and its values as well" in err


def test_a_truth_that_knows_nothing_is_too_little_data(run, tmp_path, found):
    assert run("stereo", "eval", found, write(tmp_path / "none.pfm", np.full(SIZE, np.nan)))[0] == 4


@pytest.mark.parametrize("wrong", ["missing.pfm", "folder"])
def test_what_cannot_be_read_is_told(run, tmp_path, found, wrong):
    (tmp_path / "folder").mkdir()
    code, _, err = run("stereo", "eval", found, tmp_path / wrong)
    assert code == (3 if wrong == "missing.pfm" else 2)
    assert "camcal: error:" in err


@pytest.mark.parametrize("there", ["folder", "truth.pfm"])
def test_a_map_that_is_not_there_is_said_whatever_the_truth_is(run, tmp_path, truth, there):
    (tmp_path / "folder").mkdir()
    for given in ((tmp_path / "nowhere", tmp_path / there), (tmp_path / there, tmp_path / "nowhere")):
        code, _, err = run("stereo", "eval", *given)
        assert code == 3
        assert f"{tmp_path / 'nowhere'}: no such file" in err


def test_of_many_pairs_ten_are_listed_a_line_each_unless_all_are_asked_for(run, tmp_path):
    for number in range(12):
        write(tmp_path / "found" / f"{number}.pfm", np.full(SIZE, 8.0))
        write(tmp_path / "truth" / f"{number}.pfm", np.full(SIZE, 8.0))
    _, out, _ = run("stereo", "eval", tmp_path / "found", tmp_path / "truth")
    lines = out.splitlines()
    assert lines[10] == "… and 2 more (--verbose lists all)"
    assert all(line.startswith(str(tmp_path / "found")) for line in lines[:10])
    _, out, _ = run("stereo", "eval", tmp_path / "found", tmp_path / "truth", "--verbose")
    assert out.count(" against ") == out.count("occluded by:") == 12


def test_mask_and_right_truth_exclude_each_other(run, found, truth):
    assert run("stereo", "eval", found, truth, "--mask", truth, "--right-truth", truth)[0] == 2


def test_the_sample_settings_are_gates(run, tmp_path, monkeypatch, found):
    monkeypatch.chdir(tmp_path)
    for name in ("disp2.png", "disp6.png"):
        cv2.imwrite(name, np.full(SIZE, 32, np.uint8))
    code, _, err = run("stereo", "eval", found, "disp2.png", "--config", CONFIG)
    assert code == 7
    assert "density=99 failed: 95" in err
