"""A histogram of values in letters."""

from camcal.report.text_figures import value_histogram


def test_every_value_is_counted_and_the_longest_bar_fills_the_width():
    lines = value_histogram([0.1] * 6 + [0.15, 0.75, 0.9], "RMS, px", 50, "utf-8")
    assert lines[0] == "RMS, px"
    counts = [int(line.split()[3]) for line in lines[1:]]
    assert counts == [7, 0, 0, 2]
    assert max(map(len, lines)) == len(lines[1]) == 50
    assert lines[1].endswith("█")


def test_letters_of_a_narrow_terminal_without_blocks_fit():
    lines = value_histogram([1.0, 1.0, 1.0], "the same value thrice", 40, "ascii")
    assert len(lines) == 2
    assert lines[1].isascii()
    assert max(map(len, lines)) <= 40
