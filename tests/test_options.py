"""Options records: what they declare, how values are read, written, refused and repeated."""

from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.options import (
    DEGREES,
    INPUT,
    NAMES,
    NUMBER,
    NUMBERS,
    OUTPUT,
    PERCENT,
    SIZE,
    TEXT,
    Argument,
    Option,
    OptionsRecord,
    Without,
    Written,
    assembled,
    by_group,
    command_line,
    declared,
    given_words,
    scaled,
    separated,
)

if TYPE_CHECKING:
    from somewhere import Heavy  # never imported: the record has to do without it


@dataclass(frozen=True)
class Inner(OptionsRecord):
    tone: Annotated[str, Option("A curve.", metavar="NAME", choices=("linear", "srgb"))] = "linear"
    hidden: Annotated[int, Option("Not everywhere.")] = 0
    count: Annotated[int, Option("How many.", names="--most -m", least=1, most=9)] = 3


@dataclass(frozen=True)
class Outer(OptionsRecord):
    inputs: Annotated[tuple[str, ...], Argument("Files.", metavar="FILES…")]
    output: Annotated[
        Path, Option("Where.", group=OUTPUT, names="--output -o", recorded=False, written=Written(folder=True))
    ]
    board: Annotated["Heavy | str | None", Option("A board.", type=TEXT)] = None
    inner: Annotated[Inner, Without(("hidden",))] = Inner()
    share: Annotated[float, Option("A share.", type=PERCENT)] = 0.1
    fix: Annotated[tuple[str, ...], Option("Names.", type=NAMES)] = ()
    dark: Annotated[tuple[str, ...], Option("Files.", group=INPUT)] = ()
    bow: Annotated[tuple[float, float], Option("Two numbers.", values=2, type=scaled(1e-3))] = (0.0, 0.0)
    quick: Annotated[bool, Option("A flag.")] = False
    ruler: Annotated[bool, Option("A flag that is on.")] = True
    tall: Annotated[bool | None, Option("A flag that may be open.", names="--tall/--wide")] = None
    work: int = 5  # for programs only


def option(name):
    return next(each for each in declared(Outer) if each.name == name)


def test_a_record_declares_its_fields_and_those_of_the_records_it_holds():
    names = [each.name for each in declared(Outer)]
    assert names == [
        "FILES…", "--output", "--board", "--tone", "--most", "--share", "--fix", "--dark", "--bow", "--quick",
        "--ruler", "--tall",
    ]  # fmt: skip
    assert [each.name for each in declared(Outer) if each.required] == ["FILES…", "--output"]
    assert option("--most").spellings == ("--most", "-m")
    assert option("--most").path == ("inner", "count")
    assert [option(name).opposite for name in ("--quick", "--ruler", "--tall")] == ["", "--no-ruler", "--wide"]


def test_a_field_whose_type_does_not_say_how_it_is_written_is_a_mistake():
    @dataclass(frozen=True)
    class Wrong:
        view: Annotated[complex, Option("What is this?")] = 0j

    with pytest.raises(TypeError, match="how it is written"):
        declared(Wrong)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("--most", "7", 7),
        ("--share", "20", 0.2),
        ("--fix", "p1, p2", ("p1", "p2")),
        ("--dark", ["a", "b"], ("a", "b")),
        ("--bow", ("1", "-2"), (0.001, -0.002)),
        ("--tall", False, False),
        ("--board", "chessboard:9x6", "chessboard:9x6"),
    ],
)
def test_a_value_is_read_and_written_back(name, text, value):
    each = option(name)
    assert each.read(text) == pytest.approx(value) if name == "--bow" else each.read(text) == value
    if not each.flag:
        written = each.texts(each.read(text))
        assert each.read(written if isinstance(text, (list, tuple)) else written[0]) == each.read(text)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("--most", "x", "Invalid value for '--most': 'x' is not a whole number"),
        ("--most", "1_0", "Invalid value for '--most': '1_0' is not a whole number"),
        ("--most", "0", "Invalid value for '--most': 0 is less than 1"),
        ("--most", "10", "Invalid value for '--most': 10 is more than 9"),
        ("--tone", "flat", "Invalid value for '--tone': 'flat' is not one of linear, srgb"),
        ("--tone", "liner", "Invalid value for '--tone': 'liner' is not one of linear, srgb. Did you mean 'linear'?"),
        ("--share", "ten", "Invalid value for '--share': 'ten' is not a number"),
    ],
)
def test_a_text_that_does_not_do_is_refused_by_name(name, text, message):
    with pytest.raises(InvalidInput) as caught:
        option(name).read(text)
    assert caught.value.message == message


def test_what_is_no_number_is_out_of_every_range():
    with pytest.raises(InvalidInput, match="nan is not a number"):
        Inner(count=nan)


@pytest.mark.parametrize("wrong", [{"count": 0}, {"count": 10}, {"tone": "flat"}])
def test_a_program_is_refused_what_a_command_line_is(wrong):
    with pytest.raises(InvalidInput, match="Invalid value for '--"):
        Inner(**wrong)


def test_the_command_has_every_option_that_differs_from_its_default_in_order():
    assert command_line("work on", Outer(("a", "b c"), Path("out"))) == ["work", "on", "a", "b c"]
    options = Outer(
        ("a",), Path("out"), "b.yaml", Inner("srgb", hidden=3, count=4), 0.25, ("k1", "k2"), ("d", "e"), (0.001, 0.0),
        quick=True, ruler=False, tall=False,
    )  # fmt: skip
    words = ["--board", "b.yaml", "--tone", "srgb", "--most", "4", "--share", "25", "--fix", "k1,k2"]
    words += ["--dark", "d", "--dark", "e", "--bow", "1", "0", "--quick", "--no-ruler", "--wide"]
    assert given_words(options) == words
    assert command_line("work", options) == ["work", "a", *words]


def test_a_record_is_assembled_from_what_was_given():
    given_values = {("inputs",): ("a",), ("output",): Path("o"), ("inner", "count"): 5, ("quick",): True}
    assert assembled(Outer, given_values) == Outer(("a",), Path("o"), inner=Inner(count=5), quick=True)


def test_groups_have_one_order():
    assert list(by_group(declared(Outer))) == ["Input", "Method", "Output"]


@given(st.tuples(st.integers(1, 10**6), st.integers(1, 10**6)))
def test_a_size_is_read_as_it_is_written(size):
    assert SIZE.read(SIZE.write(size)) == size


@pytest.mark.parametrize("text", ["", "x", "12x", "0x3", "3x0", "1x2x3", "-1x2", "1_0x2", "\u0661x2", "1.5x2"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(ValueError):  # noqa: PT011 - the option says it in words
        SIZE.read(text)


@given(st.lists(st.floats(-1e12, 1e12).map(lambda value: float(f"{value:.12g}")), min_size=1))
def test_numbers_are_read_as_they_are_written(values):
    assert NUMBERS.read(NUMBERS.write(values)) == tuple(values)


@given(st.floats(-1e6, 1e6).map(lambda value: float(f"{value:.12g}")))
def test_a_number_in_a_unit_of_its_own_is_read_as_it_was(number):
    for unit in (NUMBER, PERCENT, DEGREES, scaled(1e-3), scaled(1e-6)):
        value = unit.read(repr(number))
        assert unit.read(unit.write(value)) == value


def test_so_many_numbers_are_needed_as_are_asked_for():
    pair = separated("two numbers", ":", 2)
    assert pair.read("6:64") == (6.0, 64.0)
    for text in ("6", "6:7:8", "6:x", "6:inf"):
        with pytest.raises(ValueError):  # noqa: PT011 - the option says it in words
            pair.read(text)
