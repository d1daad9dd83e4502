"""`camcal advise` as it is called from a shell, and camcal.advise_views."""

import json
from dataclasses import replace

import numpy as np
import pytest

import camcal
from camcal.cameras.catalogue import model_named
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board

BOARD = Board("chessboard", 7, 5, 0.03)
CAMERA = make_camera(model_named("opencv4"), (640, 480), np.radians(60))
KEYS = ["schema", "uncertainty_px", "unit", "views", "spared", "spared_increase", "output", "warnings"]
VIEW = {"words", "tilt_deg", "nearer_side", "turned_deg", "centre_px", "distance", "camera_T_board", "uncertainty_px"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A detections file, and the camera file of its calibration."""
    path, rng = tmp_path_factory.mktemp("advise"), np.random.default_rng(2)
    found, _ = observe(CAMERA, BOARD, views(CAMERA, BOARD, 14, rng=rng), rng=rng, noise_px=0.1)
    detections.write(path / "seen.csv", found)
    report = camcal.calibrate_camera(path / "seen.csv")
    native.write(path / "camera.yaml", report.file)
    sides = (replace(view, camera=("left", "right")[index % 2]) for index, view in enumerate(found.views))
    detections.write(path / "two.csv", replace(found, views=tuple(sides)))
    entry = next(iter(report.file.cameras.values()))
    bare = CameraEntry(replace(entry.camera, covariance=None))
    native.write(path / "bare.yaml", CameraFile({"left": bare}, provenance=report.file.provenance))
    native.write(path / "boardless.yaml", CameraFile({"left": entry}))
    return path


def test_views_and_their_picture_follow_from_a_camera_file(run, folder):
    code, out, err = run("advise", str(folder / "camera.yaml"), "-o", str(folder / "next.png"))
    assert code == 0, err
    assert out.startswith("Projection uncertainty over the image (1 sigma, RMS): ")
    assert "views to take next" in out
    assert "nearer" in out
    assert (folder / "next.png").read_bytes().startswith(b"\x89PNG")


def test_detections_and_their_camera_file_lead_to_the_same_views(run, folder):
    first, second = (json.loads(run("advise", str(folder / name), "--json")[1]) for name in ("seen.csv", "camera.yaml"))
    assert list(first) == [*KEYS[:-1], *(["warnings"] if "warnings" in first else [])]
    assert first["schema"] == "camcal/advise/1"
    assert [set(view) for view in first["views"]] == [VIEW] * 3
    assert [view["words"] for view in first["views"]] == [view["words"] for view in second["views"]]
    assert first["views"][-1]["uncertainty_px"] == pytest.approx(second["views"][-1]["uncertainty_px"], rel=1e-3)
    assert first["uncertainty_px"] > first["views"][0]["uncertainty_px"] > first["views"][-1]["uncertainty_px"]
    assert second["spared"] == []


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["bare.yaml"], 2, "states no covariance and noise: calibrate with camcal, or give the detections"),
        (["boardless.yaml"], 2, "names no board: give --board, such as --board chessboard:9x6:25mm"),
        (["camera.yaml", "--model", "opencv5"], 2, "--model applies to detections, not to a camera file"),
        (["camera.yaml", "--views", "0"], 2, "0 is less than 1"),
        (
            ["two.csv", "--model", "opencv4"],
            2,
            "the views are of several cameras (left, right): name one of a rig file",
        ),
        (["nothing.yaml"], 3, "no such file"),
        (["nothing.csv"], 3, "no such file"),
    ],
)
def test_what_cannot_be_advised_is_one_line_and_a_code(run, folder, monkeypatch, arguments, code, words):
    monkeypatch.chdir(folder)
    found, _, err = run("advise", *arguments)
    assert found == code
    assert words in err
    assert sum("camcal: error" in line for line in err.splitlines()) == 1


def test_another_board_is_held_where_it_fits(run, folder):
    code, out, _ = run("advise", str(folder / "camera.yaml"), "--board", "chessboard:11x8:100mm", "--views", "2")
    assert code == 0
    assert "distances: at which the board takes 40 to 85 % of the image" in out


def test_the_library_takes_files_their_content_and_calibrations(folder):
    report = camcal.calibrate_camera(folder / "seen.csv")
    by_file, by_content = camcal.advise_views(folder / "camera.yaml", 2), camcal.advise_views(report.file, 2)
    by_report = camcal.advise_views(report, 2)
    assert len(by_file.views) == 2
    stds = [each.views[-1].std_px for each in (by_file, by_content, by_report)]
    assert stds == pytest.approx([stds[0]] * 3, rel=1e-3)
