"""Tables and lines for a width: columns that are left out, names of files, and nothing broken."""

from hypothesis import given
from hypothesis import strategies as st

from camcal.report.table import Column, cells, short_names, shortened, table_lines, wrapped

NUMBERS = st.one_of(st.none(), st.integers(), st.floats(), st.sampled_from(["12.5", "-1.234e-300", "1e+300", "fixed"]))
NAMES = st.one_of(st.text("ab/写é ", min_size=1, max_size=120), st.sampled_from(["a/x.png", "b/x.png", "x.png"]))
POSES = [Column("image", file=True), Column("points", priority=2), Column("x y z", "mm"), Column("± std", priority=1)]
ROWS = [["a/1.png", 54, "1.25 -3.5 700.125", "0.12 0.12 0.31"], ["b/1.png", 9, "11.25 -3.5 700.125", "0.1 0.1 0.3"]]


@given(st.data(), st.integers(40, 200), st.booleans())
def test_no_line_is_wider_and_no_number_is_broken(data, width, in_full):
    priorities = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=12))
    columns = [Column("name", file=True)]
    columns += [Column(f"figure {place}", "px", priority=priority) for place, priority in enumerate(priorities)]
    rows = data.draw(st.lists(st.tuples(NAMES, *[NUMBERS] * len(priorities)), max_size=4))
    lines = table_lines(columns, rows, width, in_full=in_full)
    alone = {f"  {row[0]}" for row in rows} if in_full else set()  # a path that is too long has a line of its own
    assert [line for line in lines if cells(line) > width and line not in alone] == []
    left_out = next((place for place, line in enumerate(lines) if "not shown: " in line), len(lines))
    known = {word for row in table_lines(columns, rows, 10_000, in_full=in_full) for word in row.split()}
    shown = {word for line in lines[:left_out] for word in line.split()}
    assert {word for word in shown - known if "…" not in word} == set()
    assert not in_full or shown == known


def test_columns_go_by_their_priority_and_are_named():
    assert table_lines(POSES, ROWS, 60)[0].split() == ["image", "points", "x", "y", "z,", "mm", "±", "std"]
    assert table_lines(POSES, ROWS, 50) == [
        "  image    x y z, mm           ± std",
        "  a/1.png  1.25 -3.5 700.125   0.12 0.12 0.31",
        "  b/1.png  11.25 -3.5 700.125  0.1 0.1 0.3",
        "  not shown: points (--verbose or a wider terminal",
        "    shows all columns)",
    ]
    narrow = table_lines(POSES, ROWS, 40)
    assert narrow[0].split() == ["image", "x", "y", "z,", "mm"]
    assert " ".join(narrow[3:]).split()[:5] == ["not", "shown:", "points;", "±", "std"]


def test_in_full_all_columns_and_whole_paths_are_shown_in_blocks():
    lines = table_lines(POSES, [["/data/session/a/1.png", *ROWS[0][1:]]], 60, in_full=True)
    assert [line.split()[0] for line in lines] == ["image", "/data/session/a/1.png"] * 2
    assert "54" in lines[1]
    assert "0.12 0.12 0.31" in lines[3]
    own = table_lines(POSES, [["/data/" + "x" * 60, *ROWS[0][1:]]], 60, in_full=True)
    assert own[2] == "  /data/" + "x" * 60
    assert own[3].split() == ["54", "1.25", "-3.5", "700.125", "0.12", "0.12", "0.31"]


def test_decimal_points_stand_above_each_other_and_heads_take_several_lines():
    lines = table_lines([Column(), Column("a long head", "px")], [["fx", "458.65"], ["k1", "-0.2834"], ["n", 3]], 40)
    assert lines == ["      a long head, px", "  fx         458.65", "  k1          -0.2834", "  n            3"]
    narrow = table_lines([Column("head of two lines")] * 4, [[1] * 4], 40)
    assert [line.split() for line in narrow] == [["head", "of"] * 4, ["two"] * 4, ["lines"] * 4, ["1"] * 4]
    assert len({len(line) for line in narrow}) == 1  # numbers and their heads end in the same cell


def test_sentences_take_several_lines_of_their_column():
    columns = [Column("image", file=True), Column("reason", wraps=True)]
    lines = table_lines(columns, [["x.png", "differs from the majority, 640x480: 2 px off"]], 40)
    assert lines == ["  image  reason", "  x.png  differs from the majority,", "         640x480: 2 px off"]


def test_files_go_by_as_much_of_their_path_as_tells_them_apart():
    assert short_names(["s/a/1.png", "s/a/2.png"]) == ["1.png", "2.png"]
    assert short_names(["s/a/1.png", "s/b/1.png", "s/b/2.png"]) == ["a/1.png", "b/1.png", "2.png"]
    assert short_names(["x/a/1.png", "y/a/1.png", "1.png"]) == ["x/a/1.png", "y/a/1.png", "1.png"]
    assert short_names(["a.png", "a.png", ""]) == ["a.png", "a.png", ""]


def test_a_name_that_is_too_long_keeps_both_ends():
    name = "写真" * 20 + "_0001.png"
    assert cells(shortened(name, 18)) <= 18
    assert shortened(name, 18).startswith("写真")
    assert shortened(name, 18).endswith("_0001.png")
    assert shortened("short.png", 18) == "short.png"


def test_a_line_ends_at_words_and_a_number_keeps_its_uncertainty_and_unit():
    line = "  the lens: fx 458.65 ± 0.41 px, and so on for some more words"
    for width in range(24, 60):
        parts = wrapped(line, width)
        assert all(cells(part) <= width for part in parts)
        assert "458.65 ± 0.41 px," in " | ".join(parts)
        assert " ".join(parts).split() == line.split()
    assert wrapped(line, 30)[1].startswith("    ")
    assert wrapped("wrote /a/" + "x" * 60, 40) == ["wrote", "  /a/" + "x" * 60]
