"""No path that stands in the content of a file leads a command to write outside of its output folder."""

import json
import re

import numpy as np
import pytest
from typer.main import get_command

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.main import app
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry import rotation as so3
from camcal.images.files import save

COMMAND = get_command(app)
LENS = Camera(model_named("opencv5"), (640, 480), np.array([500.0, 500, 320, 240, -0.1, 0.02, 0, 0, 0]))
OUTSIDE = ("../../stray.png", "/tmp/camcal-stray/deep/a.png", "..", "a/../../../b.png", "s3://bucket/c.png")
NAMES = (*(f"../{number}.png" for number in range(5)), *OUTSIDE)


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A working folder two folders below one that is watched."""
    folder = tmp_path / "outside" / "work"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(LENS)}))
    return folder


def run(*words):
    with pytest.raises(SystemExit) as leaving:
        COMMAND([str(word) for word in words])
    return leaving.value.code or 0


def strays(lab):
    """What stands outside of the working folder, and in it outside of `out` and what was there before."""
    watched = lab.parents[1]
    return [path for path in watched.rglob("*") if path.is_file() and lab / "in" not in path.parents]


def detections(names):
    """A detections file of a board of 9x6 corners that was seen, tilted this way and that, in images of these names."""
    points = np.array([[0.025 * (number % 9), 0.025 * (number // 9), 0.0] for number in range(54)]) - [0.1, 0.0625, 0]
    rows = ["image,width,height,id,u,v"]
    for view, name in enumerate(names):
        tilt = 0.6 * np.array([np.cos(2.4 * view), np.sin(2.4 * view), 0.1])
        pixels = LENS.project(points @ so3.exp(tilt).T + [0.02 * (view % 3 - 1), 0.02 * (view % 2), 0.35]).pixels
        rows += [f'"{name}",640,480,{number},{u},{v}' for number, (u, v) in enumerate(pixels)]
    return "\n".join([*rows, ""])


@pytest.mark.slow
def test_names_of_images_in_detections_do_not_lead_out(lab):
    (lab / "in").mkdir()
    (lab / "in" / "corners.csv").write_text(detections(NAMES))
    for name in NAMES[:5]:
        save(lab / name, np.full((480, 640), 128, np.uint8))
    before = set(strays(lab))
    codes = [
        run("calibrate", "in/corners.csv", "-b", "chessboard:9x6:25mm", "-o", "out/c.yaml", "--figures", "out/figures"),
        run(
            "pnp",
            "camera.yaml",
            "in/corners.csv",
            "-b",
            "chessboard:9x6:25mm",
            "-o",
            "out/p.csv",
            "--draw",
            "out/drawn",
        ),
        run("plot", "in/corners.csv", "-o", "out/plots"),
    ]
    assert codes == [0, 0, 0]
    assert {path for path in strays(lab) if lab / "out" not in path.parents} == before


@pytest.mark.parametrize("name", ["../../stray", "/tmp/camcal-stray", "a/b", "..", "con.txt/../x"])
def test_names_of_cameras_are_names_and_not_paths(lab, name, capsys):
    text = (lab / "camera.yaml").read_text()
    (lab / "rig.yaml").write_text(re.sub(r"(?m)^  camera:", f"  {json.dumps(name)}:", text))
    assert run("inspect", "rig.yaml") == 2
    assert "is not a valid name" in capsys.readouterr().err


def test_names_of_cameras_of_other_programs_do_not_lead_out(lab):
    (lab / "in").mkdir()
    text = "image_width: 640\nimage_height: 480\ncamera_name: ../../stray\ndistortion_model: plumb_bob\n"
    text += "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n"
    text += "distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}\n"
    (lab / "in" / "ros.yaml").write_text(text)
    before = set(strays(lab))
    run("convert", "in/ros.yaml", "out/own.yaml")
    run("convert", "in/ros.yaml", "out/again.yaml", "--to", "ros")
    run("undistort", "in/ros.yaml", "in/photos", "-o", "out/straight")
    assert {path for path in strays(lab) if lab / "out" not in path.parents} == before


def test_a_list_of_outputs_does_not_lead_out(lab):
    (lab / "out").mkdir()
    save(lab / "photos" / "1.png", np.full((480, 640, 3), 128, np.uint8))
    (lab.parent / "kept.png").write_bytes(b"kept")
    (lab / "out" / ".camcal-output").write_text("../../kept.png\n" + "0" * 64 + "\t4\t\t\t../../kept.png\n")
    run("undistort", "camera.yaml", "photos", "-o", "out", "--resume")
    assert (lab.parent / "kept.png").read_bytes() == b"kept"


def test_names_of_images_in_a_journal_do_not_lead_out(lab):
    board = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((16, 16))).astype(np.uint8) * 160 + 40
    save(lab / "photos" / "1.png", np.pad(board, 16, constant_values=200))
    (lab / "photos" / "2.png").touch()
    save(lab.parents[1] / "stray" / "1.png", np.pad(board, 16, constant_values=200))
    command = ("detect", "photos", "-b", "chessboard:7x5:25mm", "-o", "out/corners.csv", "-j", 1)
    assert run(*command) == 6
    journal = lab / "out" / ".corners.csv.camcal-journal"
    journal.write_text(journal.read_text().replace("photos/1.png", "../../stray/1.png"))
    before = {path for path in strays(lab) if lab / "out" not in path.parents}
    assert run(*command, "--resume", "--draw", "out/drawn") == 6
    assert len(list((lab / "out" / "drawn").glob("*.png"))) == 1
    assert {path for path in strays(lab) if lab / "out" not in path.parents} == before


def test_a_covariance_beside_a_camera_file_has_a_bare_name(lab, capsys):
    text = (lab / "camera.yaml").read_text()
    assert run("inspect", "camera.yaml") == 0
    block = "    covariance_file: ../../stray.npz\n"
    (lab / "camera.yaml").write_text(re.sub(r"(?m)^(  camera:\n)", rf"\g<1>{block}", text))
    assert run("inspect", "camera.yaml") == 2
    assert "camera.yaml" in capsys.readouterr().err
