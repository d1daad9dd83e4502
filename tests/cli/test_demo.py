"""`camcal demo`: the main job from end to end, and a folder that explains itself."""

import io
import json
import re
import shlex
import shutil
from contextlib import redirect_stdout

import pytest

from camcal.cli.main import app
from camcal.formats import detections, native

VIEWS = 8


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """The folder that a short demonstration leaves, and the document it prints."""
    folder = tmp_path_factory.mktemp("demo") / "left"
    with redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit) as leaving:
        app(["demo", "-o", str(folder), "--views", str(VIEWS), "--json"])
    assert not leaving.value.code
    return folder, json.loads(printed.getvalue())


@pytest.mark.slow
def test_truth_is_recovered_within_its_standard_deviations(left):
    _, document = left
    assert document["trustworthy"]
    assert document["views_used"] == VIEWS
    names = [row["name"] for row in document["compared"]]
    assert names == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "bend of the board, mm"]
    for row in document["compared"]:
        assert abs(row["sigmas"]) < 5, row  # 10 numbers, and the detector's own bias beside the noise


@pytest.mark.slow
def test_the_document_is_frozen(left):
    _, document = left
    assert list(document) == [
        "schema",
        "output",
        "images",
        "views_used",
        "rms_px",
        "sigma_px",
        "trustworthy",
        "compared",
        "warnings",
    ]
    assert document["schema"] == "camcal/demo/1"


@pytest.mark.slow
def test_every_file_that_is_left_is_explained(left):
    folder, _ = left
    explained = set(re.findall(r"^(\S+?)/?  ", (folder / "README.txt").read_text(), re.MULTILINE))
    found = {path.name for path in folder.iterdir()} - {"README.txt", ".camcal-output"}
    assert found == explained


@pytest.mark.slow
def test_the_files_are_what_they_are_said_to_be(left):
    folder, _ = left
    assert native.read(folder / "camera.yaml").cameras["camera"].camera.covariance is not None
    assert native.read(folder / "truth.yaml").board_shape.deflection > 1e-3
    assert len(detections.read(folder / "detections.csv").views) == VIEWS
    assert [path.name for path in (folder / "undistorted").glob("*.png")] == ["view0000.png"]


@pytest.mark.slow
def test_the_commands_it_proposes_work(left, run, monkeypatch, tmp_path):
    folder = shutil.copytree(left[0], tmp_path / "copy")
    monkeypatch.chdir(folder)
    commands = [line for line in (folder / "README.txt").read_text().splitlines() if line.startswith("camcal ")]
    quick = [shlex.split(re.split(r"   +", line)[0])[1:] for line in commands if "inspect" in line or "again" in line]
    assert len(quick) == 4
    for arguments in quick:
        code, _, err = run(*arguments)
        assert code == 0, (arguments, err)


def test_a_folder_of_something_else_is_left_alone(run, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    code, _, err = run("demo", "-o", tmp_path)
    assert code == 2
    assert "choose another folder" in err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
