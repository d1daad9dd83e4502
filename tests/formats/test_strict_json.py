"""JSON as strict as the YAML: what two readers could take differently is refused, faults are named by key path."""

import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats.documents import load_json
from camcal.formats.schema import items, mapping, number

CHECK = mapping({"values": items(number())})


def load(tmp_path, text, check=None):
    path = tmp_path / "a.json"
    path.write_text(text, "utf-8")
    return load_json(path, check)


def test_a_document_holds_plain_data(tmp_path):
    document = load(tmp_path, '{"values": [1, 2.5, 1e-5]}', CHECK)
    assert document["values"] == [1, 2.5, 1e-5]
    assert document.where == str(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "duplicate key 'c'"),
        ('{"a": NaN}', "NaN is not a JSON number"),
        ('{"a": -Infinity}', "-Infinity is not a JSON number"),
    ],
)
def test_what_readers_take_differently_is_refused(tmp_path, text, message):
    with pytest.raises(InvalidInput) as caught:
        load(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'a.json'}: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1', "a.json:1: invalid or truncated JSON"),
        ('{\n"a": }', "a.json:2: invalid or truncated JSON"),
        ("[1, 2]", "a.json: not a JSON object"),
        ("", "a.json: is empty"),
        ("[" * 100_000, "a.json: is nested too deeply"),
    ],
)
def test_what_is_no_json_mapping_cannot_be_read(tmp_path, text, message):
    with pytest.raises(FileError) as caught:
        load(tmp_path, text)
    assert message in str(caught.value)


def test_every_fault_is_listed_with_its_key_path(tmp_path):
    with pytest.raises(InvalidInput) as caught:
        load(tmp_path, '{"values": [1, "x", true], "valeus": 3}', CHECK)
    where = tmp_path / "a.json"
    assert str(caught.value).splitlines() == [
        f"{where}: values[1]: 'x' is not a number",
        f"{where}: values[2]: true is not a number",
        f"{where}: valeus: unknown key. Did you mean 'values'?",
    ]


def test_a_long_list_of_faults_is_cut(tmp_path):
    with pytest.raises(InvalidInput) as caught:
        load(tmp_path, '{"values": [' + ", ".join(['"x"'] * 60) + "]}", CHECK)
    lines = str(caught.value).splitlines()
    assert len(lines) == 51
    assert lines[-1].endswith("and 10 more")
