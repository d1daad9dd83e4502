"""`camcal board`: what it writes, what it says, and what it refuses."""

import json

import pytest

from camcal.formats import boards
from camcal.targets.board import parse_board

CHESSBOARD = "chessboard:9x6:25mm"


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".png"])
def test_a_drawing_and_its_board_file_are_written(run, tmp_path, suffix):
    output = tmp_path / f"target{suffix}"
    code, out, err = run("board", CHESSBOARD, "-o", output)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "chessboard of 9x6 inner corners, 250 x 175 mm, on A4 landscape (297 x 210 mm)"
    assert "print at 100 % (actual size), then measure the ruler" in lines
    assert f"wrote {output} and {tmp_path}/target.yaml" in lines
    assert boards.read(tmp_path / "target.yaml") == parse_board(CHESSBOARD)
    assert {path.name for path in tmp_path.iterdir()} == {".camcal-output", f"target{suffix}", "target.yaml"}


def test_json_is_one_document_with_its_schema_first(run, tmp_path):
    code, out, _ = run("board", CHESSBOARD, "-o", tmp_path / "a.png", "--dpi", 300, "--paper", "a3", "--json")
    told = json.loads(out)
    assert code == 0
    assert list(told) == [
        "schema", "output", "board_file", "kalibr_file", "board", "paper", "margin_mm", "board_mm", "white_border_mm",
        "ruler_mm", "dpi", "pixels", "warnings",
    ]  # fmt: skip
    assert told["schema"] == "camcal/board/1"
    assert told["board"] == {"type": "chessboard", "inner_corners": [9, 6], "square_mm": 25}
    assert told["paper"] == {"name": "A3", "width_mm": 420, "height_mm": 297, "landscape": True}
    assert (told["board_mm"], told["white_border_mm"]) == ([250, 175], 6.25)
    assert (told["dpi"], told["pixels"]) == (300, [4961, 3508])


def test_the_page_says_what_is_on_it(run, tmp_path):
    run("board", "charuco:5x7:35mm:26mm:DICT_5X5_100:legacy", "-o", tmp_path / "a.svg")
    run("board", "aprilgrid:4x3:40mm:0.3", "-o", tmp_path / "b.svg", "--no-ruler")
    charuco, aprilgrid = ((tmp_path / name).read_text() for name in ("a.svg", "b.svg"))
    assert "ChArUco board of 5x7 squares, squares of 35 mm, markers of 26 mm, DICT_5X5_100" in charuco
    assert "charuco:5x7:35mm:26mm:DICT_5X5_100:legacy" in charuco
    assert "the ruler is 100 mm long" in charuco
    assert "AprilGrid of 4x3 tags, tags of 40 mm, 52 mm from tag to tag, tag36h11" in aprilgrid
    assert "ruler" not in aprilgrid


def test_kalibr_gets_its_own_file(run, tmp_path):
    target = tmp_path / "kalibr.yaml"
    code, out, _ = run("board", "aprilgrid:4x3:40mm:0.3", "-o", tmp_path / "a.pdf", "--kalibr", target)
    assert code == 0
    assert f" and {target}\n" in out
    assert "target_type: aprilgrid" in target.read_text()
    assert boards.read(target) == boards.read(tmp_path / "a.yaml") == parse_board("aprilgrid:4x3:40mm:0.3")


def test_a_file_that_is_no_target_of_kalibr_is_kept(run, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("type: aprilgrid\ntags: [4, 3]\ntag_mm: 40\nspacing_ratio: 0.3\n")
    code, _, err = run("board", mine, "-o", tmp_path / "a.pdf", "--kalibr", mine)
    assert (code, sorted(path.name for path in tmp_path.iterdir())) == (2, ["mine.yaml"])
    assert err == f"camcal: error: {mine}: is an input and is not overwritten; choose another output\n"


def test_a_board_file_is_drawn_and_kept(run, tmp_path):
    source = tmp_path / "mine.yaml"
    source.write_text("# mine\ntype: circles\ncircles: [7, 6]\npitch_mm: 25\ndiameter_mm: 15\n")
    code, _, err = run("board", source, "-o", tmp_path / "mine.pdf")
    assert (code, err) == (0, "")
    assert source.read_text().startswith("# mine\n")


def test_a_charuco_board_that_does_not_say_is_printed_in_the_current_pattern_and_says_so_then(run, tmp_path):
    source = tmp_path / "mine.yaml"
    source.write_text("type: charuco\nsquares: [5, 7]\nsquare_mm: 35\nmarker_mm: 26\ndictionary: DICT_5X5_100\n")
    assert run("board", source, "-o", tmp_path / "mine.pdf")[0] == 0
    assert run("board", source, "-o", tmp_path / "other.pdf")[0] == 0
    assert boards.read(source).legacy is None
    assert boards.read(tmp_path / "other.yaml").legacy is False


def test_a_second_run_leaves_the_same_bytes(run, tmp_path, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    output = tmp_path / "target.pdf"
    kept = []
    for _ in range(2):
        assert run("board", CHESSBOARD, "-o", output)[0] == 0
        kept.append(output.read_bytes())
    assert kept[0] == kept[1]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")
    run("board", CHESSBOARD, "-o", output)
    assert b"/CreationDate (D:20260101000000Z)" in output.read_bytes()


def test_the_board_file_of_another_board_is_kept(run, tmp_path):
    run("board", CHESSBOARD, "-o", tmp_path / "target.pdf")
    code, _, err = run("board", "chessboard:9x6:20mm", "-o", tmp_path / "target.svg")
    assert code == 2
    assert err == (
        f"camcal: error: {tmp_path}/target.yaml: describes another board and is not replaced; choose another output\n"
    )
    assert not (tmp_path / "target.svg").exists()
    (tmp_path / "notes.yaml").write_text("milk: 2\n")
    code, _, err = run("board", CHESSBOARD, "-o", tmp_path / "notes.pdf")
    assert (code, (tmp_path / "notes.yaml").read_text()) == (2, "milk: 2\n")
    assert "is not a board file and is not replaced; choose another output" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((CHESSBOARD, "-o", "a.jpg"), "a.jpg: .jpg is not written; use .pdf, .svg, .png"),
        ((CHESSBOARD, "-o", "a"), "a: a name without a suffix is not written; use .pdf, .svg, .png"),
        (("chessboard:9x6", "-o", "a.pdf"), "has no size for printing; give it as in chessboard:9x6"),
        ((CHESSBOARD, "-o", "a.pdf", "--paper", "B5"), "paper 'B5' is unknown; use A4, A3"),
        ((CHESSBOARD, "-o", "a.pdf", "--portrait", "--paper", "A4"), "use --paper A3, or 19 mm in place of 25 mm"),
        ((CHESSBOARD, "-o", "a.pdf", "--paper", "90x90"), "is too narrow for a ruler of 100 mm: use --no-ruler"),
        (("chessboard:9x6:300mm", "-o", "a.pdf"), "use --paper 3160x2265mm, or 110.1 mm in place of 300 mm"),
        ((CHESSBOARD, "-o", "a.pdf", "--margin", "-1"), "a margin of -1 mm: use 0 to 1000"),
        ((CHESSBOARD, "-o", "a.pdf", "--dpi", "300"), "--dpi is for .png"),
        ((CHESSBOARD, "-o", "a.png", "--dpi", "nan"), "Invalid value for '--dpi': nan is not a number"),
        ((CHESSBOARD, "-o", "a.png", "--dpi", "3"), "it takes 4: use 5 dpi or more"),
        ((CHESSBOARD, "-o", "a.png", "--dpi", "9999"), "at most 400 million"),
        (("charuco:5x7:35mm:26mm:DICT_5X5_100", "-o", "a.pdf", "--kalibr", "k.yaml"), "Kalibr does not support"),
        ((CHESSBOARD, "-o", "a.pdf", "--kalibr", "a.yaml"), "is another output; choose another name"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_one_line_and_exit_two_and_nothing_is_written(
    run, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    code, _, err = run("board", *arguments)
    assert code == 2
    assert message in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_board_file_that_is_not_there_is_exit_three(run, tmp_path):
    code, _, err = run("board", tmp_path / "none.yaml", "-o", tmp_path / "a.pdf")
    assert (code, err.count("\n")) == (3, 1)


def test_a_folder_that_cannot_be_made_is_exit_three(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("board", CHESSBOARD, "-o", tmp_path / "file" / "a.pdf")
    assert (code, err.count("\n")) == (3, 1)


def test_quiet_prints_nothing(run, tmp_path):
    assert run("board", CHESSBOARD, "-o", tmp_path / "a.pdf", "--quiet") == (0, "", "")
