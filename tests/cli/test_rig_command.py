"""`camcal rig` and `camcal stereo calibrate`: the file, the document, refusals, and what `inspect` makes of it."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import camcal
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections, native, poses
from camcal.formats.camera_file import rig_of
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

BOARD = Board("chessboard", 7, 6, 0.04)
LEFT = Camera(model_named("opencv4"), (1280, 960), [1000.0, 1002, 640, 480, -0.1, 0.05, 1e-4, -2e-4])
RIGHT = Camera(model_named("opencv4"), (960, 720), [800.0, 801, 480, 360, -0.12, 0.05, 1e-4, -2e-4])
RIGHT_T_LEFT = Pose.from_vector(np.array([0.01, -0.05, 0.02]), np.array([-0.12, 0.002, 0.004]))
QUICK = ("--model", "opencv4", "--flat-board", "--no-free-corners")


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(1)
    placed = views(LEFT, BOARD, 12, rng=rng)
    both = {
        "left": observe(LEFT, BOARD, placed, rng=rng, noise_px=0.1)[0],
        "right": observe(RIGHT, BOARD, [RIGHT_T_LEFT @ pose for pose in placed], rng=rng, noise_px=0.1)[0],
    }
    return Detections(
        BOARD,
        tuple(
            replace(view, camera=name, image=f"{name}/{index:02}.png")
            for name, found in both.items()
            for index, view in enumerate(found.views)
        ),
    )


@pytest.fixture
def table(tmp_path, seen):
    path = tmp_path / "corners.csv"
    detections.write(path, seen)
    return path


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory, seen):
    """A rig file as the command writes it."""
    from camcal.tasks.rigs.calibrate_rig import rig
    from camcal.tasks.rigs.options import RigSettings, RigTaskOptions

    folder = tmp_path_factory.mktemp("rig")
    detections.write(folder / "corners.csv", seen)
    settings = RigSettings(folder / "rig.yaml", models=("opencv4",), flat_board=True, free_corners=False)
    rig(RigTaskOptions((str(folder / "corners.csv"),), settings))
    return folder / "rig.yaml"


def test_the_rig_file_has_the_pair_with_its_joint_covariance(rig_file):
    file = native.read(rig_file)
    assert list(file.cameras) == ["left", "right"]
    assert file.cameras["right"].camera.image_size == (960, 720)
    transform, joint = file.transforms["right_T_left"], file.joint_covariance
    step = np.concatenate(
        [
            transform.pose.translation - RIGHT_T_LEFT.translation,
            (transform.pose @ RIGHT_T_LEFT.inverse()).vector(),
        ]
    )
    assert step @ np.linalg.solve(transform.covariance, step) < 25  # χ² of 6: exceeded once in 3000
    assert set(joint.names) >= {"left.fx", "right.k2", "right_T_left.tx", "right_T_left.rz"}
    rows = [joint.names.index(f"right_T_left.{name}") for name in ("tx", "ty", "tz", "rx", "ry", "rz")]
    np.testing.assert_allclose(joint.matrix[np.ix_(rows, rows)], transform.covariance, rtol=1e-9)
    lens = [joint.names.index(f"left.{name}") for name in LEFT.model.parameter_names]
    np.testing.assert_allclose(joint.matrix[np.ix_(lens, lens)], file.cameras["left"].camera.covariance, rtol=1e-9)
    cross = joint.matrix[np.ix_(rows, lens)] / np.sqrt(
        np.outer(np.diag(joint.matrix)[rows], np.diag(joint.matrix)[lens])
    )
    assert np.abs(cross).max() > 0.1
    images = file.provenance["images"]
    assert [image["camera"] for image in images] == ["left"] * 12 + ["right"] * 12
    assert all("camera_T_board" in image for image in images)


def test_every_camera_of_a_rig_has_a_line_of_its_coverage_and_a_figure_on_a_terminal(run, table, tmp_path, monkeypatch):
    command = ["rig", table, "-o", tmp_path / "rig.yaml", *QUICK]
    piped = run(*command)[1]
    for name in ("left", "right"):
        assert f"\n{name}: corners in " in piped
    assert piped.count("┌") == 0
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert run(*command)[1].count("┌") == 2


def test_the_report_says_baseline_rotation_and_what_was_matched(run, table, tmp_path):
    code, out, _ = run("rig", table, "-o", tmp_path / "rig.yaml", *QUICK)
    assert code == 0
    assert "Calibration is trustworthy" in out
    assert "12 captures of 2 cameras, matched by name" in out
    row = next(line for line in out.splitlines() if line.strip().startswith("right_T_left"))
    baseline, std, rotation = (float(word) for word in row.split()[1:4])
    assert abs(baseline - 120.083) < 5 * std < 1.5
    assert rotation == pytest.approx(np.degrees(np.linalg.norm(RIGHT_T_LEFT.vector())), abs=0.2)


def test_the_json_document(run, table, tmp_path):
    code, out, _ = run("rig", table, "-o", tmp_path / "rig.yaml", *QUICK, "--json")
    found = json.loads(out)
    assert code == 0
    assert list(found) == [
        "schema",
        "output",
        "lenses",
        "first",
        "cameras",
        "transforms",
        "links",
        "scales",
        "epipolar_rms_px",
        "motion",
        "times",
        "unlinked",
        "matched_by",
        "largest_time_difference_s",
        "captures",
        "unmatched",
        "refinement",
        "candidates",
        "trustworthy",
        "failures",
        "frames",
        "failed",
        "reused",
        "timings",
        "warnings",
    ]
    assert found["schema"] == "camcal/rig/1"
    assert list(found["transforms"]) == ["right_T_left"]
    assert list(found["transforms"]["right_T_left"]) == [
        "R",
        "t",
        "covariance",
        "baseline_m",
        "baseline_std_m",
        "rotation_deg",
        "rotation_std_deg",
    ]
    assert found["captures"][0] == {"name": "00", "images": {"left": "left/00.png", "right": "right/00.png"}}
    assert {"model", "parameters", "std", "uncertainty", "trustworthy"} < set(found["cameras"]["left"])


@pytest.mark.slow
def test_stereo_calibrate_is_the_same_for_two_cameras(run, seen, tmp_path, rig_file):
    for name in ("left", "right"):
        own = replace(seen, views=tuple(replace(view, camera="") for view in seen.views if view.camera == name))
        detections.write(tmp_path / f"{name}.csv", own)
    words = ("stereo", "calibrate", tmp_path / "left.csv", tmp_path / "right.csv", "-o", tmp_path / "rig.yaml")
    code, out, _ = run(*words, *QUICK, "--json")
    assert (code, json.loads(out)["schema"]) == (0, "camcal/stereo-calibrate/1")
    found, expected = native.read(tmp_path / "rig.yaml"), native.read(rig_file)
    np.testing.assert_array_equal(
        found.transforms["right_T_left"].pose.matrix(), expected.transforms["right_T_left"].pose.matrix()
    )
    assert found.provenance["command"].startswith("camcal stereo calibrate")


def test_a_pair_has_two_cameras(run, tmp_path):
    for name in ("left", "middle", "right"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "1.png").write_bytes(b"x")
    code, _, err = run("stereo", "calibrate", tmp_path, "-b", "chessboard:7x6:40mm", "-o", tmp_path / "rig.yaml")
    assert (code, "3 cameras (left, middle, right): use 'camcal rig'" in err) == (2, True)


def test_cameras_of_a_table_without_their_names_are_those_of_its_images(run, seen, tmp_path):
    table = replace(seen, views=tuple(replace(view, camera="") for view in seen.views))
    detections.write(tmp_path / "corners.vnl", table)
    code, _, err = run("rig", tmp_path / "corners.vnl", "-o", tmp_path / "rig.yaml", "-b", "chessboard:7x6:40mm")
    assert (code, "left/00.png was not found: set --image-size" in err) == (2, True)
    named = replace(table, views=tuple(replace(view, image=view.image.replace("/", "_")) for view in table.views))
    detections.write(tmp_path / "named.csv", named)
    code, out, _ = run("rig", tmp_path / "named.csv", "-o", tmp_path / "rig.yaml", *QUICK)
    assert (code, "12 captures of 2 cameras, matched by name" in out) == (0, True)


@pytest.mark.slow
@pytest.mark.slow
def test_a_rig_is_drawn_with_its_cameras_and_its_file_again(run, table, tmp_path):
    words = ("rig", table, "-o", tmp_path / "rig.yaml", *QUICK, "--figures", tmp_path / "figures", "--json")
    code, out, _ = run(*words)
    names = {Path(path).stem for path in json.loads(out)["figure_files"]}
    assert code == 0
    assert {"rig", "epipolar_errors", "covariance_right_T_left", "left_coverage", "right_residual_vectors"} < names
    code, out, _ = run("plot", tmp_path / "rig.yaml", "-o", tmp_path / "again", "--json")
    document = json.loads(out)
    assert (code, document["inputs"][0]["kind"]) == (0, "rig")
    assert {"rig", "left_field_angle", "right_residuals_by_view"} <= set(document["captions"])


def test_lenses_may_be_held_or_be_a_prior(run, seen, table, tmp_path, rig_file):
    given = native.read(rig_file).cameras["left"].camera
    for lenses in ("fixed", "prior"):
        words = (
            "rig",
            table,
            "-o",
            tmp_path / f"{lenses}.yaml",
            "--lenses",
            lenses,
            "--guess",
            rig_file,
        )
        assert run(*words, "--flat-board", "--no-free-corners")[0] == 0
    fixed, prior = (native.read(tmp_path / f"{name}.yaml") for name in ("fixed", "prior"))
    np.testing.assert_array_equal(fixed.cameras["left"].camera.parameters, given.parameters)
    assert "left.fx" not in fixed.joint_covariance.names or not fixed.cameras["left"].camera.covariance.any()
    assert prior.cameras["left"].camera.std("fx") < given.std("fx")


@pytest.fixture
def pictures(tmp_path):
    """Folders of two small images each, all different."""
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        for index in range(2):
            pixels = np.random.default_rng([index, len(name)]).integers(0, 255, (48, 64), np.uint8)
            cv2.imwrite(str(tmp_path / name / f"{index}.png"), pixels)
    return tmp_path


def test_a_prior_from_the_same_images_is_refused(run, seen, rig_file, pictures):
    images = [pictures / camera / f"{index}.png" for camera in ("left", "right") for index in range(2)]
    chosen = [view for view in seen.views if int(view.image[-6:-4]) < 2]
    renamed = [replace(view, image=str(path)) for view, path in zip(chosen, images, strict=True)]
    detections.write(pictures / "corners.csv", replace(seen, views=tuple(renamed)))
    from camcal import files

    file = native.read(rig_file)
    records = [{"file": "other.png", "camera": "left", "sha256": files.sha256(images[1])}]
    native.write(pictures / "lenses.yaml", replace(file, provenance={**file.provenance, "images": records}))
    words = ("rig", pictures / "corners.csv", "-o", pictures / "rig.yaml", "--lenses", "prior")
    code, _, err = run(*words, "--guess", pictures / "lenses.yaml")
    assert code == 2
    assert "1 image of camera left (1.png, …) also made this calibration, and as a prior would count twice" in err
    assert not (pictures / "rig.yaml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--lenses", "fixed"), "--lenses fixed needs the lenses: give --guess FILE"),
        (("--model", "middle=opencv4"), "no camera 'middle' in the rig"),
        (("--model", "left=nonsense"), "nonsense"),
        (("--match", "time"), "has no time: set --timestamps"),
        (("--match", "name", "--time-tolerance", "5"), "--time-tolerance goes with --match time"),
        (("--board", "chessboard:7x6"), "of unknown size gives no distances between cameras"),
        (("--refine",), "--refine needs images, not a detections file"),
    ],
)
def test_options_that_do_not_fit_are_refused(run, table, tmp_path, words, message):
    code, _, err = run("rig", table, "-o", tmp_path / "rig.yaml", *words)
    assert (code, message in err) == (2, True), err


def test_a_gate_that_fails_ends_with_7_and_leaves_the_file(run, table, tmp_path):
    code, _, err = run("rig", table, "-o", tmp_path / "rig.yaml", *QUICK, "--max-uncertainty", "1e-6")
    assert code == 7
    assert "left: projection uncertainty" in err
    assert (tmp_path / "rig.yaml").exists()


def test_cameras_that_never_see_the_board_are_left_out_and_named(run, seen, tmp_path):
    blind = [
        replace(view.without_points("no chessboard"), camera="top", image=f"top/{view.image[-6:]}")
        for view in seen.views
        if view.camera == "left"
    ]
    detections.write(tmp_path / "corners.csv", replace(seen, views=(*seen.views, *blind)))
    code, _, err = run("rig", tmp_path / "corners.csv", "-o", tmp_path / "rig.yaml", *QUICK)
    assert code == 0
    assert "camera top: none of 12 images shows the board: left out" in err
    assert list(native.read(tmp_path / "rig.yaml").cameras) == ["left", "right"]


def test_inspect_says_what_the_rig_can_measure(run, rig_file):
    code, out, _ = run("inspect", rig_file)
    assert code == 0
    assert "pairs of cameras" in out
    assert "depth error of left, right" in out
    _, out, _ = run("inspect", rig_file, "--json")
    pair = json.loads(out)["rig"]["pairs"][0]
    assert pair["baseline_m"] == pytest.approx(0.12008, abs=5 * pair["baseline_std_m"])
    depth = pair["depth"][4]
    assert depth["distance_m"] == pytest.approx(10 * pair["baseline_m"])
    assert 0 < depth["calibration_std_m"] < depth["matching_std_m"]
    assert 0 < pair["epipolar_px"] < 0.2


@pytest.mark.slow
def test_the_picture_of_a_rig_shows_its_cameras_and_boards(run, rig_file, tmp_path):
    code, out, _ = run("inspect", rig_file, "-o", tmp_path / "rig.png")
    assert (code, "left blue, right orange" in out) == (0, True)
    picture = cv2.imread(str(tmp_path / "rig.png")).astype(int)
    for colour in ((178, 114, 0), (0, 130, 230), (150, 150, 150)):
        assert (np.abs(picture - colour).max(axis=2) < 12).sum() > 200


@pytest.mark.parametrize(
    "provenance",
    [
        {"images": [{"file": "a", "camera": "left", "camera_T_board": {"t": [1.0], "rotation_vector": "x"}}]},
        {
            "images": [
                {"file": "a", "camera": "left", "camera_T_board": {"t": [1e300] * 3, "rotation_vector": [1e300] * 3}}
            ]
        },
        {"images": [{"file": "a", "camera": "top", "camera_T_board": 3}], "board": {"type": "chessboard"}},
        {"board": {"type": "nonsense"}, "rig": ["x"]},
        {"rig": {"epipolar_rms_px": "large"}},
    ],
)
def test_a_provenance_that_says_nothing_of_use_is_passed_over(run, rig_file, tmp_path, provenance):
    native.write(tmp_path / "rig.yaml", replace(native.read(rig_file), provenance=provenance))
    code, out, _ = run("inspect", tmp_path / "rig.yaml", "-o", tmp_path / "rig.html")
    assert (code, "pairs of cameras" in out) == (0, True)


def test_the_page_of_a_rig_is_a_page_and_a_single_camera_has_no_picture(run, rig_file, tmp_path):
    assert run("inspect", rig_file, "-o", tmp_path / "rig.html", "-q")[0] == 0
    assert (tmp_path / "rig.html").read_text().startswith("<!doctype html>")
    code, _, err = run("inspect", f"{rig_file}#left", "-o", tmp_path / "left.png")
    assert (code, "needs a file of several cameras that transforms join" in err) == (2, True)


@pytest.mark.slow
def test_poses_by_the_rig_count_the_uncertainty_of_its_transform(run, rig_file, seen, tmp_path):
    detections.write(tmp_path / "corners.csv", seen)
    certain = native.read(rig_file)
    bare = {name: replace(item, covariance=None) for name, item in certain.transforms.items()}
    native.write(tmp_path / "certain.yaml", replace(certain, transforms=bare, joint_covariance=None))
    spreads = []
    for path in (rig_file, tmp_path / "certain.yaml"):
        words = (
            "pnp",
            "--rig",
            path,
            tmp_path / "corners.csv",
            "-o",
            tmp_path / "poses.yaml",
            "--noise",
            "0.1",
            "--overwrite",
        )
        assert run(*words)[0] == 0
        found = poses.read(tmp_path / "poses.yaml").estimates
        spreads.append(np.mean([np.trace(record.covariance[:3, :3]) for record in found.values()]))
    assert rig_of(certain, "")[0].covariance is not None
    assert spreads[0] != pytest.approx(spreads[1], rel=1e-3)


@pytest.mark.slow
def test_programs_calibrate_a_rig_from_detections_or_captures(seen, rig_file):
    settings = camcal.RigSettings(models=("opencv4",), flat_board=True, free_corners=False)
    report = camcal.calibrate_rig(seen, options=settings)
    expected = native.read(rig_file).transforms["right_T_left"]
    np.testing.assert_allclose(report.calibration.poses["right"].matrix(), expected.pose.matrix(), rtol=1e-10)
    rows = zip(seen.views[:12], seen.views[12:], strict=True)
    captures = camcal.Captures(("left", "right"), tuple(map(str, range(12))), tuple(rows))
    again = camcal.calibrate_rig(captures, BOARD, settings)
    np.testing.assert_array_equal(again.calibration.covariance, report.calibration.covariance)
    with pytest.raises(camcal.InvalidInput, match="captures name no board"):
        camcal.calibrate_rig(captures)
