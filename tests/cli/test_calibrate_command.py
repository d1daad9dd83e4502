"""`camcal calibrate` from a detections file: the file it writes, its bytes, its exit codes, what it prints."""

import json
import re
import shlex

import numpy as np
import pytest

from camcal.calibrate.intrinsics import RejectedCorner
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli import calibrate
from camcal.formats import boards, cameras, detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import bow
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

BOARD = Board("chessboard", 9, 6, 0.040)
CAMERA = Camera(
    model_named("opencv5"), (1600, 1200), np.array([1200.0, 1205, 805, 590, -0.12, 0.06, 5e-4, -3e-4, 0.01])
)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(1)
    poses = views(CAMERA, BOARD, 15, rng=rng)
    return observe(CAMERA, BOARD, poses, rng=rng, noise_px=0.1, outliers=0.004, shape=bow(1e-3, 5e-4))[0]


@pytest.fixture
def table(tmp_path, seen):
    path = tmp_path / "corners.csv"
    detections.write(path, seen)
    return path


def test_the_camera_file_holds_the_lens_its_covariance_and_the_board(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    code, out, err = run("calibrate", table, "-o", output, "--verbose")
    assert (code, "error" in err) == (0, False)
    assert "camcal: warning: board deflection 1.50 mm" in err
    file = native.read(output)
    camera = file.cameras["camera"].camera
    error = (camera.parameters - CAMERA.parameters) / np.sqrt(np.diag(camera.covariance))
    assert np.abs(error).max() < 4
    shape = file.board_shape
    assert shape.deflection > 4 * shape.deflection_std
    assert shape.classes["bow"][0] > 1e-4  # bent by a thousandth of its side
    assert file.cameras["camera"].quality["images_used"] == 15
    assert "± std" in out
    assert "bent by" in out
    assert "Rejected corners:" in out


def test_the_file_holds_the_exact_command_that_makes_it(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    options = ["--no-free-corners", "--max-rejected", 20, "--name", "left", "--model", "opencv5"]
    assert run("calibrate", table, "-o", output, "--jobs", 1, "--verbose", *options)[0] == 0
    recorded = native.read(output).provenance["command"]
    assert recorded == f"camcal calibrate {table} --model opencv5 --name left --no-free-corners --max-rejected 20"
    content = output.read_bytes()
    assert run(*shlex.split(recorded)[1:], "-o", output)[0] == 0
    assert output.read_bytes() == content


def test_the_same_input_gives_the_same_bytes(run, table, tmp_path):
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    assert run("calibrate", table, "-o", first)[0] == 0
    assert run("calibrate", table, "-o", second, "--jobs", 1)[0] == 0
    assert first.read_bytes() == second.read_bytes()


def test_json_is_the_only_thing_on_stdout(run, table, tmp_path):
    code, out, _ = run("calibrate", table, "-o", tmp_path / "camera.yaml", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == [
        "schema", "output", "model", "image_size", "parameters", "std", "held_by_prior", "noise_std",
        "within_views", "entrance_pupil", "two_cameras", "rms_px",
        "sigma_px", "model_error_px", "degrees_of_freedom", "board", "board_shape", "views", "rejected", "uncertainty",
        "image_circle", "times",
        "refinement", "trustworthy", "region", "failures", "candidates", "frames", "failed", "reused", "timings",
        "warnings",
    ]  # fmt: skip
    assert document["schema"] == "camcal/calibrate/1"
    assert list(document["timings"]) == ["choosing the lens model", "solving", "checking", "writing"]
    assert all(own["cpu_s"] > 0 and 0 < own["wall_s"] < 600 for own in document["timings"].values())
    assert len(document["views"]) == 15
    assert all(np.hypot(*corner["residual"]) > 0.4 for corner in document["rejected"])
    assert list(document["board_shape"]) == [
        "unit", "tiers", "classes", "terms", "std", "deflection", "deflection_std", "free_corners", "correlations",
    ]  # fmt: skip


def test_the_projection_uncertainty_is_in_the_file_the_document_and_on_the_terminal(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    command = ["calibrate", table, "-o", output, "--model", "opencv5"]
    code, out, _ = run(*command, "--json")
    found = json.loads(out)["uncertainty"]
    assert code == 0
    assert {key: list(part) for key, part in found.items()} == {
        "projection": ["rms_px", "worst_px", "inside_rms_px", "inside_worst_px"],
        "map": ["u", "v", "rms_px", "worst_px", "inside"],
    }
    (item,) = native.read(output).cameras["camera"].projection
    assert item.range_m is None
    assert list(item.figures) == ["rms_px", "max_px", "inside_rms_px", "inside_max_px"]
    assert list(item.figures.values()) == pytest.approx(list(found["projection"].values()))
    assert 0 < item.figures["inside_rms_px"] <= item.figures["rms_px"] < item.figures["max_px"] < 5
    rows, columns = len(found["map"]["v"]), len(found["map"]["u"])
    assert (found["map"]["u"][-1], found["map"]["v"][-1]) == (1599, 1199)
    for name in ("rms_px", "worst_px", "inside"):
        assert np.shape(found["map"][name]) == (rows, columns)
    assert np.max(found["map"]["worst_px"]) == pytest.approx(found["projection"]["worst_px"], rel=1e-3)
    line = "Projection uncertainty (1 sigma, at infinity): RMS "
    assert line in run(*command)[1]
    assert line in run("inspect", output)[1]


def test_coefficients_that_the_data_do_not_determine_are_named_everywhere(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    code, out, _ = run("calibrate", table, "-o", output, "--model", "opencv8", "--json")
    held = json.loads(out)["held_by_prior"]
    assert code == 0
    assert {"k3", "k6"} & set(held)  # r⁶ above and below the line: these corners do not tell them apart
    assert not {"fx", "cx", "p1", "p2"} & set(held)
    assert native.read(output).cameras["camera"].held_by_prior == tuple(held)
    _, shown, _ = run("calibrate", table, "-o", output, "--model", "opencv8")
    assert f"{', '.join(held)} " in shown
    assert "not by the data" in shown
    assert "not by the data" in run("inspect", output)[1]


def test_fix_and_guess_reach_the_solver(run, table, tmp_path):
    guess, output = tmp_path / "guess.yaml", tmp_path / "camera.yaml"
    assert run("calibrate", table, "-o", guess, "--model", "opencv4")[0] == 0
    assert run("calibrate", table, "-o", output, "--guess", guess, "--fix", "fx,k3")[0] == 0
    camera = cameras.read_camera(output)
    assert camera.fixed == ("fx", "k3")
    assert camera.value("fx") == cameras.read_camera(guess).value("fx")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--model", "opencv6"], 2, "opencv"),
        (["--fix", "k9"], 2, "no parameter 'k9'"),
        (["--board", "chessboard:9by6"], 2, "9by6"),
        (["--guess", "nowhere.yaml"], 3, "no such file"),
        (["--max-rejected", "200"], 2, "max-rejected"),
        (["--require", "good"], 2, "'--require': 'good' is not one of trustworthy"),
        (["--max-uncertainty", "0"], 2, "--max-uncertainty 0 is not above 0"),
        (["--max-uncertainty", "nan"], 2, "--max-uncertainty nan is not above 0"),
    ],
)
def test_wrong_arguments_get_one_line_and_write_nothing(run, table, tmp_path, arguments, code, words):
    output = tmp_path / "camera.yaml"
    found, out, err = run("calibrate", table, "-o", output, *arguments)
    assert found == code
    assert words in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert not output.exists()


def test_a_result_that_is_not_to_be_trusted_is_written_and_ends_with_exit_7_where_trust_is_required(
    run, table, tmp_path
):
    output = tmp_path / "camera.yaml"
    command = ["calibrate", table, "-o", output, "--model", "pinhole", "--flat-board"]
    code, out, err = run(*command, "--json", "--require", "trustworthy")
    document = json.loads(out)  # the only one, although it failed
    assert code == 7
    assert not document["trustworthy"]
    texts = [failure["text"] for failure in document["failures"]]
    assert len(texts) >= 1
    assert (document["error"]["kind"], document["error"]["where"]) == ("gate_failed", "--require trustworthy")
    assert f"camcal: error: --require trustworthy: {texts[0]}\n" in err
    assert all(f"camcal: error: {text}\n" in err for text in texts[1:])
    (tried,) = re.findall(
        "none of (.*) passes all checks in a brief calibration either", texts[-1]
    )  # the board is bent
    assert set(tried.split(", ")) == {"opencv5", "kannala_brandt5t", "kannala_brandt4", "opencv8"}
    file = native.read(output)
    assert file.cameras["camera"].verdict.reasons == tuple(texts)
    code, out, err = run(*command)
    assert (code, "error" in err) == (0, False)
    assert f"DO NOT TRUST: {texts[0]}" in out.splitlines()
    assert "DO NOT TRUST" not in err
    for silent in ("--quiet", "--json"):
        code, out, err = run(*command, silent)
        assert (code, "DO NOT TRUST" in out) == (0, False)
        assert [line for line in err.splitlines() if "DO NOT" in line] == [
            f"camcal: warning: DO NOT TRUST: {text}" for text in texts
        ]


def test_a_result_that_is_to_be_trusted_passes_where_trust_is_required(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    code, out, err = run("calibrate", table, "-o", output, "--model", "opencv5", "--require", "trustworthy")
    assert (code, "error" in err) == (0, False)
    region = native.read(output).cameras["camera"].verdict.region
    where = f"in {100 * region.share:.0f} % of the image (projection uncertainty up to 1 px)"
    assert out.startswith(f"Calibration is trustworthy {where}\n")
    assert region.polygon.max(axis=0).tolist() == [1599, 1199]  # from edge to edge, but for corners
    assert "DO NOT TRUST" not in out
    assert native.read(output).cameras["camera"].verdict.trustworthy


def test_coverage_and_residuals_are_drawn_on_a_terminal_and_lines_in_a_pipe(run, table, tmp_path, monkeypatch):
    command = ["calibrate", table, "-o", tmp_path / "camera.yaml", "--model", "opencv5"]
    piped = run(*command)[1].splitlines()
    assert [line.partition(":")[0] for line in piped[-3:-1]] == ["Coverage", "Residuals"]
    assert not any("\x1b" in line or set(line) & set("┌│█+|#") for line in piped)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    out = run(*command)[1]
    assert "\x1b" not in out
    figure = out[out.index("corners: ") : out.index("└")].splitlines()
    assert all("│" in line for line in figure)
    assert 70 <= max(map(len, figure)) <= 80
    assert "┌" not in run(*command, "--json")[1]


def test_a_projection_uncertainty_above_the_most_that_is_allowed_ends_with_exit_7(run, table, tmp_path):
    output = tmp_path / "camera.yaml"
    command = ["calibrate", table, "-o", output, "--model", "opencv5"]
    code, out, _ = run(*command, "--max-uncertainty", 100, "--json")
    figures = json.loads(out)["uncertainty"]["projection"]
    reached = figures["inside_rms_px"]  # where corners were seen; the image's is larger
    most = 1.02 * reached
    assert (code, most < figures["rms_px"]) == (0, True)
    assert run(*command, "--max-uncertainty", most)[0] == 0
    output.unlink()
    most = 0.98 * reached
    code, _, err = run(*command, "--max-uncertainty", most)
    assert code == 7
    line = f"camcal: error: --max-uncertainty: projection uncertainty {reached:.3g} px (limit {most:g} px)"
    assert err.splitlines()[-1] == line
    assert output.exists()


def test_an_input_is_never_overwritten(run, table):
    before = table.read_bytes()
    code, _, err = run("calibrate", table, "-o", table)
    assert code == 2
    assert "not overwritten" in err
    assert table.read_bytes() == before


@pytest.mark.parametrize("option", ["--board", "--guess", "--config"])
def test_a_board_a_guess_or_settings_are_never_overwritten(run, table, tmp_path, option):
    file = tmp_path / "file.yaml"
    if option == "--board":
        boards.write(file, BOARD)
    elif option == "--guess":
        native.write(file, CameraFile({"camera": CameraEntry(CAMERA)}))
    else:
        file.write_text("flat-board: true\n")
    before = file.read_bytes()
    code, _, err = run("calibrate", table, option, file, "-o", file)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "file.yaml: is an input and is not overwritten" in err
    assert file.read_bytes() == before


def test_an_image_of_a_folder_is_never_overwritten(run, tmp_path):
    image = tmp_path / "photos" / "1.png"
    image.parent.mkdir()
    image.write_bytes(b"a picture")
    code, _, err = run("calibrate", image.parent, "--board", "chessboard:9x6:25mm", "-o", image)
    assert code == 2
    assert "1.png: .png is not written; use .yaml, .yml" in err
    assert image.read_bytes() == b"a picture"


@pytest.mark.parametrize(
    ("name", "words"), [("camera.yaml", "would both be written to it"), ("other.yaml", "use .csv, .vnl")]
)
def test_saved_detections_have_a_suffix_and_a_place_of_their_own(run, table, tmp_path, name, words):
    output = tmp_path / "camera.yaml"
    code, _, err = run("calibrate", table, "-o", output, "--save-detections", tmp_path / name)
    assert code == 2
    assert words in err
    assert not output.exists()


@pytest.mark.parametrize(
    ("residual", "words"), [((0.3, 0.4), "off by 0.50 px"), ((np.nan, 0.4), "outside the domain of the lens model")]
)
def test_a_rejected_corner_is_off_by_pixels_or_out_of_the_model(residual, words):
    corner = RejectedCorner("a.png", 3, np.zeros(2), np.array(residual))
    assert words in calibrate._how_far(corner)


@pytest.mark.slow
def test_fronto_parallel_views_end_with_exit_4_and_the_reason(run, tmp_path):
    rng = np.random.default_rng(2)
    flat = [
        Pose(so3.about_z(rng.uniform(-0.3, 0.3)), np.array([*rng.uniform(-0.25, -0.1, 2), rng.uniform(0.5, 0.9)]))
        for _ in range(12)
    ]
    path, output = tmp_path / "flat.csv", tmp_path / "camera.yaml"
    detections.write(path, observe(CAMERA, BOARD, flat, rng=rng, noise_px=0.1)[0])
    code, _, err = run("calibrate", path, "-o", output)
    assert code == 4
    assert "tilted" in err
    assert not output.exists()


def test_two_views_end_with_exit_4(run, seen, tmp_path):
    path = tmp_path / "two.csv"
    detections.write(path, Detections(seen.board, seen.views[:2]))
    code, out, _ = run("calibrate", path, "-o", tmp_path / "camera.yaml", "--json")
    assert code == 4
    assert json.loads(out)["error"]["kind"] == "insufficient_data"


@pytest.mark.slow
def test_a_lens_that_the_default_model_cannot_hold_gets_another_and_it_is_said(run, tmp_path):
    camera = Camera(
        model_named("kannala_brandt4"), (1600, 1200), np.array([520.0, 521, 803, 596, 0.02, -0.01, 0.004, 0])
    )
    rng = np.random.default_rng(4)
    found = observe(camera, BOARD, views(camera, BOARD, 25, rng=rng), rng=rng, noise_px=0.05)[0]
    path, output = tmp_path / "wide.csv", tmp_path / "camera.yaml"
    detections.write(path, found)
    code, out, _ = run("calibrate", path, "-o", output)
    assert code == 0
    assert cameras.read_camera(output).model.name == "kannala_brandt4"
    assert "lens model kannala_brandt4: " in out


def test_mrcal_corner_files_are_calibrated_from(run, seen, tmp_path):
    path, output = tmp_path / "corners.vnl", tmp_path / "camera.yaml"
    detections.write(path, seen)
    size = ["--image-size", "1600x1200", "--model", "opencv5"]
    assert run("calibrate", path, "-o", output, "--board", "chessboard:9x6:40mm", *size)[0] == 0
    assert abs(cameras.read_camera(output).value("fx") - 1200) < 5
    code, _, err = run("calibrate", path, "-o", tmp_path / "b.yaml", "--board", "chessboard:9x6:40mm")
    assert code == 2
    assert "--image-size" in err
