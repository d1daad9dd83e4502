"""The path from two folders to a point cloud, as docs/stereo.md shows it, for photographs and for drawn images."""

import csv
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from room_scene import BESIDE, RoomRig
from typer.main import get_command

from camcal.cli.main import app
from camcal.formats import boards, native, pointclouds
from camcal.geometry.pose import Pose

PAGE = Path(__file__).parents[2] / "docs" / "stereo.md"
SQUARE = 0.025  # m
pytestmark = pytest.mark.slow


def lines_of_the_path() -> list[str]:
    """Return the command lines of the first block of the page."""
    block = re.search(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [line.partition("  #")[0] for line in block[1].splitlines()]


def ran(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(line)
    assert words.pop(0) == "camcal"
    with pytest.raises(SystemExit) as leaving:
        get_command(app)(words)
    printed = capsys.readouterr()
    assert not leaving.value.code, f"{line}\n{printed.err}"


def followed(capsys: pytest.CaptureFixture[str]) -> np.ndarray:
    """Return the points (N, 3) of the cloud, m, after running the lines of the path in this folder."""
    for line in lines_of_the_path():
        ran(line, capsys)
    pairs = len(list(Path("left").iterdir()))
    assert len(list(Path("result/clouds").glob("*.ply"))) == len(list(Path("result/views").glob("*.html"))) == pairs
    cloud = pointclouds.read(Path("cloud.ply"))
    return np.column_stack([cloud.vertices[name] for name in "xyz"]).astype(float)


def off_their_plane(points: np.ndarray) -> float:
    """Return the median distance of points (N, 3) from the plane through those near their middle, m."""
    centred = points - np.median(points, axis=0)
    near = centred[np.linalg.norm(centred, axis=1) < 0.1]
    return float(np.median(np.abs(centred @ np.linalg.svd(near, full_matrices=False)[2][2])))


def test_the_path_has_six_lines():
    lines = lines_of_the_path()
    assert len(lines) == 6
    assert [" ".join(line.split()[1:3]) for line in lines[2:4]] == ["stereo disparity", "stereo cloud"]


def test_two_folders_become_clouds_of_a_room(tmp_path, monkeypatch, capsys, real_data):
    monkeypatch.chdir(tmp_path)
    for side in ("left", "right"):
        Path(side).mkdir()
        for path in sorted((real_data / "chessboard" / "opencv-left-right").glob(f"{side}[01]*.jpg"))[::3]:
            Path(side, path.name.removeprefix(side)).symlink_to(path)
    points = followed(capsys)
    rig = native.read("rig.yaml")
    assert np.linalg.norm(rig.transforms["right_T_left"].pose.translation) == pytest.approx(0.0832, abs=0.0015)
    near = points[(np.abs(points[:, 0] + 0.02) < 0.1) & (np.abs(points[:, 1] + 0.03) < 0.07) & (points[:, 2] < 0.6)]
    assert off_their_plane(near) < 0.005  # a board 0.4 m away is flat


def drawn(capsys: pytest.CaptureFixture[str]) -> tuple[np.ndarray, RoomRig]:
    """Return the middle (3,) of the board in the first left picture, m, after drawing ten pairs of it in a room."""
    Path("room").mkdir()
    room = RoomRig(Path("room"), "pinhole", BESIDE, scale=2.0)
    ran(f"camcal simulate chessboard:9x6:25mm {room.file} --views 10 --noise 0.5 -o drawn", capsys)
    file, board = native.read(room.file), boards.read(Path("drawn/board.yaml"))
    with Path("drawn/poses.csv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    table = {
        row["image"]: Pose.from_vector(*([float(row[f"{kind}{axis}"]) for axis in "xyz"] for kind in "rt"))
        for row in rows
    }
    width, height = board.extent
    sheet = np.array([(x, y, 0) for x in (-1.4, 1.4 + width / SQUARE) for y in (-1.4, 1.4 + height / SQUARE)]) * SQUARE
    for side in ("left", "right"):
        Path(side).mkdir()
        behind = cv2.imread(str(getattr(room, side)), cv2.IMREAD_GRAYSCALE)
        for number, path in enumerate(sorted(Path("drawn/images", side).iterdir()), 1):
            corners = file.cameras[side].camera.project(table[f"{side}/{path.name}"].apply(sheet)).pixels
            mask = cv2.fillConvexPoly(np.zeros_like(behind), cv2.convexHull(corners.astype(np.int32)), 1)
            picture = np.where(mask > 0, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), behind)
            cv2.imwrite(f"{side}/{number:02d}.jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 98])
    first = min(name for name in table if name.startswith("left/"))
    return table[first].apply(np.array([[width / 2, height / 2, 0.0]]))[0], room


def test_drawn_folders_become_clouds_with_the_board_where_it_was(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    middle, room = drawn(capsys)
    points = followed(capsys)
    truth = native.read(room.file).transforms["right_T_left"]
    pose = native.read("rig.yaml").transforms["right_T_left"].pose
    assert np.linalg.norm(pose.translation - truth.pose.translation) < 0.001
    board = points[np.linalg.norm(points - middle, axis=1) < 0.06]
    assert len(board) > 1000
    assert np.linalg.norm(np.median(board, axis=0) - middle) < 0.015  # the part of it that was matched
    assert off_their_plane(board) < 0.005
