"""`camcal rig` with several boards: files that hold them, what is refused, and what `inspect` makes of the result."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from body_pictures import picture, tagged_faces
from body_scenes import BodyScene, captures_of, cube, two_sides

from camcal.formats import boards, detections, native
from camcal.geometry import rotation as so3
from camcal.targets.board_set import BoardSet
from camcal.targets.detection import Detections

QUICK = ("--model", "opencv5", "--flat-board", "--no-free-corners", "--match", "name")
A, B = "a=chessboard:9x6:50mm", "b=chessboard:8x5:50mm"


def write_table(path: Path, scene: BodyScene, shows=lambda camera, board, moment: True) -> Path:
    rows = captures_of(scene, shows=shows).views
    views = [view for row in rows for view in row if view is not None]
    detections.write(path, Detections(scene.together, tuple(views)))
    return path


@pytest.fixture(scope="module")
def panel(tmp_path_factory) -> Path:
    """Corners that a camera on each side of a panel sees, each of the board on its side."""
    return write_table(tmp_path_factory.mktemp("panel") / "panel.csv", two_sides(1, 14, per_side=1))


def refused(run, *arguments) -> tuple[int, str]:
    """Return the exit code and the last line on stderr; nothing else may be an error."""
    code, out, err = run("rig", *arguments)
    assert out == ""
    lines = [line for line in err.splitlines() if "warning" not in line]
    assert len(lines) == 1, lines
    return code, lines[0].removeprefix("camcal: error: ")


def test_a_table_of_several_boards_is_read_as_it_is_written(tmp_path, panel):
    found = detections.read(panel)
    assert isinstance(found.board, BoardSet)
    assert found.board.names == ("a", "b")
    assert {(view.camera, view.body) for view in found.views} == {("north0", "a"), ("south0", "b")}
    assert min(view.ids.min() for view in found.views if view.body == "b") >= 54
    detections.write(tmp_path / "again.csv", found)
    assert (tmp_path / "again.csv").read_bytes() == panel.read_bytes()


def test_a_file_of_several_boards_is_read_as_it_is_written(tmp_path, panel):
    board = detections.read(panel).board
    boards.write(tmp_path / "boards.yaml", board)
    assert boards.load_board(str(tmp_path / "boards.yaml")) == board


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("board:b=", "board:x=", r"panel.csv:\d+: board 'b' is none of a, x"),
        ("north0,a\n", "north0,A\n", "panel.csv:3: board 'A' is none of a, b"),
        (",960,53,", ",960,54,", r"panel.csv:\d+: id 54: board a has the ids 0 to 53"),
    ],
)
def test_a_wrong_board_in_a_table_is_told_with_its_line(run, tmp_path, panel, old, new, line):
    text = panel.read_text()
    assert old in text
    (tmp_path / "panel.csv").write_text(text.replace(old, new))
    code, told = refused(run, tmp_path / "panel.csv", "-o", tmp_path / "rig.yaml", *QUICK)
    assert code == 2
    assert re.search(line, told)


@pytest.mark.parametrize(
    ("given", "code", "told"),
    [
        (("--board", A, "--board", "c=chessboard:8x5:50mm"), 2, "the points are those of another board"),
        (("--board", A, "--board", "chessboard:8x5:50mm"), 2, "several boards need names: --board a=BOARD"),
        (("--board", A, "--board", "a=chessboard:8x5:50mm"), 2, "--board: the name 'a' is given twice"),
        (("--board", A, "--board", "a_T_b=chessboard:8x5:50mm"), 2, "'a_T_b' is not a valid name of a board"),
        (("--board", "a=aprilgrid:6x6:8mm:0.3", "--board", "b=aprilgrid:6x6:6mm:0.3"), 2, "cannot be told apart"),
        (("--board", A, "--board", "b=chessboard:8x6:50mm"), 2, "looks the same when it is turned"),
        (("--board", A, "--board", "b=none.yaml"), 3, "none.yaml: no such file"),
        (("--joined", "a,c"), 2, "--joined: no board 'c'"),
        (("--joined", "a,b", "--joined", "b"), 2, "--joined: board 'b' is named twice"),
        (("--joined", "none"), 4, "nothing links the cameras north0, south0"),
        (("--joined", "none", "--distance", "a.0:b.1=1m±1mm"), 2, "the boards are not joined, see --joined"),
        (("--distance", "12:40=1.503m±2mm"), 2, "a board is missing before its number"),
        (("--distance", "a.0:c.1=1m±1mm"), 2, "no board 'c'; possible here: a, b"),
        (("--distance", "a.0:b.40=1m±1mm"), 2, "no point '40': board b has the points 0 to 39"),
        (("--distance", "a.0:b.-1=1m±1mm"), 2, "no point '-1'"),
        (("--distance", "a.0:b.1=1.5"), 2, "is not of the form POINT:POINT=LENGTH±STD"),
        (("--distance", "a.0:b.1=1.5±1mm"), 2, "'1.5' is not a length with its unit"),
        (("--distance", "a.0:a.0=1m±1mm"), 2, "needs two points"),
        (("--distance", "a.0:b.1=1m±0mm"), 2, "a positive length and standard deviation"),
        (("--motion",), 2, "--motion is of one board"),
        (("--distance", "a.0:a.53=0.55m±1mm"), 4, "--distance a.0:a.53=0.55m±1mm: contradicts the captures"),
    ],
)
def test_what_is_wrong_with_boards_is_one_clear_line(run, tmp_path, panel, given, code, told):
    found, line = refused(run, panel, "-o", tmp_path / "rig.yaml", *QUICK, *given)
    assert (found, told in line) == (code, True), line
    assert not (tmp_path / "rig.yaml").exists()


def test_a_board_with_the_name_of_a_camera_is_refused(run, tmp_path, panel):
    path = tmp_path / "same.csv"
    path.write_text(panel.read_text().replace("board:a=", "board:north0=").replace(",a\n", ",north0\n"))
    code, line = refused(run, path, "-o", tmp_path / "rig.yaml", *QUICK)
    assert (code, line) == (2, "--board: 'north0' is the name of a camera as well; use another one")


def test_the_file_holds_the_boards_and_inspect_tells_the_path_between_cameras(run, tmp_path, panel):
    code, out, _ = run("rig", panel, "-o", tmp_path / "rig.yaml", *QUICK)
    assert code == 0
    assert "a_T_b" in out
    file = native.read(tmp_path / "rig.yaml")
    assert list(file.transforms) == ["south0_T_north0", "a_T_b"]
    assert list(file.boards) == ["a", "b"]
    assert {f"a_T_b.{axis}" for axis in ("tx", "rz")} < set(file.joint_covariance.names)
    images = file.provenance["images"]
    assert {(image["camera"], image["board"]) for image in images} == {("north0", "a"), ("south0", "b")}
    code, out, _ = run("inspect", tmp_path / "rig.yaml")
    assert code == 0
    assert "most certain path: north0 – south0 by a and b (1" in out
    code, out, _ = run("inspect", tmp_path / "rig.yaml", "--json")
    [pair] = json.loads(out)["rig"]["pairs"]
    [link] = pair["path"]
    assert (link["cameras"], link["boards"]) == (["north0", "south0"], ["a", "b"])
    assert 0 < link["std_m"] < 0.05


def test_a_rig_file_gives_the_relation_of_its_boards_to_another_rig(run, tmp_path, panel):
    assert run("rig", panel, "-o", tmp_path / "rig.yaml", *QUICK)[0] == 0
    axis = write_table(tmp_path / "axis.csv", two_sides(1, 14, turns=(0.5, 0.0, 0.0), per_side=1))
    code, line = refused(run, axis, "-o", tmp_path / "other.yaml", *QUICK)
    assert code == 4
    assert "turn about one axis" in line
    given = ("--board-poses", tmp_path / "rig.yaml")
    code, out, _ = run("rig", axis, "-o", tmp_path / "other.yaml", *QUICK, *given, "--json")
    assert code == 0
    found = json.loads(out)
    # the boards stand alike in both scenes; to a few of the standard deviations that the file gives
    before = native.read(tmp_path / "rig.yaml").transforms["a_T_b"]
    apart = np.array(found["transforms"]["a_T_b"]["t"]) - before.pose.translation
    assert (np.abs(apart) < 4 * np.sqrt(np.diag(before.covariance))[:3]).all()
    nothing = replace(native.read(tmp_path / "rig.yaml"), transforms={}, joint_covariance=None)
    native.write(tmp_path / "lenses.yaml", nothing)
    code, line = refused(run, axis, "-o", tmp_path / "x.yaml", *QUICK, "--board-poses", tmp_path / "lenses.yaml")
    assert code in (2, 3)


@pytest.mark.parametrize(("share", "code"), [(0.005, 0), (0.035, 0), (0.07, 4)])
def test_a_distance_sets_the_scale_of_a_single_board(run, tmp_path, share, code):
    from test_rig_command import BOARD, LEFT, RIGHT, RIGHT_T_LEFT

    from camcal.simulate.scene import observe, views

    rng = np.random.default_rng(1)
    placed = views(LEFT, BOARD, 12, rng=rng)
    seen = [
        replace(view, camera=name, image=f"{name}/{index:02}.png")
        for name, camera, poses in (("left", LEFT, placed), ("right", RIGHT, [RIGHT_T_LEFT @ own for own in placed]))
        for index, view in enumerate(observe(camera, BOARD, poses, rng=rng, noise_px=0.1)[0].views)
    ]
    detections.write(tmp_path / "corners.csv", Detections(BOARD, tuple(seen)))
    # the board is 6 squares of 40 mm wide and drawn to 1 %: a distance on it may say up to 4.5 % else
    quick = ("--model", "opencv4", "--flat-board", "--no-free-corners", "--json")
    given = ("--distance", f"0:6={240 * (1 + share):.4f}mm±0.05mm")
    found, out, _ = run("rig", tmp_path / "corners.csv", "-o", tmp_path / "rig.yaml", *quick, *given)
    assert found == code
    said = json.loads(out)
    if code:
        assert "contradicts the captures" in said["error"]["message"]
        return
    assert said["scales"]["board"]["scale"] == pytest.approx(1 + share, abs=4 * 0.05 / 240)
    assert said["scales"]["board"]["std"] == pytest.approx(0.05 / 240, rel=0.2)
    baseline = said["transforms"]["right_T_left"]
    assert baseline["baseline_m"] == pytest.approx((1 + share) * 0.120083, abs=5 * baseline["baseline_std_m"])


def test_boards_of_a_table_that_are_seen_in_no_image_are_named(run, tmp_path, panel):
    text = panel.read_text().replace("board:b=", "board:c=chessboard:7x4:50mm board:b=", 1)
    (tmp_path / "more.csv").write_text(text)
    code, line = refused(run, tmp_path / "more.csv", "-o", tmp_path / "rig.yaml", *QUICK)
    assert (code, line) == (4, "board c: no image of any camera shows it")


@pytest.mark.slow
def test_images_of_a_cube_with_tags_calibrate_cameras_and_faces(run, tmp_path):
    scene = cube(1, 7, 2, tagged_faces(3))
    for name in scene.cameras:
        for moment in range(7):
            picture(scene, name, moment, tmp_path)
    boards.write(tmp_path / "cube.yaml", scene.together)
    cameras = [f"{name}={tmp_path / name}" for name in scene.cameras]
    command = ("rig", *cameras, "--board", tmp_path / "cube.yaml", "-o", tmp_path / "rig.yaml", *QUICK[:4], "--json")
    code, out, _ = run(*command, "--save-detections", tmp_path / "corners.csv")
    assert code == 0
    transforms = json.loads(out)["transforms"]
    assert list(transforms) == ["c1_T_c0", "f0_T_f1", "f0_T_f2"]
    for name, found in transforms.items():
        target, source = name.split("_T_")
        truth = scene.relative("c1") if target == "c1" else np.linalg.inv(scene.on_body[target]) @ scene.on_body[source]
        step = np.concatenate([np.array(found["t"]) - truth[:3, 3], so3.log(np.array(found["R"]) @ truth[:3, :3].T)])
        # χ² of six numbers exceeds 24 in one of 2000 cases
        assert step @ np.linalg.solve(np.array(found["covariance"]), step) < 24, name
    assert {view.body for view in detections.read(tmp_path / "corners.csv").views if view.found} == {"f0", "f1", "f2"}
