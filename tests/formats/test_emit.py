"""The emitter stays inside the YAML that PyYAML, OpenCV and our own reader understand alike."""

import math

import cv2
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.documents import parse

keys = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.()/+-]{0,10}", fullmatch=True).filter(
    lambda key: key.lower() not in emit.WORDS
)
numbers = st.floats(allow_nan=False, allow_infinity=False)
legible = st.characters(exclude_categories=("Cs", "Cc", "Zl", "Zp"), exclude_characters="\ufeff\ufffe\uffff")
texts = st.one_of(
    st.text(legible, max_size=40),
    st.sampled_from(["yes", "1e-05", "two\nlines", "a\tb", "~", "# no remark", "{", "- 1"]),
)
scalars = st.one_of(st.booleans(), st.integers(-(2**31) + 1, 2**31 - 1), numbers, texts)
trees = st.dictionaries(
    keys,
    st.recursive(
        st.one_of(scalars, st.lists(scalars, max_size=5)),
        lambda inner: st.one_of(st.dictionaries(keys, inner, max_size=4), st.lists(inner, max_size=4)),
        max_leaves=12,
    ),
    min_size=1,
    max_size=5,
)


def rounded(value):
    """The value as 12 significant digits keep it."""
    if isinstance(value, float):
        return float(f"{value:.12g}")
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list) else value


@pytest.mark.slow
@settings(max_examples=50)
@given(trees)
def test_pyyaml_and_our_reader_read_back_what_was_written(tree):
    content = emit.document(tree, "a remark")
    assert yaml.safe_load(content) == rounded(tree)
    assert dict(parse(content, "a.yaml")) == rounded(tree)


@given(numbers)
def test_a_number_keeps_twelve_digits_and_is_a_number_to_every_reader(value):
    content = emit.number_text(value)
    assert "." in content
    assert isinstance(yaml.safe_load(content), float)
    assert math.isclose(float(content), value, rel_tol=5.1e-12, abs_tol=0)  # half a unit of the twelfth digit


def test_zero_has_no_sign():
    assert emit.number_text(-0.0) == "0.0"


@settings(max_examples=50)
@given(trees)
def test_opencv_opens_what_was_written(tree):
    storage = cv2.FileStorage(emit.document(tree), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.isOpened()
    assert {*tree} <= {*storage.root().keys()}


def test_opencv_reads_numbers_names_and_nested_lists():
    tree = {"a": {"R": [[1.0, 0.0], [0.0, 1.5e-7]], "t": [0.1, 2.0]}, "model": "opencv5", "long": [0.5] * 3000}
    storage = cv2.FileStorage(emit.document(tree), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.getNode("a").getNode("R").at(1).at(1).real() == 1.5e-7
    assert storage.getNode("model").string() == "opencv5"
    assert storage.getNode("long").size() == 3000


def test_short_lists_stand_on_one_line_and_matrices_a_row_each():
    tree = {"size": [640, 480], "lens": {"fx": 500.0, "fy": 501.0}, "matrix": [[1.0, 2.0], [3.0, 4.0]]}
    assert emit.document(tree) == (
        "%YAML 1.1\n---\nsize: [640, 480]\nlens: {fx: 500.0, fy: 501.0}\nmatrix:\n  - [1.0, 2.0]\n  - [3.0, 4.0]\n"
    )


@pytest.mark.parametrize("key", ["", "a b", "1st", "a:b", "yes", '"a"', "#a", "a,b"])
def test_a_key_that_some_reader_would_miss_is_refused(key):
    with pytest.raises(InvalidInput, match="invalid key"):
        emit.document({key: 1})


def test_a_text_longer_than_opencv_reads_is_refused():
    emit.document({"a": "x" * 3990})
    with pytest.raises(InvalidInput, match="more than 4000 bytes"):
        emit.document({"a": "x" * 4001})


@pytest.mark.parametrize("letter", ["\udcff", "\x07", "\x85", "\u2028", "\ufeff"])
def test_a_letter_that_some_reader_would_refuse_is_spelt_out(letter):
    content = emit.document({"file": f"a{letter}.png"})
    spelt = f"a{chr(92)}{f'x{ord(letter):02x}' if letter < chr(0x80) else f'u{ord(letter):04x}'}.png"
    assert parse(content, "a.yaml")["file"] == yaml.safe_load(content)["file"] == spelt
    storage = cv2.FileStorage(content, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.getNode("file").string() == spelt
