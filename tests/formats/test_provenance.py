"""Provenance says where a result comes from, and the same work leaves the same bytes."""

import shlex

import pytest

import camcal
from camcal.errors import InvalidInput
from camcal.formats import provenance
from camcal.targets.board import parse_board


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "a/", "--board", "b.yaml", "-o", "one.yaml", "--jobs", "1"],
        ["calibrate", "./a", "--board", "b.yaml", "--output=two.yaml", "-j", "2", "--json", "--quiet"],
        ["calibrate", "--jobs=7", "-v", "a//", "--board", "b.yaml", "--output", "three.yaml"],
    ],
)
def test_options_that_change_no_number_are_not_recorded(arguments):
    assert provenance.command(arguments) == "camcal calibrate a --board b.yaml"


def test_the_recorded_command_can_be_pasted_into_a_shell():
    line = provenance.command(["calibrate", "my images/a.png", "--board", "chessboard:9x6"])
    assert shlex.split(line) == ["camcal", "calibrate", "my images/a.png", "--board", "chessboard:9x6"]


def test_a_long_command_is_cut_in_the_middle():
    line = provenance.command(["calibrate", *[f"images/{i:04}.png" for i in range(400)], "--board", "b.yaml"])
    assert len(line) <= provenance.MAX_COMMAND + 3
    assert line.startswith("camcal calibrate images/0000.png")
    assert line.endswith("--board b.yaml")


def test_the_moment_is_recorded_only_if_the_environment_gives_it(monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert "created" not in provenance.build(["demo"], None)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert provenance.build(["demo"], None)["created"] == "1970-01-02T00:00:00Z"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InvalidInput, match="SOURCE_DATE_EPOCH: 'yesterday' is not a number"):
        provenance.build(["demo"], None)


def test_a_block_names_tool_libraries_board_and_images_and_passes_its_check():
    image = {"file": "a.png", "sha256": "00ff", "used": False, "points": 0, "reason": "no board found"}
    block = provenance.build(["calibrate"], parse_board("chessboard:9x6:25mm"), [image])
    assert (block["tool"], block["tool_version"]) == ("camcal", camcal.__version__)
    assert {"opencv", "numpy"} <= block["libraries"].keys()
    assert block["board"] == {"type": "chessboard", "inner_corners": [9, 6], "square_mm": 25.0}
    assert block["images"] == [image]
    assert not list(provenance.check(block, "provenance"))


def test_types_are_checked_but_further_keys_are_welcome():
    block = {"tool": 5, "operator": "night shift", "images": [{"file": "a.png", "used": "yes", "iso": 100}]}
    assert [fault.path for fault in provenance.check(block, "p")] == ["p.tool", "p.images[0].used"]
