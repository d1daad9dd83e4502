"""YAML as plain data with lines; what two readers could take differently is refused."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import documents
from camcal.formats.documents import Fault, load, parse
from camcal.formats.schema import flag, integer, items, mapping, number, one_of, text

SCHEMA = mapping(
    {"size": items(integer(1), 2), "lens": mapping({"fx": number(positive=True)}, {"k1": number(-1, 1)})},
    {"name": text, "fixed": flag, "unit": one_of(("metres", "squares"), "unit")},
)
GOOD = "size: [640, 480]\nlens: {fx: 500.5}\n"


def fails(content: str, check: documents.Check | None = SCHEMA) -> list[str]:
    with pytest.raises(InvalidInput) as caught:
        parse(content, "a.yaml", check)
    return str(caught.value).splitlines()


def test_every_key_path_has_its_line():
    document = parse("%YAML 1.1\n---\n# remark\nsize: [640, 480]\nlens:\n  fx: 500.5\n  k1: 0.0\n", "a.yaml", SCHEMA)
    assert document["lens"] == {"fx": 500.5, "k1": 0.0}
    assert [document.line(path) for path in ("size", "size[1]", "lens", "lens.fx", "lens.k1")] == [4, 4, 5, 6, 7]


def test_a_path_the_file_lacks_has_the_line_of_its_innermost_part():
    document = parse("a:\n  b:\n    c: 1\n", "a.yaml")
    assert document.line("a.b.missing[3].deep") == 2
    assert document.line("nowhere") == 1


def test_plain_values_have_the_types_of_yaml():
    document = parse("a: 1\nb: 1.5\nc: true\nd: text\ne: ~\nf: '1'\ng: -2.0e-05\nh: False\n", "a.yaml")
    assert dict(document) == {"a": 1, "b": 1.5, "c": True, "d": "text", "e": None, "f": "1", "g": -2e-5, "h": False}


def test_a_key_that_stands_twice_is_named_with_both_lines():
    assert fails("size: [1, 2]\nlens:\n  fx: 1.0\n  k1: 0.5\n  fx: 2.0\n") == [
        "a.yaml:5: lens: duplicate key 'fx' (first at line 3)"
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("size: &a [640, 480]\nlens: {fx: 1.0}\n", "a.yaml:1: size: anchor &a not supported"),
        ("size: [640, 480]\nlens: *a\n", "a.yaml:2: lens: alias *a not supported"),
        ("size: !!python/tuple [640, 480]\nlens: {fx: 1.0}\n", "a.yaml:1: size: tag tag:yaml.org,2002:python/tuple"),
        ("size: [640, 480]\nlens: {fx: 1.0}\nname: !!str 5\n", "a.yaml:3: name: tag"),
        ("size: [640, 0x1E0]\nlens: {fx: 1.0}\n", "a.yaml:1: size[1]: '0x1E0' is a number in YAML 1.1 only"),
        ("size: [640, 0480]\nlens: {fx: 012}\n", "a.yaml:2: lens.fx: '012' is a number in YAML 1.1 only"),
        ("size: [640, 480]\nlens: {fx: 1:30}\n", "a.yaml:2: lens.fx: '1:30' is a number in YAML 1.1 only"),
        ("size: [640, 480]\nlens: {fx: 1_000.5}\n", "a.yaml:2: lens.fx: '1_000.5' is a number in YAML 1.1 only"),
        (GOOD + "fixed: yes\n", "a.yaml:3: fixed: 'yes' is a boolean in YAML 1.1 only"),
        (GOOD + "name: 2026-11-21\n", "a.yaml:3: name: '2026-11-21' is a date in YAML 1.1; quote it"),
    ],
)
def test_what_another_reader_could_take_differently_is_refused(content, words):
    assert any(line.startswith(words) for line in fails(content))


def test_an_exponent_without_a_dot_is_told_how_to_be_written():
    assert fails("size: [640, 480]\nlens: {fx: 1.0, k1: 1e-05}\n") == [
        "a.yaml:2: lens.k1: '1e-05' was read as text (YAML 1.1 needs 1.0e-05, without quotes)"
    ]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (".nan", ".nan is not finite"),
        ("-.inf", "-.inf is not finite"),
        ("1.0e+999", ".inf is not finite"),
        ("true", "true is not a number"),
        ("wide", "'wide' is not a number"),
        ("[1.0]", "a list is not a number"),
        ("", "an empty value is not a number"),
        ("-458.6", "-458.6 must be > 0"),
    ],
)
def test_a_number_must_be_finite_and_in_its_range(value, words):
    assert fails(f"size: [640, 480]\nlens:\n  fx: {value}\n") == [f"a.yaml:3: lens.fx: {words}"]


def test_all_faults_are_listed_in_the_order_of_the_file():
    assert fails("size: [640, 0, 3]\nlense: {fx: 1.0}\nname: 5\nunit: meters\nfixed: 'no'\n") == [
        "a.yaml:1: size: 3 items; 2 are needed",
        "a.yaml:2: lense: unknown key. Did you mean 'lens'?",
        "a.yaml:3: name: 5 is not text; put it in quotes",
        "a.yaml:4: unit: unknown unit 'meters'. Did you mean 'metres'?",
        "a.yaml:5: fixed: 'no' is not true or false",
    ]


def test_a_missing_key_is_named_at_its_parent():
    assert fails("size: [640, 480]\nlens: {k1: 0.5}\n") == ["a.yaml:2: lens: missing key 'fx'"]


def test_an_unknown_key_without_a_likeness_lists_what_is_possible():
    assert fails(GOOD + "zoom: 3\n") == ["a.yaml:3: zoom: unknown key; possible here: name, fixed, unit"]


def test_vendor_keys_may_hold_any_plain_data_but_no_infinity():
    assert parse(GOOD + "x_lab: {shelf: 3, notes: [a, b]}\n", "a.yaml", SCHEMA)["x_lab"]["shelf"] == 3
    assert fails(GOOD + "x_lab: {depth: .inf}\n") == ["a.yaml:3: x_lab.depth: .inf is not finite"]


def test_many_faults_are_cut_off():
    lines = fails("size: [640, 480]\nlens: {fx: 1.0}\n" + "".join(f"bad{i}: 1\n" for i in range(80)))
    assert lines[-1] == "a.yaml: and 30 more"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("cameras: [1, 2", "a.yaml:2: invalid or truncated YAML"),
        ("a: b: c\n", "a.yaml:1: invalid or truncated YAML"),
        ("just text\n", "a.yaml: not a YAML mapping"),
        ("# only a remark\n", "a.yaml: not a YAML mapping"),
        ("- 1\n- 2\n", "a.yaml: not a YAML mapping"),
        ("a: \x01\n", "a.yaml: invalid YAML"),
        ("%YAML:1.0\n---\na: 1\n", "a.yaml: starts with %YAML:, which only OpenCV reads"),
    ],
)
def test_what_is_no_yaml_mapping_is_a_file_error(content, words):
    with pytest.raises(FileError) as caught:
        parse(content, "a.yaml")
    assert str(caught.value).startswith(words)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xd8\xff\xe0JFIF"])
def test_a_missing_empty_or_binary_file_is_a_file_error(tmp_path, content):
    path = tmp_path / "a.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=r"a\.yaml"):
        load(path)


def test_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load(path, SCHEMA)["lens"] == {"fx": 500.5}


@pytest.mark.parametrize(
    ("content", "limit"),
    [("a: " + "[" * 40 + "]" * 40, "32 levels"), ("a: [" + "1," * 100_001 + "]", "100000 values")],
)
def test_depth_and_count_are_limited(content, limit):
    with pytest.raises(InvalidInput, match=limit):
        parse(content, "a.yaml")


def test_an_alias_bomb_is_refused_before_it_grows():
    bomb = "a: &a [1]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(20)
    )
    assert "alias" in "\n".join(fails(bomb, None))


def test_a_second_document_is_refused():
    assert fails("a: 1\n---\nb: 2\n", None) == ["a.yaml:2: more than one YAML document"]


def test_a_key_that_is_no_name_is_refused():
    assert fails("? [1, 2]\n: 3\n", None) == ["a.yaml:1: keys must be plain text"]


def test_the_error_says_where_the_first_fault_is():
    with pytest.raises(InvalidInput) as caught:
        parse("size: [640, 480]\nlens: {fx: -1.0}\n", "a.yaml", SCHEMA)
    assert caught.value.where == "a.yaml:2"
    assert caught.value.message == "lens.fx: -1.0 must be > 0"


def test_a_fault_may_carry_its_own_line():
    document = parse(GOOD, "a.yaml")
    assert str(document.error([Fault("lens", "odd", 7)])) == "a.yaml:7: lens: odd"


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_with_a_message(content):
    try:
        document = parse(content, "a.yaml", SCHEMA)
    except (InvalidInput, FileError) as error:
        assert str(error).startswith("a.yaml")  # noqa: PT017 either outcome is right, a traceback is not
    else:
        assert document["lens"]["fx"] > 0


scalars = st.one_of(
    st.integers(-(10**17), 10**17),
    st.booleans(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(max_size=20),
)


@given(st.dictionaries(st.from_regex(r"[a-z]{1,8}", fullmatch=True), st.lists(scalars, max_size=4), min_size=1))
def test_what_pyyaml_writes_is_read_as_pyyaml_reads_it(data):
    content = yaml.safe_dump(data)
    read = parse(content, "a.yaml")
    assert dict(read) == {key: yaml.safe_load(content)[key] for key in data}


def test_special_floats_are_read_so_that_a_check_can_name_them():
    document = parse("a: .NaN\nb: .inf\nc: -.Inf\n", "a.yaml")
    assert math.isnan(document["a"])
    assert (document["b"], document["c"]) == (math.inf, -math.inf)
