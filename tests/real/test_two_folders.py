"""The path from two folders to a point cloud, as docs/stereo.md shows it, on real images of a board in a room."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from camcal.cli.main import app
from camcal.formats import native, pointclouds

PAGE = Path(__file__).parents[2] / "docs" / "stereo.md"
pytestmark = pytest.mark.slow


def lines_of_the_path() -> list[str]:
    """Return the command lines of the first block of the page."""
    block = re.search(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [line.partition("  #")[0] for line in block[1].splitlines()]


def test_the_path_has_six_lines():
    lines = lines_of_the_path()
    assert len(lines) == 6
    assert [" ".join(line.split()[1:3]) for line in lines[2:4]] == ["stereo disparity", "stereo cloud"]


def test_two_folders_become_clouds_of_a_room(tmp_path, monkeypatch, capsys, real_data):
    monkeypatch.chdir(tmp_path)
    for side in ("left", "right"):
        Path(side).mkdir()
        for path in sorted((real_data / "chessboard" / "opencv-left-right").glob(f"{side}[01]*.jpg")):
            Path(side, path.name.removeprefix(side)).symlink_to(path)
    command = get_command(app)
    for line in lines_of_the_path():
        words = shlex.split(line)
        assert words.pop(0) == "camcal"
        with pytest.raises(SystemExit) as leaving:
            command(words)
        printed = capsys.readouterr()
        assert not leaving.value.code, f"{line}\n{printed.err}"
    rig = native.read("rig.yaml")
    assert np.linalg.norm(rig.transforms["right_T_left"].pose.translation) == pytest.approx(0.0832, abs=0.0015)
    cloud = pointclouds.read(Path("cloud.ply"))
    board = np.column_stack([cloud.vertices[name] for name in "xyz"]).astype(float)
    near = board[(np.abs(board[:, 0] + 0.02) < 0.1) & (np.abs(board[:, 1] + 0.03) < 0.07) & (board[:, 2] < 0.6)]
    centred = near - np.median(near, axis=0)
    normal = np.linalg.svd(centred[np.linalg.norm(centred, axis=1) < 0.1], full_matrices=False)[2][2]
    assert np.median(np.abs(centred @ normal)) < 0.005  # a board 0.4 m away is flat
    assert len(list(Path("result/clouds").glob("*.ply"))) == len(list(Path("left").iterdir()))
    assert len(list(Path("result/views").glob("*.html"))) == len(list(Path("left").iterdir()))
