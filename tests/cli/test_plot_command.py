"""`camcal plot`, and --figures of other commands: what is drawn, what is written, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_page import REGISTERED

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections, disparity, trajectories
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 7, 5, 0.03)
CALIBRATION = {
    "projection_uncertainty", "uncertainty_over_distance", "residual_vectors", "residuals_over_radius",
    "residuals_by_view", "residual_histogram",
    "coverage", "board_shape", "board_height", "poses", "correlations",
}  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder with detections, a table, a trajectory and a disparity map."""
    folder = tmp_path_factory.mktemp("results")
    camera = Camera(model_named("pinhole"), (640, 480), np.array([600.0, 600.0, 320.0, 240.0]))
    rng = np.random.default_rng(0)
    seen, _ = observe(camera, BOARD, views(camera, BOARD, 6, rng=rng), rng=rng, noise_px=0.1)
    detections.write(folder / "detections.csv", seen)
    time = np.arange(40) / 10
    table = np.column_stack([time, np.sin(time) + rng.normal(0, 0.05, 40)])
    np.savetxt(folder / "table.csv", table, delimiter=",", header="t,height", comments="")
    places = np.column_stack([np.cos(time), np.sin(time), 0.1 * time]) + rng.normal(0, 0.01, (40, 3))
    path = Trajectory("world_T_camera", time, so3.exp(rng.normal(0, 0.01, (40, 3))), places)
    trajectories.write(folder / "path.tum", path)
    values = np.linspace(5, 30, 60 * 80, dtype=np.float32).reshape(60, 80)
    disparity.write(folder / "truth.pfm", values)
    disparity.write(folder / "found.pfm", values + rng.normal(0, 0.3, values.shape).astype(np.float32))
    return folder


def written(folder):
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


@pytest.mark.slow
def test_calibrate_draws_its_figures_with_their_captions(run, results, tmp_path):
    figures = tmp_path / "figures"
    code, out, _ = run(
        "calibrate", results / "detections.csv", "--model", "pinhole", "-o", tmp_path / "camera.yaml",
        "--figures", figures, "--figure-format", "svg", "--json",
    )  # fmt: skip
    assert code == 0
    assert {Path(name).stem for name in json.loads(out)["figure_files"]} == CALIBRATION
    assert written(figures) == {f"{name}.svg" for name in CALIBRATION} | {"figures.md"}
    captions = (figures / "figures.md").read_text()
    assert "![" in captions
    assert "(coverage.svg)" in captions
    assert "px RMS" in captions
    assert run("plot", tmp_path / "camera.yaml", "-o", tmp_path / "more")[0] == 0
    drawn = {
        "field_angle",
        "projection_uncertainty",
        "correlations",
        "residuals_by_view",
        "board_shape",
        "board_height",
    }
    assert written(tmp_path / "more") == {f"{name}.png" for name in drawn} | {"figures.md"}


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["smooth", "table.csv"], {"over_time"}),
        (["smooth", "path.tum"], {"over_time", "trajectory_planes", "trajectory_space"}),
        (["fit", "table.csv", "--model", "poly:2"], {"fitted_curve"}),
        (["stereo", "eval", "found.pfm", "truth.pfm"], {"error_histogram", "error_map", "bad_pixels"}),
    ],
)
def test_commands_draw_their_figures(run, results, tmp_path, words, names):
    paths = [results / word if (results / word).exists() else word for word in words]
    code, out, _ = run(*paths, "--figures", tmp_path / "figures", "--json")
    assert code == 0
    assert {Path(name).stem for name in json.loads(out)["figure_files"]} == names
    assert written(tmp_path / "figures") == {f"{name}.png" for name in names} | {"figures.md"}


def test_without_the_option_nothing_is_drawn_and_nothing_said(run, results):
    code, out, _ = run("fit", results / "table.csv", "--model", "poly:1", "--json")
    assert (code, "figure_files" in json.loads(out)) == (0, False)


@pytest.mark.parametrize(
    ("file", "kind", "names"),
    [
        ("detections.csv", "detections", {"coverage", "corners_by_view"}),
        ("path.tum", "trajectory", {"trajectory_planes", "trajectory_space"}),
        ("found.pfm", "disparity", {"disparity"}),
    ],
)
def test_a_file_is_known_by_its_content(run, results, tmp_path, file, kind, names):
    code, out, _ = run("plot", results / file, "-o", tmp_path / "figures", "--json")
    document = json.loads(out)
    assert (code, document["inputs"][0]["kind"]) == (0, kind)
    assert set(document["captions"]) == names
    assert written(tmp_path / "figures") == {f"{name}.png" for name in names} | {"figures.md"}


def test_results_of_smoothing_and_fitting_can_be_drawn(run, results, tmp_path):
    smoothed, fit = tmp_path / "smoothed.csv", tmp_path / "fit.yaml"
    assert run("smooth", results / "table.csv", "-o", smoothed)[0] == 0
    assert run("fit", results / "table.csv", "--model", "poly:2", "-o", fit)[0] == 0
    code, out, _ = run("plot", smoothed, fit, "-o", tmp_path / "figures", "--json")
    assert code == 0
    assert [item["kind"] for item in json.loads(out)["inputs"]] == ["series", "fit"]
    stems = {Path(name).stem for name in json.loads(out)["figure_files"]}
    assert stems == {"smoothed_over_time", "fit_parameter_errors", "fit_correlations"}


def printed(run, path, *words):
    code, out, _ = run(*words, "--json")
    assert code == 0
    path.write_text(out)
    return json.loads(out)


def test_what_commands_print_can_be_drawn(run, results, tmp_path):
    said, camera = tmp_path / "said.json", tmp_path / "camera.yaml"
    quick = ("--model", "pinhole", "--flat-board", "--no-free-corners")
    figures = printed(run, said, "calibrate", results / "detections.csv", *quick, "-o", camera)["uncertainty"]
    again = printed(run, tmp_path / "drawn.json", "plot", said, "-o", tmp_path / "figures")
    assert again["inputs"][0]["kind"] == "calibrate --json"
    assert list(again["captions"]) == ["projection_uncertainty", "residuals_by_view"]
    for name in ("inside_rms_px", "rms_px", "worst_px"):  # the figures of the map are those that were printed
        assert f"{figures['projection'][name]:.2g} px" in again["captions"]["projection_uncertainty"]
    printed(run, said, "fit", results / "table.csv", "--model", "poly:2")
    code, out, _ = run("plot", said, "-o", tmp_path / "errors.svg", "--figure", "parameter_errors")
    assert (code, "fit --json: parameter_errors, correlations" in out) == (0, True)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"schema": "camcal/undistort/1"}', "is what camcal undistort prints with --json: draw the files"),
        ('{"schema": "camcal/fit/1", "error": {}}', "holds the failure of camcal fit, nothing to draw"),
        ('{"schema": "camcal/calibrate/1", "views": []}', "missing key 'image_size'"),
        ('{"schema": "camcal/detect/1", "images": []}', "holds no images to draw"),
        (
            (
                '{"schema": "camcal/calibrate/1", "views": [], "image_size": [9, 9], "uncertainty": '
                '{"map": {"u": [], "v": [], "rms_px": [], "worst_px": [], "inside": null}}}'
            ),
            "uncertainty.map",
        ),
    ],
)
def test_what_commands_print_and_cannot_be_drawn_is_named(run, tmp_path, content, said):
    (tmp_path / "said.json").write_text(content)
    code, _, err = run("plot", tmp_path / "said.json", "-o", tmp_path / "figures")
    assert (code in (2, 3, 4), said in err) == (True, True)
    assert not (tmp_path / "figures").exists()


def test_with_a_reference_errors_are_drawn(run, results, tmp_path):
    path = results / "path.tum"
    code, _, _ = run("plot", path, "--reference", path, "-o", tmp_path / "error.pdf", "--figure", "trajectory_error")
    assert (code, (tmp_path / "error.pdf").read_bytes()[:4]) == (0, b"%PDF")


def test_the_same_file_gives_the_same_bytes(run, results, tmp_path):
    for name in ("one", "two"):
        assert run("plot", results / "detections.csv", "-o", tmp_path / name)[0] == 0
    first, second = ((tmp_path / name / "coverage.png").read_bytes() for name in ("one", "two"))
    assert first == second


def test_a_file_takes_one_figure(run, results, tmp_path):
    code, _, err = run("plot", results / "detections.csv", "-o", tmp_path / "one.png")
    assert code == 2
    assert "takes one figure, there are 2: choose one with --figure (coverage, corners_by_view)" in err
    assert not (tmp_path / "one.png").exists()


def test_an_unknown_figure_is_named(run, results, tmp_path):
    code, _, err = run("plot", results / "detections.csv", "-o", tmp_path / "one.png", "--figure", "coverege")
    assert (code, "Did you mean 'coverage'?" in err) == (2, True)


@pytest.mark.parametrize(
    ("name", "content"),
    [("board.yaml", "type: chessboard\n"), ("notes.md", "# notes\n"), ("list.csv", "a,b\n1,2\n"), ("x.json", "{}")],
)
def test_other_files_are_refused_in_one_line(run, tmp_path, name, content):
    (tmp_path / name).write_text(content)
    code, _, err = run("plot", tmp_path / name, "-o", tmp_path / "figures")
    assert (code, err.count("\n")) == (3, 1)
    assert "is no result that can be drawn" in err
    assert not (tmp_path / "figures").exists()


def test_a_damaged_sensor_file_is_refused_with_its_line(run, tmp_path):
    (tmp_path / "s.yaml").write_text(
        "format: camcal-sensor\nversion: 1\nsaturation: full well\nfigures: {}\ncurves: {}\n"
    )
    code, _, err = run("plot", tmp_path / "s.yaml", "-o", tmp_path / "figures")
    assert (code, "s.yaml:4: figures: missing key 'gain_dn_per_e'" in err) == (2, True)


def test_pictures_of_others_are_not_replaced(run, results, tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "coverage.png").write_bytes(b"mine")
    code, _, err = run("plot", results / "detections.csv", "-o", tmp_path / "figures")
    assert (code, "was not written by camcal" in err) == (2, True)
    assert written(tmp_path / "figures") == {"coverage.png"}
    assert run("plot", results / "detections.csv", "-o", tmp_path / "figures", "--overwrite")[0] == 0


def test_the_commands_that_draw_their_results_are_these():
    drawing = {name for name, each in REGISTERED.items() if any(one.name == "--figures" for one in each.declared)}
    assert drawing == {"calibrate", "rig", "stereo calibrate", "track", "smooth", "fit", "sensor", "stereo eval"}
