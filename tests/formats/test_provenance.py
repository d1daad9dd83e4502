"""Provenance says where a result comes from, and the same work leaves the same bytes."""

import shlex

import pytest

import camcal
from camcal.errors import InvalidInput
from camcal.formats import documents, emit, provenance
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


def rig_image(number):
    """What a rig says of an image: nothing lists more of one."""
    pose = {"t": [0.1, 0.2, 0.3], "rotation_vector": [0.1, 0.2, 0.3]}
    return {
        "file": f"{number}.png",
        "sha256": "00ff",
        "used": number % 2 == 0,
        "points": 24,
        "rms_px": 0.1,
        "reason": "few corners",
        "camera": "left",
        "camera_T_board": pose,
    }


def test_as_many_images_are_listed_as_a_file_can_hold_and_of_more_there_are_totals():
    images = [rig_image(number) for number in range(5001)]
    block = provenance.build(["rig"], None, images[:5000])
    documents.parse(emit.document({"provenance": block}), "rig.yaml")
    assert len(block["images"]) == 5000
    assert provenance.image_counts(block) == (2500, 5000)
    short = provenance.build(["rig"], None, images)
    assert "images" not in short
    assert provenance.image_counts(short) == (2501, 5001)
    assert not list(provenance.check(short, "provenance"))


def test_totals_tell_other_images_apart():
    images = [rig_image(number) for number in range(5001)]
    other = [*images[:-1], images[-1] | {"sha256": "00fe"}]
    one, same, two = (provenance.build([], None, each)["image_totals"]["sha256"] for each in (images, images, other))
    assert one == same != two
