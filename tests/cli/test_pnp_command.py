"""`camcal pnp` from the outside: what is printed, what is written, how it exits."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from tagged import facing, photograph, pinhole

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.main import app
from camcal.formats import detections, native, poses
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe
from camcal.targets.board import parse_board

SETTINGS = Path(__file__).parents[2] / "sample_configs" / "pnp.yaml"
CAMERA = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 320.0, 240.0])
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
TRUTH = Pose.from_vector(np.array([0.3, 0.2, 0.1]), np.array([0.02, -0.03, 0.7]))
RIGHT_T_LEFT = Pose.from_vector(np.array([0.0, 0.1, 0.0]), np.array([-0.2, 0.0, 0.01]))
FILE_KEYS = [
    *("format", "version", "frames", "unit", "covariance_order", "covariance_steps", "noise", "poses", "missing"),
]
POSE_KEYS = [
    *("image", "status", "object_T_camera", "position", "std", "rms_px", "max_px", "n_points", "n_inliers", "outliers"),
    *("p_wrong", "alternatives", "planarity", "least_depth", "image_share", "condition", "covariance"),
    "covariance_noise",
]


def rows_of(camera_T_cube, rng):
    return np.column_stack([CUBE, CAMERA.project(camera_T_cube.apply(CUBE)).pixels + rng.normal(0, 0.2, (8, 2))])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "camera.yaml", CameraFile({"cam": CameraEntry(CAMERA)}))
    table = rows_of(TRUTH, np.random.default_rng(1)).tolist()
    rows = [",".join([image, *map(str, row)]) for image in ("a", "b") for row in table]
    (tmp_path / "points.csv").write_text("image,X,Y,Z,u,v\n" + "\n".join(rows) + "\n")
    (tmp_path / "one_bad.csv").write_text("image,X,Y,Z,u,v\n" + "\n".join(rows[:11]) + "\n")
    return tmp_path


@pytest.fixture
def rig(folder):
    entries = {name: CameraEntry(CAMERA) for name in ("left", "right")}
    native.write(folder / "rig.yaml", CameraFile(entries, {"right_T_left": Transform(RIGHT_T_LEFT)}))
    return folder


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        app(["pnp", *map(str, arguments)])
    return caught.value.code or 0


def test_poses_are_printed_as_a_table_and_written(folder, capsys):
    assert run("camera.yaml", "--points", "points.csv", "-o", "poses.yaml") == 0
    printed = capsys.readouterr().out
    assert "camera_T_object" in printed
    assert "x y z, mm" in printed
    assert "not shown: points; ± std, mm; ± std, deg; seen from (--verbose" in printed
    assert "20 degrees of freedom" in printed
    assert "wrote poses.yaml" in printed
    assert [pose_key.image for pose_key in poses.read(folder / "poses.yaml").estimates] == ["a", "b"]


def test_json_is_one_document_with_its_schema_first(folder, capsys):
    assert run("camera.yaml", "--points", "points.csv", "--json", "--pose", "object_T_camera") == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document) == ["schema", *FILE_KEYS, "failed", "pictures", "reused", "timings", "warnings"]
    assert document["schema"] == "camcal/pnp/1"
    assert list(document["poses"][0]) == POSE_KEYS
    # 0.2 px of noise at 500 px and 0.7 m
    np.testing.assert_allclose(
        document["poses"][0]["object_T_camera"]["translation"], TRUTH.inverse().translation, atol=5e-3
    )
    assert document["poses"][0]["position"] == document["poses"][0]["object_T_camera"]["translation"]


def test_an_image_without_a_pose_is_exit_6_and_the_rest_is_there(folder, capsys):
    assert run("camera.yaml", "--points", "one_bad.csv", "-o", "poses.csv") == 6
    out, err = capsys.readouterr()
    assert "no pose: b: a pose needs 4 different points or more, found 3" in out
    assert "no pose from 1 of 2 images: b" in err
    assert "# none b,," in (folder / "poses.csv").read_text()


def test_the_sample_settings_are_taken(folder, capsys):
    board = parse_board("chessboard:9x6:25mm")
    found, _ = observe(CAMERA, board, [TRUTH], rng=np.random.default_rng(2), noise_px=0.2)
    detections.write(folder / "detections.csv", found)
    assert run("camera.yaml", "detections.csv", "--config", SETTINGS) == 0
    assert "noise 0.2 px, as given" in capsys.readouterr().out
    assert yaml.safe_load((folder / "poses.yaml").read_text())["frames"] == "camera_T_object"


def test_a_gate_is_exit_7_after_everything_is_written(folder, capsys):
    gates = ("--max-rms", "0.01", "--min-inliers", "9")
    assert run("camera.yaml", "--points", "points.csv", "-o", "poses.json", "--draw", "pictures", *gates) == 7
    out, err = capsys.readouterr()
    assert err.splitlines() == [
        "camcal: error: --max-rms, --min-inliers: a: reprojection RMS 0.153 px (limit 0.01 px)",
        "camcal: error: a: 8 of 8 points are inliers (limit 9)",
        "camcal: error: b: reprojection RMS 0.153 px (limit 0.01 px)",
        "camcal: error: b: 8 of 8 points are inliers (limit 9)",
    ]
    assert "wrote poses.json and 2 pictures to pictures/" in out
    assert (folder / "poses.json").is_file()
    assert sorted(path.name for path in (folder / "pictures").glob("*.png")) == ["a_pose.png", "b_pose.png"]


def test_every_solution_is_listed_when_asked_for(folder, capsys):
    tag = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.02
    far = Pose.from_vector(np.array([0.3, 0.1, 0.0]), np.array([0.0, 0.0, 1.5]))
    table = np.column_stack([tag, CAMERA.project(far.apply(tag)).pixels])
    np.savetxt(folder / "tag.csv", table, "%.17g", ",", header="X,Y,Z,u,v", comments="")
    assert run("camera.yaml", "--points", "tag.csv", "--noise", "0.3", "--all-solutions", "--outliers", "none") == 0
    out = capsys.readouterr().out
    assert "ambiguous: another pose has nearly the same residuals, probability" in " ".join(out.split())
    assert "other poses" in out


def test_points_of_a_rig_give_one_pose_in_its_frame(rig, capsys):
    rng = np.random.default_rng(3)
    seen = {"left": rows_of(TRUTH, rng), "right": rows_of(RIGHT_T_LEFT @ TRUTH, rng)}
    rows = [",".join(["1", name, *map(str, row)]) for name, table in seen.items() for row in table.tolist()]
    (rig / "both.csv").write_text("image,camera,X,Y,Z,u,v\n" + "\n".join(rows))
    assert run("--rig", "rig.yaml", "--points", "both.csv", "-o", "poses.yaml", "--draw", "pictures") == 0
    assert "left_T_object" in capsys.readouterr().out
    (record,) = poses.read(rig / "poses.yaml").estimates.values()
    assert record.n_points == 16
    off = np.concatenate(
        [record.transform.translation - TRUTH.translation, (record.transform @ TRUTH.inverse()).vector()]
    )
    assert off @ np.linalg.solve(record.covariance, off) < 45  # 5 σ in six dimensions
    assert sorted(path.name for path in (rig / "pictures").glob("*.png")) == ["left_1_pose.png", "right_1_pose.png"]
    # the right one looks elsewhere than the file says
    moved = [",".join(["1", "right", *map(str, row)]) for row in rows_of(TRUTH, rng).tolist()]
    (rig / "moved.csv").write_text("image,camera,X,Y,Z,u,v\n" + "\n".join(rows[:8] + moved[:6]))
    assert run("--rig", "rig.yaml", "--points", "moved.csv", "--noise", "0.2") == 0
    assert "1 of camera right: no inliers: " in capsys.readouterr().err
    # from the left camera alone the depth is worse: that is what the other one is for
    (rig / "left.csv").write_text("\n".join(["X,Y,Z,u,v", *(",".join(row.split(",")[2:]) for row in rows[:8])]))
    assert run("rig.yaml#left", "--points", "left.csv", "-o", "left.yaml", "--noise", "0.2") == 0
    (alone,) = poses.read(rig / "left.yaml").estimates.values()
    assert alone.std[2] > 1.5 * record.std[2]


def test_images_of_a_rig_are_joined_by_their_names(folder, capsys):
    camera, shift = pinhole(), Pose(np.eye(3), np.array([-0.05, 0.0, 0.0]))
    entries = {name: CameraEntry(camera) for name in ("left", "right")}
    native.write(folder / "rig.yaml", CameraFile(entries, {"right_T_left": Transform(shift)}))
    truths = [facing(0.0, 0.0, 0.4, (0.5, 0.1, 0.0)), facing(0.03, 0.01, 0.5, (0.1, -0.5, 0.2))]
    for side, side_T_left in (("left", Pose.identity()), ("right", shift)):
        (folder / side).mkdir()
        for number, truth in enumerate(truths):
            image = photograph(camera, [(5, side_T_left @ truth)], seed=number)
            cv2.imwrite(str(folder / side / f"{side}_{number:03d}.png"), image)
    arguments = ("left=left", "right=right", "--tags", "tag36h11:50mm", "--jobs", "1")
    assert run("--rig", "rig.yaml", *arguments, "-o", "poses.json", "--draw", "pictures") == 0
    found = poses.read(folder / "poses.json")
    assert [str(pose_key) for pose_key in found.estimates] == ["000.png, tag_5", "001.png, tag_5"]
    for record, truth in zip(found.estimates.values(), truths, strict=True):
        assert record.n_points == 8
        # a tenth of a pixel of 600 px at half a metre across, some times that in depth
        np.testing.assert_allclose(record.transform.translation, truth.translation, atol=2e-3)
    assert len(list((folder / "pictures").glob("*.png"))) == 4


def test_tags_in_images_are_objects_of_their_own(folder, capsys):
    camera = pinhole()
    native.write(folder / "pinhole.yaml", CameraFile({"cam": CameraEntry(camera)}))
    truths = {3: facing(-0.05, 0.0, 0.4, (0.4, 0.0, 0.0)), 7: facing(0.05, 0.0, 0.4, (0.0, 0.4, 0.3))}
    cv2.imwrite("tags.png", photograph(camera, list(truths.items())))
    cv2.imwrite("empty.png", np.full((480, 640), 128, np.uint8))
    images = ("pinhole.yaml", "tags.png", "empty.png", "--tags", "tag36h11:50mm", "--jobs", "1")
    assert run(*images, "-o", "poses.csv", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert [(item["image"], item["object"]) for item in document["poses"]] == [
        *(("tags.png", name) for name in ("tag_3", "tag_7")),
    ]
    assert [item["image"] for item in document["missing"]] == ["empty.png"]
    for record, truth in zip(poses.read(folder / "poses.csv").estimates.values(), truths.values(), strict=True):
        np.testing.assert_allclose(record.transform.translation, truth.translation, atol=2e-3)
    cv2.imwrite("small.png", np.full((240, 320), 128, np.uint8))
    assert run("pinhole.yaml", "small.png", "--tags", "tag36h11:50mm") == 2
    assert "if the images were resized, not cropped, give --scale-intrinsics" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["camera.yaml", "--points", "few.csv"], 4, "few.csv: a pose needs 4 different points or more, found 3"),
        (["camera.yaml", "--points", "line.csv"], 4, "line.csv: all 4 points are collinear"),
        (["camera.yaml", "--points", "none.csv"], 3, "none.csv: no such file"),
        (["camera.yaml", "--points", "empty.csv"], 3, "empty.csv: is empty"),
        (["camera.yaml", "--points", "wrong.csv"], 2, "wrong.csv:2: u: 'left' is not a number"),
        (["camera.yaml", "--points", "nan.csv"], 2, "nan.csv:2: u: nan is not finite"),
        (
            ["camera.yaml", "--points", "twice.csv"],
            2,
            "twice.csv:3: image 'twice.csv': the point (0, 0, 0) occurs twice",
        ),
        (["camera.yaml", "--points", "points.csv", "--noise", "-1"], 2, "a noise of -1 px is not positive"),
        (
            ["camera.yaml", "--points", "points.csv", "--noise", "much"],
            2,
            "'--noise': 'much' is not a number of pixels, or auto",
        ),
        (["camera.yaml", "--points", "points.csv", "--max-rms", "0"], 2, "--max-rms must be more than 0 px"),
        (["camera.yaml", "--points", "points.csv", "--max-ambiguity", "2"], 2, "--max-ambiguity is a probability"),
        (
            ["camera.yaml", "--points", "points.csv", "--outliers", "man"],
            2,
            "'man' is not one of auto, none, few, many. Did you mean 'many'?",
        ),
        (
            ["camera.yaml", "--points", "points.csv", "--pose", "pose"],
            2,
            "it is camera_T_object or object_T_camera here",
        ),
        (["camera.yaml", "--points", "points.csv", "--draw", "points.csv"], 2, "is an input and is not overwritten"),
        (["camera.yaml", "--points", "points.csv", "-o", "points.csv"], 2, "is an input and is not overwritten"),
        (["camera.yaml", "--points", "points.csv", "--prior-sigma", "1,1"], 2, "--prior-sigma needs --prior"),
        (["camera.yaml", "--points", "points.csv", "--prior", "p.txt", "--prior-sigma", "1"], 2, "METRES,DEGREES"),
        (["camera.yaml", "--points", "points.csv", "--prior", "none.txt", "--noise", "1"], 3, "none.txt: no such file"),
        (["camera.yaml", "points.csv", "--tags", "none.yaml"], 2, "points.csv: holds corners of a board"),
        (["camera.yaml", "a.png", "--tags", "none.yaml"], 3, "none.yaml: no such file"),
        (["camera.yaml"], 2, "no input: give --points FILE"),
        (["-v"], 2, "no camera: give a camera file, --camera-matrix FX,FY,CX,CY, or --rig"),
        (["camera.yaml", "detections.csv"], 2, "detections.csv: names no board: give --board"),
        (
            ["--rig", "rig.yaml", "photos", "--board", "chessboard:9x6"],
            2,
            "photos: no camera given: give CAMERA=IMAGES",
        ),
        (
            ["--rig", "rig.yaml", "lef=photos", "--board", "chessboard:9x6"],
            2,
            "no camera 'lef' in the rig. Did you mean",
        ),
        (["--rig", "rig.yaml", "--points", "points.csv"], 2, "points of a rig need a column camera: left, right"),
        (["--rig", "rig.yaml#left", "--points", "points.csv"], 2, "--rig uses all cameras; leave the camera name out"),
        (["rig.yaml", "--points", "points.csv"], 2, "rig.yaml: holds 2 cameras"),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(rig, capsys, arguments, code, message):
    head = "X,Y,Z,u,v\n"
    (rig / "few.csv").write_text(head + "0,0,0,1,2\n1,0,0,3,4\n0,1,0,5,6\n")
    (rig / "line.csv").write_text(head + "".join(f"{x},0,0,{100 + 10 * x},100\n" for x in range(4)))
    (rig / "wrong.csv").write_text(head + "0,0,0,left,2\n")
    (rig / "nan.csv").write_text(head + "0,0,0,nan,2\n")
    (rig / "twice.csv").write_text(head + "0,0,0,1,2\n0,0,0,3,4\n")
    (rig / "empty.csv").write_text("")
    (rig / "detections.csv").write_text("image,width,height,id,u,v\na.png,640,480,0,1,2\n")
    assert run(*arguments) == code
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert message in err[0]


def test_points_that_name_no_image_are_drawn_on_gray(folder):
    table = rows_of(TRUTH, np.random.default_rng(2)).tolist()
    (folder / "plain.csv").write_text("X,Y,Z,u,v\n" + "".join(",".join(map(str, row)) + "\n" for row in table))
    assert run("camera.yaml", "--points", "plain.csv", "--draw", "pictures") == 0
    assert (folder / "pictures" / "plain_pose.png").is_file()


def test_a_pose_of_fewer_than_half_of_the_points_is_doubted(folder, capsys):
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (30, 3))
    pixels = CAMERA.project(TRUTH.apply(points)).pixels
    pixels[10:] = rng.uniform(0, 480, (20, 2))
    rows = np.column_stack([points, pixels]).tolist()
    (folder / "most_wrong.csv").write_text("X,Y,Z,u,v\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    assert run("camera.yaml", "--points", "most_wrong.csv", "--noise", 0.2) == 0
    assert "of 30 points are inliers" in capsys.readouterr().err


def test_coordinates_that_no_camera_sees_are_refused_at_their_line(folder, capsys):
    (folder / "far.csv").write_text("X,Y,Z,u,v\n0,0,0,1,1\n0,1e300,0,1,2\n")
    assert run("camera.yaml", "--points", "far.csv") == 2
    assert "far.csv:3: a coordinate of 1e+300 m" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--noise", "--threshold"])
@pytest.mark.parametrize("value", ["1e300", "1e-300"])
def test_sizes_that_cannot_be_computed_with_are_refused(folder, capsys, option, value):
    assert run("camera.yaml", "--points", "points.csv", option, value) == 2
    assert "implausible" in capsys.readouterr().err


@pytest.mark.parametrize(("column", "value"), [("sigma", "1e200"), ("sigma", "1e-200"), ("weight", "1e300")])
def test_columns_beyond_reason_are_refused_at_their_line(folder, capsys, column, value):
    lines = (folder / "points.csv").read_text().splitlines()
    (folder / "odd.csv").write_text("\n".join([f"{lines[0]},{column}", *(f"{line},{value}" for line in lines[1:])]))
    assert run("camera.yaml", "--points", "odd.csv") == 2
    assert f"odd.csv:2: {column} {value.replace('e', 'e+') if '-' not in value else value}" in capsys.readouterr().err


def test_a_prior_beyond_reason_is_refused(folder, capsys):
    arguments = "camera.yaml", "--points", "points.csv", "--noise", 0.2, "--prior", "p.yaml"
    assert run(*arguments, "--prior-sigma", "1e300,5") == 2
    assert "implausible" in capsys.readouterr().err
