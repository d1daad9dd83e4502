"""What reaches stdout and stderr."""

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from camcal.cli import progress_bar, show
from camcal.cli.progress_bar import pace
from camcal.messages import Message


def test_a_document_is_plain_json_with_its_schema_first(capsys):
    payload = {
        "number": np.float64(1 / 3),
        "matrix": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "path": Path("a") / "b",
        "pair": (1, None),
        "flag": True,
    }
    show.document("stereo cloud", payload)
    out = capsys.readouterr().out
    assert out.startswith('{\n  "schema": "camcal/stereo-cloud/1"')
    assert json.loads(out) == {
        "schema": "camcal/stereo-cloud/1",
        "number": 0.333333333333,
        "matrix": [[1.0, None], [None, 2.0]],
        "path": str(Path("a") / "b"),
        "pair": [1, None],
        "flag": True,
    }


def test_a_table_aligns_numbers_to_the_right_and_text_to_the_left(capsys):
    show.table("Values", ["name", "value", "± std"], [["fx", 1234.56789, 0.25], ["k1", -0.1, None]])
    assert capsys.readouterr().out.splitlines() == [
        "Values",
        "  name   value  ± std",
        "  fx    1235     0.25",
        "  k1      -0.1   -",
    ]


def test_a_table_without_rows_shows_its_columns(capsys):
    show.table("Nothing", ["name", "value"], [])
    assert capsys.readouterr().out == "Nothing\n  name  value\n"


def test_a_warning_has_a_line_for_each_of_its_lines(capsys):
    progress = show.progress(quiet=True)
    progress.start("work", 2)
    progress.warn("one\ntwo")
    progress.finish()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "camcal: warning: one\ncamcal: warning: two\n"


def test_a_bar_is_drawn_on_a_terminal_only(capsys, monkeypatch):
    assert work_with(show.progress(quiet=False), capsys) == "camcal: warning: careful [b]\n"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    drawn = work_with(show.progress(quiet=False), capsys)
    assert "detect" in drawn
    assert "3/3" in drawn
    assert "camcal: warning: careful [b]" in drawn
    assert work_with(show.progress(quiet=True), capsys) == "camcal: warning: careful [b]\n"


@pytest.mark.parametrize(
    ("speed", "left_s", "words"),
    [
        (None, None, ""),
        (123.4, 3.2, "123/s, 0:00:03 left"),
        (0.25, 3600, "4 s each, 1:00:00 left"),
        (16.0, None, "16/s"),  # nobody knows how many frames a video has
    ],
)
def test_a_bar_says_how_fast_the_work_is_and_how_long_it_takes(speed, left_s, words):
    assert pace(speed, left_s) == words


def test_the_rate_is_drawn_beside_the_bar(capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr(progress_bar, "_REDRAW_S", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    progress = show.progress(quiet=False)
    progress.start("detect", 9)
    for _ in range(3):
        time.sleep(0.01)
        progress.advance()
    progress.finish()
    assert re.search(r"3/9\x1b\[0m \d+\.?\d*/s, 0:00:0\d left", capsys.readouterr().err)


def work_with(progress, capsys) -> str:
    progress.start("detect", 3)
    progress.warn("careful [b]")
    progress.advance(3)
    progress.finish()
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


GOOD, BAD, END = "\x1b[1;32m", "\x1b[1;31m", "\x1b[0m"


def said(capsys):
    show.text("fx 458.65 ± 0.41 px and many words more")
    show.verdict(show.TRUSTWORTHY, good=True)
    show.verdict("DO NOT TRUST: few views", good=False)
    return capsys.readouterr().out.splitlines()


def test_verdicts_stand_out_and_lines_end_at_words_on_a_terminal_only(capsys, monkeypatch):
    plain = ["fx 458.65 ± 0.41 px and many words more", "Calibration is trustworthy", "DO NOT TRUST: few views"]
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert said(capsys) == plain
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert said(capsys) == [plain[0], f"{GOOD}Calibration is trustworthy{END}", f"{BAD}DO NOT TRUST: few views{END}"]
    show.text("one two three four five six seven eight nine")
    assert capsys.readouterr().out == "one two three four five six seven eight\n  nine\n"
    show.document("fit", {"text": "word " * 20})
    assert len(max(capsys.readouterr().out.splitlines(), key=len)) > 100
    for name, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
        with monkeypatch.context() as changed:
            changed.setenv(name, value)
            assert said(capsys) == plain


def test_one_line_says_what_was_written(capsys):
    images = [Path("out") / f"{number}.png" for number in range(20)]
    show.wrote(Path("camera.yaml"), None, show.several(images, "image"))
    show.wrote(Path("a"), Path("b"), Path("c"))
    show.wrote(show.several(images[:1], "image"))
    show.wrote(None, show.several([], "image"))
    show.wrote(show.several([Path(side) / path.name for side in ("left", "right") for path in images], "image"))
    show.wrote(show.several([Path("left/a.png"), Path("right/a.png")], "image"))
    assert capsys.readouterr().out.splitlines() == [
        "wrote camera.yaml and 20 images to out/",
        "wrote a, b and c",
        "wrote out/0.png",
        "wrote 40 images to left/, right/",
        "wrote left/a.png, right/a.png",
    ]
    show.wrote(Path("-"))
    assert capsys.readouterr().out == ""


def test_an_error_ends_at_words_on_a_terminal_and_is_one_line_in_a_pipe(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    show.error("left.yaml:9: cameras.left.distorsion: unknown key")
    assert capsys.readouterr().err == "camcal: error: left.yaml:9: cameras.left.distorsion: unknown key\n"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    show.error("left.yaml:9: cameras.left.distorsion: unknown key")
    assert capsys.readouterr().err == ("camcal: error: left.yaml:9:\n  cameras.left.distorsion: unknown key\n")


def test_a_long_line_is_whole_and_an_endless_one_ends_at_a_word(capsys):
    show.error("word " * 300 + "end")
    assert capsys.readouterr().err == f"camcal: error: {'word ' * 300}end\n"
    show.error("word " * 3000)
    long = capsys.readouterr().err
    assert 3900 < len(long) < 4100
    assert long.endswith("word …\n")
    show.error("x" * 9000)
    assert len(capsys.readouterr().err) < 4100


def test_a_long_quotation_of_a_file_is_shortened_and_what_is_said_of_it_is_not(capsys):
    show.error(f"a.csv:1: unknown column '{'- ' * 1000}'. Did you mean 'x'? {'words ' * 100}")
    said = capsys.readouterr().err
    assert f"'{'- ' * 50} …'. Did you mean 'x'? {'words ' * 100}".strip() in said


def test_a_figure_is_drawn_on_a_terminal_only(capsys, monkeypatch):
    def draw(width, encoding):
        return [f"{width} {encoding}"]

    monkeypatch.setenv("COLUMNS", "72")
    show.figure(draw)
    assert capsys.readouterr().out == ""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    show.figure(draw)
    assert capsys.readouterr().out == "72 UTF-8\n"


def test_a_verdict_is_a_sentence_and_a_calibration_has_one_or_its_failures(capsys):
    show.verdict("  rows agree", good=True)
    show.trust([])
    show.trust(["few views", "no tilt"])
    assert capsys.readouterr().out.splitlines() == [
        "  Rows agree",
        "Calibration is trustworthy",
        "DO NOT TRUST: few views",
        "DO NOT TRUST: no tilt",
    ]


def test_a_command_warns_of_one_thing_once(capsys):
    with show.session() as session:
        for code, text in (("few_views", "2 views"), ("few_views", "2 views"), ("few_views", "3 views")):
            show.progress(quiet=True).warn(Message(code, text))
    assert capsys.readouterr().err == "camcal: warning: 2 views\ncamcal: warning: 3 views\n"
    assert [message.text for message in session.warnings] == ["2 views", "3 views"]
