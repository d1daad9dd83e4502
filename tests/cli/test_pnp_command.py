"""`camcal pnp` from the outside: what is printed, what is written, how it exits."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.main import app
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry.pose import Pose
from camcal.simulate.observe import observe
from camcal.targets.board import parse_board

SETTINGS = Path(__file__).parents[2] / "sample_configs" / "pnp.yaml"
CAMERA = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 320.0, 240.0])
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
TRUTH = Pose.from_vector(np.array([0.3, 0.2, 0.1]), np.array([0.02, -0.03, 0.7]))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "camera.yaml", CameraFile({"cam": CameraEntry(CAMERA)}))
    noise = np.random.default_rng(1).normal(0, 0.2, (8, 2))
    rows_of_a_view = np.column_stack([CUBE, CAMERA.project(TRUTH.apply(CUBE)).pixels + noise]).tolist()
    rows = [",".join([image, *map(str, row)]) for image in ("a", "b") for row in rows_of_a_view]
    (tmp_path / "points.csv").write_text("image,X,Y,Z,u,v\n" + "\n".join(rows) + "\n")
    (tmp_path / "one_bad.csv").write_text("image,X,Y,Z,u,v\n" + "\n".join(rows[:11]) + "\n")
    return tmp_path


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        app(["pnp", *arguments])
    return caught.value.code or 0


def test_poses_are_printed_as_a_table_and_written(folder, capsys):
    assert run("camera.yaml", "--points", "points.csv", "-o", "poses.yaml") == 0
    printed = capsys.readouterr().out
    assert "camera_T_object" in printed
    assert "x y z, mm" in printed
    assert "20 degrees of freedom" in printed
    assert "wrote poses.yaml" in printed
    assert [item["image"] for item in yaml.safe_load((folder / "poses.yaml").read_text())["poses"]] == ["a", "b"]


def test_json_is_one_document_with_its_schema_first(folder, capsys):
    assert run("camera.yaml", "--points", "points.csv", "--json", "--inverse") == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document) == [
        "schema",
        "format",
        "version",
        "frames",
        "unit",
        "covariance_order",
        "covariance_steps",
        "noise",
        "poses",
        "missing",
        "notes",
        "failed",
    ]
    assert document["schema"] == "camcal/pnp/1"
    assert list(document["poses"][0]) == ["image", "status", "points", "rms_px", "object_T_camera", "std", "covariance"]
    # 0.2 px of noise at 500 px and 0.7 m
    np.testing.assert_allclose(
        document["poses"][0]["object_T_camera"]["translation"], TRUTH.inverse().translation, atol=5e-3
    )


def test_an_image_without_a_pose_is_exit_6_and_the_rest_is_there(folder, capsys):
    assert run("camera.yaml", "--points", "one_bad.csv", "-o", "poses.csv") == 6
    out, err = capsys.readouterr()
    assert "no pose: b: a pose needs 4 different points or more, found 3" in out
    assert "1 of 2 images have no pose: b" in err
    assert "# none b," in (folder / "poses.csv").read_text()


def test_the_sample_settings_are_taken(folder, capsys):
    board = parse_board("chessboard:9x6:25mm")
    found, _ = observe(CAMERA, board, [TRUTH], rng=np.random.default_rng(2), noise_px=0.2)
    detections.write(folder / "detections.csv", found)
    assert run("camera.yaml", "detections.csv", "--config", str(SETTINGS)) == 0
    assert "noise 0.2 px, as given" in capsys.readouterr().out
    assert yaml.safe_load((folder / "poses.yaml").read_text())["frames"] == "camera_T_object"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--points", "few.csv"], 4, "few.csv: a pose needs 4 different points or more, found 3"),
        (["--points", "none.csv"], 3, "none.csv: no such file"),
        (["--points", "wrong.csv"], 2, "wrong.csv:2: u: 'left' is not a number"),
        (["--points", "points.csv", "--noise", "-1"], 2, "a noise of -1 px is not positive"),
        ([], 2, "nothing to work on: give --points"),
        (["detections.csv"], 2, "detections.csv: names no board: give --board"),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(folder, capsys, arguments, code, message):
    (folder / "few.csv").write_text("X,Y,Z,u,v\n0,0,0,1,2\n1,0,0,3,4\n0,1,0,5,6\n")
    (folder / "wrong.csv").write_text("X,Y,Z,u,v\n0,0,0,left,2\n")
    (folder / "detections.csv").write_text("image,width,height,id,u,v\na.png,640,480,0,1,2\n")
    assert run("camera.yaml", *arguments) == code
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert message in err[0]
